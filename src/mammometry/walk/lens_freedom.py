"""Pose errors of a photograph whose lens differed from that of the other photographs.

A telephone focuses again for each photograph, and its stabiliser shifts the lens. In the image of the board, both look
like a small rotation and shift of the telephone, and the pose that is found from the board absorbs them. For the skin
above the board, that pose is wrong. Its error has only as many degrees of freedom as the lens: three.
"""

from __future__ import annotations

import numpy as np

from mammometry.calibration.adjust.network import POSE_NAMES_CAMERA
from mammometry.calibration.judge.expected_error import derivatives
from mammometry.geometry import Array, Camera, Float64

_LENS_NAMES = ("f_px", "cx_px", "cy_px")
_STEPS = 6  # points along each side of the board; not critical


def pose_errors(
    camera: Camera, board_mm: Float64[Array, "2 2"], skin_world: Float64[Array, "n 3"]
) -> Float64[Array, "6 3"]:
    """Corrections of a pose found from the board, for a unit change of the lens.

    The rows are those of `POSE_NAMES_CAMERA`. The columns are a focal length that moves points at half the picture's
    width by 1 px, and a principal point moved by 1 px along the rows and along the columns. A change c of the lens
    moves image points by L c, and a change d of the pose moves them by P d. So c looks like the change P⁺ L c of the
    pose. The correction is that change for points of the skin, minus that for points of the board.

    Args:
        camera: camera of the photograph, in the board's frame.
        board_mm: lowest and highest corner of the board's points (x, y), mm.
        skin_world: points of the skin, mm.
    """
    x, y = (np.linspace(low, high, _STEPS) for low, high in np.asarray(board_mm).T)
    board = np.stack([*np.meshgrid(x, y), np.zeros((_STEPS, _STEPS))], axis=-1).reshape(-1, 3)
    return _as_pose(camera, skin_world) - _as_pose(camera, board)


def _as_pose(camera: Camera, points: Float64[Array, "n 3"]) -> Float64[Array, "6 3"]:
    """Changes of the pose that move image points like a unit change of the lens (least squares)."""
    names = tuple(f"{camera.name}.{name}" for name in (*POSE_NAMES_CAMERA, *_LENS_NAMES))
    _, by_parameter = derivatives(camera, points, names)
    rows = by_parameter.reshape(-1, len(names))
    rows[:, 6] /= camera.size_wh[0] / 2 / camera.matrix[0, 0]
    scale = np.linalg.norm(rows[:, :6], axis=0)  # rad and mm
    found, *_ = np.linalg.lstsq(rows[:, :6] / scale, rows[:, 6:], rcond=None)
    return np.asarray(found / scale[:, None])
