"""Closing of a scan's hole below a breast that hangs over its fold.

At the edge of such a hole the chest's skin slopes inwards and the breast's skin outwards. The patch continues both
slopes and bends as little as possible (docs/decisions/0051).
"""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
from scipy.ndimage import gaussian_filter1d
from scipy.sparse import diags
from scipy.sparse.linalg import splu

from mammometry.base.errors import CrossingError
from mammometry.base.value import value
from mammometry.geometry import Array, Float64, Int64
from mammometry.geometry.mesh import TriangleMesh
from mammometry.geometry.nearest import point_tree
from mammometry.measure.solid.patch import cotangent_laplacian, fill, harmonic

_RING_MM = 12.0  # width of the ring of skin that determines the slope at a hole; not critical
_EVEN_MM = 2.0  # spacing of points along a hole's edge; not critical
_SMOOTH_MM = 8.0  # Gaussian σ along the edge, which is ragged by the size of a triangle; not critical
_GRID_MM = 2.0  # spacing of vertices in a closed hole
_FEWEST = 16  # fewest points along a hole's edge
_LEAST_MASS_MM2 = 1e-3  # least area of a vertex
_TAILS, _IN, _OUT = (0.1, 0.9), -0.4, 0.2
"""Two quantiles along the edge, and limits of the cosine between the skin's direction and outwards at them: at a hidden
fold the skin slopes inwards at one and outwards at the other. Eighteen hidden folds have −1.0 to −0.7 and 0.5 to 0.9.
Cut arms and necks have 0.4 or more, a dome's tip 0: no skin slopes inwards. An armpit has −0.9 and −0.3: none slopes
outwards."""

Filling: TypeAlias = tuple[Float64[Array, "k 3"], Int64[Array, "m 3"]]
"""Points inside a hole's edge, mm, and triangles: indices into the edge's vertices, then the points."""


@value(eq=False)
class HoleEdge:
    """The edge of a hole."""

    points: Float64[Array, "n 3"]
    """Its vertices, mm."""
    lengths_mm: Float64[Array, " n"]
    """Length of the edge that belongs to each vertex."""
    onwards: Float64[Array, "n 3"]
    """Unit vector in which the skin continues into the hole."""
    frame: Float64[Array, "3 3"]
    """Rows: two directions in the hole's mean plane, and outwards."""

    @property
    def out(self) -> Float64[Array, " n"]:
        """Cosine between `onwards` and outwards: −1 where the skin runs straight into the hole."""
        return np.asarray(self.onwards @ self.frame[2])


def fold_patch(mesh: TriangleMesh, loop: Int64[Array, " n"]) -> Filling | None:
    """Points and triangles that close a hole at a hidden fold. None if the hole is something else.

    Args:
        mesh: the skin with the hole, mm.
        loop: vertices of the hole's edge, in the direction of the faces.
    """
    edge = edge_of_hole(mesh, loop)
    if edge is None:
        return None
    low, high = _quantiles(edge)
    if low > _IN or high < _OUT:
        return None
    try:
        return continued(edge)
    except CrossingError:
        return None


def continued(edge: HoleEdge) -> Filling:
    """Points and triangles that close a hole with the slope at its edge and least bending.

    Of all surfaces u with this edge and slope, it has the least ∫ |Δu|².

    Raises:
        CrossingError: the edge crosses itself when flattened.
    """
    middle = edge.points.mean(axis=0)
    flat, onwards = ((vectors @ edge.frame.T)[::-1] for vectors in (edge.points - middle, edge.onwards))
    patch = fill([flat[:, :2]], _GRID_MM)
    n = patch.n_loop
    points = np.concatenate([patch.points, harmonic(patch, flat[:, 2:])], axis=1)
    points[:n] = flat
    laplacian = cotangent_laplacian(points, patch.faces).tocsc()
    a, b, c = np.moveaxis(points[patch.faces], 1, 0)
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2
    mass = np.bincount(patch.faces.ravel(), np.repeat(area / 3, 3), minlength=len(points))
    weight = diags(1 / np.maximum(mass, _LEAST_MASS_MM2))
    flux = np.zeros((len(points), 3))
    flux[:n] = -edge.lengths_mm[::-1, None] * onwards
    inner = laplacian[:, n:]
    known = flux - laplacian[:, :n] @ flat
    solved = splu((inner.T @ weight @ inner).tocsc()).solve(inner.T @ (weight @ known))
    triangles = np.where(patch.faces < n, n - 1 - patch.faces, patch.faces)
    return middle + solved @ edge.frame, triangles


