"""The first disparities: semi-global matching where the subject is small."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np

from mammometry.base.machine.cores import in_bands
from mammometry.geometry.arrays import Array, Bool, Float32, UInt8
from mammometry.matching.filters import blur, gaussian_taps
from mammometry.matching.noise import noise_variance
from mammometry.matching.pyramid import Level
from mammometry.matching.semiglobal.semiglobal_kernels import COSTS_TO_ONE, aggregate, cheapest, matching_costs

_SMALL_STEP, _LARGE_STEP = COSTS_TO_ONE // 4, COSTS_TO_ONE  # of the shift by 1 px and by more; chosen by eye
_OUTSIDE = 1.2  # cost of a partner that is not the subject; two unrelated neighbourhoods cost 1; chosen by eye
_CALM_PX = 1.0  # Gaussian σ before pixels two apart are taken: half of that distance
_POWER_PX = 1.5  # Gaussian σ over which a neighbourhood's variance is averaged: its own width
_GRAIN = 4.0  # times the noise that is seen: compressed pictures hide most; 4 to 8 measured alike (docs/decisions/0015)
_FLAT = 1e-3  # standard deviation of luma (0…1) below which a neighbourhood weighs less: a quarter of an 8-bit step


def span_px(mask: Bool[Array, "h w"]) -> float:
    """The subject's size: side of the square of its area, pixels."""
    return float(np.sqrt(np.count_nonzero(mask)))


def start(
    left: Level,
    right: Level,
    noise: tuple[Float32[Array, "h w"], Float32[Array, "h w"]],
    range_share: float,
) -> tuple[Float32[Array, "h w"], Float32[Array, "h w"]]:
    """First shifts of both directions, by semi-global matching.

    Right − left seen from the left image and left − right seen from the right one, pixels of this level. The search
    covers ± `range_share` of the subject's width around the shift between the two centroids. `noise` is its variance
    around each pixel of either image.
    """
    columns = [np.nonzero(level.mask.any(axis=0))[0] for level in (left, right)]
    width = max(int(c[-1] - c[0] + 1) for c in columns)
    centres = [
        float(np.average(np.arange(level.mask.shape[1]), weights=level.mask.sum(axis=0))) for level in (left, right)
    ]
    reach = max(int(np.ceil(range_share * width)), 2)
    return _searched(left, right, noise, round(centres[1] - centres[0]) - reach, 2 * reach + 1)


def both_ways(
    left: Level, right: Level, lowest: int, count: int
) -> tuple[Float32[Array, "h w"], Float32[Array, "h w"]]:
    """Shifts of both directions, as in `start`, of two whole pictures.

    Right − left is one of `count` whole numbers from `lowest` on, pixels. Their noise is measured in them.
    """
    return _searched(left, right, (noise_variance(left, ()), noise_variance(right, ())), lowest, count)


def _searched(
    left: Level,
    right: Level,
    noise: tuple[Float32[Array, "h w"], Float32[Array, "h w"]],
    lowest: int,
    count: int,
) -> tuple[Float32[Array, "h w"], Float32[Array, "h w"]]:
    with ThreadPoolExecutor(2) as pool:
        here, there = pool.map(_unit_neighbourhoods, (left, right), noise)

    def cost(rows: slice) -> UInt8[Array, "n w d"]:
        pictures = (here[rows], there[rows], left.mask[rows], right.mask[rows])
        return np.asarray(matching_costs(*pictures, lowest, count, _OUTSIDE))

    total = aggregate(np.concatenate(in_bands(cost, len(here))), left.mask, _SMALL_STEP, _LARGE_STEP)
    found = in_bands(lambda rows: cheapest(total[rows], left.mask[rows], lowest), len(total))
    return np.concatenate([ours for ours, _ in found]), np.concatenate([theirs for _, theirs in found])


def _unit_neighbourhoods(level: Level, noise: Float32[Array, "h w"]) -> Float32[Array, "h w 18"]:
    """Two neighbourhoods of each pixel, of unit length together.

    Without their means over the subject's pixels; 0 outside the subject. The first is of 3 × 3 adjacent pixels: on
    steep skin, which one picture shows narrower than the other, no larger one fits. Its share is that of its variance
    which is not noise; what is left has the second, of 3 × 3 pixels of the calmed image two apart: on shaded skin the
    first one would find nothing but chance.
    """
    near, near_power = _neighbourhood(level.image, level.mask, 1)
    far, far_power = _neighbourhood(blur(level.image, gaussian_taps(_CALM_PX)), level.mask, 2)
    power = blur(near_power, gaussian_taps(_POWER_PX)) / 8  # nine values without their mean
    share = np.clip(1 - _GRAIN * noise / np.maximum(power, 1e-12), 0, 1)
    near *= np.sqrt(share / (near_power + 9 * _FLAT**2))[..., None]
    far *= np.sqrt((1 - share) / (far_power + 9 * _FLAT**2))[..., None]
    return np.concatenate([near, far], axis=2, dtype=np.float32)


def _neighbourhood(
    image: Float32[Array, "h w"], mask: Bool[Array, "h w"], spacing: int
) -> tuple[Float32[Array, "h w 9"], Float32[Array, "h w"]]:
    """3 × 3 pixels, `spacing` apart, and the sum of their squares.

    Less the mean of the subject's among them; 0 where not the subject's.
    """
    height, width = mask.shape
    padded = np.pad(image, spacing, mode="edge")
    subject = np.pad(mask, spacing).astype(np.float32)
    offsets = [(i * spacing, j * spacing) for i in range(3) for j in range(3)]
    values = np.stack([padded[i : i + height, j : j + width] for i, j in offsets], axis=2)
    weights = np.stack([subject[i : i + height, j : j + width] for i, j in offsets], axis=2)
    mean = (values * weights).sum(axis=2) / np.maximum(weights.sum(axis=2), 1)
    values = (values - mean[..., None]) * weights
    return values, (values**2).sum(axis=2)
