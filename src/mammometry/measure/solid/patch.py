"""Triangulation of closed loops in a plane, harmonic values on it, and sewing onto an opening.

No vertex is added on a loop, so that a patch can be sewn to the mesh from which the loop was taken.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import manifold3d
import numpy as np
from scipy.ndimage import binary_dilation
from scipy.sparse import coo_matrix, csr_matrix
from scipy.sparse.linalg import splu

from mammometry.base.errors import CrossingError, MeasureError
from mammometry.base.value import value
from mammometry.geometry import Array, Bool, Float64, Int64, TriangleMesh
from mammometry.measure.solid.cut import OpenPart, opening_loops
from mammometry.measure.solid.untangle import rounded, signed_area_mm2, uncrossed


@value(eq=False)
class Patch:
    """A triangulated region of a plane."""

    points: Float64[Array, "n 2"]
    """The loops' points in the given order, then the inner ones, mm."""
    faces: Int64[Array, "m 3"]
    """Counter-clockwise."""
    n_loop: int
    """Number of points on the loops, which come first."""

    def area_mm2(self) -> float:
        """Area of the region, mm²."""
        a, b, c = np.moveaxis(self.points[self.faces], 1, 0)
        return float(_cross(b - a, c - a).sum() / 2)


def fill(loops: Sequence[Float64[Array, "_ 2"]], spacing_mm: float | None = None) -> Patch:
    """Triangulation of the region inside closed loops (outer ones counter-clockwise, holes clockwise).

    A loop that crosses itself is replaced by a simple one, and the triangulation is then moved harmonically onto the
    loop. Triangles overlap there, but their signed areas still add up to that of the loop.

    Args:
        loops: corners in order, the first not repeated, mm.
        spacing_mm: side of the inner grid's squares; None: no inner points (enough for a flat wall).

    Raises:
        CrossingError: the loops cross one another and so enclose no region.
    """
    given = np.concatenate(loops)
    for simple in (uncrossed, rounded):
        patch = _filled([simple(loop) for loop in loops], spacing_mm)
        if patch is not None:
            moved = given - patch.points[: patch.n_loop]
            return replace(patch, points=patch.points + harmonic(patch, moved)) if moved.any() else patch
    raise CrossingError(
        "boundary",
        found="curves that cross each other when flattened",
        expected="simple closed curves around the breast",
        remedy="Draw the boundary with `mammometry edit`, without crossings, or choose another wall with "
        "--set measure.wall=plane",
    )


def _filled(loops: Sequence[Float64[Array, "_ 2"]], spacing_mm: float | None) -> Patch | None:
    """Triangulation of the region inside simple loops. None if they enclose no region."""
    points = np.concatenate(loops)
    starts = np.cumsum([0, *(len(loop) for loop in loops)])
    rings = [np.arange(a, b) for a, b in pairwise(starts)]
    n_loop = len(points)
    cells = np.empty((0, 3), dtype=np.int64)
    if spacing_mm is not None:
        inner, cells = _inner_grid(loops, spacing_mm)
        cells = cells + n_loop
        points = np.concatenate([points, inner])
        rings += [ring[::-1] for ring in opening_loops(cells, len(points))] if len(cells) else []
    order = np.concatenate(rings)
    centre = points.mean(axis=0)  # the triangulation loses precision far from the origin
    seam = manifold3d.triangulate([points[ring] - centre for ring in rings])
    faces = np.concatenate([order[np.asarray(seam, dtype=np.int64)].reshape(-1, 3), cells])
    wanted = sum(signed_area_mm2(loop) for loop in loops)
    a, b, c = np.moveaxis(points[faces], 1, 0)
    covered = np.abs(_cross(b - a, c - a)).sum() / 2
    return (
        Patch(points=points, faces=faces, n_loop=n_loop) if np.isclose(covered, wanted, rtol=1e-3, atol=1e-6) else None
    )


def harmonic(patch: Patch, boundary_values: Float64[Array, "b k"]) -> Float64[Array, "n k"]:
    """Harmonic interpolation over the patch of values on its loops (linear finite elements)."""
    return harmonic_between(patch.points, patch.faces, np.arange(len(patch.points)) < patch.n_loop, boundary_values)


def harmonic_between(
    points: Float64[Array, "n d"],
    faces: Int64[Array, "m 3"],
    held: Bool[Array, " n"],
    values_held: Float64[Array, "h k"],
) -> Float64[Array, "n k"]:
    """Harmonic interpolation over triangles, in the plane or in space, of values at fixed points."""
    values = np.empty((len(points), values_held.shape[1]))
    values[held] = values_held
    if not held.all():
        rows = cotangent_laplacian(points, faces)[~held]
        values[~held] = splu(rows[:, ~held].tocsc()).solve(-(rows[:, held] @ values_held))
    return values


def cotangent_laplacian(points: Float64[Array, "n d"], faces: Int64[Array, "m 3"]) -> csr_matrix:
    """Stiffness matrix of linear finite elements over triangles in the plane or in space."""
    n = len(points)
    rows, columns, weights = [], [], []
    for corner in range(3):
        i, j, k = (faces[:, (corner + step) % 3] for step in range(3))
        u, v = points[j] - points[i], points[k] - points[i]
        dot = (u * v).sum(axis=1)
        twice_area = np.sqrt(np.maximum((u * u).sum(axis=1) * (v * v).sum(axis=1) - dot * dot, 1e-24))
        # A sliver's cotangent is bounded: its points practically coincide.
        cotangent = np.clip(dot / twice_area, -1e4, 1e4) / 2
        rows += [j, k, j, k]
        columns += [k, j, j, k]
        weights += [-cotangent, -cotangent, cotangent, cotangent]
    return coo_matrix((np.concatenate(weights), (np.concatenate(rows), np.concatenate(columns))), shape=(n, n)).tocsr()


