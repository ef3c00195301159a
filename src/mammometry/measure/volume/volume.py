"""Volume of the closed breast, exact for its mesh.

By the divergence theorem.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from mammometry.base.errors import MeasureError
from mammometry.geometry.arrays import Array, Float64, read_only
from mammometry.geometry.mesh import TriangleMesh
from mammometry.measure.boundary.boundary import Boundary, BreastName
from mammometry.measure.settings import MeasureSettings
from mammometry.measure.volume.definitions import MUSCLE_WALL, DefinedVolume, HalfWidths, define, other_terms_cc
from mammometry.measure.volume.uncertainty import WALL, Evidence, Uncertainty, interval
from mammometry.measure.wall.chest_wall import ChestWall
from mammometry.measure.wall.registry import TORSO_WALLS


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class VolumeMeasurement:
    """One breast, measured."""

    name: BreastName
    """"model", or the patient's "left" or "right"."""
    volume_cc: float
    """Volume between the breast's surface and the wall, cc (1 cc = 1000 mm³)."""
    interval_cc: tuple[float, float] | None
    """95 % interval of the volume, cc. None if it is not known. Never below zero. A torso's interval is about what
    stands out of a flat chest, one that carries the layer found at the boundary behind the breast too.
    """
    as_defined_cc: tuple[float, float] | None = None
    """A torso's 95 % interval of what stands in front of the named wall, wherever the chest is, cc: by how much the
    number itself may be wrong."""
    interval_terms_cc: Mapping[str, float]
    """Half-width at 95 % that each named source contributes, cc. Empty without an interval."""
    interval_note: str
    """What the interval covers and what it leaves out, one sentence."""
    closed: TriangleMesh
    """The closed solid that was integrated, mm, world frame."""
    skin_faces: int
    """Number of leading faces of `closed` that are the breast's skin. The others are its wall."""
    watertight: bool
    """Whether `closed` is closed, oriented and manifold in its edges."""
    wall_kind: str
    """Name of the wall that closes it."""
    wall_definition: str
    """What surface the wall is, one sentence."""
    boundary_world: Float64[Array, "n 3"]
    """The closed boundary curve on the surface, mm, world frame."""
    boundary_method: str
    """How the boundary was found, one sentence."""
    alternatives_cc: Mapping[str, float]
    """Volume with other walls, by name, cc. Information, not an interval."""
    base_area_cm2: float
    """Area of the wall within the boundary, cm²."""
    projection_mm: float
    """Greatest distance of the breast's surface from the boundary's best plane, mm."""
    area_cm2: float
    """Area of the breast's skin (without the wall), cm²."""
    definitions: tuple[DefinedVolume, ...] = ()
    """The volume in every meaning of "the breast", each with an interval of its own. Empty for a cast."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "boundary_world", read_only(self.boundary_world))
        object.__setattr__(self, "alternatives_cc", MappingProxyType(dict(self.alternatives_cc)))
        object.__setattr__(self, "interval_terms_cc", MappingProxyType(dict(self.interval_terms_cc)))

    @property
    def skin(self) -> TriangleMesh:
        """The breast's skin alone, open, mm, world frame."""
        return self.closed.submesh(np.arange(self.skin_faces))

    @property
    def wall(self) -> TriangleMesh:
        """The wall alone, open, mm, world frame."""
        return self.closed.submesh(np.arange(self.skin_faces, len(self.closed.faces)))


def measure(
    boundary: Boundary,
    wall: ChestWall,
    settings: MeasureSettings = MeasureSettings(),
    *,
    alternatives: Sequence[ChestWall] = (),
    evidence: Evidence = Evidence(),
) -> VolumeMeasurement:
    """Measure the solid between the skin and the wall.

    The volume is exact for the closed mesh (divergence theorem); world frame, mm in, cc out.

    Args:
        boundary: around the breast.
        wall: fitted to that boundary.
        settings: uncertainties of boundary and wall.
        alternatives: other walls on the same boundary, for information.
        evidence: what earlier stages know about the errors, for the interval.

    Raises:
        MeasureError: skin and wall do not make a closed solid, or it has no volume.
    """
    watertight = wall.closed.is_watertight()
    volume_cc = wall.closed.volume_mm3() / 1000
    if not watertight or volume_cc <= 0:
        raise MeasureError(
            f"breast {boundary.name!r}",
            found=f"a solid of {volume_cc:.1f} cc that is {'closed' if watertight else 'not closed'}",
            expected="a closed solid with the skin in front of the wall",
            remedy="Check the boundary in the report's picture, or draw it by hand",
        )
    points = boundary.points_world
    normal = np.linalg.svd(points - points.mean(axis=0), full_matrices=False)[2][2]
    heights = (wall.skin.vertices - points.mean(axis=0)) @ normal
    area_cm2 = wall.mesh.area_mm2() / 100
    uncertainty = interval(boundary, wall, volume_cc, settings, evidence)
    return VolumeMeasurement(
        name=boundary.name,
        volume_cc=volume_cc,
        interval_cc=uncertainty.interval_cc,
        as_defined_cc=uncertainty.as_defined_cc,
        interval_terms_cc=uncertainty.terms_cc,
        interval_note=uncertainty.note,
        closed=wall.closed,
        skin_faces=len(wall.skin.faces),
        watertight=watertight,
        wall_kind=wall.kind,
        wall_definition=wall.definition,
        boundary_world=points,
        boundary_method=boundary.method,
        alternatives_cc={other.kind: other.closed.volume_mm3() / 1000 for other in alternatives},
        base_area_cm2=area_cm2,
        projection_mm=float(np.abs(heights).max()),
        area_cm2=wall.skin.area_mm2() / 100,
        definitions=_definitions(boundary, wall, volume_cc, uncertainty, alternatives, settings),
    )


def _definitions(
    boundary: Boundary,
    wall: ChestWall,
    volume_cc: float,
    uncertainty: Uncertainty,
    alternatives: Sequence[ChestWall],
    settings: MeasureSettings,
) -> tuple[DefinedVolume, ...]:
    if boundary.name == "model" or uncertainty.interval_cc is None:
        return ()
    chest_cc = uncertainty.terms_cc[WALL]
    cylinder = next((each for each in (wall, *alternatives) if each.kind == MUSCLE_WALL), None)
    return define(
        boundary.name,
        wall=wall.kind,
        volume_cc=volume_cc,
        measured_wall=TORSO_WALLS[wall.kind].measured,
        errors=HalfWidths(
            chest_cc=chest_cc,
            fit_cc=min(chest_cc, settings.wall_fit_u95_mm * wall.mesh.area_mm2() / 1000),
            other_cc=other_terms_cc(uncertainty.terms_cc, WALL),
        ),
        cylinder=None if cylinder is None else (cylinder.closed.volume_mm3() / 1000, cylinder.mesh.area_mm2() / 100),
        settings=settings.layer,
    )
