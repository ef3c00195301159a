"""Measures of a virtual woman, drawn from the statistics of 101 real women.

The statistics are of breasts that were labelled in prone magnetic resonance images (doi 10.1371/journal.pone.0302974):
the boundary along the crease, the pectoral muscle behind the breast, and the layer of fat and skin that a chest without
a breast would have over it. Only means, standard deviations and correlations are used, and no images.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np

from mammometry.geometry.arrays import Array, Float64

SIDES = ("left", "right")
Pose: TypeAlias = Literal["prone", "leaning"]

RADII = np.array([0.43, 0.54, 0.67, 0.55, 0.47, 0.58, 0.62, 0.59])
"""Ratio of the boundary's radius to the root of its area, every 45° from lateral via the head. ± 0.04 between women."""
WIDTH_MM, HEIGHT_MM = (121.0, 15.0), (167.0, 9.0)
"""Width and height of the boundary: mean and standard deviation between women, mm."""
FLAT_CC = (540.0, 0.36)
"""Volume in front of a flat chest: median, cc, and standard deviation of its logarithm (90 % from 295 to 960 cc)."""
MUSCLE_ASIDE_MM = np.array([25.0, 50.0, 75.0, 100.0, 125.0])
"""Distances from the midline at which the muscle's height is known, mm."""
MUSCLE_MM = np.array([3.6, 4.0, -2.5, -18.0, -33.0])
"""The muscle's height there relative to the midline, mm."""
MUSCLE_SD_MM = np.array([2.4, 3.8, 6.4, 7.3, 6.2])
"""Its standard deviation between women, mm."""
ALONG_PER_M = (2.9, 1.2)
"""Curvature of the muscle along the body: mean and standard deviation, 1/m."""
TWIST_PER_M = (-0.7, 0.9)
"""Twist of the muscle: mean and standard deviation, 1/m."""
TILT_UP_DEG = (6.6, 1.8)
"""Tilt of the boundary's plane back towards the head: mean and standard deviation, degrees."""
LAYER_MM = np.array([24.0, 18.0, 12.0, 16.0])
"""Thickness of the layer normal to the muscle at the boundary: lateral, above, medial, below. mm."""
LAYER_SD_MM = np.array([8.0, 4.0, 4.0, 4.0])
"""Its standard deviation between women, mm."""
LAYER_SECTORS_R, LAYER_SIDES_R = 0.68, 0.92
"""Correlation of the layer between sectors of one breast, and between both breasts."""

_WIDE_CC = (100.0, 1500.0)  # volumes of the wide draw: uniform in their logarithm
_WIDTH_HEIGHT_R = 0.66  # correlation that gives the area's scatter of 28 cm² in 170 cm²
_RADII_SD = 0.045  # scatter of the relative radii before scaling to width and height; after it ± 0.04
_VOLUME_WIDTH_R = 0.65  # correlation of the logarithms of volume and width: gives the apex's ± 18 mm
_SIDES_R = 0.9  # correlation of a woman's sides if the statistics give none; made up
# ratio of mean to largest height in front of the flat chest, which fits volume, area and apex
_FILL, _FILL_SD = 0.42, 0.035
_FILL_GROWTH = 0.45  # power of the mean height in this ratio: gives the apex's ± 18 mm
_TYPICAL_MM = 33.0  # mean height of a typical breast in front of its flat chest, mm
_LAYER_LEAST_MM = 4.0  # thinnest layer
_MIDLINE_MM = (8.0, 2.5)  # distance of a boundary's medial end from the midline: gives the planes' tilt of 7.7°
_MIDLINE_LEAST_MM = 4.0  # smallest such distance
_MUSCLE_LAYER_R = 0.85  # correlation of a deep muscle with a thick lateral layer: gives the planes' tilt of ± 3.4°
_SLOPE_MORE_DEG = 1.2  # slope of the muscle in addition to that of the boundary's plane: gives its tilt of 6.6°
_ROUGH_MM = 1.6  # amplitude of the muscle's unevenness


