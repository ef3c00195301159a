"""Select sharp frames of a video from directions spread over the walk."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mammometry.base.photograph import Photograph
from mammometry.base.value import value
from mammometry.calibration.detection.detect import detect_in
from mammometry.calibration.features.board_map import homography_of
from mammometry.calibration.targets.target import Target
from mammometry.geometry import Array, Float64
from mammometry.walk.stations import TELEPHONE

MOST = 30
"""Largest number of frames of a walk: more show the same skin again."""
_APART_DEG = 3.0  # least angle between two frames' directions: pairs are 8 to 25 degrees apart
_FOCAL_WIDTHS = 0.8  # assumed focal length of a video, picture widths: good enough for approximate directions
_SOFT = 0.7  # least sharpness of a usable frame, relative to the median of frames from the same direction


@value(eq=False)
class SeenFrame:
    """A frame of a video in which the board was found."""

    index: int
    """Number of the frame in the video, from 0."""
    sharpness: float
    """Larger for sharper frames; comparable between frames of the same direction."""
    direction: Float64[Array, 3]
    """Approximate unit vector from the board to the telephone, in the board's frame."""


def direction_in(frame: Photograph, board: Target) -> Float64[Array, 3] | None:
    """Direction from the middle of the board to the telephone. None if no board is found."""
    found = detect_in(frame, board, camera=TELEPHONE, pose=frame.name)
    if found is None:
        return None
    picture_from_board = homography_of(board.points_target[found.ids, :2], found.uv)
    width, height = frame.size_wh
    focal_px = _FOCAL_WIDTHS * max(width, height)
    matrix = np.array([[focal_px, 0, (width - 1) / 2], [0, focal_px, (height - 1) / 2], [0, 0, 1]])
    axes = np.linalg.inv(matrix) @ picture_from_board
    first, second, place = axes[:, 0], axes[:, 1], axes @ np.append(board.points_target[:, :2].mean(axis=0), 1.0)
    first, second = first / np.linalg.norm(first), second / np.linalg.norm(second)
    u, _, v = np.linalg.svd(np.column_stack([first, second, np.cross(first, second)]))
    sign = 1.0 if place[2] > 0 else -1.0  # the sign of a homography is arbitrary
    turn = u @ np.diag([sign, sign, 1.0]) @ v
    away = -turn.T @ (sign * place)
    return away / np.linalg.norm(away)


def choose_frames(seen: Sequence[SeenFrame], most: int = MOST) -> list[int]:
    """Numbers of the frames to use, ascending.

    Their directions are as far apart as possible; each is the sharpest frame of its direction.

    Args:
        seen: frames in which the board was found.
        most: largest number of frames.
    """
    if not seen:
        return []
    directions = np.stack([frame.direction for frame in seen])
    sharpness = np.array([frame.sharpness for frame in seen])
    apart_deg = np.degrees(np.arccos(np.clip(directions @ directions.T, -1.0, 1.0)))
    near = apart_deg < _APART_DEG
    usual = np.array([np.median(sharpness[row]) for row in near])
    usable = np.flatnonzero(sharpness >= _SOFT * usual)
    chosen = [int(usable[np.argmax(sharpness[usable])])]
    while len(chosen) < most:
        gap_deg = apart_deg[:, chosen].min(axis=1)
        farthest = int(usable[np.argmax(gap_deg[usable])])
        if gap_deg[farthest] < _APART_DEG:
            break
        like = usable[(apart_deg[farthest, usable] < _APART_DEG / 2) & (gap_deg[usable] >= _APART_DEG)]
        chosen.append(int(like[np.argmax(sharpness[like])]))
    return sorted(seen[place].index for place in chosen)
