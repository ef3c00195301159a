"""Volume of the closed breast, exact for its mesh. By the divergence theorem."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mammometry.base.errors import MeasureError
from mammometry.measure.boundary.boundary import Boundary
from mammometry.measure.settings import MeasureSettings
from mammometry.measure.volume.definitions import MUSCLE_WALL, DefinedVolume, HalfWidths, define, other_terms_cc
from mammometry.measure.volume.measurement import VolumeMeasurement
from mammometry.measure.volume.uncertainty import WALL, Evidence, Uncertainty, interval
from mammometry.measure.wall.chest_wall import ChestWall
from mammometry.measure.wall.registry import TORSO_WALLS

_WIDEST = 0.5  # share of a volume by which it may be wrong; more is no result


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
    _require_known(boundary.name, volume_cc, uncertainty)
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


def _require_known(name: str, volume_cc: float, uncertainty: Uncertainty) -> None:
    """Refuse a torso's volume in front of its wall that is no better known than by half.

    Where the chest lies behind a small breast does not count: that is no fault of what was seen.

    Raises:
        MeasureError: names the largest causes.
    """
    if uncertainty.as_defined_cc is None:
        return
    low, high = uncertainty.as_defined_cc
    half = max(high - volume_cc, volume_cc - low)
    if half <= _WIDEST * volume_cc:
        return
    largest = sorted(uncertainty.terms_cc.items(), key=lambda term: -term[1])[:2]
    causes = " and ".join(f"{cause} ± {term:.0f} cc" for cause, term in largest)
    raise MeasureError(
        f"breast {name!r}",
        found=f"a volume of {volume_cc:.0f} ± {half:.0f} cc ({causes})",
        expected=f"an uncertainty of at most ± {100 * _WIDEST:.0f} %",
        remedy="Check the boundary in the picture, or draw it with `mammometry edit`",
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
    cylinder = next((candidate for candidate in (wall, *alternatives) if candidate.kind == MUSCLE_WALL), None)
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
