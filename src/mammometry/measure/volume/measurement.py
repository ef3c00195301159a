"""A measured breast by each definition of "the breast", and the volume deficit of one side.

A breast's volume can mean the volume above a flat chest, the volume in front of a named surface, or all tissue down to
the muscle, as weighed after a mastectomy. On real women these differ by a third, so each has an interval of its own
(docs/decisions/0029).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Literal, TypeAlias

import numpy as np

from mammometry.base.normal import COVERAGE_95
from mammometry.base.value import value
from mammometry.geometry import Array, Float64, TriangleMesh
from mammometry.measure.boundary import BoundaryRemark
from mammometry.measure.settings import LayerSettings

if TYPE_CHECKING:
    from mammometry.measure.boundary.boundary import BreastName


USUAL_LAYER_MM = (24.0, 18.0, 12.0, 16.0)
"""Mean lateral, upper, medial and lower thickness of real women, mm."""
FEWEST_LAYERS = 2
"""Least number of measured thicknesses per side. With fewer, the mean of real women is used."""
MEAN_LAYER_MM = 17.8
"""Distance between the cylinder membrane and the muscle: mean of 145 breasts, mm."""
LAYER_U95_MM = 12.0
"""Half-width of that distance's 95 % interval if no thickness was measured, from the same breasts, mm."""
OVER_LAYER_MM = 0.6
"""That distance minus the mean layer normal to the muscle at the boundary: 17.8 − 17.2, mm."""
MEASURED_LAYER_U95_MM = 5.0
"""Half-width with four measured thicknesses, mm: 4.7 on real women, with ± 2 mm per thickness."""
MISSING_LAYER_U95_MM = 3.0
"""Added for two missing quadrants, mm (root of the sum of squares): quadrants of one breast correlate by 0.6 to 0.75,
and their mean varies by ± 4.5 mm between women."""

Meaning: TypeAlias = Literal["flat chest", "named wall", "muscle", "measured wall"]

DENSITY_G_PER_CC, DENSITY_SD = 0.97, 0.04
"""Density of breast tissue and its standard deviation between women, g/cc: between two studies, with a scatter that
covers both. Specimens of 31 women: 0.94 ± 0.02 (doi 10.1055/a-2253-8442); of 108 women: 0.96 ± 0.04 above and
1.01 ± 0.08 below 50 years (Arch Aesthetic Plast Surg 25(4), 2019)."""
LEAST_OF_LAYER = 0.5
"""An assumed layer is added only if the breast in front of it has at least this share of the layer's volume."""
MUSCLE_WALL = "cylinder-membrane"
"""Wall to which the layer's thickness refers."""


@dataclass(frozen=True, slots=True, kw_only=True)
class DefinedVolume:
    """Volume of a breast by one definition."""

    meaning: Meaning
    """Definition of "the breast"."""
    volume_cc: float
    """Volume, cc."""
    interval_cc: tuple[float, float]
    """95 % interval for this definition, cc. Never below zero."""
    sentence: str
    """The definition, one sentence."""

    @property
    def weight_g(self) -> tuple[float, float]:
        """Weight of this volume of breast tissue, and the half-width of its 95 % interval, g."""
        low, high = self.interval_cc
        half = np.hypot((high - low) / 2 * DENSITY_G_PER_CC, COVERAGE_95 * DENSITY_SD * self.volume_cc)
        return self.volume_cc * DENSITY_G_PER_CC, float(half)


@dataclass(frozen=True, slots=True, kw_only=True)
class HalfWidths:
    """Half-widths at 95 % of a volume's sources of error, cc."""

    chest_cc: float
    """Difference between the wall and a flat chest (for a measured wall: the chest)."""
    fit_cc: float
    """Difference between the wall and its own definition."""
    other_cc: float
    """All other sources of error."""


