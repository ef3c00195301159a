"""A measured breast by each definition of "the breast", and what one side lacks to the other.

Surgeons mean different things by a breast's volume: what stands out of a flat chest, what lies in front of one named
surface, or all tissue down to the muscle, as on the scales after a mastectomy. On real women these differ by a third.
No interval covers two meanings (docs/decisions/0029).
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
"""Lateral, upper, medial and lower thickness of real women, mean, mm."""
FEWEST_LAYERS = 2
"""Thicknesses of one side that are needed. With fewer, the mean of real women is used."""
MEAN_LAYER_MM = 17.8
"""Distance between the cylinder membrane and the muscle, mean of 145 breasts, mm."""
LAYER_U95_MM = 12.0
"""Half-width of its 95 % interval if no thickness was measured, mm. Of the same breasts."""
OVER_LAYER_MM = 0.6
"""Excess of that over the mean layer normal to the muscle at the boundary: 17.8 less 17.2, mm."""
MEASURED_LAYER_U95_MM = 5.0
"""Half-width with four measured thicknesses, mm: 4.7 on real women, each thickness ± 2 mm."""
MISSING_LAYER_U95_MM = 3.0
"""Added for two missing quadrants, mm (root of the sum of squares): quadrants of one breast correlate by .6 to .75 and
their mean has ± 4.5 mm between women."""

Meaning: TypeAlias = Literal["flat chest", "named wall", "muscle", "measured wall"]

DENSITY_G_PER_CC, DENSITY_SD = 0.97, 0.04
"""Density of breast tissue and its standard deviation between women, g/cc. Specimens of 31 women had .94 ± .02
(doi 10.1055/a-2253-8442), of 108 women .96 ± .04 above and 1.01 ± .08 below 50 years (Arch Aesthetic Plast Surg 25(4),
2019). Taken between both, with a scatter that holds both."""
LEAST_OF_LAYER = 0.5
"""Least share of an assumed layer's volume that must stand out before it, for the layer to be added."""
MUSCLE_WALL = "cylinder-membrane"
"""The wall from which the layer before the muscle is counted."""


@dataclass(frozen=True, slots=True, kw_only=True)
class DefinedVolume:
    """The volume of a breast in one meaning of the word."""

    meaning: Meaning
    """Meaning of "the breast"."""
    volume_cc: float
    """Volume, cc."""
    interval_cc: tuple[float, float]
    """95 % interval of this meaning alone, cc. Never below zero."""
    sentence: str
    """Definition of the meaning, one sentence."""

    @property
    def half_percent(self) -> float:
        """Half of the interval's width, % of the volume."""
        low, high = self.interval_cc
        return 50 * (high - low) / self.volume_cc

    @property
    def weight_g(self) -> tuple[float, float]:
        """Weight of this volume of breast tissue, and its half-width, g.

        The half-width is that of the 95 % interval. The density of the patient's tissue is not known.
        """
        low, high = self.interval_cc
        half = np.hypot((high - low) / 2 * DENSITY_G_PER_CC, COVERAGE_95 * DENSITY_SD * self.volume_cc)
        return self.volume_cc * DENSITY_G_PER_CC, float(half)


@dataclass(frozen=True, slots=True, kw_only=True)
class HalfWidths:
    """Half-widths at 95 % of a volume's sources of error, cc."""

    chest_cc: float
    """By which the wall may lie off a flat chest (off the chest, if it was measured)."""
    fit_cc: float
    """By which the wall may lie off what its name means."""
    other_cc: float
    """All other sources of error."""


