"""Circle boards against exact pictures: the centroid's perspective error is taken off."""

import numpy as np
import pytest
from printed import camera, centred, circles, photograph_of_board

from mammometry.calibration.detect import DetectSettings, detect_in
from mammometry.calibration.target import CirclesTarget
from mammometry.photograph import Photograph


@pytest.mark.parametrize(
    "target",
    [
        CirclesTarget(grid=(7, 5), pitch_mm=26.0, diameter_mm=17.0),
        CirclesTarget(grid=(4, 9), pitch_mm=20.0, diameter_mm=17.0, asymmetric=True),
    ],
)
def test_centres_are_where_they_are_projected(target):
    middle = centred(target.points_target)
    pattern, shift = circles(target), middle.translation_mm
    view = camera(turn_deg=(28.0, -24.0, 8.0), distortion=(-0.1, 0.05, 0.001, 0.0, 0.0))
    photograph = photograph_of_board(view, lambda x, y: pattern(x - shift[0], y - shift[1]))
    found = detect_in(photograph, target, DetectSettings(), camera="camera", pose="00")
    assert np.array_equal(found.ids, np.arange(len(target.points_target)))
    error = found.uv - view.project(middle.apply(target.points_target))
    # The centroids of these ellipses lie up to 0.2 px beside the centres' pictures.
    assert np.abs(error.mean(axis=0)).max() < 0.02
    assert np.sqrt(np.square(error).mean()) < 0.03


def test_no_circles_is_none():
    target = CirclesTarget(grid=(7, 5), pitch_mm=26.0, diameter_mm=16.0)
    blank = Photograph(name="blank", pixels=np.full((200, 300), 90, np.uint8))
    assert detect_in(blank, target, DetectSettings(), camera="camera", pose="00") is None
