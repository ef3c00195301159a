"""Photographs whose board does not fit the lens of all."""

from types import SimpleNamespace

import numpy as np
from board_walk import BOARD, FOCAL_PX, MIDDLE, SIZE_WH

from mammometry.geometry import Camera, Transform
from mammometry.walk.one_lens import judge_lenses


def test_a_photograph_without_a_place_is_left_out_by_name() -> None:
    """The adjustment excludes all corners of a board that fits nowhere, and gives its photograph no place."""
    telephone = Camera(
        name="01",
        size_wh=SIZE_WH,
        matrix=np.array([[FOCAL_PX, 0, MIDDLE[0]], [0, FOCAL_PX, MIDDLE[1]], [0, 0, 1]]),
        distortion=np.zeros(5),
        camera_from_world=Transform(rotation=np.eye(3), translation_mm=np.array([-130.0, -90.0, 620.0])),
    )
    stations = {"01": telephone}
    ids = np.arange(len(BOARD.points_target))
    uv = stations["01"].project(BOARD.points_target)
    detections = tuple(SimpleNamespace(pose=pose, ids=ids, uv=uv) for pose in ("01", "02"))
    calibration = SimpleNamespace(
        set_aside=(),
        observations=SimpleNamespace(detections=detections),
        residuals_px=(np.zeros((len(ids), 2)), np.full((len(ids), 2), np.nan)),
        target_points=BOARD.points_target,
    )
    assert {name: why.code for name, why in judge_lenses(calibration, stations).items()} == {"02": "another-lens"}
