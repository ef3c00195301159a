"""Twins of a scan with a known truth: its mirror image, another size, another unit.

A mirrored twin has the sides exchanged, a scaled one the cube of the factor, and one in another unit the same volume.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import trimesh

from mammometry.base.units import MM_PER_UNIT
from mammometry.geometry.mesh import TriangleMesh


def mirrored(mesh: TriangleMesh, axis: int = 0) -> TriangleMesh:
    """The mirror image as most programs export it: one coordinate negated, corners in their old order."""
    return replace(mesh, vertices=mesh.vertices * np.where(np.arange(3) == axis, -1.0, 1.0))


def scaled(mesh: TriangleMesh, factor: float) -> TriangleMesh:
    """The scan of a model without scale: every length times a factor."""
    return replace(mesh, vertices=mesh.vertices * factor)


def in_unit(mesh: TriangleMesh, unit: str) -> TriangleMesh:
    """The same scan, its coordinates in another unit than mm."""
    return scaled(mesh, 1.0 / MM_PER_UNIT[unit])


def written(mesh: TriangleMesh, path: Path, comment: str = "") -> Path:
    """A mesh as PLY, OBJ, STL or GLB; a PLY or an OBJ with a comment."""
    trimesh.Trimesh(mesh.vertices, mesh.faces, process=False).export(path)
    if comment:
        content = path.read_bytes()
        marked = {
            ".ply": lambda: content.replace(b" 1.0\n", f" 1.0\ncomment {comment}\n".encode(), 1),
            ".obj": lambda: f"# {comment}\n".encode() + content,
        }[path.suffix]()
        path.write_bytes(marked)
    return path
