"""Volumes on one side of planes, exact for the mesh, without caps.

The divergence theorem gives the volume of a solid as a sum over its faces of the tetrahedra that they make with any
origin. With the origin on the cutting planes, the cut faces make tetrahedra without volume: they need not be built.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mammometry.geometry.arrays import Array, Bool, Float64
from mammometry.geometry.mesh import TriangleMesh


def volume_within_mm3(solid: TriangleMesh, origin: Float64[Array, 3], normals: Sequence[Float64[Array, 3]]) -> float:
    """Volume of a closed solid's part on the positive side of planes.

    The planes go through one common point.

    Args:
        solid: closed, mm.
        origin: the planes' common point, mm.
        normals: of each plane, towards the side that counts; one plane, or several that meet in `origin`.
    """
    triangles = solid.corners() - origin
    for normal in normals:
        triangles = _clipped(triangles, normal)
    a, b, c = np.moveaxis(triangles, 1, 0)
    return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6)


def _clipped(triangles: Float64[Array, "m 3 3"], normal: Float64[Array, 3]) -> Float64[Array, "k 3 3"]:
    """Parts of triangles above the plane through the origin. They are triangles of the same orientation."""
    height = triangles @ normal
    inside = height >= 0
    count = inside.sum(axis=1)
    a, b, c, up = _turned(triangles, height, inside, count == 1)
    ab, ac = _crossing(a, b, up[:, 0], up[:, 1]), _crossing(a, c, up[:, 0], up[:, 2])
    d, e, f, down = _turned(triangles, height, ~inside, count == 2)
    ed, fd = _crossing(e, d, down[:, 1], down[:, 0]), _crossing(f, d, down[:, 2], down[:, 0])
    parts = [
        triangles[count == 3],
        np.stack([a, ab, ac], axis=1),
        np.stack([ed, e, f], axis=1),
        np.stack([ed, f, fd], axis=1),
    ]
    return np.concatenate(parts)


def _turned(
    triangles: Float64[Array, "m 3 3"],
    height: Float64[Array, "m 3"],
    odd: Bool[Array, "m 3"],
    chosen: Bool[Array, " m"],
) -> tuple[Float64[Array, "k 3"], Float64[Array, "k 3"], Float64[Array, "k 3"], Float64[Array, "k 3"]]:
    """Corners of the chosen triangles, odd one first, with their heights."""
    order = (np.argmax(odd[chosen], axis=1)[:, None] + np.arange(3)) % 3
    corners = np.take_along_axis(triangles[chosen], order[..., None], axis=1)
    return corners[:, 0], corners[:, 1], corners[:, 2], np.take_along_axis(height[chosen], order, axis=1)


def _crossing(
    above: Float64[Array, "k 3"], below: Float64[Array, "k 3"], high: Float64[Array, " k"], low: Float64[Array, " k"]
) -> Float64[Array, "k 3"]:
    return above + (below - above) * (high / (high - low))[:, None]