def _inner_grid(
    loops: Sequence[Float64[Array, "_ 2"]], spacing: float
) -> tuple[Float64[Array, "n 2"], Int64[Array, "m 3"]]:
    """Square cells at least one cell's width inside the loops, as points and triangles."""
    points = np.concatenate(loops)
    low = points.min(axis=0) - 2 * spacing
    width, height = (int(size) for size in np.ceil((points.max(axis=0) + 2 * spacing - low) / spacing))
    cells = _cells_inside([(loop - low) / spacing for loop in loops], height, width)
    row, column = np.nonzero(cells)
    corner = row * (width + 1) + column
    right, up, across = corner + 1, corner + width + 1, corner + width + 2
    faces = np.concatenate([np.stack([corner, right, across], axis=1), np.stack([corner, across, up], axis=1)])
    used, compact = np.unique(faces, return_inverse=True)
    grid = np.stack([used % (width + 1), used // (width + 1)], axis=1) * spacing + low
    return grid, compact.reshape(-1, 3).astype(np.int64)


def _cells_inside(loops: Sequence[Float64[Array, "_ 2"]], height: int, width: int) -> Bool[Array, "h w"]:
    touched = np.zeros((height, width), dtype=bool)
    crossings = np.zeros((height, width + 1), dtype=np.int64)
    for loop in loops:
        a, b = loop, np.roll(loop, -1, axis=0)
        steps = int(np.ceil(np.abs(b - a).max() * 4)) + 1
        for t in np.linspace(0.0, 1.0, steps):
            cell = np.floor(a + (b - a) * t).astype(int)
            touched[cell[:, 1], cell[:, 0]] = True
        low, high = np.minimum(a[:, 1], b[:, 1]), np.maximum(a[:, 1], b[:, 1])
        first, last = np.ceil(low - 0.5).astype(int), np.ceil(high - 0.5).astype(int)  # centre rows low ≤ y < high
        for k in range(int((last - first).max(initial=0))):
            row = first + k
            hit = row < last
            y = row[hit] + 0.5
            x = a[hit, 0] + (y - a[hit, 1]) / (b[hit, 1] - a[hit, 1]) * (b[hit, 0] - a[hit, 0])
            np.add.at(crossings, (row[hit], np.ceil(x - 0.5).astype(int)), 1)
    inside = (np.cumsum(crossings, axis=1)[:, :-1] % 2 == 1) & ~binary_dilation(touched)
    while True:  # cells that touch only in a corner would make the inner region's edge cross itself
        first = inside[:-1, :-1] & inside[1:, 1:] & ~inside[:-1, 1:] & ~inside[1:, :-1]
        second = inside[:-1, 1:] & inside[1:, :-1] & ~inside[:-1, :-1] & ~inside[1:, 1:]
        if not (first.any() or second.any()):
            return inside
        inside[:-1, :-1] &= ~first
        inside[:-1, 1:] &= ~second


def _cross(u: Float64[Array, "n 2"], v: Float64[Array, "n 2"]) -> Float64[Array, " n"]:
    return u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]


Lift = Callable[[Patch], Float64[Array, "k 3"]]
"""Function that gives the world positions of a patch's inner points, mm."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Closed:
    """A skin and the wall that closes it, world frame, mm."""

    wall: TriangleMesh
    """The wall alone, open, normals pointing away from the skin."""
    skin: TriangleMesh
    """The skin alone, open."""
    solid: TriangleMesh
    """Both, joined without a gap. The skin's faces come first."""
    kind: str | None = None
    """Name of the resulting wall if it is not the requested one: a cylinder may become a plane."""
    definition: str | None = None
    """Definition of the wall, one sentence, if it depends on the breast, such as a cylinder's radius."""


def sew(
    part: OpenPart, flat_loops: tuple[Float64[Array, "_ 2"], ...], lift: Lift, *, spacing_mm: float | None, subject: str
) -> Closed:
    """Skin closed by a wall.

    Args:
        part: the skin; its loops run counter-clockwise for a viewer outside.
        flat_loops: each loop flattened as that viewer sees it, mm.
        lift: world positions of the wall's inner points.
        spacing_mm: spacing of the wall's inner points; None for a flat wall, which needs none.
        subject: name for messages.

    Raises:
        MeasureError: the skin has no opening, or the flattened opening runs clockwise.
    """
    if not part.loops:
        raise MeasureError(
            subject,
            found="a surface without an opening for the wall",
            expected="a wall that cuts the surface",
            remedy="Check the boundary: it must run around the breast, on the surface",
        )
    turning = sum(signed_area_mm2(loop) for loop in flat_loops)
    if turning <= 0:
        raise CrossingError(
            subject,
            found="a boundary with the wrong direction when flattened",
            expected="a simple closed curve around the breast",
            remedy="Draw the boundary with `mammometry edit`, or choose another wall with --set measure.wall=plane",
        )
    patch = fill(flat_loops, spacing_mm)
    loop = np.concatenate(part.loops)
    inner = lift(patch) if len(patch.points) > patch.n_loop else np.empty((0, 3))
    faces = patch.faces[:, ::-1]
    wall = TriangleMesh(
        vertices=np.concatenate([part.mesh.vertices[loop], inner]), faces=np.ascontiguousarray(faces, dtype=np.int32)
    )
    number = np.concatenate([loop, len(part.mesh.vertices) + np.arange(len(inner))])
    closed = TriangleMesh(
        vertices=np.concatenate([part.mesh.vertices, inner]),
        faces=np.concatenate([part.mesh.faces, number[faces].astype(np.int32)]),
    )
    return Closed(wall=wall, skin=part.mesh, solid=closed)
