"""Dense correspondence of a rectified pair (paper 2.3, Eq. 1)."""

from concurrent.futures import Executor, ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np

from mammometry.base.errors import MatchingError
from mammometry.base.progress import Progress, no_progress
from mammometry.geometry.arrays import Array, Bool, Float32, read_only
from mammometry.geometry.camera import Camera
from mammometry.matching.belief import agreeing
from mammometry.matching.filters import squared_slope
from mammometry.matching.first_disparities import span_px, start
from mammometry.matching.layers import without_specks
from mammometry.matching.noise import noise_variance
from mammometry.matching.pyramid import Level, build, coarser_camera, decimation, finer_field, finer_mask
from mammometry.matching.rectify import RectifiedPair
from mammometry.matching.refine import Refined, refined
from mammometry.matching.region import Window, at_level, cut_levels, cut_solved, pasted, worth_matching
from mammometry.matching.settings import MatchSettings
from mammometry.matching.solve import both, finally_smoothed, handed_down, initial, solve_level
from mammometry.matching.texture import unexplained, weak_texture
from mammometry.matching.vertical import VerticalField

_FIRST_STEPS, _FURTHER_STEPS, _LAST_STEPS = 5, 4, 2  # least-squares steps on the coarsest, middle and finest level:
# an error left on a coarse one is twice as many pixels on the next, and beyond its texture's grain it stays
_SIGMA_SCALE, _SIGMA_SLOPE = 1.8, 1.0  # expected σ from the smoothing's: measured on captures of two renderers
_DOUBT_SLOPE = 4.0  # a window on steep skin is doubted sooner, by 1 + 4·slope²
_SMALLEST_SPAN_PX = 24
_CALM_SPAN_PX = 230  # a subject that spans more can afford to start on a coarser level than the finest
_LAST_STEP_PX = 0.5
_ISLAND_WINDOWS = 4  # of a Gaussian window's area, 4πσ²: fewer matched pixels that touch one another are not believed
_FINEST_LEVEL = 1  # of a large subject: optics leave little on the photograph's own pixels


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
    steps, in both directions; of a large subject's last level in one. Pixels of the rectified pair.

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
    dense = max(0, int(np.ceil(np.log2(span / settings.finest_span_px))))
    finest = min(dense, _FINEST_LEVEL)  # from `dense` on only the left picture's matches are made finer
    calm = dense + int(span / 2**dense > _CALM_SPAN_PX)  # halving a picture first takes half of its noise
    coarsest = max(calm, int(np.ceil(np.log2(span / settings.start_span_px))))
    size_wh = (pair.left_image.shape[1], pair.left_image.shape[0])
    with ThreadPoolExecutor(2) as pool:
        left, right = both(
            pool,
            lambda image, mask: build(image, mask, finest, coarsest),
            (pair.left_image, pair.right_image),
            (masks[0], masks[1]),
        )
        progress(0.1)
        decimations = [decimation(level) for level in range(finest + 1, coarsest + 1)]
        noise = both(pool, lambda levels: noise_variance(levels[0], decimations), (left, right))
        images = (left.pop(), right.pop())
        whole = (images[0].mask, images[1].mask)
        known = initial(start(*images, noise, settings.search_share), whole)
        solved = solve_level(
            images,
            coarsest,
            known,
            VerticalField(size_wh=size_wh),
            settings,
            pool,
            steps=_FIRST_STEPS,
            last=coarsest == dense,
        )
        progress(0.3)
        kept, window = worth_matching(solved.matches, whole)
        if coarsest > finest:
            left, right = cut_levels(left, kept[0], window), cut_levels(right, kept[1], window)
            origin = (window[1].start << coarsest, window[0].start << coarsest)
            solved = cut_solved(solved, window, replace(solved.field, origin_uv=origin))
        else:
            window = (slice(0, whole[0].shape[0]), slice(0, whole[0].shape[1]))
        for level in range(coarsest - 1, dense - 1, -1):
            images = (left.pop(), right.pop())
            known = handed_down(solved, settings.agreement_px, images[0].mask.shape)
            solved = solve_level(
                images,
                level,
                known,
                solved.field,
                settings,
                pool,
                steps=_LAST_STEPS if level == dense else _FURTHER_STEPS,
                last=level == dense,
            )
            progress(0.9 - 0.6 * (level - finest) / (coarsest - finest))
        subject = (images[0].mask, images[1].mask)
        ours, theirs = both(pool, finally_smoothed, solved.matches, subject, solved.shifts, (settings, settings))
        field = solved.field
        fine = Refined(matches=solved.matches[0], shift=ours[0], variance=ours[1], other=theirs[0], halvings=0)
        del solved, ours, theirs, known
        for level in range(dense - 1, finest - 1, -1):
            images = (left.pop(), right.pop())
            fine = refined(images, fine, field, level, settings, pool)
            progress(0.9 - 0.6 * (level - finest) / (coarsest - finest))
        image = images[0]
        del images
        found = _final(pair, settings, image, fine, pool)
        del fine, image
        result = _laid_out(pair, settings, found, field, window, coarsest, finest, pool)
    progress(1.0)
    return result


