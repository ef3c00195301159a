"""Topology of a closed mesh: its largest part, and its tunnels."""

from __future__ import annotations

import numpy as np

from mammometry.geometry import mesh_kernels
from mammometry.geometry.arrays import Array, Float64, bounds
from mammometry.geometry.mesh import TriangleMesh


def largest_part(mesh: TriangleMesh) -> TriangleMesh:
    """Return the connected part that encloses the largest volume.

    This drops crumbs, and also cavities, whose volume is negative.
    """
    count, label = mesh.components()
    if count <= 1:
        return mesh
    volumes = mesh_kernels.part_volumes(mesh.vertices, mesh.faces, label, count)
    return mesh.submesh(label[mesh.faces[:, 0]] == np.argmax(volumes))


def tunnel_places(mesh: TriangleMesh, cell_mm: float) -> Float64[Array, "n 3"]:
    """Places of the tunnels and handles of a closed mesh, mm.

    They are cells whose total curvature is that of a handle. By Gauss and Bonnet the angles missing from 2π at the
    vertices sum to 2π·(V − E + F); a handle takes 4π, which no saddle of a body does within a cell a few millimetres
    wide.
    """
    defect = mesh_kernels.angle_defects(mesh.vertices, mesh.faces)
    low, _ = bounds(mesh.vertices)
    cell = tuple(((mesh.vertices - low) / cell_mm).astype(np.int64).T)
    shape = tuple(int(axis.max()) + 1 for axis in cell)
    total = np.bincount(np.ravel_multi_index(cell, shape), defect)
    found = np.stack(np.unravel_index(np.flatnonzero(total < -np.pi), shape), axis=1)
    return low + (found + 0.5) * cell_mm
