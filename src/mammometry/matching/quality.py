"""Judge a disparity map, and the calibration, without a truth.

In a few figures and sentences.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from mammometry.matching.match import DisparityMap

ALARMING_D_V_PX = 0.3
"""Median or spread of the vertical disparity above which calibration and photographs do not fit, px. Chosen by eye: a
right calibration leaves less than 0.1 (docs/decisions/0011).
"""
_MUCH_WEAK_PERCENT = 10.0  # of the surface, worth a warning; chosen by eye


@dataclass(frozen=True, slots=True, kw_only=True)
class MatchQuality:
    """One pair's figures."""

    size_wh: tuple[int, int]
    """Of the map, pixels."""
    matched_pixels: int
    weak_percent: float
    """Share of matched and weak pixels with texture too weak to match, %."""
    d_v_median_px: float
    """Median vertical disparity: 0 with a right calibration. Here and below pixels of the rectified pair."""
    d_v_spread_px: float
    """Half the width of its middle 68 %, px."""
    sigma_median_px: float
    """Median expected standard deviation of the horizontal disparity, px."""
    confidence_median: float
    """Median correlation."""

    @property
    def calibration_alarm(self) -> bool:
        """Whether the vertical disparity says that the cameras are others.

        A camera moved, or the photographs are another rig's.
        """
        return max(abs(self.d_v_median_px), self.d_v_spread_px) > ALARMING_D_V_PX


def assess(found: DisparityMap) -> MatchQuality:
    """Judge a disparity map by itself. No truth is needed."""
    matched, weak = int(found.valid.sum()), int((found.weak & ~found.valid).sum())
    d_v = found.pair_px * found.d_v_px[found.valid].astype(np.float64)
    low, median, high = np.percentile(d_v, (16, 50, 84)) if matched else (0.0, 0.0, 0.0)
    height, width = found.valid.shape
    return MatchQuality(
        size_wh=(width, height),
        matched_pixels=matched,
        weak_percent=100 * weak / max(matched + weak, 1),
        d_v_median_px=float(median),
        d_v_spread_px=float(high - low) / 2,
        sigma_median_px=found.pair_px * float(np.median(found.sigma_px[found.valid])) if matched else 0.0,
        confidence_median=float(np.median(found.confidence[found.valid])) if matched else 0.0,
    )


def concerns(pair: str, quality: MatchQuality) -> Iterator[str]:
    """Sentences that a user must read before trusting the pair."""
    if quality.calibration_alarm:
        yield (
            f"Pair {pair}: vertical disparity of {quality.d_v_median_px:+.2f} ± {quality.d_v_spread_px:.2f} px shows "
            "that a camera moved after the calibration, or that the photographs belong to another one."
        )
    if quality.weak_percent > _MUCH_WEAK_PERCENT:
        yield (
            f"Pair {pair}: on {quality.weak_percent:.0f} % of the surface the texture is too weak to be matched; "
            "nothing was invented there. Light it more, focus, or paint a pattern on a model."
        )
