"""Turning a number of matching does what its docstring says; other tests turn the ones not named here.

`resolution`: test_match. `vertical`: test_free_vertical. `foreground.mode`: test_foreground.
"""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest
from alone import foreground as foreground_of
from scipy import ndimage
from test_foreground import RADIUS, SIZE, U, picture
from test_rectify import converging, foreground, grey
from tests.first_cases import first
from textured_pair import Texture, make_pair

from mammometry.base.progress import no_progress
from mammometry.matching.dense.least_squares import Levels, choose_levels
from mammometry.matching.dense.least_squares_step import prepare_side, step
from mammometry.matching.dense.match import DisparityMap, match, prepare
from mammometry.matching.pyramid import Level
from mammometry.matching.rectify import RectifiedPair, rectify
from mammometry.matching.settings import MatchSettings

DEFAULT = MatchSettings()


@pytest.fixture(scope="module")
def noisy() -> tuple[RectifiedPair, np.ndarray]:
    return make_pair(np.random.default_rng(21), noise=0.02)


@pytest.fixture(scope="module")
def by_default(noisy: tuple[RectifiedPair, np.ndarray]) -> DisparityMap:
    return match(noisy[0])


def levels(span_px: int) -> Levels:
    return choose_levels("front", [np.ones((span_px, span_px), bool)] * 2)


# --- the subject and the rectified pictures


def test_a_lower_contour_level_lays_the_silhouette_further_out(monkeypatch: pytest.MonkeyPatch) -> None:
    photograph = picture(np.full(SIZE, 0.4), np.full(SIZE, 0.004))
    areas = []
    for level in (0.2, 0.4, 0.7):
        monkeypatch.setattr("mammometry.matching.foreground.foreground.CONTOUR_LEVEL", level)
        areas.append(foreground_of(photograph, "a").mask.sum())
    assert areas[0] > areas[1] > areas[2]


def test_a_larger_margin_over_the_backdrop_keeps_less_of_a_dark_flank(monkeypatch: pytest.MonkeyPatch) -> None:
    """The flank's light falls to a sixteenth of the front's; in grey nothing but brightness tells it apart."""
    shade = np.clip((U - 60) / 160, 0.06, 1)
    photograph = picture(0.4 * shade, np.full(SIZE, 0.004), grey=True)
    whole = np.pi * RADIUS**2
    shares = []
    for margin in (1.05, 2.0):
        monkeypatch.setattr("mammometry.matching.foreground.block_segmentation.BACKGROUND_MARGIN", margin)
        shares.append(foreground_of(photograph, "a").mask.sum() / whole)
    assert shares[0] > 0.99
    assert shares[1] < 0.97


def test_the_margin_is_kept_around_the_silhouette(monkeypatch: pytest.MonkeyPatch) -> None:
    texture = Texture.random(np.random.default_rng(0), shortest_px=6.0, longest_px=50.0, contrast=0.05)
    v, u = np.mgrid[:220, :300]
    photograph, subject = grey(texture), foreground(np.hypot(u - 150, v - 110) < 70)
    shapes = []
    for margin in (16, 30):
        monkeypatch.setattr("mammometry.matching.rectify.MARGIN_PX", margin)
        pair = rectify(converging(), photograph, photograph, subject, subject)
        shapes.append(np.array(pair.left_image.shape))
        rows, columns = np.nonzero(pair.left_mask)
        assert abs(min(rows.min(), columns.min()) - margin) <= 2
    np.testing.assert_array_equal(shapes[1] - shapes[0], 28)


@pytest.mark.slow
def test_so_many_pixels_are_taken_off_the_silhouette(
    noisy: tuple[RectifiedPair, np.ndarray], monkeypatch: pytest.MonkeyPatch
) -> None:
    pair = noisy[0]
    with ThreadPoolExecutor(2) as pool:
        for pixels in (0, 2, 5):
            monkeypatch.setattr("mammometry.matching.dense.match.ERODE_PX", pixels)
            begun = prepare(pair, DEFAULT, pool, no_progress)
            expected = ndimage.binary_erosion(pair.left_mask, iterations=pixels) if pixels else pair.left_mask
            np.testing.assert_array_equal(begun.images[0][0].mask, expected)