def layer_before_muscle_mm(side: str, settings: LayerSettings) -> tuple[float, float, int]:
    """Mean height of the layer in front of the muscle, from the muscle to the cylinder membrane.

    A quadrant that was not measured is assumed to differ from its usual thickness by as much as the measured ones.

    Returns:
        Height and its 95 % half-width, mm; number of thicknesses used, 0 for the mean of real women.
    """
    usual = np.array(USUAL_LAYER_MM)
    measured = np.array(settings.of(side))
    known = measured > 0
    count = int(known.sum())
    if count < FEWEST_LAYERS:
        return MEAN_LAYER_MM, LAYER_U95_MM, 0
    layer = float(usual.mean() + (measured - usual)[known].mean())
    missing = MISSING_LAYER_U95_MM * (len(usual) - count) / 2
    return layer + OVER_LAYER_MM, float(np.hypot(MEASURED_LAYER_U95_MM, missing)), count


def define(
    side: str,
    *,
    wall: str,
    volume_cc: float,
    measured_wall: bool,
    errors: HalfWidths,
    cylinder: tuple[float, float] | None,
    settings: LayerSettings,
) -> tuple[DefinedVolume, ...]:
    """One breast's volume by each definition, the leading one first.

    The volume down to the muscle is given only if the layer was measured, or if an assumed layer is less than twice the
    volume in front of it: the mean of women does not apply to a flat or a male chest.

    Args:
        side: left or right.
        wall: name of the wall that closes it.
        volume_cc: volume in front of that wall, cc.
        measured_wall: whether the wall was measured separately.
        errors: half-widths by source.
        cylinder: volume in front of the cylinder membrane, cc, and its base, cm²; None if that wall does not fit.
        settings: thicknesses of the layer in front of the muscle.
    """
    if measured_wall:
        sentence = "All that lies before the wall that was measured by itself."
        return (_defined("measured wall", volume_cc, np.hypot(errors.chest_cc, errors.other_cc), sentence),)
    found = [
        _defined(
            "flat chest",
            volume_cc,
            np.hypot(errors.chest_cc, errors.other_cc),
            "What stands out of a flat chest, whose layer of fat and skin goes on behind the breast.",
        ),
        _defined(
            "named wall",
            volume_cc,
            np.hypot(errors.fit_cc, errors.other_cc),
            f"What lies before the {wall}, wherever the chest is: to compare measurements by.",
        ),
    ]
    mean_mm, u95_mm, count = layer_before_muscle_mm(side, settings)
    if cylinder is not None and (count or volume_cc >= LEAST_OF_LAYER * mean_mm * cylinder[1] / 10):
        before_cc, base_cm2 = cylinder
        basis = (
            f"by {count} thicknesses measured at the boundary"
            if count
            else f"by the {mean_mm:.1f} mm that real women have on average{_too_few(side, settings)}"
        )
        found.append(
            _defined(
                "muscle",
                before_cc + mean_mm * base_cm2 / 10,
                np.hypot(u95_mm * base_cm2 / 10, errors.other_cc),
                f"All tissue down to the muscle, as weighed after a mastectomy: with the layer behind it, {basis}.",
            )
        )
    return tuple(found)


def _too_few(side: str, settings: LayerSettings) -> str:
    """Note on thicknesses that were entered but are too few."""
    entered = sum(thickness > 0 for thickness in settings.of(side))
    return f" ({entered} measured, {FEWEST_LAYERS} are needed to count)" if 0 < entered < FEWEST_LAYERS else ""


def _defined(meaning: Meaning, volume_cc: float, half_cc: float, sentence: str) -> DefinedVolume:
    return DefinedVolume(
        meaning=meaning,
        volume_cc=float(volume_cc),
        interval_cc=(max(float(volume_cc - half_cc), 0.0), float(volume_cc + half_cc)),
        sentence=sentence,
    )


def other_terms_cc(terms_cc: Mapping[str, float], wall: str) -> float:
    """Half-width of all sources except the wall, cc."""
    return float(np.linalg.norm([term for name, term in terms_cc.items() if name != wall]))


