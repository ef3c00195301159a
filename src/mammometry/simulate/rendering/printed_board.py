"""A printed board as an object of the scene, which can occlude the subject and be occluded by it."""

from __future__ import annotations

import numpy as np

from mammometry.calibration.targets.board import FlatBody
from mammometry.geometry import Array, Float64, Transform
from mammometry.simulate.rendering.props import Props
from mammometry.simulate.rendering.scene import Prop
from mammometry.simulate.rendering.solid_target import INKS


def printed_board(body: FlatBody, rig_from_board: Transform) -> Prop:
    """Sheet of a board of squares, cut along all edges of the print into rectangles of one colour.

    Args:
        body: a board without circles.
        rig_from_board: its pose.

    Raises:
        ValueError: the board has circles.
    """
    sheet = body.board.sheet()
    if len(sheet.discs):
        raise ValueError("a board of circles has no straight edges to cut along")
    x, y = (_cuts(body.paper_mm[:, axis], sheet.rectangles[:, axis], sheet.rectangles[:, 2 + axis]) for axis in (0, 1))
    middles = np.stack(np.meshgrid((x[1:] + x[:-1]) / 2, (y[1:] + y[:-1]) / 2), axis=-1)
    dark = sheet.is_dark(middles.reshape(-1, 2))
    across, down = np.meshgrid(x, y)
    vertices = np.stack([across.ravel(), down.ravel(), np.zeros(across.size)], axis=1)
    row, column = (grid.ravel() for grid in np.mgrid[0 : len(y) - 1, 0 : len(x) - 1])
    a = row * len(x) + column
    b, c, d = a + 1, a + len(x), a + len(x) + 1
    # The printed side is −z: seen from there the corners run a, b, d, c.
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


def _cuts(paper_mm: Float64[Array, 2], starts: Float64[Array, " n"], sizes: Float64[Array, " n"]) -> Array:
    """Sorted edges of the paper and of all rectangles along one axis, mm, without duplicates."""
    return np.unique(np.concatenate([paper_mm, starts, starts + sizes]).round(6))
