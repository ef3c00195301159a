"""Surfaces through a breast's boundary that know nothing but the boundary: plane, membrane, thin plate, Coons patch.

A wall is a height over a chart, and what the boundary lies off that height carried in harmonically, so that every wall
meets the skin exactly. `through` is that rule; each shape is a chart and a height.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from typing import Protocol, TypeAlias, runtime_checkable

import numpy as np
from scipy.interpolate import RBFInterpolator
from scipy.sparse.linalg import splu

from mammometry.base.errors import MeasureError
from mammometry.geometry.arrays import Array, Float64, read_only
from mammometry.geometry.mesh import TriangleMesh
from mammometry.measure.boundary.cast_base import frame_towards
from mammometry.measure.solid.cut import OpenPart
from mammometry.measure.solid.patch import Patch, cotangent_laplacian, fill, harmonic, signed_area_mm2
from mammometry.measure.solid.sew import sew

Sewn: TypeAlias = tuple[TriangleMesh, TriangleMesh]
"""The wall alone, its normals away from the breast, and the closed solid."""
Height: TypeAlias = Callable[[Float64[Array, "n 2"]], Float64[Array, " n"]]
"""Height over a chart at its flat places, mm."""

_SPACING_MM = 2.5
_KNOTS = 240
_SAME_PLACE_DIGITS = 6  # of millimetres: knots nearer than a nanometre are one, for two would make the spline singular
_MINIMAL_ROUNDS = 6


@runtime_checkable
class Chart(Protocol):
    """Coordinates in which a wall is a height over a region of the plane."""

    def flatten(self, points_world: Float64[Array, "n 3"]) -> Float64[Array, "n 3"]:
        """Flat place (two) and height (the third) of world points, mm."""
        ...

    def world(self, places: Float64[Array, "n 3"]) -> Float64[Array, "n 3"]:
        """World points, mm: the inverse."""
        ...


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PlaneChart:
    """Heights over a plane."""

    origin: Float64[Array, 3]
    """A point on it, mm, world frame."""
    frame: Float64[Array, "3 3"]
    """Rows: two directions in the plane and its normal, towards the breast; world frame."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "origin", read_only(self.origin))
        object.__setattr__(self, "frame", read_only(self.frame))

    def flatten(self, points_world: Float64[Array, "n 3"]) -> Float64[Array, "n 3"]:
        """Place in the plane and height over it, mm."""
        return (points_world - self.origin) @ self.frame.T

    def world(self, places: Float64[Array, "n 3"]) -> Float64[Array, "n 3"]:
        """World points, mm."""
        return self.origin + places @ self.frame


def best_plane(part: OpenPart) -> PlaneChart:
    """The plane of least squares through the opening, its normal on the side from which the loops run anticlockwise."""
    points = part.mesh.vertices[np.concatenate(part.loops)]
    origin = points.mean(axis=0)
    frame = frame_towards(np.linalg.svd(points - origin, full_matrices=False)[2][2])
    if sum(signed_area_mm2((part.mesh.vertices[loop] - origin) @ frame[:2].T) for loop in part.loops) < 0:
        frame = frame_towards(-frame[2])
    return PlaneChart(origin=origin, frame=frame)


def through(part: OpenPart, chart: Chart, height: Height | None = None, *, subject: str) -> Sewn:
    """Close a skin with a height over a chart, plus its misfit on the opening, harmonic inside.

    Raises:
        MeasureError: the opening laid flat crosses itself, or the height is not known everywhere within it.
    """
    loops = tuple(chart.flatten(part.mesh.vertices[loop]) for loop in part.loops)

    def lift(patch: Patch) -> Float64[Array, "k 3"]:
        smooth = np.zeros(len(patch.points)) if height is None else height(patch.points)
        rise = smooth + harmonic(patch, np.concatenate(loops)[:, 2:] - smooth[: patch.n_loop, None])[:, 0]
        return chart.world(np.concatenate([patch.points, rise[:, None]], axis=1)[patch.n_loop :])

    return sew(part, tuple(loop[:, :2] for loop in loops), lift, spacing_mm=_SPACING_MM, subject=subject)


