"""Triangle meshes: topology, exact integrals, edge splitting without gaps.

World frame, mm, faces counter-clockwise seen from outside.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TypeAlias

import numpy as np

from mammometry.base.value import value
from mammometry.geometry.arrays import Array, Bool, Float64, Int32, Int64
from mammometry.geometry.transform import Transform

_PER_MM = 1024.0  # a power of two: dividing by it is exact

PointMap: TypeAlias = Callable[[Float64[Array, "n 3"]], Float64[Array, "n 3"]]
"""Maps points, mm, to another frame or position."""


@value(eq=False)
class TriangleMesh:
    """Vertices and triangles.

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

    def corners(self) -> Float64[Array, "m 3 3"]:
        """Corner positions of every face, (face, corner, xyz), mm."""
        return self.vertices[self.faces]

    def face_vectors(self) -> Float64[Array, "m 3"]:
        """Outward normals (m, 3) whose length is the face's area, mm²."""
        from mammometry.geometry import mesh_kernels

        vectors: Float64[Array, "m 3"] = mesh_kernels.area_vectors(self.vertices, self.faces)
        return vectors

    def vertex_normals(self) -> Float64[Array, "n 3"]:
        """Unit outward normals: area-weighted means of the faces' normals. Zero at a vertex without area."""
        from mammometry.geometry import mesh_kernels

        normals: Float64[Array, "n 3"] = mesh_kernels.vertex_normals(
            len(self.vertices), self.faces, self.face_vectors()
        )
        return normals

    def edges(self) -> Int64[Array, "e 2"]:
        """Each undirected edge once, smaller index first."""
        starts, stops = self.faces.ravel().astype(np.int64), self.faces[:, [1, 2, 0]].ravel().astype(np.int64)
        return unique_edges(starts, stops, len(self.vertices))

    def is_watertight(self) -> bool:
        """Whether every directed edge occurs once, and so does its opposite."""
        starts, stops, across = self._sides()
        side = np.arange(len(across))
        opposite = (across[across] == side) & (starts[across] == stops) & ((starts != stops) | (across == side))
        return len(starts) > 0 and bool(opposite.all())

    def euler_number(self) -> int:
        """V − E + F over the vertices in use. 2 for one closed surface without tunnels."""
        used = np.bincount(self.faces.ravel(), minlength=1)
        starts, stops, across = self._sides()
        side = np.arange(len(across))
        few = across[across] == side  # on a manifold, every edge has one or two faces
        edges = int(np.count_nonzero(few & (side <= across)))
        edges += len(unique_edges(starts[~few].astype(np.int64), stops[~few].astype(np.int64), len(self.vertices)))
        return int(np.count_nonzero(used)) - edges + len(self.faces)

    def _sides(self) -> tuple[Int32[Array, " h"], Int32[Array, " h"], Int32[Array, " h"]]:
        """Start and end of each half-edge, and the next one on the same edge (`mesh_kernels.edge_rings`)."""
        from mammometry.geometry import mesh_kernels

        across = mesh_kernels.edge_rings(len(self.vertices), self.faces)
        return self.faces.ravel(), self.faces[:, [1, 2, 0]].ravel(), across

    def components(self) -> tuple[int, Int32[Array, " n"]]:
        """Number of connected parts and each vertex's part. A vertex without faces is a part of its own."""
        from mammometry.geometry import mesh_kernels

        count, labels = mesh_kernels.parts(len(self.vertices), self.faces)
        return int(count), labels

    def area_mm2(self) -> float:
        """Surface area, mm²."""
        return float(np.linalg.norm(self.face_vectors(), axis=1).sum())

    def volume_mm3(self) -> float:
        """Signed enclosed volume by the divergence theorem, mm³. Exact for a closed mesh.

        Coordinates are relative to the mean vertex, so that a mesh far from the origin keeps its precision.
        """
        from mammometry.geometry import mesh_kernels

        if not len(self.faces):
            return 0.0
        return float(mesh_kernels.volume(self.vertices, self.faces, self.vertices.mean(axis=0)))

    def transformed(self, b_from_a: Transform) -> TriangleMesh:
        """Return the mesh in frame b."""
        return self.mapped(b_from_a.apply)

    def faces_within(self, inside: Bool[Array, " n"]) -> Bool[Array, " m"]:
        """Mask of the faces whose three corners are all marked."""
        first, second, third = self.faces.T  # `all` over an axis of length three is many times slower
        return np.asarray(inside[first] & inside[second] & inside[third])

    def vertices_between(self, low: Float64[Array, 3], high: Float64[Array, 3]) -> Int64[Array, " k"]:
        """Indices of the vertices in a box, including its faces."""
        x, y, z = self.vertices.T
        inside = (x >= low[0]) & (x <= high[0]) & (y >= low[1]) & (y <= high[1]) & (z >= low[2]) & (z <= high[2])
        return np.flatnonzero(inside)

    def vertices_used_by(self, chosen_faces: Array) -> Bool[Array, " n"]:
        """Mask of the vertices that are corners of chosen faces, given by mask or index."""
        used = np.zeros(len(self.vertices), dtype=bool)
        used[self.faces[chosen_faces]] = True
        return used

    def submesh(self, keep_faces: Array) -> TriangleMesh:
        """Return the faces chosen by mask or index. Unused vertices are removed. Others keep their order."""
        used = self.vertices_used_by(keep_faces)
        number = np.cumsum(used, dtype=np.int32) - 1
        return TriangleMesh(vertices=self.vertices[used], faces=number[self.faces[keep_faces]].astype(np.int32))

    def mapped(self, motion: PointMap) -> TriangleMesh:
        """Return the mesh with every vertex mapped by a function, mm."""
        return TriangleMesh(vertices=motion(self.vertices), faces=self.faces)

    def turned_over(self) -> TriangleMesh:
        """Return the mesh with its faces reversed, as needed after mirroring."""
        return TriangleMesh(vertices=self.vertices, faces=np.ascontiguousarray(self.faces[:, ::-1]))


