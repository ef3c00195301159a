"""Matching of pairs whose disparity is known in closed form.

Tolerances: for white noise of σ_n in both images the variance of a shift from a window of effective area A and mean
squared slope g² is 2 σ_n²/(A g²) (Cramér–Rao). With σ_n = .004, contrast .05 over waves of 5–40 px (g² ≈ 6e-4 / px²)
and A = 4π·2.5² the deviation is .026 px before smoothing, of which the final plane fits leave about half.
"""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from scipy import ndimage
from tests.first_cases import first
from textured_pair import make_pair

from mammometry.base.errors import MatchingError
from mammometry.base.progress import no_progress
from mammometry.matching.dense import match as refine
from mammometry.matching.dense.least_squares import choose_levels
from mammometry.matching.dense.match import coarse_to_fine, match, prepare, requirements
from mammometry.matching.rectify import RectifiedPair
from mammometry.matching.settings import MatchSettings


def with_images(pair: RectifiedPair, left: np.ndarray, right: np.ndarray) -> RectifiedPair:
    return RectifiedPair(
        name=pair.name,
        left=pair.left,
        right=pair.right,
        left_image=left,
        right_image=right,
        left_mask=pair.left_mask,
        right_mask=pair.right_mask,
    )


def inner(mask: np.ndarray, pixels: int = 8) -> np.ndarray:
    return ndimage.binary_erosion(mask, iterations=pixels)


def errors(pair: RectifiedPair, truth: np.ndarray, settings: MatchSettings = MatchSettings()) -> tuple:
    found = match(pair, settings)
    judged = inner(pair.left_mask & pair.right_mask)
    return found, (found.d_h_px - truth)[judged & found.valid], (judged & found.valid).sum() / judged.sum()


@pytest.mark.parametrize(
    ("gain", "offset"), first(1, [(1.5, -0.1), (1.0, 0.0)]), ids=["half a stop more", "same exposure"]
)
def test_a_smooth_disparity_is_found_to_a_few_hundredths(gain: float, offset: float) -> None:
    pair, truth = make_pair(np.random.default_rng(1), gain=gain, offset=offset)
    found, error, complete = errors(pair, truth)
    assert complete > 0.99
    assert np.median(np.abs(error)) < 0.026
    assert np.percentile(np.abs(error), 95) < 0.1
    assert abs(error.mean()) < 0.015  # three standard errors: after smoothing about 40 patches are independent
    assert found.confidence[found.valid].min() > 0.5
    assert not found.d_h_px[~found.valid].any()
    assert not found.valid[~pair.left_mask].any()
    for field, step in (("d_h_px", 2.0**-8), ("d_v_px", 2.0**-10), ("confidence", 2.0**-7)):
        assert not np.any(np.mod(getattr(found, field) / step, 1)), "files and memory hold the same, and no noise"
    assert not np.any(found.sigma_px.view(np.uint32) & 0x3FFFF), "six binary digits"


def test_the_expected_deviation_is_that_of_the_errors() -> None:
    pair, truth = make_pair(np.random.default_rng(2), noise=0.008)
    found, error, _ = errors(pair, truth)
    judged = inner(pair.left_mask & pair.right_mask) & found.valid
    score = 1.4826 * np.median(np.abs(error) / found.sigma_px[judged])
    assert 0.4 < score < 1.3  # an expected σ that is wrong by more than a factor of two would mislead the fusion


@pytest.mark.slow
def test_vertical_disparity_is_measured_and_does_no_harm() -> None:
    pair, truth = make_pair(np.random.default_rng(3), d_v_px=-0.7)
    found, error, complete = errors(pair, truth)
    assert np.median(found.d_v_px[found.valid]) == pytest.approx(-0.7, abs=0.03)
    assert complete > 0.99
    assert np.median(np.abs(error)) < 0.035


@pytest.mark.slow
def test_without_texture_nothing_is_invented() -> None:
    rng = np.random.default_rng(4)
    pair, _ = make_pair(rng)
    half = np.arange(pair.left_image.shape[1]) < 110
    flat = rng.normal(0.5, 0.0005, (2, *pair.left_image.shape)).astype(np.float32)  # a quarter of an 8-bit step
    found = match(
        with_images(pair, np.where(half, pair.left_image, flat[0]), np.where(half, pair.right_image, flat[1]))
    )
    deep_flat = inner(pair.left_mask) & (np.arange(220) > 135)
    textured = inner(pair.left_mask) & (np.arange(220) < 90)
    assert found.valid[deep_flat].mean() < 0.01
    assert found.valid[textured].mean() > 0.97


def test_noise_alone_is_refused() -> None:
    rng = np.random.default_rng(5)
    pair, _ = make_pair(rng)
    noise = rng.normal(0.5, 0.05, (2, *pair.left_image.shape)).astype(np.float32)
    try:
        found = match(with_images(pair, noise[0], noise[1]))
    except MatchingError:
        return
    assert found.valid[pair.left_mask].mean() < 0.01


@pytest.mark.slow
def test_small_islands_of_agreement_are_not_believed() -> None:
    """Where the pictures show different things some windows agree by chance; a part of four windows does not."""
    rng = np.random.default_rng(7)
    pair, _ = make_pair(rng)
    other, _ = make_pair(rng)
    half = np.arange(pair.left_image.shape[1]) < 110
    found = match(with_images(pair, pair.left_image, np.where(half, pair.right_image, other.right_image)))
    labels, count = ndimage.label(found.valid, structure=np.ones((3, 3)))
    areas = ndimage.sum_labels(found.valid, labels, np.arange(1, count + 1))
    assert areas.min() >= 4 * 4 * np.pi * 2.5**2 - 1
    strange = pair.left_mask & (np.arange(220) > 130)
    assert found.valid[strange].mean() < 0.01
    assert found.valid[inner(pair.left_mask) & (np.arange(220) < 90)].mean() > 0.97


