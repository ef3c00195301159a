"""A part cut out again along curves near its first one.

Only a band of skin around the curve is looked at. The part is the same, bit by bit, as if the whole mesh had been cut.
"""

from __future__ import annotations

import numpy as np

from mammometry.geometry import mesh_kernels
from mammometry.geometry.arrays import Array, Bool, Int64
from mammometry.geometry.mesh import TriangleMesh
from mammometry.geometry.nearest import point_tree
from mammometry.measure.solid.cut import OpenPart, faces_inside, inside_curve, open_part, sides_on


class Band:
    """The skin around a curve along which a mesh was cut.

    Args:
        mesh: a closed mesh, mm.
        curve: vertices of the closed curve, as for `inside_curve`.
        reach_mm: how far the band reaches to both sides.
    """

    def __init__(self, mesh: TriangleMesh, curve: Int64[Array, " n"], reach_mm: float) -> None:
        points = mesh.vertices[curve]
        box = mesh.vertices_between(points.min(axis=0) - reach_mm, points.max(axis=0) + reach_mm)
        away = np.asarray(point_tree(points).query(mesh.vertices[box], distance_upper_bound=reach_mm)[0])
        close = np.zeros(len(mesh.vertices), dtype=bool)
        close[box[np.isfinite(away)]] = True
        self._whole, self._inside = mesh, faces_inside(mesh, curve)
        in_band = mesh.faces_within(close)
        self._faces = np.flatnonzero(in_band)
        self._vertices = np.flatnonzero(mesh.vertices_used_by(self._faces))
        self.mesh = mesh.submesh(self._faces)
        """The band alone, open, mm."""
        self._core = self._inside & ~in_band
        self._at_core = self._beside(self._core)
        self._at_rest = self._beside(~self._inside & ~in_band)
        self._rings = mesh_kernels.edge_rings(len(self.mesh.vertices), self.mesh.faces)

    def inside(self, curve: Int64[Array, " k"]) -> OpenPart:
        """Keep the part inside another curve.

        Args:
            curve: vertices of `mesh`, the band, in order.
        """
        walls = sides_on(self.mesh, curve)
        count, part = mesh_kernels.face_parts(self._rings, walls)
        core, rest, touching = (np.zeros(count, dtype=bool) for _ in range(3))
        core[part[self._at_core]] = rest[part[self._at_rest]] = True
        touching[part[np.flatnonzero(walls) // 3]] = True
        if (core & rest).any() or (core & touching).sum() != 1 or (rest & touching).sum() != 1 or touching.sum() != 2:
            return inside_curve(self._whole, self._vertices[curve])  # the band alone does not tell
        faces = self._core.copy()
        faces[self._faces] = core[part] | (~rest[part] & self._inside[self._faces])
        return open_part(self._whole, faces, self._vertices[curve])

    def _beside(self, faces: Bool[Array, " m"]) -> Bool[Array, " b"]:
        """Which of the band's faces share a vertex with others outside it."""
        near = self._whole.vertices_used_by(faces)[self._vertices]
        a, b, c = self.mesh.faces.T
        return np.asarray(near[a] | near[b] | near[c])
