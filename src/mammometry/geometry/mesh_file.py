"""Triangles out of other people's mesh files: PLY, OBJ, STL, GLB. Which unit they are in, no such reader knows."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from mammometry.errors import SessionError
from mammometry.geometry.arrays import Array, Float64, Int32, UInt8

_GREY = 128


def read_triangles(path: Path) -> tuple[Float64[Array, "n 3"], Int32[Array, "m 3"], UInt8[Array, "n 3"]]:
    """Vertices, faces and colours as they stand in a mesh file; vertices in one place made one, empty faces dropped.

    Raises:
        SessionError: the file cannot be read, or holds no triangles or no numbers.
    """
    import trimesh

    if not path.is_file():
        raise _refused(path, "no such file", "a mesh as PLY, OBJ, STL or GLB", "Check the path")
    try:
        loaded: Any = trimesh.load(path, process=False, force="mesh", skip_materials=True)
        vertices = np.asarray(loaded.vertices, dtype=np.float64).reshape(-1, 3)
        faces = np.asarray(loaded.faces, dtype=np.int64).reshape(-1, 3)
        colours = _colours(loaded, len(vertices))
    except Exception as error:  # the readers raise anything that a damaged file makes them stumble over
        said = (str(error) or type(error).__name__).splitlines()[0]
        raise _refused(
            path, f"a file that cannot be read ({said})", "a mesh as PLY, OBJ, STL or GLB", "Export it anew"
        ) from None
    if not len(faces):
        raise _refused(path, "no triangles", "a triangulated surface", "Export it with its faces, not as points")
    if faces.min() < 0 or faces.max() >= len(vertices):
        raise _refused(path, "faces of vertices that are not there", "a whole mesh", "Export it anew")
    if not np.isfinite(vertices[faces]).all():
        raise _refused(path, "coordinates that are not finite", "numbers", "Export it anew")
    _, first, place = np.unique(vertices, axis=0, return_index=True, return_inverse=True)
    faces = place.reshape(-1)[faces]
    different = (faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])
    faces = faces[different]
    if not len(faces):
        raise _refused(path, "no triangle with an area", "a triangulated surface", "Export it anew")
    used, compact = np.unique(faces, return_inverse=True)
    return vertices[first[used]], compact.reshape(-1, 3).astype(np.int32), colours[first[used]]


def _colours(loaded: Any, count: int) -> UInt8[Array, "n 3"]:
    found = getattr(getattr(loaded, "visual", None), "kind", None)
    if found == "vertex":
        return np.asarray(loaded.visual.vertex_colors, dtype=np.uint8)[:, :3].copy()
    return np.full((count, 3), _GREY, dtype=np.uint8)


def _refused(path: Path, found: str, expected: str, remedy: str) -> SessionError:
    return SessionError(str(path), found=found, expected=expected, remedy=remedy)
