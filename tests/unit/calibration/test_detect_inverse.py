"""Boards printed white on black: found in the photograph's inverse, as well as black on white, and named."""

from types import SimpleNamespace

import numpy as np
import pytest
from printed import BRIGHT, DARK, camera, centred, charuco, chessboard, circles, photograph_of_board

from mammometry.base.photograph import Photograph
from mammometry.calibration.detection.detect import detect_in
from mammometry.calibration.features.pixels import inverse_of, linear_luma
from mammometry.calibration.judge.findings import about_inverse
from mammometry.calibration.targets.kinds.charuco import CharucoTarget
from mammometry.calibration.targets.kinds.chessboard import ChessboardTarget
from mammometry.calibration.targets.kinds.circles import CirclesTarget

VIEW = camera(turn_deg=(20.0, 25.0, 10.0))
BOARDS = {
    "charuco": (CharucoTarget(squares=(9, 7), square_mm=20.0, marker_mm=15.0, dictionary="DICT_5X5_100"), charuco),
    "circles": (CirclesTarget(grid=(7, 6), pitch_mm=20.0, diameter_mm=10.0), circles),
    "chessboard": (ChessboardTarget(squares=(9, 7), square_mm=18.0), chessboard),
}


def shoot(target, pattern, *, white_on_black):
    shift = centred(target.points_target).translation_mm

    def reflectance(x, y):
        light = pattern(x - shift[0], y - shift[1])
        swapped = np.where(light == DARK, BRIGHT, np.where(light == BRIGHT, DARK, light))
        return swapped if white_on_black else light

    return photograph_of_board(VIEW, reflectance)


@pytest.mark.slow
@pytest.mark.parametrize("white_on_black", [pytest.param(False, marks=pytest.mark.slow), True])
@pytest.mark.parametrize("kind", BOARDS)
def test_a_board_is_found_either_way(kind, white_on_black):
    target, pattern = BOARDS[kind]
    found = detect_in(shoot(target, pattern(target), white_on_black=white_on_black), target, camera="a", pose="00")
    assert len(found.ids) > 0.9 * len(target.points_target)
    assert found.inverse == (white_on_black and kind != "chessboard")  # a dark rim alone hides no chessboard
    places = centred(target.points_target).apply(target.points_target)
    assert np.sqrt(np.square(found.uv - VIEW.project(places)[found.ids]).mean()) < 0.03


def test_the_inverse_keeps_linear_light():
    level = np.linspace(0, 255, 240).astype(np.uint8)
    photograph = Photograph(name="a", pixels=np.repeat(np.stack([level, level[::-1]])[..., None], 3, axis=2))
    light, inverse = linear_luma(photograph), linear_luma(inverse_of(photograph))
    both = (light + inverse)[light < 0.9]
    assert np.ptp(both) < 1e-4
    assert both.mean() > 0.95


@pytest.mark.parametrize(("inverse", "said"), [((False, False), 0), ((True, False), 1)])
def test_a_white_on_black_target_is_named(inverse, said):
    seen = SimpleNamespace(detections=[SimpleNamespace(inverse=one) for one in inverse])
    findings = list(about_inverse(SimpleNamespace(observations=seen)))
    assert len(findings) == said
    assert all(found.verdict == "pass" for found in findings)
    assert [found.notice.values for found in findings] == [{"photographs": 1, "total": 2}] * said