def _quantiles(edge: HoleEdge) -> tuple[float, float]:
    """Lower and upper quantile of `HoleEdge.out`, weighted by length."""
    order = np.argsort(edge.out)
    share = np.cumsum(edge.lengths_mm[order]) / edge.lengths_mm.sum()
    low, high = np.interp(_TAILS, share, edge.out[order])
    return float(low), float(high)


def edge_of_hole(mesh: TriangleMesh, loop: Int64[Array, " n"]) -> HoleEdge | None:
    """The edge of a hole. None if the hole has no area.

    Args:
        mesh: the skin with the hole, mm.
        loop: vertices of the hole's edge, in the direction of the faces.
    """
    rim = mesh.vertices[loop]
    after = np.roll(rim, -1, axis=0)
    outwards = np.cross(after - rim.mean(axis=0), rim - rim.mean(axis=0)).sum(axis=0)
    steps = np.linalg.norm(after - rim, axis=1)
    along, length = np.concatenate([[0.0], np.cumsum(steps)]), float(steps.sum())
    if not np.linalg.norm(outwards) > _LEAST_MASS_MM2:
        return None
    ahead = outwards / np.linalg.norm(outwards)
    right = np.cross(np.eye(3)[np.argmin(np.abs(ahead))], ahead)
    right /= np.linalg.norm(right)
    count = max(_FEWEST, int(length / _EVEN_MM))
    places, sigma = np.arange(count) * length / count, _SMOOTH_MM * count / length

    def evenly(values: Float64[Array, "n 3"]) -> Float64[Array, "k 3"]:
        return np.stack([np.interp(places, along, np.append(v, v[0])) for v in values.T], axis=1)

    def smooth(values: Float64[Array, "k 3"]) -> Float64[Array, "k 3"]:
        return _unit(gaussian_filter1d(values, sigma, axis=0, mode="wrap"))

    curve = evenly(rim)
    own = smooth(evenly(mesh.vertex_normals()[loop]))
    even = gaussian_filter1d(curve, sigma, axis=0, mode="wrap")
    tangent = _unit(np.roll(even, -1, axis=0) - np.roll(even, 1, axis=0))
    vectors, middles = mesh.face_vectors(), mesh.corners().mean(axis=1)
    near = np.flatnonzero(((middles > rim.min(axis=0) - _RING_MM) & (middles < rim.max(axis=0) + _RING_MM)).all(axis=1))
    normal = own.copy()
    for k, faces in enumerate(point_tree(middles[near]).query_ball_point(curve, _RING_MM)):
        beside = vectors[near[faces]]
        normal[k] += (beside[beside @ own[k] > 0]).sum(axis=0)
    onwards = smooth(_unit(np.cross(tangent, _unit(normal))))
    closed = np.concatenate([onwards, onwards[:1]])
    return HoleEdge(
        points=rim,
        lengths_mm=(steps + np.roll(steps, 1)) / 2,
        onwards=np.stack([np.interp(along[:-1], np.append(places, length), v) for v in closed.T], axis=1),
        frame=np.stack([right, np.cross(ahead, right), ahead]),
    )


def _unit(vectors: Float64[Array, "n 3"]) -> Float64[Array, "n 3"]:
    return vectors / np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), 1e-12)
