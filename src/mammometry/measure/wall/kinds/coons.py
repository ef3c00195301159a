"""Coons' patch between the boundary's four sides."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from mammometry.base.errors import MeasureError
from mammometry.geometry.arrays import Array, Float64
from mammometry.measure.solid.patch import Patch
from mammometry.measure.solid.sew import Closed, sew
from mammometry.measure.solid.untangle import signed_area_mm2
from mammometry.measure.wall.heights import SPACING_MM, best_plane
from mammometry.measure.wall.open_breast import OpenBreast
from mammometry.measure.wall.registry import CAST_WALLS, TORSO_WALLS, add_wall


@add_wall(
    TORSO_WALLS,
    CAST_WALLS,
    name="coons",
    place=7,
    sees_the_chest=False,
    definition="Coons' bilinearly blended patch between the boundary's four sides",
)
def coons(breast: OpenBreast) -> Closed:
    """Coons' bilinearly blended patch between the sides above, below, towards and off the midline.

    Raises:
        MeasureError: the skin has more openings than one, or the boundary has no four sides.
    """
    part = breast.part
    if len(part.loops) != 1:
        raise MeasureError(
            "coons wall",
            found=f"{len(part.loops)} openings",
            expected="one boundary with four sides",
            remedy="Choose another wall with --set measure.wall=default",
        )
    points = part.mesh.vertices[part.loops[0]]
    laid = best_plane(part).flatten(points)[:, :2]
    corners = [int(np.argmax(laid @ direction)) for direction in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
    turned = np.roll(np.arange(len(points)), -corners[0])
    starts = [(corner - corners[0]) % len(points) for corner in corners] + [len(points)]
    if np.any(np.diff(starts) < 1):
        raise MeasureError(
            "coons wall",
            found="a boundary without four sides",
            expected="a simple closed curve around the breast",
            remedy="Choose another wall with --set measure.wall=default",
        )
    closed = np.concatenate([points[turned], points[turned[:1]]])
    sides, shares = [], []
    for first, last in pairwise(starts):
        side = closed[first : last + 1]
        along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(side, axis=0), axis=1))])
        sides.append(side)
        shares.append(along / along[-1])
    zero, one = np.zeros_like, np.ones_like
    square = np.concatenate(
        [
            np.stack(place, axis=1)[:-1]
            for place in (
                (shares[0], zero(shares[0])),
                (one(shares[1]), shares[1]),
                (1 - shares[2], one(shares[2])),
                (zero(shares[3]), 1 - shares[3]),
            )
        ]
    )
    scale = float(np.sqrt(max(signed_area_mm2(laid), 1.0)))
    unit = np.empty_like(square)
    unit[turned] = square * scale

    def at(number: int, share: Float64[Array, " n"]) -> Float64[Array, "n 3"]:
        return np.stack([np.interp(share, shares[number], sides[number][:, axis]) for axis in range(3)], axis=1)

    def lift(patch: Patch) -> Float64[Array, "k 3"]:
        s, t = (patch.points[patch.n_loop :] / scale).T
        below, right, above, left = at(0, s), at(1, t), at(2, 1 - s), at(3, 1 - t)
        s, t = s[:, None], t[:, None]
        low = (1 - s) * sides[0][0] + s * sides[1][0]
        high = (1 - s) * sides[3][0] + s * sides[2][0]
        return (1 - t) * below + t * above + (1 - s) * left + s * right - (1 - t) * low - t * high

    return sew(part, (unit,), lift, spacing_mm=SPACING_MM, subject="coons wall")
