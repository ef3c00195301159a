"""Circle boards against exact pictures: the centroid's perspective error is taken off."""

import cv2
import numpy as np
import pytest
from printed import camera, centred, circles, photograph_of_board

from mammometry.base.photograph import Photograph
from mammometry.calibration.detection.detect import detect_in
from mammometry.calibration.targets.kinds.circles import CirclesTarget


@pytest.mark.slow
@pytest.mark.parametrize(
    "target",
    [
        CirclesTarget(grid=(7, 5), pitch_mm=26.0, diameter_mm=17.0),
        pytest.param(
            CirclesTarget(grid=(4, 9), pitch_mm=20.0, diameter_mm=17.0, asymmetric=True), marks=pytest.mark.slow
        ),
    ],
)
def test_centres_are_where_they_are_projected(target):
    middle = centred(target.points_target)
    pattern, shift = circles(target), middle.translation_mm
    view = camera(turn_deg=(28.0, -24.0, 8.0), distortion=(-0.1, 0.05, 0.001, 0.0, 0.0))
    photograph = photograph_of_board(view, lambda x, y: pattern(x - shift[0], y - shift[1]))
    found = detect_in(photograph, target, camera="camera", pose="00")
    assert np.array_equal(found.ids, np.arange(len(target.points_target)))
    error = found.uv - view.project(middle.apply(target.points_target))
    # The centroids of these ellipses lie up to 0.2 px beside the centres' pictures.
    assert np.abs(error.mean(axis=0)).max() < 0.02
    assert np.sqrt(np.square(error).mean()) < 0.03


@pytest.mark.slow
@pytest.mark.parametrize("turn_deg", [(52.0, 0.0, 6.0), pytest.param((-20.0, 50.0, -8.0), marks=pytest.mark.slow)])
def test_perspective_moves_no_centre_however_oblique(turn_deg):
    """Large circles, near, and aslant: their ellipses' centres lie up to 0.4 px beside the circles' centres."""
    target = CirclesTarget(grid=(6, 5), pitch_mm=28.0, diameter_mm=19.0)
    middle = centred(target.points_target)
    pattern, shift = circles(target), middle.translation_mm
    view = camera(turn_deg=turn_deg, at=(0, 0, 300.0), focal_px=640.0, size_wh=(560, 460))
    photograph = photograph_of_board(view, lambda x, y: pattern(x - shift[0], y - shift[1]))
    found = detect_in(photograph, target, camera="camera", pose="00")
    angle = np.linspace(0, 2 * np.pi, 60, endpoint=False)
    rim = target.diameter_mm / 2 * np.column_stack([np.cos(angle), np.sin(angle), 0 * angle])
    truth = view.project(middle.apply(target.points_target))
    outline = view.project(middle.apply((target.points_target[:, None] + rim).reshape(-1, 3)))
    ellipse = np.array([cv2.fitEllipse(one.astype(np.float32))[0] for one in outline.reshape(-1, 60, 2)])
    assert np.linalg.norm(ellipse - truth, axis=1).max() > 0.25  # without the correction
    error = found.uv - truth[found.ids]
    assert len(found.ids) > 25
    assert np.sqrt(np.square(error).mean()) < 0.03
    assert np.abs(error.mean(axis=0)).max() < 0.02


@pytest.mark.slow
def test_light_that_falls_off_across_a_dot_does_not_move_it():
    """A lamp beside the board, 0.25 m before it, by the law of distance and cosine: up to 1.5 % a pixel.

    The centroid of what the dots lack against their background, 20 px high here, lay 0.16 px towards the lamp.
    """
    target = CirclesTarget(grid=(7, 5), pitch_mm=26.0, diameter_mm=17.0)
    middle = centred(target.points_target)
    pattern, shift = circles(target), middle.translation_mm

    def lit(x, y):
        distance2 = (x - 170.0) ** 2 + (y + 60.0) ** 2 + 250.0**2
        return pattern(x - shift[0], y - shift[1]) * 1.4 * (260.0**2 / distance2) ** 1.5

    view = camera(turn_deg=(14.0, -48.0, 5.0), distortion=(-0.1, 0.05, 0.001, 0.0, 0.0), at=(0, 0, 420))
    found = detect_in(photograph_of_board(view, lit), target, camera="camera", pose="00")
    error = found.uv - view.project(middle.apply(target.points_target))[found.ids]
    assert len(found.ids) > 30
    assert np.abs(error.mean(axis=0)).max() < 0.01
    assert np.sqrt(np.square(error).mean()) < 0.03


def test_no_circles_is_none():
    target = CirclesTarget(grid=(7, 5), pitch_mm=26.0, diameter_mm=16.0)
    blank = Photograph(name="blank", pixels=np.full((200, 300), 90, np.uint8))
    assert detect_in(blank, target, camera="camera", pose="00") is None
