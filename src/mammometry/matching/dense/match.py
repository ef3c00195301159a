"""Dense correspondence of a rectified pair (paper 2.3, Eq. 1).

The last levels of a large subject are matched from the left image alone (`refined`) and checked with the right image's
matches of a coarser level, which are accurate enough: this saves half of the time and of the peak memory. The work is
done in bands of rows, each from its first step to its final smoothing.
"""

from concurrent.futures import Executor, ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np

from mammometry.base.errors import MatchingError
from mammometry.base.progress import Progress, no_progress
from mammometry.base.value import value
from mammometry.geometry import Array, Bool, Camera, Float32
from mammometry.geometry.arrays import SIGMA_BITS, to_bits, to_step
from mammometry.matching.dense.crop import (
    Window,
    at_level,
    cut_levels,
    cut_solved,
    pasted,
    whole_window,
    worth_matching,
)
from mammometry.matching.dense.depth_layers import without_specks
from mammometry.matching.dense.least_squares import (
    AGREEMENT_PX,
    LAST_SMOOTHING_PX,
    Levels,
    LevelStart,
    both,
    choose_levels,
    finally_smoothed,
    initial,
    judged,
    solve_level,
    upsampled,
    upsampled_start,
)
from mammometry.matching.dense.least_squares_step import (
    LARGEST_STEP_PX,
    LEAST_CORRELATION,
    Both,
    MatchEstimate,
    Side,
    agreeing,
    prepare_side,
    smoothing_weights,
    step,
)
from mammometry.matching.dense.plane_smoothing import smooth
from mammometry.matching.dense.vertical_disparity import Vertical, VerticalField, aligned, nothing_yet
from mammometry.matching.filters import squared_slope
from mammometry.matching.noise import empty_levels, noise_variance, unexplained, weak_texture
from mammometry.matching.pyramid import Level, build, coarser_camera, decimation, finer_field, finer_mask, finer_shift
from mammometry.matching.rectify import RectifiedPair
from mammometry.matching.semiglobal import start
from mammometry.matching.settings import MatchSettings

DIRECTIONS_APART_PX = 0.5
"""Largest disagreement between both matching directions, pixels of the finest level matched from both."""
_BAND_ROWS = 384  # bounds memory: a full-size torso under a gigabyte (docs/decisions/0020)
_HALO_ROWS = 64  # even; 4.4 σ of two passes of the widest smoothing
SEARCH_SHARE = 0.25
"""Search range to either side of the shift between both silhouettes, as a share of the subject's width."""
ERODE_PX = 2
"""Pixels removed from the silhouette's border before matching. They are mixed with the background."""
LARGEST_SIGMA_PX = 1.0
"""Standard deviation of one window's match above which it is rejected, pixels of the finest level. Half of it where
noise does not explain the residual after gain and offset."""
_SIGMA_SCALE = 1.8  # expected σ relative to the smoothing's; from two renderers (error / σ in docs/decisions/0015)
_SIGMA_SLOPE = 1.0  # … plus this times slope²
_DOUBT_SLOPE = 4.0  # factor 1 + 4·slope² on the deviation of a window on steep skin
_LAST_STEP_PX = LARGEST_STEP_PX / 2  # a match that still moves by more has not converged
_D_H_STEP_PX = 2.0**-8  # step of the stored values: its rounding has a σ of 0.0011 px, matching at least 0.019
_D_V_STEP_PX = 2.0**-10  # finer, since its medians are used to detect motion
_CONFIDENCE_STEP = 2.0**-7  # shown with two decimals
_ISLAND_WINDOWS = 4  # least island, areas of a Gaussian window, 4πσ²: smaller ones are rejected (docs/decisions/0015)


