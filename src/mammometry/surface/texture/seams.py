"""Fading of photographs into one another on a viewing mesh.

Each photograph has a weight at every vertex: its share of the faces around, spread over the mesh by a few edges. The
weight is 0 if it does not see all of them. Weights are linear between vertices, so they are the same from both sides
of a seam. So is the mean of the photographs with these weights: no step is left whatever their brightness.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mammometry.geometry.arrays import Array, Bool, Float32, Float64, Int32, Int64
from mammometry.geometry.mesh import TriangleMesh
from mammometry.surface.repair.energy import graph_of_mesh, laplacian
from mammometry.surface.texture import atlas_kernels

_FADING_ROUNDS = 5  # edges over which one photograph fades into the next; chosen by eye
_LEAST_SHARE = 0.03  # of a photograph at a vertex; less of one is not seen; chosen by eye
_MARGIN_PX = 1.5  # beside a face, for who reads between pixels
_LEAST_WEIGHT = 1e-6  # of a face's own photograph: where no weight is left, it shows that one
_BAND_PX = 512  # rows of the picture that are gone through at once; chosen for memory


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FadingPixels:
    """The pixels of a covering picture that show more than one photograph."""

    row: Int32[Array, " p"]
    column: Int32[Array, " p"]
    corners: Int32[Array, "p 3"]
    """The vertices between which each pixel lies."""
    between: Float32[Array, "p 3"]
    """Its barycentric coordinates: weights of those vertices. Slightly negative just outside the face."""
    shares: Float32[Array, "k p"]
    """Of each photograph in each pixel. They add up to 1."""


def spread(values: Float64[Array, "n k"], mesh: TriangleMesh, rounds: int) -> Float64[Array, "n k"]:
    """Diffuse values of the vertices over a few edges."""
    stiffness = laplacian(graph_of_mesh(mesh))
    degree = np.maximum(stiffness.diagonal(), 1.0)[:, None]
    for _ in range(rounds):
        values = values - 0.5 * (stiffness @ values) / degree
    return values


def fading_weights(mesh: TriangleMesh, view: Int64[Array, " m"], seen: Bool[Array, "k n"]) -> Float32[Array, "k n"]:
    """Weight of each photograph at each vertex, 0…1.

    Positive for several only within a few edges of a seam.

    Args:
        mesh: the viewing mesh.
        view: number of the photograph that each face shows, −1 for none.
        seen: whether each photograph sees each vertex.
    """
    shown = np.zeros((len(mesh.vertices), len(seen)))
    for k in range(len(seen)):
        shown[:, k] = np.bincount(mesh.faces[view == k].ravel(), minlength=len(mesh.vertices))
    share = spread(shown / np.maximum(shown.sum(axis=1, keepdims=True), 1.0), mesh, _FADING_ROUNDS)
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
    """Pixels of faces that share another photograph, and all shares.

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
    height, width = size_wh[1], size_wh[0]
    bands = [
        atlas_kernels.deepest_triangles(uv_px[faces], first, min(first + _BAND_PX, height), width, _MARGIN_PX)
        for first in range(0, height, _BAND_PX)
    ]
    face, row, column, between = (np.concatenate(parts) for parts in zip(*bands, strict=True))
    corners = mesh.faces[faces[face]]
    shown = own[faces[face]].astype(np.int32)
    shares = atlas_kernels.shares_of(weights, corners, between, shown, _LEAST_WEIGHT)
    return FadingPixels(row=row, column=column, corners=corners, between=between, shares=shares)