def _eroded(mask: Bool[Array, "h w"], pixels: int) -> Bool[Array, "h w"]:
    """Without the pixels that are not farther than so many steps, along rows and columns, from what is not subject."""
    for _ in range(pixels):
        smaller = np.zeros_like(mask)
        middle = mask[1:-1, 1:-1]
        smaller[1:-1, 1:-1] = middle & mask[:-2, 1:-1] & mask[2:, 1:-1] & mask[1:-1, :-2] & mask[1:-1, 2:]
        mask = smaller
    return mask


def _final(
    pair: RectifiedPair, settings: MatchSettings, image: Level, fine: Refined, pool: Executor
) -> dict[str, Array]:
    """What can be trusted of the finest level, in its own pixels: the map's arrays by name, not yet zeroed."""
    matches, shift, sigma = fine.matches, fine.shift, fine.variance
    window = settings.window_px / np.sqrt(12)
    too_weak = pool.submit(weak_texture, image, matches, window, settings.largest_sigma_px)
    doubted = matches.variance * unexplained(image, matches, window)
    steep = squared_slope(shift)
    weak = too_weak.result()  # before the correlation is changed
    valid = (
        matches.plausible
        & (matches.correlation > settings.least_correlation)
        & (np.abs(matches.step) < _LAST_STEP_PX)
        & agreeing(shift, fine.other, settings.agreement_px * 2**fine.halvings)
        & (np.sqrt(doubted) * (1 + _DOUBT_SLOPE * steep) < settings.largest_sigma_px)
    )
    # What noise alone lets agree are small islands, most often beyond an outline; they hold too little to be confirmed.
    valid = without_specks(valid, round(_ISLAND_WINDOWS * 4 * np.pi * window**2))
    if not valid.any():
        raise MatchingError(
            f"pair {pair.name}",
            found="no point that both pictures show alike",
            expected="the same textured skin in both",
            remedy="Check that the two photographs are of one moment, sharp, and of the cameras named",
        )
    np.sqrt(sigma, out=sigma)
    steep *= np.float32(_SIGMA_SLOPE)
    steep += np.float32(1)
    sigma *= steep
    sigma *= np.float32(_SIGMA_SCALE)
    confidence = np.clip(matches.correlation, -1, 1, out=matches.correlation)
    return {"shift": shift, "sigma": sigma, "confidence": confidence, "valid": valid, "weak": weak}


def _laid_out(
    pair: RectifiedPair,
    settings: MatchSettings,
    found: dict[str, Array],
    field: VerticalField,
    window: Window,
    coarsest: int,
    finest: int,
    pool: Executor,
) -> DisparityMap:
    """The map at the resolution asked for."""
    shift = found["shift"]
    found["vertical"] = field.at(np.arange(shift.shape[1], dtype=np.float32) + shift, finest)
    shape = _level_shape(pair, finest)
    part = at_level(window, coarsest - finest, shape)
    left, right = pair.left, pair.right
    full = settings.resolution == "full"
    for _ in range(0 if full else finest):
        left, right = coarser_camera(left), coarser_camera(right)
    doublings = finest if full else 0

    def laid_out(name: str) -> Array:
        values = pasted(found.pop(name), part, shape)
        for level in range(finest - 1, finest - 1 - doublings, -1):
            double = finer_mask if values.dtype == np.bool_ else finer_field
            values = double(values, _level_shape(pair, level))
        return values

    valid, weak = laid_out("valid"), laid_out("weak")
    if full:
        valid, weak = valid & pair.left_mask, weak & pair.left_mask

    def field_of(name: str, scale: float) -> Float32[Array, "H W"]:
        made = laid_out(name)
        made *= np.float32(scale)
        made *= valid
        return made

    scales = {"shift": -(2.0**doublings), "vertical": 2.0**doublings, "confidence": 1.0, "sigma": 2.0**doublings}
    d_h, d_v, confidence, sigma = pool.map(field_of, scales, scales.values())
    return DisparityMap(
        name=pair.name,
        left=left,
        right=right,
        d_h_px=d_h,
        d_v_px=d_v,
        confidence=confidence,
        sigma_px=sigma,
        valid=valid,
        weak=weak,
    )


def _level_shape(pair: RectifiedPair, level: int) -> tuple[int, int]:
    return -(-pair.left_mask.shape[0] // 2**level), -(-pair.left_mask.shape[1] // 2**level)