@value(eq=False)
class DisparityMap:
    """Match of each left pixel in the right image: (u, v) → (u − d_h, v − d_v)."""

    name: str
    left: Camera
    """Ideal rectified camera at the map's resolution."""
    right: Camera
    """The right camera at the same resolution and orientation. Only the principal column differs."""
    d_h_px: Float32[Array, "h w"]
    """Horizontal disparity u_left − u_right, in steps of 2^-8. 0 where not valid."""
    d_v_px: Float32[Array, "h w"]
    """Vertical disparity v_left − v_right, near 0 if the calibration is right, in steps of 2^-10. 0 where not valid."""
    confidence: Float32[Array, "h w"]
    """Zero-mean normalised cross-correlation c(i, j) of the matched windows, −1…1, in steps of 2^-7. 0 where not
    valid."""
    sigma_px: Float32[Array, "h w"]
    """Expected standard deviation of d_h_px, rounded to six binary digits. 0 where not valid."""
    valid: Bool[Array, "h w"]
    weak: Bool[Array, "h w"]
    """Parts of the subject whose texture is too weak for a reliable match, matched or not."""
    halvings: int = 0
    """Resolution relative to the rectified pair: 1 if a pixel of the map is two of the pair's."""

    @property
    def pair_px(self) -> float:
        """Pixels of the rectified pair per pixel of the map."""
        return 2.0**self.halvings


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Refined:
    """The left image's matches on one level, and the right image's to check them."""

    matches: MatchEstimate
    """Matches of the last step."""
    shift: Float32[Array, "h w"]
    """After the final smoothing, pixels of the level."""
    variance: Float32[Array, "h w"]
    """Expected variance of the shift, px² of the level."""
    other: Float32[Array, "h w"]
    """The right image's shift from the last level matched from both, after the final smoothing, pixels of this
    level."""
    halvings: int
    """Number of levels by which that one was coarser."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Start:
    """Pyramids and initial disparities, from which matching starts."""

    levels: Levels
    images: tuple[Both[Level], ...]
    """Both images on each level, fine to coarse."""
    known: Both[LevelStart]
    """Semi-global start of the coarsest level."""
    vertical: Vertical
    """Vertical disparity, unknown at the start."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SolvedBoth:
    """Result of the levels that are matched from both images."""

    images: tuple[Both[Level], ...]
    """Levels cropped to the window: the last one matched, preceded by those refined from the left image only."""
    matches: Refined
    vertical: Vertical
    window: Window
    """Part of the image in use: rows and columns of the coarsest level."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Finest:
    """Result of the finest level, in its own pixels."""

    levels: Levels
    image: Level
    """The left image."""
    matches: Refined
    vertical: Vertical
    window: Window
    """Part of the image in use: rows and columns of the coarsest level."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class AcceptedMatches:
    """The finest level's accepted matches. Invalid ones are not zeroed yet."""

    shift: Float32[Array, "h w"]
    """−d_h, pixels of the level."""
    d_v: Float32[Array, "h w"]
    """Pixels of the level."""
    sigma: Float32[Array, "h w"]
    """Expected standard deviation of the shift, pixels of the level."""
    confidence: Float32[Array, "h w"]
    valid: Bool[Array, "h w"]
    weak: Bool[Array, "h w"]


def match(
    pair: RectifiedPair, settings: MatchSettings = MatchSettings(), *, progress: Progress = no_progress
) -> DisparityMap:
    """Match a rectified pair densely (Eq. 1).

    Finds d_H and d_V that maximise the correlation of the local areas around each left pixel.

    1. `prepare`: image pyramids of the subject, and semi-global matching of 3 × 3 neighbourhoods on the coarsest level.
    2. `coarse_to_fine`: dense least squares with free gain and offset in Gaussian windows on the warped image, in both
       directions (on a large subject's last levels in one), with plane smoothing between the steps.
    3. `finish`: acceptance of matches, and the map at the requested resolution.

    Pixels of the rectified pair.

    Raises:
        MatchingError: a mask is empty, or nothing could be matched.
    """
    with ThreadPoolExecutor(2) as pool:
        # Intermediate results have no names, so that they are freed early.
        result = finish(
            pair, coarse_to_fine(prepare(pair, settings, pool, progress), settings, pool, progress), settings, pool
        )
    progress(1.0)
    return result


