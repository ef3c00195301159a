"""Dense correspondence of a rectified pair (paper 2.3, Eq. 1)."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from mammometry.errors import MatchingError
from mammometry.geometry.arrays import Array, Bool, Float32, read_only
from mammometry.geometry.camera import Camera
from mammometry.matching.pyramid import build, coarser_camera, finer_field, finer_mask
from mammometry.matching.rectify import RectifiedPair
from mammometry.matching.settings import MatchSettings
from mammometry.matching.solve import (
    Estimate,
    adaptively_smoothed,
    carried,
    competed,
    disagreement,
    initial,
    prepare,
    smoothed,
    step,
    trust,
)
from mammometry.matching.start import span_px, start
from mammometry.progress import Progress, no_progress

_SMALLEST_SPAN_PX = 24
_LAST_STEP_PX = 0.5


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class DisparityMap:
    """Where each left pixel is seen in the right image: (u, v) → (u − d_h, v − d_v)."""

    name: str
    left: Camera
    """Ideal rectified camera at the map's resolution; the map's pixels are its pixels."""
    right: Camera
    """Its partner at the same resolution, same orientation; only the principal column differs."""
    d_h_px: Float32[Array, "h w"]
    """Horizontal disparity u_left − u_right; 0 where not valid."""
    d_v_px: Float32[Array, "h w"]
    """Vertical disparity v_left − v_right, ~0 with a right calibration; 0 where not valid."""
    confidence: Float32[Array, "h w"]
    """Zero-mean normalised cross-correlation c(i, j) of the matched windows, −1…1; 0 where not valid."""
    sigma_px: Float32[Array, "h w"]
    """Expected standard deviation of d_h_px; 0 where not valid."""
    valid: Bool[Array, "h w"]

    def __post_init__(self) -> None:
        for name in ("d_h_px", "d_v_px", "confidence", "sigma_px", "valid"):
            object.__setattr__(self, name, read_only(getattr(self, name)))


def match(
    pair: RectifiedPair, settings: MatchSettings = MatchSettings(), *, progress: Progress = no_progress
) -> DisparityMap:
    """Find d_H and d_V that maximise the correlation of the local areas around each left pixel (Eq. 1).

    Coarse to fine: semi-global matching of 3 × 3 neighbourhoods where the subject is small, then dense least squares
    with free gain and offset in Gaussian windows on the image warped by the whole field, plane smoothing between the
    steps, in both directions. Pixels of the rectified pair.

    Raises:
        MatchingError: a mask is empty, or nothing could be matched.
    """
    masks = [_eroded(mask, settings.erode_px) for mask in (pair.left_mask, pair.right_mask)]
    span = min(span_px(mask) for mask in masks)
    if span < _SMALLEST_SPAN_PX:
        raise MatchingError(
            f"pair {pair.name}",
            found=f"a subject of {span:.0f} pixels across",
            expected=f"at least {_SMALLEST_SPAN_PX}",
            remedy="Check the foreground masks",
        )
    finest = max(0, int(np.ceil(np.log2(span / settings.finest_span_px))))
    coarsest = max(finest, int(np.ceil(np.log2(span / settings.start_span_px))))
    pyramids = [
        build(image, mask, coarsest) for image, mask in zip((pair.left_image, pair.right_image), masks, strict=True)
    ]
    progress(0.1)
    sigma = settings.window_px / np.sqrt(12)
    shifts = start(pyramids[0][coarsest], pyramids[1][coarsest], settings.search_share)
    progress(0.3)
    coarse: tuple[Estimate, Estimate] | None = None
    with ThreadPoolExecutor(2) as pool:
        for level in range(coarsest, finest - 1, -1):
            if level < coarsest:
                shape = pyramids[0][level].mask.shape
                shifts = tuple(2 * finer_field(shift, shape) for shift in shifts)
            sides = (prepare(pyramids[0][level], sigma), prepare(pyramids[1][level], sigma))
            if coarse is None:
                coarse = initial(shifts, sides)
            steps = 3 if level == coarsest else 2
            for _ in range(steps):
                estimates = step(sides, shifts, sigma, settings.least_correlation, settings.flat_deviation, pool)
                if coarse is not None:
                    estimates = (competed(estimates[0], coarse[0]), competed(estimates[1], coarse[1]))
                weights = trust(estimates, sides, 1.0)
                shifts = smoothed(estimates, weights, 4.5 if level == finest else 2.5, pool)
            if level > finest:
                finer = pyramids[0][level - 1].mask.shape
                agrees = [disagreement(shifts[k], shifts[1 - k]) < settings.agreement_px for k in (0, 1)]
                coarse = (
                    carried(estimates[0], shifts[0], agrees[0], finer),
                    carried(estimates[1], shifts[1], agrees[1], finer),
                )
            progress(0.3 + 0.5 * (coarsest - level + 1) / (coarsest - finest + 1))
        estimates = step(sides, shifts, sigma, settings.least_correlation, settings.flat_deviation, pool)
        if coarse is not None:
            estimates = (competed(estimates[0], coarse[0]), competed(estimates[1], coarse[1]))
        weights = trust(estimates, sides, 1.0)
        futures = [
            pool.submit(
                adaptively_smoothed,
                estimates[k],
                weights[k],
                sigma,
                settings.smoothing_px,
                settings.detail_factor,
            )
            for k in (0, 1)
        ]
        shifts = (futures[0].result(), futures[1].result())
    return _accepted(pair, settings, finest, estimates[0], shifts)


def _eroded(mask: Bool[Array, "h w"], pixels: int) -> Bool[Array, "h w"]:
    if pixels == 0:
        return mask
    eroded: Bool[Array, "h w"] = ndimage.binary_erosion(mask, iterations=pixels)
    return eroded


def _accepted(
    pair: RectifiedPair,
    settings: MatchSettings,
    finest: int,
    estimate: Estimate,
    shifts: tuple[Float32[Array, "h w"], Float32[Array, "h w"]],
) -> DisparityMap:
    """The map of what can be trusted."""
    field = shifts[0]
    slope = np.hypot(*np.gradient(field))
    sigma = 0.85 * np.sqrt(estimate.variance) * (1 + 4 * slope**2)
    valid = (
        estimate.plausible
        & (np.abs(estimate.step) < _LAST_STEP_PX)
        & (disagreement(field, shifts[1]) < settings.agreement_px)
        & (sigma < settings.largest_sigma_px)
    )
    left, right = pair.left, pair.right
    for _ in range(finest):
        left, right = coarser_camera(left), coarser_camera(right)
    confidence = estimate.correlation
    if settings.resolution == "full":
        for level in range(finest - 1, -1, -1):
            shape = tuple(-(-size // 2**level) for size in pair.left_mask.shape)
            field = 2 * finer_field(field, shape)
            sigma = 2 * finer_field(sigma, shape)
            confidence = finer_field(confidence, shape)
            valid = finer_mask(valid, shape)
        left, right = pair.left, pair.right
        valid = valid & pair.left_mask
    zero = np.zeros(valid.shape, dtype=np.float32)
    return DisparityMap(
        name=pair.name,
        left=left,
        right=right,
        d_h_px=np.where(valid, -field, 0).astype(np.float32),
        d_v_px=zero,
        confidence=np.where(valid, confidence, 0).astype(np.float32),
        sigma_px=np.where(valid, sigma, 0).astype(np.float32),
        valid=valid,
    )