@dataclass(frozen=True, slots=True, kw_only=True)
class WomanBreast:
    """Measures of one breast seen from the front, mm."""

    volume_cc: float
    """Volume in front of a flat chest, cc. It is matched exactly."""
    middle_mm: tuple[float, float]
    """Centre of the boundary: distance from the midline, height."""
    width_mm: float
    """Width of the boundary."""
    height_mm: float
    """Height of the boundary."""
    radii: tuple[float, ...]
    """Relative radii of the boundary every 45° from lateral via the head. Only their ratios matter."""
    layer_mm: tuple[float, float, float, float]
    """Thickness of the layer normal to the muscle at the boundary: lateral, above, medial, below."""
    fill: float
    """Ratio of mean to largest height in front of the flat chest."""
    fall_mm: tuple[float, float]
    """Offset of the apex from the boundary's centre, to the side and up."""
    run_out: float
    """Additional flatness above and towards the midline, compared with below. 0: none."""


@dataclass(frozen=True, slots=True, kw_only=True)
class WomanShape:
    """A chest, its breasts and the pose."""

    pose: Pose
    """prone: hanging straight ahead from the chest, with steep flanks. leaning: pulled down over a fold."""
    breasts: Mapping[str, WomanBreast]
    """"left" and "right", the patient's own."""
    muscle_mm: Mapping[str, tuple[float, ...]]
    """Side → the muscle's height relative to the midline at `MUSCLE_ASIDE_MM`."""
    along_per_mm: float
    """Curvature of the muscle along the body."""
    slope: float
    """Slope of the muscle back towards the head."""
    twist_per_mm: float
    """Twist of the muscle."""
    side_mm: float
    """Half width of the trunk."""
    thick_mm: float
    """Depth of the trunk from back to front."""
    rough_mm: float
    """Amplitude of the muscle's unevenness."""
    lean_rad: float
    """Forward lean towards the rig."""
    cut_mm: float
    """Depth of an open front mesh, from the top of the breasts."""
    seed: int
    """Seed of the unevenness."""

    @property
    def areas_cm2(self) -> dict[str, float]:
        """Side → area within the boundary, as seen from the front, cm²."""
        return {side: outline_area_mm2(outline_mm(breast)) / 100 for side, breast in self.breasts.items()}


