"""Dense correspondence of a rectified pair (paper 2.3, Eq. 1)."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np
from scipy import ndimage

from mammometry.errors import MatchingError
from mammometry.geometry.arrays import Array, Bool, Float32, read_only
from mammometry.geometry.camera import Camera
from mammometry.matching.noise import noise_variance
from mammometry.matching.pyramid import build, coarser_camera, decimation, finer_field, finer_mask
from mammometry.matching.rectify import RectifiedPair
from mammometry.matching.region import Window, at_level, cut_levels, cut_matches, pasted, worth_matching
from mammometry.matching.settings import MatchSettings
from mammometry.matching.solve import Both, Estimate, carried, disagreement, initial, solve_level
from mammometry.matching.start import span_px, start
from mammometry.matching.texture import weak_texture
from mammometry.matching.vertical import VerticalField
from mammometry.progress import Progress, no_progress

_FIRST_STEPS, _FURTHER_STEPS, _LAST_STEPS = 5, 4, 2  # least-squares steps on the coarsest, middle and finest level:
# an error left on a coarse one is twice as many pixels on the next, and beyond its texture's grain it stays
_SIGMA_SCALE, _SIGMA_SLOPE = 1.8, 1.0  # expected σ from the smoothing's: measured on captures of two renderers
_DOUBT_SLOPE = 4.0  # a window on steep skin is doubted sooner, by 1 + 4·slope²
_SMALLEST_SPAN_PX = 24
_CALM_SPAN_PX = 230  # a subject that spans more can afford to start on a coarser level than the finest
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
    weak: Bool[Array, "h w"]
    """Subject whose texture is too weak for a sure match, whether one was found there or not."""

    def __post_init__(self) -> None:
        for name in ("d_h_px", "d_v_px", "confidence", "sigma_px", "valid", "weak"):
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
    finest = 1 if span > settings.finest_span_px else 0
    calm = finest + int(span / 2**finest > _CALM_SPAN_PX)  # halving a picture first takes half of its noise
    coarsest = max(calm, int(np.ceil(np.log2(span / settings.start_span_px))))
    left = build(pair.left_image, masks[0], finest, coarsest)
    right = build(pair.right_image, masks[1], finest, coarsest)
    progress(0.1)
    decimations = [decimation(level) for level in range(finest + 1, coarsest + 1)]
    noise = (noise_variance(left[0], decimations), noise_variance(right[0], decimations))
    shifts = start(left[-1], right[-1], noise, settings.search_share)
    matches = initial(shifts, (left[-1].mask, right[-1].mask))
    height, width = pair.left_image.shape
    field = VerticalField(size_wh=(width, height))
    window: Window | None = None
    progress(0.3)
    with ThreadPoolExecutor(2) as pool:
        for level in range(coarsest, finest - 1, -1):
            if window is None and level < coarsest:
                kept, window = worth_matching(matches, (left[-1].mask, right[-1].mask))
                left, right = cut_levels(left, kept[0], window), cut_levels(right, kept[1], window)
                matches, shifts = cut_matches(matches, shifts, window)
                field = replace(field, origin_uv=(window[1].start << coarsest, window[0].start << coarsest))
            if level < coarsest:
                shape = left[level - finest].mask.shape
                matches = carried(matches, shifts, settings.agreement_px, shape)
                shifts = (matches[0].shift, matches[1].shift)
            matches, shifts, expected, field = solve_level(
                (left[level - finest], right[level - finest]),
                level,
                shifts,
                matches,
                field,
                settings,
                pool,
                steps=_FIRST_STEPS if level == coarsest else _LAST_STEPS if level == finest else _FURTHER_STEPS,
                last=level == finest,
            )
            progress(0.3 + 0.6 * (coarsest - level + 1) / (coarsest - finest + 1))
    if window is None:
        whole = left[-1].mask.shape
        window = (slice(0, whole[0]), slice(0, whole[1]))
    weak = weak_texture(left[0], matches[0], settings.window_px / np.sqrt(12), settings.largest_sigma_px)
    result = _accepted(pair, settings, matches[0], shifts, expected, weak, field, window, coarsest, finest)
    progress(1.0)
    return result


def _eroded(mask: Bool[Array, "h w"], pixels: int) -> Bool[Array, "h w"]:
    if pixels == 0:
        return mask
    eroded: Bool[Array, "h w"] = ndimage.binary_erosion(mask, iterations=pixels)
    return eroded


def _accepted(
    pair: RectifiedPair,
    settings: MatchSettings,
    matches: Estimate,
    shifts: Both[Float32[Array, "h w"]],
    expected: Float32[Array, "h w"],
    weak: Bool[Array, "h w"],
    field: VerticalField,
    window: Window,
    coarsest: int,
    finest: int,
) -> DisparityMap:
    """The map of what can be trusted, at the resolution asked for."""
    shift = shifts[0]
    slope = np.hypot(*np.gradient(shift))
    window_sigma = np.sqrt(matches.variance) * (1 + _DOUBT_SLOPE * slope**2)
    sigma = (_SIGMA_SCALE * np.sqrt(expected) * (1 + _SIGMA_SLOPE * slope**2)).astype(np.float32)
    valid = (
        matches.plausible
        & (matches.correlation > settings.least_correlation)
        & (np.abs(matches.step) < _LAST_STEP_PX)
        & (disagreement(shift, shifts[1]) < settings.agreement_px)
        & (window_sigma < settings.largest_sigma_px)
    )
    if not valid.any():
        raise MatchingError(
            f"pair {pair.name}",
            found="no point that both pictures show alike",
            expected="the same textured skin in both",
            remedy="Check that the two photographs are of one moment, sharp, and of the cameras named",
        )
    confidence = matches.correlation
    vertical = field.at(np.arange(shift.shape[1], dtype=np.float32) + shift, finest)
    shape = _level_shape(pair, finest)
    part = at_level(window, coarsest - finest, shape)
    shift, vertical, sigma, confidence, valid, weak = (
        pasted(values, part, shape) for values in (shift, vertical, sigma, confidence, valid, weak)
    )
    left, right = pair.left, pair.right
    full = settings.resolution == "full"
    for _ in range(0 if full else finest):
        left, right = coarser_camera(left), coarser_camera(right)
    steps = finest if full else 0

    def finer(values: Array) -> Array:
        for level in range(finest - 1, finest - 1 - steps, -1):
            double = finer_mask if values.dtype == np.bool_ else finer_field
            values = double(values, _level_shape(pair, level))
        return values

    valid, weak = finer(valid), finer(weak)
    if full:
        valid, weak = valid & pair.left_mask, weak & pair.left_mask

    def field_of(values: Float32[Array, "h w"], scale: float) -> Float32[Array, "H W"]:
        made = finer(values)  # one after the other: at full size each takes as much memory as a picture
        made = made * np.float32(scale)
        made[~valid] = 0
        return np.asarray(made, dtype=np.float32)

    return DisparityMap(
        name=pair.name,
        left=left,
        right=right,
        d_h_px=field_of(shift, -(2.0**steps)),
        d_v_px=field_of(vertical, 2.0**steps),
        confidence=field_of(np.clip(confidence, -1, 1), 1.0),
        sigma_px=field_of(sigma, 2.0**steps),
        valid=valid,
        weak=weak,
    )


def _level_shape(pair: RectifiedPair, level: int) -> tuple[int, int]:
    return -(-pair.left_mask.shape[0] // 2**level), -(-pair.left_mask.shape[1] // 2**level)
