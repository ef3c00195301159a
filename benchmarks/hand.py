"""A hand with its forearm on a breast, as part of a virtual body.

A scan joins both into one surface. The body's volumes are those of the uncovered breasts.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np
from scipy import ndimage

from mammometry.geometry import Array, Bool, Float64, TriangleMesh
from mammometry.geometry.mesh import joined
from mammometry.simulate.subjects.solid import SubjectSolid

HAND_MM = 25.0
"""Thickness of a hand at its palm, mm: adults have 22 to 30."""
_STEP_MM = 3.0  # step of the grid on which the hand is made: a third of a finger's radius
_REACH_MM = 420.0  # around the breast: hand and forearm
_DEPTH_MM = 170.0  # behind the foremost skin, where the arm is next to the trunk
_FOLD_MM, _EVEN_MM, _SMOOTH_MM = 33.0, 12.0, 6.0  # skin under a hand: folds closed, levelled, smoothed
# A hand in its own plane, mm, centre of the palm at 0, fingers along the first axis: adults' mean lengths.
_PALM_MM, _CORNER_MM = (32.0, 27.0), 15.0
_FINGERS_MM = ((-31.0, 70.0), (-10.0, 82.0), (11.0, 78.0), (31.0, 60.0))  # position across, length
_FINGER_RADII_MM, _THUMB_RADII_MM, _ARM_RADII_MM = (10.0, 8.0), (12.0, 9.0), (30.0, 42.0)  # adults', at both ends
_WRIST_MM, _THICKENING_MM = -60.0, 80.0  # where the forearm starts to become twice as thick, and over what length


def with_hand(
    solid: SubjectSolid,
    side: Literal["left", "right"],
    *,
    fingers_deg: float,
    shift_mm: tuple[float, float] = (0.0, 0.0),
    thick_mm: float = HAND_MM,
) -> SubjectSolid:
    """Place a hand on a breast.

    Args:
        solid: a torso, y to the head and z ahead.
        side: the patient's own.
        fingers_deg: direction of the fingers seen from the front: 0 to the patient's left, 90 to the head.
        shift_mm: shift of the palm's centre from the border's, to the patient's left and to the head.
        thick_mm: thickness of the palm.
    """
    border = solid.mesh.vertices[solid.breasts[side].boundary]
    hand = _hand(solid.mesh, border.mean(axis=0)[:2] + shift_mm, np.deg2rad(fingers_deg), thick_mm)
    more = len(hand.vertices)
    return replace(
        solid,
        mesh=joined([solid.mesh, hand]),
        areola=np.concatenate([solid.areola, np.zeros(more, np.float32)]),
        tint=None if solid.tint is None else np.concatenate([solid.tint, np.ones((more, 3), np.float32)]),
    )


def _hand(skin: TriangleMesh, middle: Float64[Array, 2], angle_rad: float, thick_mm: float) -> TriangleMesh:
    low = np.minimum(skin.vertices.min(axis=0)[:2], middle - _REACH_MM)
    high = np.maximum(skin.vertices.max(axis=0)[:2], middle + _REACH_MM)
    columns, rows = ((high - low) / _STEP_MM).astype(int) + 1
    flat = np.stack(np.meshgrid(np.arange(columns), np.arange(rows), indexing="ij"), axis=-1) * _STEP_MM + low
    along = np.array([np.cos(angle_rad), np.sin(angle_rad)])
    own = (flat - middle) @ np.stack([along, [-along[1], along[0]]]).T
    away = _outline(own)
    half = thick_mm / 2 * (1 + np.clip((_WRIST_MM - own[..., 0]) / _THICKENING_MM, 0.0, 1.0))
    rounded = half * np.sqrt(1 - (1 - np.clip(-away / half, 0.0, 1.0)) ** 2)
    height = _skin_height(skin, low, (columns, rows)) + half
    return _two_sheets(flat, height - rounded, height + rounded, away < 0)


def _outline(own: Float64[Array, "h w 2"]) -> Float64[Array, "h w"]:
    """Distance from the hand's outline, mm, negative inside."""
    beyond = np.abs(own) - _PALM_MM
    away = np.linalg.norm(np.maximum(beyond, 0), axis=-1) + np.minimum(beyond.max(axis=-1), 0) - _CORNER_MM
    for across, length in _FINGERS_MM:
        away = np.minimum(away, _rod(own, (30.0, across), (40.0 + length, 1.1 * across), _FINGER_RADII_MM))
    away = np.minimum(away, _rod(own, (-20.0, 35.0), (35.0, 70.0), _THUMB_RADII_MM))
    return np.minimum(away, _rod(own, (-40.0, 0.0), (-300.0, 0.0), _ARM_RADII_MM))


