"""Meshes of fewer triangles, for viewing only: quadric edge collapse.

The library that collapses edges keeps its memory for good: 700 MB after a torso. So a large mesh is thinned in a
process of its own (``python -m mammometry.surface.thinning``), beside other work.
"""

from __future__ import annotations

import io
import subprocess
import sys

import numpy as np

from mammometry.geometry.arrays import Array, Float32, Int32
from mammometry.geometry.mesh import TriangleMesh

_LARGE = 300_000  # triangles from which a process of its own, which takes half a second to begin, is worth it


def thinned(mesh: TriangleMesh, triangles: int) -> TriangleMesh:
    """Thin a mesh to at most `triangles`."""
    if len(mesh.faces) <= triangles:
        return mesh
    middle = mesh.vertices.mean(axis=0)  # the collapse computes in float32, and wants arrays it could write to
    vertices, faces = (mesh.vertices - middle).astype(np.float32), np.array(mesh.faces, dtype=np.int32)
    collapse = _collapsed if len(faces) < _LARGE else _collapsed_apart
    vertices, faces = collapse(vertices, faces, triangles)
    return TriangleMesh(vertices=vertices.astype(np.float64) + middle, faces=faces.astype(np.int32))


def _collapsed(
    vertices: Float32[Array, "n 3"], faces: Int32[Array, "m 3"], triangles: int
) -> tuple[Float32[Array, "k 3"], Int32[Array, "l 3"]]:
    from fast_simplification import simplify

    found: tuple[Float32[Array, "k 3"], Int32[Array, "l 3"]] = simplify(vertices, faces, target_count=triangles)
    return found


def _collapsed_apart(
    vertices: Float32[Array, "n 3"], faces: Int32[Array, "m 3"], triangles: int
) -> tuple[Float32[Array, "k 3"], Int32[Array, "l 3"]]:
    """The same in a process of its own."""
    given = io.BytesIO()
    for each in (vertices, faces, np.array(triangles)):
        np.save(given, each, allow_pickle=False)
    command = [sys.executable, "-P", "-m", "mammometry.surface.thinning"]
    done = subprocess.run(command, input=given.getbuffer(), stdout=subprocess.PIPE, check=True)
    answer = io.BytesIO(done.stdout)
    return np.load(answer, allow_pickle=False), np.load(answer, allow_pickle=False)


def main() -> None:
    """Thin the mesh of standard input, and write it to standard output."""
    given = io.BytesIO(sys.stdin.buffer.read())
    vertices, faces, triangles = (np.load(given, allow_pickle=False) for _ in range(3))
    for each in _collapsed(vertices, faces, int(triangles)):
        np.save(sys.stdout.buffer, each, allow_pickle=False)


if __name__ == "__main__":
    main()
