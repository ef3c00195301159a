"""Walls through a breast's boundary: membranes, thin plates, a plane and Coons' patch."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from scipy.sparse.linalg import splu

from mammometry.base.errors import MeasureError
from mammometry.geometry import Array, Float64, TriangleMesh
from mammometry.geometry.nearest import point_tree
from mammometry.measure.solid.patch import Closed, Patch, cotangent_laplacian, fill, harmonic, sew
from mammometry.measure.solid.untangle import signed_area_mm2
from mammometry.measure.trunk.thorax import on_trunk
from mammometry.measure.wall.heights import SPACING_MM, TrunkChart, best_plane, plate, through
from mammometry.measure.wall.open_breast import OpenBreast
from mammometry.measure.wall.registry import CAST_WALLS, TORSO_WALLS, add_wall

_ROUNDS = 6  # iterations, after which Scherk's surface is reproduced (tests/unit/measure/test_walls.py)


@add_wall(
    TORSO_WALLS,
    CAST_WALLS,
    name="membrane",
    place=5,
    flat_u95_mm=9.2,
    sees_the_chest=False,
    definition="the surface of least area through the boundary, as a film of soap would hang in it",
)
def membrane(breast: OpenBreast) -> Closed:
    """Surface of least area through the boundary, by iterated harmonic maps (Pinkall and Polthier)."""
    part = breast.part
    chart = best_plane(part)
    loops = tuple(chart.flatten(part.mesh.vertices[loop]) for loop in part.loops)

    def lift(patch: Patch) -> Float64[Array, "k 3"]:
        rim, b = np.concatenate(loops), patch.n_loop
        places = np.concatenate([patch.points, harmonic(patch, rim[:, 2:])], axis=1)
        for _ in range(_ROUNDS):
            laplacian = cotangent_laplacian(places, patch.faces)
            places[b:] = splu(laplacian[b:, b:].tocsc()).solve(-(laplacian[b:, :b] @ rim))
        return chart.world(places[b:])

    return sew(part, tuple(loop[:, :2] for loop in loops), lift, spacing_mm=SPACING_MM, subject="membrane wall")


@add_wall(
    TORSO_WALLS,
    name="cylinder-membrane",
    place=1,
    flat_u95_mm=4.5,  # 4.1 (3.7 to 4.5) on 145 breasts
    definition="a membrane stretched over the boundary, in the trunk's cylindrical coordinates (the distance from "
    "the axis is harmonic); the breast is what lies in front of it",
)
def cylinder_membrane(breast: OpenBreast) -> Closed:
    """Radius from the trunk's axis that is harmonic over (θ, y) and fixed on the boundary."""
    return through(breast.part, TrunkChart(trunk=breast.trunk), subject="cylinder-membrane wall")


_USUAL_PER_MM = 0.0033
"""Curvature of a flat chest along the body, 1/mm: mean of real women (docs/decisions/0029)."""
_GOES_ON = 0.5
"""Curvature behind a breast, relative to that beside it. It is 0.3 to 0.9 in five families of bodies with known chests;
0.5 gives the smallest errors (docs/decisions/0029)."""


@add_wall(
    TORSO_WALLS,
    name="rounded-membrane",
    place=0,
    flat_u95_mm=3.8,  # the scatter of the cylinder membrane on 145 breasts, 1.9 mm, without its mean (decision 29)
    definition="a membrane stretched over the boundary, in the trunk's cylindrical coordinates, and rounded from top "
    "to bottom as chests are: by a quarter of the sum of the curvature of the skin beside both breasts and that of "
    "real women's chests",
)
def rounded_membrane(breast: OpenBreast) -> Closed:
    """Radius from the trunk's axis whose Laplacian over (θ, y) is constant, fixed on the boundary."""
    curvature = _GOES_ON * _curvature_per_mm(breast)

    def bent(flat: Float64[Array, "n 2"]) -> Float64[Array, " n"]:
        return np.asarray(-curvature * flat[:, 1] ** 2 / 2)

    return through(breast.part, TrunkChart(trunk=breast.trunk), bent, subject="rounded-membrane wall")


def _curvature_per_mm(breast: OpenBreast) -> float:
    """Curvature of the chest along the body, 1/mm: mean of the skin beside the breast and real women.

    The skin beside breasts is also bent by folds, armpits and the slope of a hanging breast. So its curvature has the
    same weight as the mean of real women, and is limited to between 0 and twice that mean.
    """
    try:
        thorax = breast.thorax
    except MeasureError:  # too little skin is visible beside the breasts
        return _USUAL_PER_MM
    rim = breast.trunk.cylindrical(breast.part.mesh.vertices[np.concatenate(breast.part.loops)])
    shown = float(thorax.bend_per_mm(rim[:, :2]).mean())
    return (_USUAL_PER_MM + float(np.clip(shown, 0.0, 2 * _USUAL_PER_MM))) / 2


@add_wall(
    TORSO_WALLS,
    CAST_WALLS,
    name="thin-plate",
    place=6,
    flat_u95_mm=6.5,
    definition="the plate of least bending through the boundary: a thin-plate spline over its best plane",
)
def thin_plate(breast: OpenBreast) -> Closed:
    """Thin-plate spline through the boundary over its best plane: least bending energy (Duchon)."""
    part = breast.part
    chart = best_plane(part)
    rim = chart.flatten(part.mesh.vertices[np.concatenate(part.loops)])
    return through(part, chart, plate(rim), subject="thin-plate wall")


