"""The first disparities: semi-global matching where the subject is small."""

import numpy as np

from mammometry.geometry.arrays import Array, Bool, Float32
from mammometry.matching.pyramid import Level
from mammometry.matching.semiglobal import aggregate, cheapest, matching_costs

_SMALL_STEP = 0.25
_LARGE_STEP = 1.0
_OUTSIDE = 1.2  # cost of a partner that is not the subject; two unrelated neighbourhoods cost 1
_FLAT = 1e-3  # standard deviation of luma below which a neighbourhood weighs less


def span_px(mask: Bool[Array, "h w"]) -> float:
    """Side of the square of the subject's area, pixels: its size whatever its shape."""
    return float(np.sqrt(np.count_nonzero(mask)))


def start(left: Level, right: Level, range_share: float) -> tuple[Float32[Array, "h w"], Float32[Array, "h w"]]:
    """Shifts right − left seen from the left image and left − right seen from the right one, pixels of this level.

    Searched are shifts within ± `range_share` of the subject's width around the shift between the two centroids.
    """
    columns = [np.nonzero(level.mask.any(axis=0))[0] for level in (left, right)]
    width = max(int(c[-1] - c[0] + 1) for c in columns)
    centres = [
        float(np.average(np.arange(level.mask.shape[1]), weights=level.mask.sum(axis=0))) for level in (left, right)
    ]
    reach = max(int(np.ceil(range_share * width)), 2)
    lowest = round(centres[1] - centres[0]) - reach
    unit_vectors = [_unit_neighbourhoods(level) for level in (left, right)]
    costs = matching_costs(unit_vectors[0], unit_vectors[1], left.mask, right.mask, lowest, 2 * reach + 1, _OUTSIDE)
    total = aggregate(costs, left.mask, _SMALL_STEP, _LARGE_STEP)
    return cheapest(total, left.mask, lowest)


def _unit_neighbourhoods(level: Level) -> Float32[Array, "h w 9"]:
    """3 × 3 neighbourhoods without their mean over the subject's pixels, of unit length; 0 outside the subject."""
    height, width = level.mask.shape
    image = np.pad(level.image, 1, mode="edge")
    mask = np.pad(level.mask, 1).astype(np.float32)
    offsets = [(i, j) for i in range(3) for j in range(3)]
    values = np.stack([image[i : i + height, j : j + width] for i, j in offsets], axis=2)
    weights = np.stack([mask[i : i + height, j : j + width] for i, j in offsets], axis=2)
    mean = (values * weights).sum(axis=2) / np.maximum(weights.sum(axis=2), 1)
    values = (values - mean[..., None]) * weights
    length = np.sqrt((values**2).sum(axis=2) + 9 * _FLAT**2)
    return np.ascontiguousarray(values / length[..., None], dtype=np.float32)
