"""Fading one photograph into the next where a viewing mesh changes between them.

Each photograph has a weight at every vertex: its share of the faces around, spread over the mesh by a few edges, and
nothing where it does not see all of them. What is linear between vertices is the same from both sides of a seam: so
is the mean of the photographs with these weights, and no step is left whatever their brightness.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mammometry.geometry.arrays import Array, Bool, Float32, Float64, Int64
from mammometry.geometry.mesh import TriangleMesh
from mammometry.surface.energy import graph_of_mesh, laplacian

_ROUNDS = 12
_LEAST_SHARE = 0.03
_MARGIN_PX = 1.5
_PIXELS_AT_ONCE = 1 << 20


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FadingPixels:
    """The pixels of a covering picture that show more than one photograph."""

    row: Int64[Array, " p"]
    column: Int64[Array, " p"]
    corners: Int64[Array, "p 3"]
    """The vertices between which each pixel lies."""
    between: Float32[Array, "p 3"]
    """Its barycentric coordinates: weights of those vertices; slightly negative just outside the face."""
    shares: Float32[Array, "k p"]
    """Of each photograph in each pixel; they add up to 1."""


def spread(values: Float64[Array, "n k"], mesh: TriangleMesh) -> Float64[Array, "n k"]:
    """Diffuse values of the vertices over a few edges."""
    stiffness = laplacian(graph_of_mesh(mesh))
    degree = np.maximum(stiffness.diagonal(), 1.0)[:, None]
    for _ in range(_ROUNDS):
        values = values - 0.5 * (stiffness @ values) / degree
    return values


def fading_weights(mesh: TriangleMesh, view: Int64[Array, " m"], seen: Bool[Array, "k n"]) -> Float32[Array, "k n"]:
    """Weight of each photograph at each vertex, 0…1; positive for several only within a few edges of a seam.

    Args:
        mesh: the viewing mesh.
        view: number of the photograph that each face shows, −1 for none.
        seen: whether each photograph sees each vertex.
    """
    shown = np.zeros((len(mesh.vertices), len(seen)))
    for k in range(len(seen)):
        shown[:, k] = np.bincount(mesh.faces[view == k].ravel(), minlength=len(mesh.vertices))
    share = spread(shown / np.maximum(shown.sum(axis=1, keepdims=True), 1.0), mesh)
    blind = np.zeros_like(seen)
    for k, sees in enumerate(seen):
        blind[k, mesh.faces[~sees[mesh.faces].all(axis=1)]] = True
    return np.where(blind, 0.0, np.maximum(share.T - _LEAST_SHARE, 0.0)).astype(np.float32)


def fading_pixels(
    mesh: TriangleMesh,
    view: Int64[Array, " m"],
    weights: Float32[Array, "k n"],
    uv_px: Float64[Array, "m 3 2"],
    size_wh: tuple[int, int],
) -> FadingPixels:
    """Find the pixels of all faces with a share in another photograph than their own, and every photograph's share.

    Args:
        mesh: the viewing mesh.
        view: number of the photograph that each face shows, −1 for none.
        weights: from `fading_weights`.
        uv_px: where the faces' corners lie in the picture, pixels, integers at pixel centres.
        size_wh: of the picture.
    """
    own = np.maximum(view, 0)
    elsewhere = weights.sum(axis=0)[mesh.faces] - weights[own[:, None], mesh.faces]
    faces = np.flatnonzero((view >= 0) & (elsewhere.max(axis=1) > 0))
    face, row, column, between = _within(uv_px[faces], size_wh)
    corners = mesh.faces[faces[face]].astype(np.int64)
    inside = np.maximum(between, 0.0)
    shares = np.stack([np.einsum("pc,pc->p", inside, weight[corners]) for weight in weights])
    shares[own[faces[face]], np.arange(len(face))] += 1e-6  # where no weight is left, each face shows its own
    return FadingPixels(
        row=row, column=column, corners=corners, between=between, shares=shares / shares.sum(axis=0, keepdims=True)
    )


def _within(
    corners: Float64[Array, "b 3 2"], size_wh: tuple[int, int]
) -> tuple[Int64[Array, " p"], Int64[Array, " p"], Int64[Array, " p"], Float32[Array, "p 3"]]:
    """Face, row, column and barycentric coordinates of the pixels that lie in faces or at most a margin beside one.

    The margin is for who reads between pixels; a pixel belongs to the face that it lies deepest in.
    """
    low = np.maximum(np.ceil(corners.min(axis=1) - _MARGIN_PX), 0).astype(np.int64)
    high = np.minimum(np.floor(corners.max(axis=1) + _MARGIN_PX).astype(np.int64) + 1, size_wh)
    wide, tall = (high - low).T
    count = wide * tall
    found: list[tuple[Array, ...]] = [(np.zeros(0, np.int64),) * 3 + (np.zeros((0, 3), np.float32), np.zeros(0))]
    parts = np.flatnonzero(np.diff(np.cumsum(count) // _PIXELS_AT_ONCE, prepend=-1))
    for faces in np.split(np.arange(len(corners)), parts[1:]):
        face = np.repeat(faces, count[faces])
        number = np.arange(len(face)) - np.repeat(np.cumsum(count[faces]) - count[faces], count[faces])
        column, row = low[face, 0] + number % wide[face], low[face, 1] + number // wide[face]
        across = np.empty((len(face), 3))
        between = np.empty((len(face), 3))
        for corner in range(3):
            start, end, tip = (corners[face, (corner + k) % 3] for k in (1, 2, 0))
            (dx, dy), length = (end - start).T, np.linalg.norm(end - start, axis=1)
            twice_area = dx * (tip[:, 1] - start[:, 1]) - dy * (tip[:, 0] - start[:, 0])
            height = dx * (row - start[:, 1]) - dy * (column - start[:, 0])
            with np.errstate(divide="ignore", invalid="ignore"):
                between[:, corner] = height / twice_area
                across[:, corner] = between[:, corner] * np.abs(twice_area) / length
        depth = across.min(axis=1)
        kept = depth >= -_MARGIN_PX  # not a face without area either: NaN
        found.append((face[kept], row[kept], column[kept], between[kept].astype(np.float32), depth[kept]))
    face, row, column, between, depth = (np.concatenate(parts) for parts in zip(*found, strict=True))
    order = np.lexsort((depth, column, row))
    last = np.append((np.diff(row[order]) != 0) | (np.diff(column[order]) != 0), True)[: len(order)]
    chosen = order[last]
    return face[chosen], row[chosen], column[chosen], between[chosen]