# --- 1. Prepare ------------------------------------------------------------------------------------------------------


def prepare(pair: RectifiedPair, settings: MatchSettings, pool: Executor, progress: Progress) -> Start:
    """Build both images' levels, and match the coarsest one."""
    masks = [_eroded(mask, ERODE_PX) for mask in (pair.left_mask, pair.right_mask)]
    pictures = (pair.left_image, pair.right_image)
    empty = max(both(pool, empty_levels, pictures, (masks[0], masks[1])))
    levels = choose_levels(pair.name, masks, empty=empty)
    left, right = both(
        pool,
        lambda image, mask: build(image, mask, levels.finest, levels.coarsest),
        (pair.left_image, pair.right_image),
        (masks[0], masks[1]),
    )
    progress(0.1)
    decimations = [decimation(level) for level in range(levels.finest + 1, levels.coarsest + 1)]
    noise = both(pool, lambda pyramid: noise_variance(pyramid[0], decimations), (left, right))
    subject = (left[-1].mask, right[-1].mask)
    vertical: Vertical = VerticalField(size_wh=(pair.left_image.shape[1], pair.left_image.shape[0]))
    if settings.vertical == "free":
        vertical = nothing_yet(subject[0].shape, levels.coarsest, settings.window_sigma_px)
    return Start(
        levels=levels,
        images=tuple(zip(left, right, strict=True)),
        known=initial(start(left[-1], right[-1], noise, SEARCH_SHARE), subject),
        vertical=vertical,
    )


def _eroded(mask: Bool[Array, "h w"], pixels: int) -> Bool[Array, "h w"]:
    """Remove a mask's border: pixels within `pixels` steps along rows and columns."""
    for _ in range(pixels):
        smaller = np.zeros_like(mask)
        middle = mask[1:-1, 1:-1]
        smaller[1:-1, 1:-1] = middle & mask[:-2, 1:-1] & mask[2:, 1:-1] & mask[1:-1, :-2] & mask[1:-1, 2:]
        mask = smaller
    return mask


# --- 2. Coarse to fine -----------------------------------------------------------------------------------------------


def coarse_to_fine(begun: Start, settings: MatchSettings, pool: Executor, progress: Progress) -> Finest:
    """Solve the levels, coarse to fine: first from both images, then refined from the left one."""
    found = _solve_both(begun, settings, pool, progress)
    images, vertical, matches = found.images, found.vertical, found.matches
    for level in begun.levels.left_only():
        images = images[:-1]
        matches = refined(images[-1], matches, vertical, level, settings, pool)
        progress(begun.levels.share_done(level))
    return Finest(levels=begun.levels, image=images[-1][0], matches=matches, vertical=vertical, window=found.window)


def _solve_both(begun: Start, settings: MatchSettings, pool: Executor, progress: Progress) -> SolvedBoth:
    """Solve all levels in both directions. A cluttered scene is cropped after the coarsest one."""
    first, *further = begun.levels.both()
    images = begun.images
    solved = solve_level(images[-1], first, begun.known, begun.vertical, settings, pool)
    progress(0.3)
    masks = (images[-1][0].mask, images[-1][1].mask)
    window = whole_window(masks[0])
    if len(images) > 1:
        kept, window = worth_matching(solved.matches, masks)
        images = cut_levels(images, kept, window)
        solved = cut_solved(solved, window, first.level)
    for work in further:
        images = images[:-1]
        known = upsampled(solved, DIRECTIONS_APART_PX, images[-1][0].mask.shape)
        solved = solve_level(images[-1], work, known, solved.vertical, settings, pool)
        progress(begun.levels.share_done(work.level))
    subject = (images[-1][0].mask, images[-1][1].mask)
    ours, theirs = both(pool, finally_smoothed, solved.matches, subject, solved.shifts, (settings, settings))
    return SolvedBoth(
        images=images,
        matches=Refined(matches=solved.matches[0], shift=ours[0], variance=ours[1], other=theirs[0], halvings=0),
        vertical=solved.vertical,
        window=window,
    )