def joined(meshes: Sequence[TriangleMesh]) -> TriangleMesh:
    """Concatenate meshes. No vertices are merged."""
    offsets = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes[:-1])])
    return TriangleMesh(
        vertices=np.concatenate([mesh.vertices for mesh in meshes]),
        faces=np.concatenate([mesh.faces + offset for mesh, offset in zip(meshes, offsets, strict=True)]).astype(
            np.int32
        ),
    )


def unique_edges(starts: Int64[Array, " k"], stops: Int64[Array, " k"], n: int) -> Int64[Array, "e 2"]:
    """Each undirected edge between n vertices once, smaller number first, in order."""
    keys = np.sort(np.minimum(starts, stops) * n + np.maximum(starts, stops))
    keys = keys[np.diff(keys, prepend=-1) > 0]  # np.unique hashes first, which is ten times slower here
    return np.stack(np.divmod(keys, max(n, 1)), axis=1)


def on_microns(vectors_mm: Float64[Array, "n 3"]) -> Float64[Array, "n 3"]:
    """Round to 1/1024 mm, a hundredth of the measurement error.

    Sums of such vectors up to 16 m are exact as float32, so files need half the space. Zeros are positive.
    """
    rounded: Float64[Array, "n 3"] = np.round(vectors_mm * _PER_MM) / _PER_MM + 0.0
    return rounded


_CORNERS = np.arange(3)


def edge_table(faces: Int32[Array, "m 3"]) -> tuple[Int64[Array, "e 2"], Int64[Array, "m 3"]]:
    """Unique edges, and the numbers of each face's three edges.

    Each edge has its smaller index first. A face's edges are 0–1, 1–2 and 2–0.
    """
    directed = np.stack([faces, np.roll(faces, -1, axis=1)], axis=-1).astype(np.int64)
    directed.sort(axis=-1)
    count = int(faces.max()) + 1
    keys, number = np.unique(directed[..., 0] * count + directed[..., 1], return_inverse=True)
    return np.stack(np.divmod(keys, count), axis=1), number.reshape(-1, 3)


def split_edges(
    faces: Int32[Array, "m 3"], edges_of_face: Int64[Array, "m 3"], split: Bool[Array, " e"], first_new: int
) -> Int32[Array, "k 3"]:
    """Split the marked edges at one new vertex each. Each adjacent face becomes two, three or four.

    Args:
        faces: vertex indices.
        edges_of_face: numbers from `edge_table`.
        split: mask of the edges.
        first_new: index of the first marked edge's new vertex; the others follow in order.
    """
    new_vertex = np.full(len(split), -1, dtype=np.int64)
    new_vertex[split] = first_new + np.arange(int(split.sum()))
    middle = new_vertex[edges_of_face]
    marked = middle >= 0
    count = marked.sum(axis=1)
    parts = [faces[count == 0].astype(np.int64)]
    # Rotate each face: a single marked edge comes first; of two marked edges neither is the last.
    turn = np.where(count == 1, marked.argmax(axis=1), (np.argmin(marked, axis=1) + 1) % 3)
    order = (turn[:, None] + _CORNERS) % 3
    corner = np.take_along_axis(faces.astype(np.int64), order, axis=1)
    middle = np.take_along_axis(middle, order, axis=1)
    one, two, three = count == 1, count == 2, count == 3
    a, b, c = corner[one].T
    m = middle[one, 0]
    parts += [np.stack([a, m, c], axis=1), np.stack([m, b, c], axis=1)]
    a, b, c = corner[two].T
    m, n = middle[two, 0], middle[two, 1]
    parts += [np.stack([m, b, n], axis=1), np.stack([a, m, n], axis=1), np.stack([a, n, c], axis=1)]
    a, b, c = corner[three].T
    m, n, o = middle[three].T
    parts += [np.stack(part, axis=1) for part in ((a, m, o), (m, b, n), (n, c, o), (m, n, o))]
    return np.concatenate(parts).astype(np.int32)