def test_an_empty_mask_is_an_error_that_names_the_pair() -> None:
    pair, _ = make_pair(np.random.default_rng(6))
    empty = RectifiedPair(
        name="front",
        left=pair.left,
        right=pair.right,
        left_image=pair.left_image,
        right_image=pair.right_image,
        left_mask=np.zeros_like(pair.left_mask),
        right_mask=pair.right_mask,
    )
    with pytest.raises(MatchingError, match="pair front"):
        match(empty)


def test_a_coarser_map_has_the_cameras_of_its_own_pixels(monkeypatch: pytest.MonkeyPatch) -> None:
    pair, truth = make_pair(np.random.default_rng(7))
    monkeypatch.setattr("mammometry.matching.dense.least_squares.FINEST_SPAN_PX", 100.0)
    found = match(pair)
    assert found.valid.shape == (90, 110) == found.left.shape_hw
    assert found.pair_px == 2
    # The same point of the world has u' = (u + .5)/2 − .5, so its disparity is half.
    point = np.array([[12.0, -9.0, 900.0]])
    fine, coarse = pair.left.project(point), found.left.project(point)
    np.testing.assert_allclose(coarse, (fine + 0.5) / 2 - 0.5)
    means = truth.reshape(90, 2, 110, 2).mean(axis=(1, 3))
    assert np.median(np.abs(found.d_h_px - means / 2)[found.valid]) < 0.03


@pytest.mark.slow
def test_a_coarse_solution_comes_back_at_full_resolution(monkeypatch: pytest.MonkeyPatch) -> None:
    pair, truth = make_pair(np.random.default_rng(8), noise=0.002)
    monkeypatch.setattr("mammometry.matching.dense.least_squares.FINEST_SPAN_PX", 100.0)
    found, error, complete = errors(pair, truth, MatchSettings(resolution="full"))
    assert found.valid.shape == truth.shape
    assert complete > 0.98
    assert np.median(np.abs(error)) < 0.06


@pytest.mark.slow
def test_a_large_subject_is_matched_finer_from_the_left_picture_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    pair, truth = make_pair(np.random.default_rng(8), noise=0.002)
    # Both pictures are matched at a quarter of their size, the left one at half.
    monkeypatch.setattr("mammometry.matching.dense.least_squares.FINEST_SPAN_PX", 50.0)
    alone = MatchSettings(resolution="full")
    found, error, complete = errors(pair, truth, alone)
    assert complete > 0.98
    assert np.median(np.abs(error)) < 0.06  # as where both are matched at half: a quarter's errors are twice as large
    monkeypatch.setattr(refine, "_BAND_ROWS", 32)
    banded = match(pair, alone)
    np.testing.assert_array_equal(banded.valid, found.valid)
    # What lies beyond the bands' halo, 3 σ of two passes of the widest smoothing, has no weight.
    np.testing.assert_allclose(banded.d_h_px, found.d_h_px, atol=2e-3)


@pytest.mark.slow
def test_a_cluttered_scene_is_cut_where_the_coarsest_level_is_the_last_of_both(monkeypatch: pytest.MonkeyPatch) -> None:
    """Half of the left picture is shown nowhere in the right one; the rest is worked on alone."""
    rng = np.random.default_rng(10)
    size_wh = (440, 360)
    pair, truth = make_pair(rng, size_wh=size_wh, noise=0.002)
    other, _ = make_pair(rng, size_wh=size_wh)
    shown = np.arange(size_wh[0]) > 250
    cluttered = with_images(pair, pair.left_image, np.where(shown, pair.right_image, other.right_image))
    monkeypatch.setattr("mammometry.matching.dense.least_squares.FINEST_SPAN_PX", 100.0)
    levels = choose_levels("front", [pair.left_mask])
    assert levels.coarsest == levels.last_both > levels.finest
    found = match(cluttered, MatchSettings(resolution="full"))
    assert found.valid.shape == pair.left_mask.shape
    judged = inner(pair.left_mask) & (np.arange(size_wh[0]) > 275)
    assert found.valid[judged].mean() > 0.95
    assert not found.valid[:, :200].any()
    assert np.percentile(np.abs(found.d_h_px - truth)[judged & found.valid], 95) < 0.05


@pytest.mark.slow
def test_progress_never_goes_back_and_ends_at_one() -> None:
    pair, _ = make_pair(np.random.default_rng(9))
    seen: list[float] = []
    match(pair, progress=seen.append)
    assert seen == sorted(seen)
    assert seen[-1] == 1.0


@pytest.mark.slow
def test_what_is_accepted_meets_every_requirement_and_each_rejects_noise() -> None:
    """Half of the right picture is noise: there the requirements fail, elsewhere they hold nearly everywhere."""
    pair, _ = make_pair(np.random.default_rng(8))
    right, settings = pair.right_image.copy(), MatchSettings()
    half = right.shape[1] // 2
    right[:, half:] = np.random.default_rng(9).uniform(0.2, 0.8, right[:, half:].shape)
    pair = with_images(pair, pair.left_image, right)
    with ThreadPoolExecutor(2) as pool:
        found = coarse_to_fine(prepare(pair, settings, pool, no_progress), settings, pool, no_progress)
        met = requirements(found, settings)
    valid = match(pair, settings).valid
    all_met = np.logical_and.reduce(list(met.values()))
    assert all_met.shape == valid.shape
    assert all_met[valid].all()
    judged = inner(pair.left_mask, 12)
    columns = np.arange(valid.shape[1])
    assert all_met[judged & (columns < half - 30)].mean() > 0.95
    assert all_met[judged & (columns > half + 30)].mean() < 0.2
