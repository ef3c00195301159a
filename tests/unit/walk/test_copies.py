"""Copies of a photograph in a walk."""

import numpy as np

from mammometry.calibration.detection.detect import Detection
from mammometry.walk.copies import judge_copies

IDS = np.arange(60)


def board(pose, uv):
    return Detection(
        camera="telephone", pose=pose, ids=IDS, uv=uv, covariance_px2=np.tile(1e-4 * np.eye(2), (60, 1, 1))
    )


def test_of_copies_the_least_compressed_is_kept():
    """Exact, compressed again, and moved by a hand. A HEIC has no quality of a JPEG: it is the original."""
    rng = np.random.default_rng(3)
    uv = rng.uniform(100, 900, (60, 2))
    boards = [
        board("01", uv),
        board("02", uv),
        board("03", uv + rng.normal(0.0, 0.05, uv.shape)),
        board("04", uv + 3.0),
        board("05", uv + 3.0 + rng.normal(0.0, 0.05, uv.shape)),
    ]
    names = {of.pose: f"IMG_{of.pose}.jpg" for of in boards}
    out = judge_copies(boards, {"01": 80.0, "02": 80.0, "03": 95.0, "04": 95.0, "05": None}, names)
    assert {name: why.code for name, why in out.items()} == dict.fromkeys(("01", "02", "04"), "duplicate")
    assert "IMG_03.jpg" in out["01"].found
    assert "IMG_05.jpg" in out["04"].found


def test_photographs_from_two_places_are_both_used():
    uv = np.random.default_rng(3).uniform(100, 900, (60, 2))
    assert judge_copies([board("01", uv), board("02", uv + 1.0)], {}, {"01": "a", "02": "b"}) == {}
