"""What a disparity map says about itself."""

from dataclasses import replace

import numpy as np
import pytest
from textured_pair import make_pair

from mammometry.matching.dense.match import DisparityMap, match
from mammometry.matching.foreground.outlines_first import without_outline
from mammometry.matching.quality import assess, concerns
from mammometry.matching.rectify import RectifiedPair
from mammometry.report.figures.thinning import thinned_map
from mammometry.surface.motion.agreement import row_errors


def changed(pair: RectifiedPair, left: np.ndarray, right: np.ndarray) -> RectifiedPair:
    return RectifiedPair(
        name=pair.name,
        left=pair.left,
        right=pair.right,
        left_image=left.astype(np.float32),
        right_image=right.astype(np.float32),
        left_mask=pair.left_mask,
        right_mask=pair.right_mask,
    )


def with_vertical(d_v_px: np.ndarray) -> DisparityMap:
    pair, _ = make_pair(np.random.default_rng(0), size_wh=(60, 50))
    valid = pair.left_mask
    ones = valid.astype(np.float32)
    return DisparityMap(
        name="front",
        left=pair.left,
        right=pair.right,
        d_h_px=ones,
        d_v_px=(ones * d_v_px).astype(np.float32),
        confidence=ones,
        sigma_px=ones,
        valid=valid,
        weak=np.zeros_like(valid),
    )


@pytest.mark.parametrize(("offset", "spread", "alarm"), [(0.0, 0.1, False), (-0.5, 0.0, True), (0.01, 0.47, False)])
def test_the_vertical_disparity_is_the_calibrations_alarm(offset: float, spread: float, alarm: bool) -> None:
    """Scatter of single pixels is no sign that a camera moved."""
    noise = np.random.default_rng(1).normal(0, 1, (50, 60))
    quality = assess(with_vertical(offset + spread * noise))
    assert quality.d_v_median_px == pytest.approx(offset, abs=0.05)
    assert quality.d_v_spread_px == pytest.approx(spread, abs=0.05)  # three standard errors of 1700 pixels
    assert quality.calibration_alarm == alarm
    assert [notice.code for notice in concerns("front", quality)] == ["pair-moved"] * alarm


def test_a_missing_outline_comes_before_a_moved_camera() -> None:
    """The background that was matched instead of the subject does not fit the calibration either."""
    quality = assess(with_vertical(np.full((50, 60), -0.5)))
    assert quality.calibration_alarm
    doubts = {"front_l": "nothing stands out", "front_r": ""}
    missing = without_outline(("front_l", "front_r"), doubts)
    found, advice = concerns("front", quality, missing)
    assert (found.code, advice.code) == ("pair-disagrees", "outline-first")
    assert advice.values == {"masks": "masks/front_l.png"}
    assert advice.photographs == ("capture/front_l",)
    assert without_outline(("left_l", "left_r"), doubts) == ()
    (found,) = concerns("left", quality)
    assert (found.code, found.about) == ("pair-moved", ("left",))


def test_a_camera_that_rolled_leaves_no_median_but_a_slope() -> None:
    noise = 0.1 * np.random.default_rng(1).normal(0, 1, (50, 60))
    found = with_vertical(0.7 * np.linspace(-1, 1, 60) + noise)
    quality = assess(found)
    assert quality.calibration_alarm
    assert quality.d_v_smooth_px == pytest.approx(found.d_v_px[found.valid].std(), rel=0.15)
    assert quality.d_v_smooth_std_px < 0.03


def test_a_maps_figures_are_in_pixels_of_the_rectified_pair() -> None:
    whole = with_vertical(np.full((50, 60), 0.2))
    halved = assess(replace(whole, halvings=1))
    assert halved.d_v_median_px == pytest.approx(2 * assess(whole).d_v_median_px)
    assert halved.sigma_median_px == 2 * assess(whole).sigma_median_px
    assert halved.calibration_alarm
    assert not assess(whole).calibration_alarm
    drawn = thinned_map(replace(whole, halvings=1))
    np.testing.assert_array_equal(drawn.d_v_px, 2 * thinned_map(whole).d_v_px)
    assert row_errors(replace(whole, halvings=1)).pixel_rad == row_errors(whole).pixel_rad / 2


@pytest.mark.slow
def test_a_rig_that_moved_is_noticed_by_matching_itself() -> None:
    pair, _ = make_pair(np.random.default_rng(2), d_v_px=0.6)
    quality = assess(match(pair))
    assert quality.calibration_alarm
    assert quality.d_v_median_px == pytest.approx(0.6, abs=0.03)


@pytest.mark.slow
def test_weak_texture_is_reported_where_it_is_and_nowhere_else() -> None:
    rng = np.random.default_rng(3)
    pair, _ = make_pair(rng, noise=0.0)
    flat = np.arange(pair.left_image.shape[1]) > 110
    images = [
        np.where(flat, 0.5, image) + rng.normal(0, 0.004, image.shape) for image in (pair.left_image, pair.right_image)
    ]
    found = match(changed(pair, *images))
    deep_flat = pair.left_mask & (np.arange(220) > 130)
    textured = pair.left_mask & (np.arange(220) < 90)
    assert found.weak[deep_flat].mean() > 0.9  # noise alone seems to have some slope in a few windows
    assert found.weak[textured].mean() < 0.02
    assert found.valid[deep_flat].mean() < 0.02
    quality = assess(found)
    assert quality.weak_percent > 25
    assert "texture-weak" in {notice.code for notice in concerns("front", quality)}
    assert not found.weak[~pair.left_mask].any()
