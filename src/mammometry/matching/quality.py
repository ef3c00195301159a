"""Quality of a disparity map and of the calibration, without ground truth: figures and warnings."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from mammometry.base.notices import Notice
from mammometry.geometry.arrays import Array, Bool, Float64
from mammometry.matching.dense.match import DisparityMap
from mammometry.matching.foreground.outlines_first import outline_first

ALARMING_D_V_PX = 0.3
"""Smooth vertical disparity above which calibration and photographs do not fit, px: three times the 0.1 that a correct
calibration leaves (docs/decisions/0011)."""
_CERTAIN_SIGMAS = 3.0  # significance of the smooth part: single pixels scatter where texture is weak
_BLOCKS = 6  # blocks along each side of the map, whose medians show the smooth part
_LEAST_PIXELS = 20  # fewest matched pixels of a block for a median
_SMOOTH_TERMS = 6  # 1, x, y, x², xy, y²: effect of turned cameras and other lenses on rows
_MUCH_WEAK_PERCENT = 10.0  # least share of the surface with weak texture for a warning; no volume depends on it


@dataclass(frozen=True, slots=True, kw_only=True)
class MatchQuality:
    """Figures of one pair."""

    size_wh: tuple[int, int]
    """Size of the map, pixels."""
    matched_pixels: int
    weak_percent: float
    """Share of matched and weak pixels with texture too weak to match, %."""
    d_v_median_px: float
    """Median vertical disparity: 0 with a correct calibration. Here and below in pixels of the rectified pair."""
    d_v_spread_px: float
    """Half the width of its middle 68 %, px."""
    d_v_smooth_px: float
    """RMS of its smooth part over the image: effect of a moved camera or another lens. 0 if too little is matched."""
    d_v_smooth_std_px: float
    """Standard error of the smooth part, px."""
    sigma_median_px: float
    """Median expected standard deviation of the horizontal disparity, px."""
    confidence_median: float
    """Median correlation."""

    @property
    def calibration_alarm(self) -> bool:
        """Whether the vertical disparity contradicts the calibration."""
        return self.d_v_smooth_px > max(ALARMING_D_V_PX, _CERTAIN_SIGMAS * self.d_v_smooth_std_px)


def assess(found: DisparityMap) -> MatchQuality:
    """Quality of a disparity map, without ground truth."""
    matched, weak = int(found.valid.sum()), int((found.weak & ~found.valid).sum())
    d_v = found.pair_px * found.d_v_px[found.valid].astype(np.float64)
    low, median, high = np.percentile(d_v, (16, 50, 84)) if matched else (0.0, 0.0, 0.0)
    smooth_px, smooth_std_px = _smooth_part(found.pair_px * found.d_v_px.astype(np.float64), found.valid)
    height, width = found.valid.shape
    return MatchQuality(
        size_wh=(width, height),
        matched_pixels=matched,
        weak_percent=100 * weak / max(matched + weak, 1),
        d_v_median_px=float(median),
        d_v_spread_px=float(high - low) / 2,
        d_v_smooth_px=smooth_px,
        d_v_smooth_std_px=smooth_std_px,
        sigma_median_px=found.pair_px * float(np.median(found.sigma_px[found.valid])) if matched else 0.0,
        confidence_median=float(np.median(found.confidence[found.valid])) if matched else 0.0,
    )


def _smooth_part(d_v_px: Float64[Array, "h w"], valid: Bool[Array, "h w"]) -> tuple[float, float]:
    """RMS and standard error, px, of a quadratic through the medians of blocks."""
    rows, columns = np.flatnonzero(valid.any(axis=1)), np.flatnonzero(valid.any(axis=0))
    places, medians = [], []
    for i, row in enumerate(np.array_split(rows, _BLOCKS)):
        for j, column in enumerate(np.array_split(columns, _BLOCKS)):
            block = np.ix_(row, column)
            inside = d_v_px[block][valid[block]]
            if inside.size >= _LEAST_PIXELS:
                places.append((2 * i / _BLOCKS - 1, 2 * j / _BLOCKS - 1))
                medians.append(float(np.median(inside)))
    if len(medians) < 2 * _SMOOTH_TERMS:
        return 0.0, 0.0
    y, x = np.array(places).T
    terms = np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=1)
    smooth = terms @ np.linalg.lstsq(terms, np.array(medians), rcond=None)[0]
    rest = np.array(medians) - smooth
    std = np.sqrt(np.sum(rest**2) / (len(rest) - _SMOOTH_TERMS) * _SMOOTH_TERMS / len(rest))
    return float(np.sqrt(np.mean(smooth**2))), float(std)


def concerns(pair: str, quality: MatchQuality, missing: Sequence[str] = ()) -> Iterator[Notice]:
    """Notices that a user must read before trusting the pair.

    Args:
        pair: name of the pair.
        quality: its figures.
        missing: cameras of the pair without an outline. The misfit may then be due to the background.
    """
    if quality.calibration_alarm:
        code = "pair-disagrees" if missing else "pair-moved"
        values = {"px": quality.d_v_smooth_px, "std_px": quality.d_v_smooth_std_px}
        yield Notice(code=code, about=(pair,), values=values)
        if missing:
            yield outline_first(missing)
    if quality.weak_percent > _MUCH_WEAK_PERCENT:
        yield Notice(code="texture-weak", level="note", about=(pair,), values={"percent": quality.weak_percent})