def _rod(
    own: Float64[Array, "h w 2"], start: tuple[float, float], end: tuple[float, float], radii_mm: tuple[float, float]
) -> Float64[Array, "h w"]:
    """Distance from a tapering rod with round ends, mm."""
    line = np.subtract(end, start)
    share = np.clip((own - start) @ line / (line @ line), 0.0, 1.0)
    return np.linalg.norm(own - start - share[..., None] * line, axis=-1) - radii_mm[0] - share * np.diff(radii_mm)


def _skin_height(skin: TriangleMesh, low: Float64[Array, 2], shape: tuple[int, int]) -> Float64[Array, "h w"]:
    """Height of the skin under a hand along the viewing axis, mm, with closed folds."""
    parts = np.array([[1, 1, 1], [1.8, 0.6, 0.6], [0.6, 1.8, 0.6], [0.6, 0.6, 1.8]]) / 3
    ahead = skin.corners()[skin.face_vectors()[:, 2] > 0]
    points = np.concatenate([ahead.reshape(-1, 3), np.einsum("pc,fcx->pfx", parts, ahead).reshape(-1, 3)])
    cell = np.clip(np.rint((points[:, :2] - low) / _STEP_MM).astype(int), 0, np.subtract(shape, 1))
    height = np.full(shape, points[:, 2].max() - _DEPTH_MM)
    np.maximum.at(height, tuple(cell.T), points[:, 2])
    closed = ndimage.grey_closing(height, size=2 * (round(_FOLD_MM / _STEP_MM),))
    even = np.maximum(ndimage.gaussian_filter(closed, _EVEN_MM / _STEP_MM), closed)
    smooth: Float64[Array, "h w"] = ndimage.gaussian_filter(even, _SMOOTH_MM / _STEP_MM)
    return smooth


def _two_sheets(
    flat: Float64[Array, "h w 2"], back: Float64[Array, "h w"], front: Float64[Array, "h w"], inside: Bool[Array, "h w"]
) -> TriangleMesh:
    """Closed mesh between two heights over a mask."""
    count = int(inside.sum())
    number = np.full(inside.shape, -1)
    number[inside] = np.arange(count)
    a, b, c, d = number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]
    sheet = np.concatenate([np.stack(corners, axis=-1).reshape(-1, 3) for corners in ((a, b, c), (a, c, d))])
    sheet = sheet[(sheet >= 0).all(axis=1)]
    edges = sheet[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    _, where, times = np.unique(np.sort(edges, axis=1), axis=0, return_inverse=True, return_counts=True)
    first, second = edges[times[where.ravel()] == 1].T
    wall = [np.stack([second, first, first + count], axis=1), np.stack([second, first + count, second + count], axis=1)]
    faces = np.concatenate([sheet, sheet[:, ::-1] + count, *wall])
    vertices = np.concatenate(
        [np.concatenate([flat[inside], height[inside][:, None]], axis=1) for height in (front, back - 1e-3)]
    )
    used, renumbered = np.unique(faces, return_inverse=True)
    return TriangleMesh(
        vertices=vertices[used].astype(np.float32).astype(np.float64),
        faces=np.ascontiguousarray(renumbered.reshape(-1, 3).astype(np.int32)),
    )
