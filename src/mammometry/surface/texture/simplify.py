"""Meshes with fewer triangles, for viewing only: quadric edge collapse.

The library never frees its memory: 700 MB after a torso. So a large mesh is simplified in a process of its own.
"""

from __future__ import annotations

import numpy as np

from mammometry.base.child_process import ChildProcess
from mammometry.geometry import Array, Float32, Int32, TriangleMesh

_LARGE = 300_000  # least number of triangles for which a child process is worth its start of half a second


def thinned(mesh: TriangleMesh, triangles: int) -> TriangleMesh:
    """A mesh of at most `triangles` faces."""
    if len(mesh.faces) <= triangles:
        return mesh
    middle = mesh.vertices.mean(axis=0)  # the library computes in float32 and requires writable arrays
    vertices = np.ascontiguousarray(mesh.vertices - middle, dtype=np.float32)
    faces = np.array(mesh.faces, dtype=np.int32, order="C")
    collapse = _collapsed if len(faces) < _LARGE else _collapsed_in_child
    vertices, faces = collapse(vertices, faces, triangles)
    return TriangleMesh(vertices=vertices.astype(np.float64) + middle, faces=faces.astype(np.int32))


def _collapsed(
    vertices: Float32[Array, "n 3"], faces: Int32[Array, "m 3"], triangles: int
) -> tuple[Float32[Array, "k 3"], Int32[Array, "l 3"]]:
    from fast_simplification import simplify

    # Copies: a call to a child process makes its arrays read-only.
    found: tuple[Float32[Array, "k 3"], Int32[Array, "l 3"]] = simplify(
        vertices.copy(), faces.copy(), target_count=triangles
    )
    return found


def _collapsed_in_child(
    vertices: Float32[Array, "n 3"], faces: Int32[Array, "m 3"], triangles: int
) -> tuple[Float32[Array, "k 3"], Int32[Array, "l 3"]]:
    """Simplified mesh, computed in a process of its own."""
    with ChildProcess() as child:
        return child.call(_collapsed, vertices, faces, triangles)