def refined(
    images: Both[Level], coarse: Refined, vertical: Vertical, level: int, settings: MatchSettings, pool: Executor
) -> Refined:
    """The left image's matches on the next finer level, by two steps."""
    shape = images[0].mask.shape
    sigma = settings.window_sigma_px
    limit = DIRECTIONS_APART_PX * 2**coarse.halvings
    known = upsampled_start(coarse.matches, coarse.shift, agreeing(coarse.shift, coarse.other, limit), shape)
    here, there = both(pool, prepare_side, (images[0], aligned(vertical, images[1], level)), (sigma, sigma))
    fine = Refined(
        matches=MatchEstimate(
            **{name: np.empty(shape, dtype=np.float32) for name in ("shift", "step", "correlation", "variance")},
            plausible=np.empty(shape, dtype=bool),
        ),
        shift=np.empty(shape, dtype=np.float32),
        variance=np.empty(shape, dtype=np.float32),
        other=finer_shift(coarse.other, shape),
        halvings=coarse.halvings + 1,
    )
    apart = AGREEMENT_PX * 2**fine.halvings

    def band(top: int) -> None:
        bottom = min(top + _BAND_ROWS, shape[0])
        read = slice(max(0, top - _HALO_ROWS), min(shape[0], bottom + _HALO_ROWS))
        part = _rows(known, read)
        ours, theirs, other = _side(here, read), _side(there, read), fine.other[read]

        def stepped(shift: Float32[Array, "h w"], *, widely: bool) -> MatchEstimate:
            found = step(ours, theirs, shift, sigma, widely=widely)
            return judged(found, agreeing(found.shift, other, apart), part)

        found = stepped(part.shift, widely=False)
        weights = smoothing_weights(found.variance, found.plausible, ours.mask)
        before = smooth(found.shift, weights, LAST_SMOOTHING_PX, part.shift)
        found = stepped(before, widely=True)
        shift, variance = finally_smoothed(found, ours.mask, before, settings)
        inner = slice(top - read.start, bottom - read.start)
        for name in MatchEstimate.__dataclass_fields__:
            getattr(fine.matches, name)[top:bottom] = getattr(found, name)[inner]
        fine.shift[top:bottom], fine.variance[top:bottom] = shift[inner], variance[inner]

    list(pool.map(band, range(0, shape[0], _BAND_ROWS)))
    return fine


def _side(side: Side, rows: slice) -> Side:
    return Side(image=side.image[rows], coefficients=side.coefficients[rows], mask=side.mask[rows])


