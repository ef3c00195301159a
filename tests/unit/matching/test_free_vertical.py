"""The vertical disparity free at each pixel (Eq. 1 as printed), beside the polynomial of a pair."""

import numpy as np
import pytest
from scipy import ndimage
from textured_pair import make_pair

from mammometry.matching.dense.least_squares_step import Side, prepare_side
from mammometry.matching.dense.match import DisparityMap, match
from mammometry.matching.dense.vertical_disparity import FreeVertical, nothing_yet, vertical_step
from mammometry.matching.pyramid import Level
from mammometry.matching.rectify import RectifiedPair
from mammometry.matching.settings import MatchSettings

FREE = MatchSettings(vertical="free")
SIZE_WH = (220, 180)


def waves(u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Vertical disparity of ± 0.5 px that no quadratic polynomial follows, px."""
    return 0.5 * np.sin(2 * np.pi * u / 90) * np.cos(2 * np.pi * v / 110)


def judged(pair: RectifiedPair, found: DisparityMap) -> np.ndarray:
    """Matched pixels whose windows lie inside both subjects."""
    return ndimage.binary_erosion(pair.left_mask & pair.right_mask, iterations=12) & found.valid


@pytest.mark.slow
def test_what_no_polynomial_follows_is_found_at_each_pixel() -> None:
    pair, d_h = make_pair(np.random.default_rng(11), size_wh=SIZE_WH, d_v_px=waves)
    v, u = np.indices(d_h.shape).astype(np.float64)
    truth = waves(u - d_h, v)
    free, polynomial = match(pair, FREE), match(pair)
    at = judged(pair, free)
    assert at.sum() > 0.95 * judged(pair, polynomial).sum()
    error, rival = (np.abs(found.d_v_px - truth)[at] for found in (free, polynomial))
    assert np.percentile(error, 95) < 0.1
    assert np.percentile(rival, 95) > 0.3
    assert np.median(np.abs(free.d_h_px - d_h)[at]) < np.median(np.abs(polynomial.d_h_px - d_h)[at])


@pytest.mark.slow
def test_by_a_right_calibration_both_agree_within_their_deviation() -> None:
    pair, _ = make_pair(np.random.default_rng(12), size_wh=SIZE_WH)
    free, polynomial = match(pair, FREE), match(pair)
    both = judged(pair, free) & judged(pair, polynomial)
    apart = np.abs(free.d_h_px - polynomial.d_h_px)[both] / polynomial.sigma_px[both]
    assert np.percentile(apart, 95) < 1
    assert np.median(np.abs(free.d_v_px[both])) < 0.03
    assert abs(free.d_v_px[both].mean()) < 0.01


def test_a_large_subject_takes_the_field_of_the_level_before(monkeypatch: pytest.MonkeyPatch) -> None:
    pair, d_h = make_pair(np.random.default_rng(13), size_wh=SIZE_WH, noise=0.002, d_v_px=waves)
    v, u = np.indices(d_h.shape).astype(np.float64)
    monkeypatch.setattr("mammometry.matching.dense.least_squares.FINEST_SPAN_PX", 50.0)
    found = match(pair, MatchSettings(vertical="free", resolution="full"))
    error = np.abs(found.d_v_px - waves(u - d_h, v))[judged(pair, found)]
    assert np.median(error) < 0.1


def test_the_vertical_step_is_signed_from_this_image_to_the_other() -> None:
    noise = np.random.default_rng(14).standard_normal((90, 120))
    here = 0.05 * ndimage.gaussian_filter(noise, 2.0).astype(np.float32) / 0.14
    there = ndimage.shift(here, (0.3, 0), order=5, mode="nearest").astype(np.float32)  # seen 0.3 rows lower
    sides = [prepare_side(Level(image=image, mask=np.ones(image.shape, bool)), 2.5) for image in (here, there)]
    change, variance, determined = vertical_step(sides[0], sides[1], np.zeros_like(here), 2.5)
    inner = np.zeros(here.shape, bool)
    inner[15:-15, 15:-15] = True
    assert determined[inner].mean() > 0.99
    assert np.median(change[inner & determined]) > 0.25
    assert np.median(change[inner & determined]) < 0.45  # one linear step with central differences
    assert (variance[determined] > 0).all()


def test_rows_alone_tell_nothing_of_the_vertical() -> None:
    """Vertical stripes look the same one row lower."""
    stripes = np.broadcast_to(np.sin(np.arange(120) / 2.0).astype(np.float32) * 0.05, (90, 120)).copy()
    side: Side = prepare_side(Level(image=stripes, mask=np.ones(stripes.shape, bool)), 2.5)
    change, variance, determined = vertical_step(side, side, np.zeros_like(stripes), 2.5)
    inner = (slice(15, -15), slice(15, -15))
    assert not determined[inner].any()
    assert not change[inner].any()
    assert (variance[inner] >= 1e4).all()


def test_the_field_is_read_on_its_own_level_and_on_finer_ones() -> None:
    field = FreeVertical(d_v_px=np.tile(np.arange(10, dtype=np.float32), (6, 1)), level=2, window_sigma_px=2.5)
    columns = np.broadcast_to(np.array([0.0, 2.5, 9.0], dtype=np.float32), (6, 3)).copy()
    np.testing.assert_allclose(field.at(columns, 2)[3], [0.0, 2.5, 9.0])
    finer = np.broadcast_to(np.arange(20, dtype=np.float32), (12, 20)).copy()
    # A pixel at u lies at (u + 0.5)/2 − 0.5 on the coarser level, whose pixels are two of these.
    np.testing.assert_allclose(field.at(finer, 1)[5, 2:-2], 2 * ((np.arange(2, 18) + 0.5) / 2 - 0.5), atol=1e-5)
    cut = field.cut((slice(2, 5), slice(4, 9)), 2)
    np.testing.assert_array_equal(cut.at(np.zeros((3, 1), np.float32), 2), np.full((3, 1), 4.0))
    assert field.matters(0)
    assert not nothing_yet((6, 10), 2, 2.5).matters(0)