@value(eq=False)
class VolumeMeasurement:
    """One breast, measured."""

    name: BreastName
    """``model``, or the patient's ``left`` or ``right``."""
    volume_cc: float
    """Volume between the breast's surface and the wall, cc (1 cc = 1000 mm³)."""
    interval_cc: tuple[float, float] | None
    """95 % interval of the volume, cc. None if unknown. Never below zero. For a torso it refers to the volume above a
    flat chest, with the layer found at the boundary continued behind the breast."""
    as_defined_cc: tuple[float, float] | None = None
    """For a torso: 95 % interval of the volume in front of the named wall, cc, regardless of the true chest."""
    interval_terms_cc: Mapping[str, float]
    """Contribution of each source: half-width at 95 %, cc. Empty without an interval."""
    common_cc: Mapping[str, tuple[float, ...]] = field(default_factory=dict)
    """Source → signed changes of the volume, cc at 95 %, by independent errors that all volumes of the capture share.
    The rest of a source's contribution is this volume's own (`difference`)."""
    interval_note: str
    """What the interval covers and what it does not, one sentence."""
    closed: TriangleMesh
    """The closed solid that was integrated, mm, world frame."""
    skin_faces: int
    """Number of faces of the breast's skin, which come first in `closed`. The others are the wall."""
    watertight: bool
    """Whether `closed` is closed, oriented and edge-manifold."""
    wall_kind: str
    """Name of the wall that closes it."""
    wall_definition: str
    """Definition of the wall, one sentence."""
    boundary_world: Float64[Array, "n 3"]
    """The closed boundary curve on the surface, mm, world frame."""
    boundary_method: str
    """How the boundary was found, one sentence."""
    alternatives_cc: Mapping[str, float]
    """Volume with other walls, by name, cc; for comparison."""
    base_area_cm2: float
    """Area of the wall within the boundary, cm²."""
    projection_mm: float
    """Greatest distance of the breast's surface from the boundary's best plane, mm."""
    area_cm2: float
    """Area of the breast's skin, cm²."""
    definitions: tuple[DefinedVolume, ...] = ()
    """The volume by each definition of "the breast". Empty for a cast."""
    boundary_remarks: tuple[BoundaryRemark, ...] = ()
    """Facts about the boundary, as codes: ``given``, ``head-not-shown``, ``to-be-confirmed``, ``confirmed``."""

    @property
    def skin(self) -> TriangleMesh:
        """The breast's skin, open, mm, world frame."""
        return self.closed.submesh(np.arange(self.skin_faces))

    @property
    def wall(self) -> TriangleMesh:
        """The wall, open, mm, world frame."""
        return self.closed.submesh(np.arange(self.skin_faces, len(self.closed.faces)))

    def inferior_shift(self, up: Float64[Array, 3]) -> float:
        """Distance of the centre of mass below the boundary's centre, relative to half the boundary's height.

        Breasts are fuller below: 25 virtual bodies, prone and leaning, had 0.05 to 0.6. Negative: they hang upwards.
        """
        corners = self.closed.corners() - self.boundary_world[0]
        volumes = np.einsum("ij,ij->i", corners[:, 0], np.cross(corners[:, 1], corners[:, 2]))
        mass = float((corners.sum(axis=1) / 4 @ up) @ volumes / volumes.sum())
        rim = (self.boundary_world - self.boundary_world[0]) @ up
        return float((rim.max() + rim.min()) / 2 - mass) / (float(np.ptp(rim)) / 2)


@value(eq=False)
class VolumeDeficit:
    """Volume deficit of one side relative to the mirrored other one."""

    name: Literal["left", "right"]
    """The smaller side, the patient's own."""
    volume_cc: float
    """Volume between the mirrored skin of the other side and the skin of this one, cc."""
    interval_cc: tuple[float, float] | None
    """95 % interval, cc. None if the other side's volume has none."""
    terms_cc: Mapping[str, float]
    """Contribution of each source: half-width at 95 %, cc. Empty without an interval."""
    curves: int
    """Number of sides with a boundary: 1 or 2."""
    boundary_world: Float64[Array, "n 3"]
    """The other side's boundary, mirrored onto the skin of this side, mm, world frame."""
    note: str
    """Definition of the volume, and what its interval covers."""