_RING_MM = (12.0, 24.0)  # distances outside the boundary of the skin that gives the slope (docs/decisions/0009)
_SECTORS = 120  # directions around the boundary, in each of which the ring's skin gives one knot; not critical
_FEWEST_SECTORS = _SECTORS // 2  # fewest directions with skin; not critical
_STEEPEST = 0.8
"""Largest slope of the ring's skin against the boundary, in the trunk's coordinates. Not critical. Folds have slopes of
up to 12 on real women."""
_NOT_BREAST = 0.8
"""Skin belongs to the breast, which may hang over its fold, if it is nearer to the breast's skin than this share of its
distance from the boundary. Without this test volumes were 108 cc too large (docs/decisions/0009). Not critical."""


@add_wall(
    TORSO_WALLS,
    name="tangent-continuous",
    place=2,
    definition="a thin plate in the trunk's cylindrical coordinates through the boundary and the skin 12 to "
    "24 mm outside it, so that it continues that skin's slope",
)
def tangent_continuous(breast: OpenBreast) -> Closed:
    """Thin plate that continues the slope of the skin 12 to 24 mm outside the boundary.

    Distances are measured on the flattened trunk, because skin that is near in space may be under a fold.

    Raises:
        MeasureError: skin is visible there around less than half of the boundary.
    """
    part, trunk = breast.part, breast.trunk
    rim = trunk.cylindrical(part.mesh.vertices[np.concatenate(part.loops)])
    flat = trunk.cylindrical(breast.beside)
    away, nearest = (np.asarray(array) for array in point_tree(rim[:, :2]).query(flat[:, :2]))
    near = (away > _RING_MM[0]) & (away < _RING_MM[1]) & on_trunk(flat, trunk)
    near &= np.abs(flat[:, 2] - rim[nearest, 2]) < _STEEPEST * away
    ring, away = flat[near], away[near]
    off_breast = np.asarray(point_tree(part.mesh.vertices).query(breast.beside[near])[0]) > _NOT_BREAST * away
    knots = _one_per_sector(ring[off_breast], rim)
    if len(knots) < _FEWEST_SECTORS:
        raise MeasureError(
            "tangent-continuous wall",
            found=f"skin {_RING_MM[0]:.0f} to {_RING_MM[1]:.0f} mm outside the boundary in {len(knots)} of {_SECTORS} "
            "directions",
            expected=f"{_FEWEST_SECTORS} or more",
            remedy="Choose another wall with --set measure.wall=default",
        )
    even = rim[np.linspace(0, len(rim) - 1, _SECTORS).astype(int)]
    return through(
        part, TrunkChart(trunk=trunk), plate(np.concatenate([even, knots])), subject="tangent-continuous wall"
    )


def _one_per_sector(ring: Float64[Array, "n 3"], rim: Float64[Array, "m 3"]) -> Float64[Array, "k 3"]:
    """Median point of the ring in each direction from the boundary's centre that contains skin."""
    offset = ring[:, :2] - rim[:, :2].mean(axis=0)
    sector = ((np.arctan2(offset[:, 1], offset[:, 0]) / (2 * np.pi) + 0.5) * _SECTORS).astype(int) % _SECTORS
    found = [np.median(ring[sector == number], axis=0) for number in range(_SECTORS) if (sector == number).any()]
    return np.array(found).reshape(-1, 3)


@add_wall(
    TORSO_WALLS,
    name="plane",
    place=8,
    flat_u95_mm=9.5,
    sees_the_chest=False,
    definition="the boundary's best-fitting plane, joined to it by a skirt along the plane's normal",
)
def plane(breast: OpenBreast) -> Closed:
    """The boundary's best plane, joined to the boundary by a skirt along the plane's normal."""
    part = breast.part
    chart = best_plane(part)
    patch = fill(tuple(chart.flatten(part.mesh.vertices[loop])[:, :2] for loop in part.loops))
    loop = np.concatenate(part.loops)
    n, n_skin = len(loop), len(part.mesh.vertices)
    base_points = chart.world(np.concatenate([patch.points, np.zeros((n, 1))], axis=1))
    upper, follower = [], []
    start = 0
    for ring in part.loops:
        index = np.arange(start, start + len(ring))
        upper.append(index)
        follower.append(np.roll(index, -1))
        start += len(ring)
    a, b = np.concatenate(upper), np.concatenate(follower)
    skirt = np.concatenate([np.stack([b, a, a + n], axis=1), np.stack([b, a + n, b + n], axis=1)])
    faces = np.concatenate([skirt, patch.faces[:, ::-1] + n])
    wall = TriangleMesh(vertices=np.concatenate([part.mesh.vertices[loop], base_points]), faces=faces.astype(np.int32))
    number = np.concatenate([loop, n_skin + np.arange(n)])
    closed = TriangleMesh(
        vertices=np.concatenate([part.mesh.vertices, base_points]),
        faces=np.concatenate([part.mesh.faces, number[faces].astype(np.int32)]),
    )
    return Closed(wall=wall, skin=part.mesh, solid=closed)


@add_wall(
    TORSO_WALLS,
    CAST_WALLS,
    name="coons",
    place=7,
    sees_the_chest=False,
    definition="Coons' bilinearly blended patch between the boundary's four sides",
)
def coons(breast: OpenBreast) -> Closed:
    """Coons' bilinearly blended patch between four sides of the boundary.

    The sides meet at the boundary's extreme points along the diagonals of its best plane's axes.

    Raises:
        MeasureError: the skin has more than one opening, or the boundary does not have four sides.
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
