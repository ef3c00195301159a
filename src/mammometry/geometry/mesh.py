"""Triangle meshes: topology and exact integrals. World frame, mm, faces counter-clockwise seen from outside."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from mammometry.geometry.arrays import Array, Bool, Float64, Int32, Int64, read_only
from mammometry.geometry.transform import Transform

_AT_ONCE = 16384


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TriangleMesh:
    """Vertices and the triangles between them.

    Raises:
        ValueError: a face refers to a vertex that does not exist, or a vertex is not finite.
    """

    vertices: Float64[Array, "n 3"]
    """mm, world frame."""
    faces: Int32[Array, "m 3"]
    """Vertex indices, counter-clockwise seen from outside."""

    def __post_init__(self) -> None:
        if len(self.faces) and not (self.faces.min() >= 0 and self.faces.max() < len(self.vertices)):
            raise ValueError(f"faces refer to vertices up to {self.faces.max()}, mesh has {len(self.vertices)}")
        if not np.isfinite(self.vertices).all():
            raise ValueError("mesh has vertices that are not finite")
        object.__setattr__(self, "vertices", read_only(self.vertices))
        object.__setattr__(self, "faces", read_only(self.faces))

    def corners(self) -> Float64[Array, "m 3 3"]:
        """Corner positions of every face, (face, corner, xyz), mm."""
        return self.vertices[self.faces]

    def face_vectors(self) -> Float64[Array, "m 3"]:
        """Outward normals whose length is the face's area, mm²."""
        result = np.empty((len(self.faces), 3))
        for start in range(0, len(self.faces), _AT_ONCE):  # what fits in the cache, and no copies of all corners
            part = slice(start, start + _AT_ONCE)
            a, b, c = (np.ascontiguousarray(self.vertices[self.faces[part, corner]].T) for corner in range(3))
            (ux, uy, uz), (vx, vy, vz) = b - a, c - a
            for axis, doubled in enumerate((uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx)):
                np.multiply(doubled, 0.5, out=result[part, axis])
        return result

    def vertex_normals(self) -> Float64[Array, "n 3"]:
        """Unit outward normals, the faces' weighted by area; zero at a vertex without area."""
        vectors = self.face_vectors()
        normals = np.stack(
            [
                sum(
                    np.bincount(self.faces[:, corner], vectors[:, axis], minlength=len(self.vertices))
                    for corner in range(3)
                )
                for axis in range(3)
            ],
            axis=1,
        )
        length = np.linalg.norm(normals, axis=1, keepdims=True)
        return np.divide(normals, length, out=np.zeros_like(normals), where=length > 0)

    def edges(self) -> Int64[Array, "e 2"]:
        """Each undirected edge once, smaller index first."""
        directed = self.faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2).astype(np.int64)
        keys = np.sort(directed.min(axis=1) * len(self.vertices) + directed.max(axis=1))
        keys = keys[np.diff(keys, prepend=-1) > 0]  # np.unique hashes first, ten times slower here
        return np.stack(np.divmod(keys, max(len(self.vertices), 1)), axis=1)

    def is_watertight(self) -> bool:
        """Whether every directed edge occurs once and its opposite once: closed, manifold in its edges, oriented."""
        directed = self.faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2).astype(np.int64)
        n = len(self.vertices)
        forward = np.sort(directed[:, 0] * n + directed[:, 1])
        backward = np.sort(directed[:, 1] * n + directed[:, 0])
        return len(forward) > 0 and bool((np.diff(forward) > 0).all() and (forward == backward).all())

    def euler_number(self) -> int:
        """V − E + F over the vertices in use: 2 for one closed surface without tunnels."""
        used = np.bincount(self.faces.ravel(), minlength=1)
        return int(np.count_nonzero(used)) - len(self.edges()) + len(self.faces)

    def components(self) -> tuple[int, Int32[Array, " n"]]:
        """Number of connected parts and each vertex's part; a vertex without faces is a part of its own."""
        n = len(self.vertices)
        first, second, third = self.faces.T  # two of its three edges connect a face
        rows, columns = np.concatenate([first, second]), np.concatenate([second, third])
        graph = coo_matrix((np.ones(len(rows), dtype=np.int8), (rows, columns)), shape=(n, n))
        count, labels = connected_components(graph, directed=False)
        return int(count), labels.astype(np.int32)

    def area_mm2(self) -> float:
        """Surface area, mm²."""
        return float(np.linalg.norm(self.face_vectors(), axis=1).sum())

    def volume_mm3(self) -> float:
        """Signed enclosed volume by the divergence theorem, exact for a closed mesh, mm³.

        Coordinates are taken relative to the mean vertex, so that a mesh far from the origin loses no digits.
        """
        a, b, c = np.moveaxis(self.corners() - self.vertices.mean(axis=0), 1, 0)
        return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6)

    def transformed(self, b_from_a: Transform) -> TriangleMesh:
        """Return the mesh carried into frame b."""
        return TriangleMesh(vertices=b_from_a.apply(self.vertices), faces=self.faces)

    def faces_within(self, inside: Bool[Array, " n"]) -> Bool[Array, " m"]:
        """Faces whose three corners are all marked."""
        first, second, third = self.faces.T  # `all` over an axis of three is many times slower
        return np.asarray(inside[first] & inside[second] & inside[third])

    def vertices_between(self, low: Float64[Array, 3], high: Float64[Array, 3]) -> Int64[Array, " k"]:
        """Numbers of the vertices in a box, its faces included."""
        x, y, z = self.vertices.T
        inside = (x >= low[0]) & (x <= high[0]) & (y >= low[1]) & (y <= high[1]) & (z >= low[2]) & (z <= high[2])
        return np.flatnonzero(inside)

    def submesh(self, keep_faces: Array) -> TriangleMesh:
        """Return the faces chosen by mask or index, with unused vertices dropped."""
        faces = self.faces[keep_faces]
        used = np.zeros(len(self.vertices), dtype=bool)
        used[faces] = True
        number = np.cumsum(used, dtype=np.int32) - 1
        return TriangleMesh(vertices=self.vertices[used], faces=number[faces].astype(np.int32))