def layer_before_muscle_mm(side: str, settings: LayerSettings) -> tuple[float, float, int]:
    """Mean height of the layer before the muscle, mm.

    Returns:
        Height over the base from the muscle to the cylinder membrane; its 95 % half-width, mm; how many thicknesses of
        that side it rests on.

    With two or more measured thicknesses the mean layer is theirs; a quadrant that was not measured is taken to differ
    from its usual thickness as the others do.
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
    """All meanings of one breast's volume, the leading one first.

    Args:
        side: left or right.
        wall: name of the wall that closes it.
        volume_cc: before that wall, cc.
        measured_wall: whether the wall was measured by itself.
        errors: how far the volume may be off, by source.
        cylinder: volume before the cylinder membrane, cc, and its base, cm²; None where that wall does not fit.
        settings: what is known of the layer before the muscle.

    Down to the muscle only where the layer was measured, or less of it is assumed than twice what stands out: other
    women's layer says little of a flat chest's or a man's.
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
    """Note on thicknesses that were entered and do not count."""
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
    """Half-width of all sources but the wall's, cc."""
    return float(np.linalg.norm([term for name, term in terms_cc.items() if name != wall]))


@value(eq=False)
class VolumeMeasurement:
    """One breast, measured."""

    name: BreastName
    """"model", or the patient's "left" or "right"."""
    volume_cc: float
    """Volume between the breast's surface and the wall, cc (1 cc = 1000 mm³)."""
    interval_cc: tuple[float, float] | None
    """95 % interval of the volume, cc. None if it is not known. Never below zero. A torso's interval is about what
    stands out of a flat chest, one that carries the layer found at the boundary behind the breast too."""
    as_defined_cc: tuple[float, float] | None = None
    """A torso's 95 % interval of what stands in front of the named wall, wherever the chest is, cc: by how much the
    number itself may be wrong."""
    interval_terms_cc: Mapping[str, float]
    """Half-width at 95 % that each named source contributes, cc. Empty without an interval."""
    common_cc: Mapping[str, tuple[float, ...]] = field(default_factory=dict)
    """Source → signed changes of the volume by errors of its capture that are independent of one another and common to
    all its volumes, cc, at 95 %. What a source contributes beyond them is this volume's own. Its errors and another
    breast's cancel by them (`difference`)."""
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
    boundary_remarks: tuple[BoundaryRemark, ...] = ()
    """Facts about the boundary by which programs decide: ``given``, ``head-not-shown``, ``to-be-confirmed``."""

    @property
    def skin(self) -> TriangleMesh:
        """The breast's skin alone, open, mm, world frame."""
        return self.closed.submesh(np.arange(self.skin_faces))

    @property
    def wall(self) -> TriangleMesh:
        """The wall alone, open, mm, world frame."""
        return self.closed.submesh(np.arange(self.skin_faces, len(self.closed.faces)))

    def sunk(self, up: Float64[Array, 3]) -> float:
        """Height of the boundary's middle over the centre of mass.

        As a share of half the boundary's height. Breasts are fuller below: 25 virtual bodies, prone and leaning, had
        .05 to .6. Below 0 they hang upwards.
        """
        corners = self.closed.corners() - self.boundary_world[0]
        volumes = np.einsum("ij,ij->i", corners[:, 0], np.cross(corners[:, 1], corners[:, 2]))
        mass = float((corners.sum(axis=1) / 4 @ up) @ volumes / volumes.sum())
        rim = (self.boundary_world - self.boundary_world[0]) @ up
        return float((rim.max() + rim.min()) / 2 - mass) / (float(np.ptp(rim)) / 2)


@value(eq=False)
class VolumeDeficit:
    """Volume that one side lacks to the mirrored other one."""

    name: Literal["left", "right"]
    """The side that lacks, the patient's own."""
    volume_cc: float
    """Volume between the mirrored skin of the other side and the skin of this one, cc."""
    interval_cc: tuple[float, float] | None
    """95 % interval, cc. None if the other side's volume has none."""
    terms_cc: Mapping[str, float]
    """Half-width at 95 % that each named source contributes, cc. Empty without an interval."""
    curves: int
    """How many sides bear a boundary: 1 or 2."""
    boundary_world: Float64[Array, "n 3"]
    """The other side's boundary, mirrored and laid onto the skin of this side, mm, world frame."""
    note: str
    """What the volume is and what its interval covers."""