# --- where matching starts


def test_the_start_is_made_where_the_subject_spans_no_more_than_400_pixels() -> None:
    assert levels(390).coarsest == 1  # above 230 px one level coarser than full
    assert levels(1500).coarsest == 2
    assert all(span / 2 ** levels(span).coarsest <= 400 for span in range(24, 3300, 61))


def test_both_pictures_are_matched_where_the_subject_spans_no_more_than_asked(monkeypatch: pytest.MonkeyPatch) -> None:
    assert levels(790).last_both == 0
    assert levels(1590) == Levels(coarsest=2, last_both=1, finest=1)
    monkeypatch.setattr("mammometry.matching.dense.least_squares.FINEST_SPAN_PX", 400.0)
    assert levels(790).last_both == 1


@pytest.mark.slow
def test_the_start_searches_that_share_of_the_subjects_width(
    noisy: tuple[RectifiedPair, np.ndarray], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Both masks are one disc of 184 px less 2 × 2: the search lies around no shift."""
    with ThreadPoolExecutor(2) as pool:
        for share in (0.01, 0.25):
            monkeypatch.setattr("mammometry.matching.dense.match.SEARCH_SHARE", share)
            begun = prepare(noisy[0], DEFAULT, pool, no_progress)
            reach = np.ceil(share * np.nonzero(begun.images[-1][0].mask.any(axis=0))[0].size)
            assert np.abs(begun.known[0].shift).max() <= reach
            if share > 0.1:
                assert np.abs(begun.known[0].shift).max() > 4, "the disparity of this pair"


# --- windows and smoothing


def test_a_larger_window_is_surer_of_its_shift(noisy: tuple[RectifiedPair, np.ndarray]) -> None:
    assert replace(DEFAULT, window_px=np.sqrt(12) * 5).window_sigma_px == pytest.approx(5.0)
    pair, truth = noisy
    variances = []
    for window_px in (DEFAULT.window_px, 2 * DEFAULT.window_px):
        sigma = replace(DEFAULT, window_px=window_px).window_sigma_px
        left, right = (
            prepare_side(Level(image=image, mask=mask), sigma)
            for image, mask in ((pair.left_image, pair.left_mask), (pair.right_image, pair.right_mask))
        )
        found = step(left, right, -truth.astype(np.float32), sigma, widely=False)
        variances.append(float(np.median(found.variance[found.plausible])))
    assert variances[1] < 0.4 * variances[0]  # a quarter, of four times the area


@pytest.mark.slow
def test_coarser_smoothings_take_more_noise(
    noisy: tuple[RectifiedPair, np.ndarray], by_default: DisparityMap, monkeypatch: pytest.MonkeyPatch
) -> None:
    pair, truth = noisy
    monkeypatch.setattr("mammometry.matching.dense.least_squares.SMOOTHING_PX", (2.5,))
    fine = match(pair)
    at = fine.valid & by_default.valid & ndimage.binary_erosion(pair.left_mask, iterations=12)
    assert np.std((fine.d_h_px - truth)[at]) > 1.3 * np.std((by_default.d_h_px - truth)[at])


# --- what is accepted


@pytest.mark.parametrize(("name", "limit"), first(1, [("DIRECTIONS_APART_PX", 0.02), ("LARGEST_SIGMA_PX", 0.1)]))
def test_less_is_accepted_where_more_is_asked(
    noisy: tuple[RectifiedPair, np.ndarray],
    by_default: DisparityMap,
    name: str,
    limit: float,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(f"mammometry.matching.dense.match.{name}", limit)
    accepted = match(noisy[0]).valid
    assert accepted.sum() < 0.7 * by_default.valid.sum()


def test_no_match_below_the_least_correlation_is_accepted(
    noisy: tuple[RectifiedPair, np.ndarray], by_default: DisparityMap, monkeypatch: pytest.MonkeyPatch
) -> None:
    least = float(np.median(by_default.confidence[by_default.valid]))
    monkeypatch.setattr("mammometry.matching.dense.match.LEAST_CORRELATION", least)
    strict = match(noisy[0])
    assert by_default.confidence[by_default.valid].min() < least - 0.05
    assert strict.confidence[strict.valid].min() >= least  # both in steps of 2^-7
