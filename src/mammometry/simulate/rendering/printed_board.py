"""A printed board as an object of the scene, which can occlude the subject and be occluded by it."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from mammometry.calibration.targets.board import BORDER_MM, FlatBody
from mammometry.calibration.targets.card_field import CARD_MM, CARD_THICKNESS_MM
from mammometry.calibration.targets.sheet import PrintedSheet
from mammometry.geometry import Array, Float64, Transform
from mammometry.simulate.rendering.props import Props
from mammometry.simulate.rendering.scene import Prop
from mammometry.simulate.rendering.solid_target import INKS


def printed_board(
    body: FlatBody,
    rig_from_board: Transform,
    field: PrintedSheet | None = None,
    *,
    stretch: float = 1.0,
    bow_mm: float = 0.0,
) -> Prop:
    """Sheet of a board of squares, cut along all edges of the print into rectangles of a single colour.

    Args:
        body: a board without circles.
        rig_from_board: its pose.
        field: print below the squares, which makes the paper longer.
        stretch: factor of all lengths along the rows, about the centre of the print.
        bow_mm: how far the centre is in front of the left and right edges, mm (parabola).

    Raises:
        ValueError: the board has circles.
    """
    sheet = body.board.sheet()
    if len(sheet.discs):
        raise ValueError("a board of circles has no straight edges to cut along")
    paper_mm = body.paper_mm
    if field is not None:
        sheet = replace(sheet, rectangles=np.concatenate([sheet.rectangles, field.rectangles]))
        paper_mm = np.stack([paper_mm[0], np.maximum(paper_mm[1], field.extent_mm[1] + BORDER_MM)])
    x, y = (_cuts(paper_mm[:, axis], sheet.rectangles[:, axis], sheet.rectangles[:, 2 + axis]) for axis in (0, 1))
    middles = np.stack(np.meshgrid((x[1:] + x[:-1]) / 2, (y[1:] + y[:-1]) / 2), axis=-1)
    dark = sheet.is_dark(middles.reshape(-1, 2))
    across, down = np.meshgrid(x, y)
    half, middle = (x[-1] - x[0]) / 2, (x[-1] + x[0]) / 2
    aside = (across.ravel() - middle) / half
    vertices = np.stack([middle + stretch * half * aside, down.ravel(), bow_mm * (aside**2 - 1.0)], axis=1)
    row, column = (grid.ravel() for grid in np.mgrid[0 : len(y) - 1, 0 : len(x) - 1])
    a = row * len(x) + column
    b, c, d = a + 1, a + len(x), a + len(x) + 1
    # The printed side is −z. Seen from there, the corners run a, b, d, c.
    faces = np.concatenate([np.stack([a, d, b], axis=1), np.stack([a, c, d], axis=1)]).astype(np.int32)
    return Prop(
        props=Props(
            vertices=rig_from_board.apply(vertices),
            normals=rig_from_board.rotate(np.broadcast_to([0.0, 0.0, -1.0], vertices.shape)),
            faces=faces,
            material=np.tile(np.where(dark, 0, 1), 2).astype(np.uint8),
        ),
        colours=np.repeat(np.array(INKS)[:, None], 3, axis=1),
        smooth=1.0,
    )


def bank_card(middle: Float64[Array, 2], turn_rad: float, rig_from_board: Transform, grey: float) -> Prop:
    """A bank card of nominal size on a board, without rounded corners.

    Args:
        middle: position of its centre on the board, mm.
        turn_rad: rotation in the board's plane.
        rig_from_board: pose of the board.
        grey: reflectance of its printed side. Its side walls are white.
    """
    half = 0.5 * np.array(CARD_MM)
    along = np.array([math.cos(turn_rad), math.sin(turn_rad)])
    across = np.array([-along[1], along[0]])
    corners = [middle + a * half[0] * along + b * half[1] * across for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
    low = np.column_stack([corners, np.zeros(4)])
    high = low - np.array([0.0, 0.0, CARD_THICKNESS_MM])  # towards the reader
    sides = [high, *(np.stack([low[k], low[(k + 1) % 4], high[(k + 1) % 4], high[k]]) for k in range(4))]
    middles = np.mean([low, high], axis=(0, 1))
    vertices, normals, faces = [], [], []
    for number, side in enumerate(sides):
        normal = np.cross(side[1] - side[0], side[2] - side[0])
        order = [0, 1, 2, 3]
        if normal @ (side.mean(axis=0) - middles) < 0:
            order, normal = order[::-1], -normal
        vertices.append(side[order])
        normals.append(np.broadcast_to(normal / np.linalg.norm(normal), (4, 3)))
        faces += [[4 * number, 4 * number + 1, 4 * number + 2], [4 * number, 4 * number + 2, 4 * number + 3]]
    return Prop(
        props=Props(
            vertices=rig_from_board.apply(np.concatenate(vertices)),
            normals=rig_from_board.rotate(np.concatenate(normals)),
            faces=np.array(faces, dtype=np.int32),
            material=np.repeat([0, 1, 1, 1, 1], 2).astype(np.uint8),
        ),
        colours=np.repeat(np.array([[grey], [INKS[1]]]), 3, axis=1),
        smooth=1.0,
    )


def _cuts(paper_mm: Float64[Array, 2], starts: Float64[Array, " n"], sizes: Float64[Array, " n"]) -> Array:
    """Sorted edges of the paper and of all rectangles along one axis, mm, without duplicates."""
    return np.unique(np.concatenate([paper_mm, starts, starts + sizes]).round(6))
