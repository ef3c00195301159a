"""Planar regions of a scan: lids and flat closures made by other programs, which are not skin."""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from mammometry.geometry import Array, Bool, TriangleMesh, mesh_kernels

_EVEN = np.cos(np.deg2rad(0.2))
"""Least cosine between the normals of neighbouring faces of a plane. On skin of 100 mm radius neighbouring 2 mm faces
differ by 1°; coordinates rounded to 0.1 µm change a normal by 0.003°."""
_FLAT_MM, _WIDE_MM = 0.3, 8.0
"""Greatest standard deviation of a plane's faces across it, and least one along its narrower side. A patch of skin of
that size is curved by 1 mm or more; a strip of coarse triangles along a round body is flat but narrow."""
_LEAST_CM2 = 10.0
"""Least area of a lid, cm². Nineteen scans of shared bodies have no plane of 3 cm²."""


def planar_faces(mesh: TriangleMesh) -> Bool[Array, " m"]:
    """Mask of the faces of a mesh, mm, in flat regions that are too large to be skin."""
    vectors = mesh.face_vectors()
    area_mm2 = np.linalg.norm(vectors, axis=1)
    normals = vectors / np.maximum(area_mm2, 1e-12)[:, None]
    rings = mesh_kernels.edge_rings(len(mesh.vertices), mesh.faces).astype(np.int64)
    side = np.flatnonzero(rings > np.arange(len(rings)))
    one, other = side // 3, rings[side] // 3
    even = np.einsum("ij,ij->i", normals[one], normals[other]) > _EVEN
    joined = (np.ones(int(even.sum()), dtype=np.int8), (one[even], other[even]))
    count, region = connected_components(coo_matrix(joined, shape=(len(normals),) * 2), directed=False)
    large = np.flatnonzero(np.bincount(region, area_mm2, minlength=count) / 100 > _LEAST_CM2)
    planar = np.zeros(len(normals), dtype=bool)
    for number in large:
        own = region == number
        corners = mesh.corners()[own].reshape(-1, 3)
        across, narrow, _ = np.linalg.eigvalsh(np.cov(corners.T, aweights=np.repeat(area_mm2[own], 3)))
        if across < _FLAT_MM**2 and narrow > _WIDE_MM**2:
            planar |= own
    return planar