def _rows(known: LevelStart, rows: slice) -> LevelStart:
    """Some rows of the start from a level of half as many rows. The first row is even."""
    half = slice(rows.start // 2, (rows.stop + 1) // 2)
    return LevelStart(
        shift=known.shift[rows],
        correlation=known.correlation[half],
        variance=known.variance[half],
        plausible=known.plausible[half],
        halved=known.halved,
    )


# --- 3. Finish -------------------------------------------------------------------------------------------------------


def finish(pair: RectifiedPair, found: Finest, settings: MatchSettings, pool: Executor) -> DisparityMap:
    """Decide which matches are accepted, and return the map at the requested resolution."""
    levels, window = found.levels, found.window
    trusted = _accept(pair.name, found, settings, pool)
    del found  # 50 MB for a full-size pair, and as much is allocated next
    finest_hw = _level_shape(pair, levels.finest)
    part = at_level(window, levels.coarsest - levels.finest, finest_hw)
    left, right = pair.left, pair.right
    full = settings.resolution == "full"
    for _ in range(0 if full else levels.finest):
        left, right = coarser_camera(left), coarser_camera(right)
    doublings = levels.finest if full else 0

    def laid_out(values: Array) -> Array:
        values = pasted(values, part, finest_hw)
        for level in range(levels.finest - 1, levels.finest - 1 - doublings, -1):
            double = finer_mask if values.dtype == np.bool_ else finer_field
            values = double(values, _level_shape(pair, level))
        return values

    valid, weak = laid_out(trusted.valid), laid_out(trusted.weak)
    if full:
        valid, weak = valid & pair.left_mask, weak & pair.left_mask

    def field_of(values: Float32[Array, "h w"], scale: float, step: float | None) -> Float32[Array, "H W"]:
        made = laid_out(values)
        made *= np.float32(scale)
        made *= valid
        return to_bits(made, SIGMA_BITS) if step is None else to_step(made, step)

    scale = 2.0**doublings
    fields = (trusted.shift, trusted.d_v, trusted.confidence, trusted.sigma)
    steps = (_D_H_STEP_PX, _D_V_STEP_PX, _CONFIDENCE_STEP, None)
    d_h, d_v, confidence, sigma = pool.map(field_of, fields, (-scale, scale, 1.0, scale), steps)
    return DisparityMap(
        name=pair.name,
        halvings=levels.finest - doublings,
        left=left,
        right=right,
        d_h_px=d_h,
        d_v_px=d_v,
        confidence=confidence,
        sigma_px=sigma,
        valid=valid,
        weak=weak,
    )


def requirements(found: Finest, settings: MatchSettings) -> dict[str, Bool[Array, "h w"]]:
    """Requirements on a match, each with the mask of the finest level's pixels that meet it."""
    fine, matches, window = found.matches, found.matches.matches, settings.window_sigma_px
    doubted = matches.variance * unexplained(found.image, matches, window)
    return {
        "plausible": matches.plausible,
        "correlates": matches.correlation > LEAST_CORRELATION,
        "settled": np.abs(matches.step) < _LAST_STEP_PX,
        "left and right agree": agreeing(fine.shift, fine.other, DIRECTIONS_APART_PX * 2**fine.halvings),
        "certain": np.sqrt(doubted) * (1 + _DOUBT_SLOPE * squared_slope(fine.shift)) < LARGEST_SIGMA_PX,
    }


def _accept(name: str, found: Finest, settings: MatchSettings, pool: Executor) -> AcceptedMatches:
    """Accept matches that correlate, have converged, agree in both directions, and are certain."""
    matches, shift, sigma = found.matches.matches, found.matches.shift, found.matches.variance
    window = settings.window_sigma_px
    too_weak = pool.submit(weak_texture, found.image, matches, window, LARGEST_SIGMA_PX)
    met = requirements(found, settings)
    steep = squared_slope(shift)
    weak = too_weak.result()  # before the correlation is clipped in place
    valid = np.logical_and.reduce(list(met.values()))
    # Random agreement gives small islands, usually outside an outline, which are too small to be confirmed.
    valid = without_specks(valid, round(_ISLAND_WINDOWS * 4 * np.pi * window**2))
    if not valid.any():
        raise MatchingError(
            f"pair {name}",
            found="no matching points in the two images",
            expected="the same textured skin in both",
            remedy="Check the subject's outline in both images, and draw a mask if one is wrong. If both are right, "
            "check that the photographs are in focus, from one exposure, and have the right camera names",
        )
    np.sqrt(sigma, out=sigma)
    steep *= np.float32(_SIGMA_SLOPE)
    steep += np.float32(1)
    sigma *= steep
    sigma *= np.float32(_SIGMA_SCALE)
    confidence = np.clip(matches.correlation, -1, 1, out=matches.correlation)
    columns = np.arange(shift.shape[1], dtype=np.float32) + shift
    d_v = found.vertical.at(columns, found.levels.finest)
    return AcceptedMatches(shift=shift, d_v=d_v, sigma=sigma, confidence=confidence, valid=valid, weak=weak)


def _level_shape(pair: RectifiedPair, level: int) -> tuple[int, int]:
    return -(-pair.left_mask.shape[0] // 2**level), -(-pair.left_mask.shape[1] // 2**level)
