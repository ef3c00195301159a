"""Compiled kernels on triangle meshes; their plain NumPy twins stand in tests/unit/geometry/."""

import numpy as np
from numba import njit, prange

from mammometry.geometry.arrays import Array, Float64, Int32


@njit(cache=True, parallel=True)
def area_vectors(vertices: Float64[Array, "n 3"], faces: Int32[Array, "m 3"]) -> Float64[Array, "m 3"]:
    """Normals, counter-clockwise seen from their tips, whose length is the face's area."""
    result = np.empty((len(faces), 3))
    for face in prange(len(faces)):
        a, b, c = faces[face, 0], faces[face, 1], faces[face, 2]
        ux, uy, uz = (
            vertices[b, 0] - vertices[a, 0], vertices[b, 1] - vertices[a, 1], vertices[b, 2] - vertices[a, 2],
        )  # fmt: skip
        vx, vy, vz = (
            vertices[c, 0] - vertices[a, 0], vertices[c, 1] - vertices[a, 1], vertices[c, 2] - vertices[a, 2],
        )  # fmt: skip
        result[face, 0] = 0.5 * (uy * vz - uz * vy)
        result[face, 1] = 0.5 * (uz * vx - ux * vz)
        result[face, 2] = 0.5 * (ux * vy - uy * vx)
    return result


@njit(cache=True)
def vertex_normals(n: int, faces: Int32[Array, "m 3"], vectors: Float64[Array, "m 3"]) -> Float64[Array, "n 3"]:
    """Sum of the faces' vectors at each of n vertices, to unit length; zero where there is none."""
    normals = np.zeros((n, 3))
    for face in range(len(faces)):
        for corner in range(3):
            vertex = faces[face, corner]
            for axis in range(3):
                normals[vertex, axis] += vectors[face, axis]
    for vertex in range(n):
        length = np.sqrt(normals[vertex, 0] ** 2 + normals[vertex, 1] ** 2 + normals[vertex, 2] ** 2)
        if length > 0.0:
            for axis in range(3):
                normals[vertex, axis] /= length
    return normals


@njit(cache=True)
def parts(n: int, faces: Int32[Array, "m 3"]) -> tuple[int, Int32[Array, " n"]]:
    """Number of connected parts of n vertices, and each one's part, in the order of their first vertices."""
    root = np.arange(n).astype(np.int32)
    for face in range(len(faces)):
        a = _root(root, faces[face, 0])
        for corner in (1, 2):
            b = _root(root, faces[face, corner])
            if a < b:
                root[b] = a
            elif b < a:
                root[a] = b
                a = b
    count = 0
    for vertex in range(n):  # a root is its part's smallest vertex, and comes first
        if root[vertex] == vertex:
            root[vertex] = -count - 1
            count += 1
        else:
            above = root[vertex]
            while above >= 0:
                above = root[above]
            root[vertex] = above
    return count, (-root - 1).astype(np.int32)


@njit(cache=True)
def _root(root: Int32[Array, " n"], vertex: int) -> int:
    while root[vertex] != vertex:
        root[vertex] = root[root[vertex]]
        vertex = root[vertex]
    return vertex