def woman_shape(number: int, seed: int, pose: Pose = "prone", *, wide: bool = False) -> WomanShape:
    """Make a random woman.

    Args:
        number: number in the family.
        seed: seed of the random values.
        pose: posture.
        wide: volumes of 100 to 1500 cc, uniform in their logarithm, instead of those of the real women.
    """
    rng = np.random.default_rng([seed, number, 91, SIDES.index("left") if pose == "prone" else 1])
    shared = rng.normal(size=8)
    common_width, common_volume = shared[0], _VOLUME_WIDTH_R * shared[0] + _rest(_VOLUME_WIDTH_R) * shared[1]
    wide_cc = math.exp(rng.uniform(*np.log(_WIDE_CC)))
    radii_shared, layer_shared = rng.normal(size=8), _sectors(rng)
    muscle_shared = -_MUSCLE_LAYER_R * layer_shared[0] + _rest(_MUSCLE_LAYER_R) * _muscle(rng)
    breasts, muscle = {}, {}
    for side in SIDES:
        wide_one, tall_one, full_one = (
            math.sqrt(_SIDES_R) * common + _rest(math.sqrt(_SIDES_R)) * rng.normal()
            for common in (
                common_width,
                _WIDTH_HEIGHT_R * shared[0] + _rest(_WIDTH_HEIGHT_R) * shared[2],
                common_volume,
            )
        )
        width = WIDTH_MM[0] + WIDTH_MM[1] * float(np.clip(wide_one, -2.5, 2.5))
        height = HEIGHT_MM[0] + HEIGHT_MM[1] * float(np.clip(tall_one, -2.5, 2.5))
        uneven = math.sqrt(_SIDES_R) * radii_shared + _rest(math.sqrt(_SIDES_R)) * rng.normal(size=8)
        radii = RADII + _RADII_SD * np.clip(uneven, -2.5, 2.5)
        volume = FLAT_CC[0] * math.exp(FLAT_CC[1] * float(np.clip(full_one, -2.5, 2.5)))
        if wide:
            volume = wide_cc * math.exp(rng.normal(0.0, 0.1))
            grown = (volume / FLAT_CC[0]) ** 0.2  # a base grows less than its breast
            width, height = width * min(grown, 1.15), height * min(grown, 1.15)
        layer = math.sqrt(LAYER_SIDES_R) * layer_shared + _rest(math.sqrt(LAYER_SIDES_R)) * _sectors(rng)
        shape = WomanBreast(
            volume_cc=volume, middle_mm=(0.0, 0.0), width_mm=width, height_mm=height,
            radii=tuple(radii.tolist()),
            layer_mm=tuple(np.maximum(LAYER_MM + LAYER_SD_MM * layer, _LAYER_LEAST_MM).tolist()),
            fill=0.4, fall_mm=(0.0, 0.0), run_out=0.0,
        )  # fmt: skip
        outline = outline_mm(shape)
        mean_mm = volume * 1000 / outline_area_mm2(outline)
        fill = _FILL * (mean_mm / _TYPICAL_MM) ** _FILL_GROWTH * math.exp(rng.normal(0.0, _FILL_SD / _FILL))
        fall = (rng.normal(4.0, 4.0), rng.normal(-6.0, 5.0))
        if pose == "leaning":
            fall = (rng.normal(3.0, 4.0), -rng.uniform(0.35, 0.7) * mean_mm)
        gap = max(rng.normal(*_MIDLINE_MM), _MIDLINE_LEAST_MM)
        breasts[side] = WomanBreast(
            volume_cc=volume, width_mm=width, height_mm=height, radii=shape.radii, layer_mm=shape.layer_mm,
            middle_mm=(gap - float(outline[:, 0].min()), rng.normal(0.0, 2.0)),
            fill=float(np.clip(fill, 0.3, 0.6)), fall_mm=fall,
            run_out=float(np.clip(rng.normal(0.65, 0.15), 0.2, 1.0)),
        )  # fmt: skip
        own = math.sqrt(_SIDES_R) * muscle_shared + _rest(math.sqrt(_SIDES_R)) * _muscle(rng)
        muscle[side] = tuple((MUSCLE_MM + MUSCLE_SD_MM * own).tolist())
    return WomanShape(
        pose=pose,
        breasts=breasts,
        muscle_mm=muscle,
        along_per_mm=max(ALONG_PER_M[0] + ALONG_PER_M[1] * float(shared[3]), 0.2) / 1000,
        slope=math.tan(math.radians(TILT_UP_DEG[0] + _SLOPE_MORE_DEG + TILT_UP_DEG[1] * float(shared[4]))),
        twist_per_mm=(TWIST_PER_M[0] + TWIST_PER_M[1] * float(shared[5])) / 1000,
        side_mm=158.0 + 8.0 * float(np.clip(shared[6], -2.0, 2.0)),
        thick_mm=205.0 + 14.0 * float(np.clip(shared[7], -2.0, 2.0)),
        rough_mm=_ROUGH_MM,
        lean_rad=math.radians(rng.uniform(27.0, 42.0)),
        cut_mm=rng.uniform(110.0, 200.0),
        seed=int(rng.integers(1 << 31)),
    )


def outline_mm(breast: WomanBreast, count: int = 360) -> Float64[Array, "n 2"]:
    """The boundary relative to its centre, to the side and up, mm, anticlockwise from lateral."""
    from scipy.interpolate import CubicSpline

    knots = np.array([*breast.radii, breast.radii[0]])
    turn = np.arange(count) * 2 * math.pi / count
    radius = CubicSpline(np.arange(9) * math.pi / 4, knots, bc_type="periodic")(turn)
    curve = radius[:, None] * np.stack([np.cos(turn), np.sin(turn)], axis=1)
    curve = curve * np.array([breast.width_mm, breast.height_mm]) / np.ptp(curve, axis=0)
    return np.asarray(curve)


def outline_area_mm2(curve: Float64[Array, "n 2"]) -> float:
    """Area within a closed curve, mm²."""
    following = np.roll(curve, -1, axis=0)
    return float((curve[:, 0] * following[:, 1] - curve[:, 1] * following[:, 0]).sum()) / 2


def _rest(correlation: float) -> float:
    return math.sqrt(1.0 - correlation**2)


def _sectors(rng: np.random.Generator) -> Float64[Array, 4]:
    """Four numbers of unit variance, correlated like the layer's sectors."""
    return math.sqrt(LAYER_SECTORS_R) * rng.normal() + _rest(math.sqrt(LAYER_SECTORS_R)) * rng.normal(size=4)


def _muscle(rng: np.random.Generator) -> Float64[Array, 5]:
    """Five numbers of unit variance for the heights of a muscle, correlated by distance."""
    apart = np.abs(MUSCLE_ASIDE_MM[:, None] - MUSCLE_ASIDE_MM[None])
    return np.linalg.cholesky(np.exp(-apart / 60.0)) @ rng.normal(size=5)