def membrane(part: OpenPart) -> Sewn:
    """The surface of least area: the harmonic height, then harmonic over itself until it rests (Pinkall, Polthier)."""
    chart = best_plane(part)
    loops = tuple(chart.flatten(part.mesh.vertices[loop]) for loop in part.loops)

    def lift(patch: Patch) -> Float64[Array, "k 3"]:
        rim, b = np.concatenate(loops), patch.n_loop
        places = np.concatenate([patch.points, harmonic(patch, rim[:, 2:])], axis=1)
        for _ in range(_MINIMAL_ROUNDS):
            laplacian = cotangent_laplacian(places, patch.faces)
            places[b:] = splu(laplacian[b:, b:].tocsc()).solve(-(laplacian[b:, :b] @ rim))
        return chart.world(places[b:])

    return sew(part, tuple(loop[:, :2] for loop in loops), lift, spacing_mm=_SPACING_MM, subject="membrane wall")


def thin_plate(part: OpenPart) -> Sewn:
    """The plate of least bending through the boundary: a thin-plate spline over its best plane (Duchon)."""
    chart = best_plane(part)
    rim = chart.flatten(part.mesh.vertices[np.concatenate(part.loops)])
    return through(part, chart, plate(rim), subject="thin-plate wall")


def plate(places: Float64[Array, "n 3"]) -> Height:
    """Thin-plate spline through places and heights, of which evenly chosen ones are used; coincident ones once."""
    knots = places[np.unique(np.linspace(0, len(places) - 1, min(_KNOTS, len(places))).astype(int))]
    knots = knots[np.sort(np.unique(knots[:, :2].round(_SAME_PLACE_DIGITS), axis=0, return_index=True)[1])]
    spline = RBFInterpolator(knots[:, :2], knots[:, 2], kernel="thin_plate_spline", degree=1)

    def height(flat: Float64[Array, "n 2"]) -> Float64[Array, " n"]:
        found: Float64[Array, " n"] = spline(flat)
        return found

    return height


def coons(part: OpenPart) -> Sewn:
    """Coons' bilinearly blended patch between the boundary's four sides: above, below, towards and off the midline.

    Raises:
        MeasureError: the skin has more openings than one.
    """
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

    return sew(part, (unit,), lift, spacing_mm=_SPACING_MM, subject="coons wall")


def flat(part: OpenPart) -> Sewn:
    """The boundary's best plane, joined to the boundary by a skirt along the plane's normal."""
    chart = best_plane(part)
    patch = fill(tuple(chart.flatten(part.mesh.vertices[loop])[:, :2] for loop in part.loops))
    loop = np.concatenate(part.loops)
    n, n_skin = len(loop), len(part.mesh.vertices)
    sunk = chart.world(np.concatenate([patch.points, np.zeros((n, 1))], axis=1))
    upper, follower = [], []
    start = 0
    for one in part.loops:
        index = np.arange(start, start + len(one))
        upper.append(index)
        follower.append(np.roll(index, -1))
        start += len(one)
    a, b = np.concatenate(upper), np.concatenate(follower)
    skirt = np.concatenate([np.stack([b, a, a + n], axis=1), np.stack([b, a + n, b + n], axis=1)])
    faces = np.concatenate([skirt, patch.faces[:, ::-1] + n])
    wall = TriangleMesh(vertices=np.concatenate([part.mesh.vertices[loop], sunk]), faces=faces.astype(np.int32))
    number = np.concatenate([loop, n_skin + np.arange(n)])
    closed = TriangleMesh(
        vertices=np.concatenate([part.mesh.vertices, sunk]),
        faces=np.concatenate([part.mesh.faces, number[faces].astype(np.int32)]),
    )
    return wall, closed
