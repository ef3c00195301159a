"""The covering picture on another mesh of the same surface."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from mammometry.geometry.arrays import Array, Float64, Int32
from mammometry.geometry.mesh import TriangleMesh
from mammometry.geometry.nearest import closest_on_mesh, closest_on_triangles
from mammometry.surface.texture.texture_atlas import Atlas


def transferred(atlas: Atlas, mesh: TriangleMesh) -> Atlas:
    """Cover a mesh with the picture of an atlas.

    A face belongs to the chart of the atlas's face nearest to its middle. Its corners take their places from the faces
    nearest to them, where these belong to the same chart. Other corners, beyond a seam, take the nearest place on the
    middle's face.

    Args:
        atlas: of the viewing mesh.
        mesh: another mesh of the same surface, or a part of it, mm, the same frame.

    Raises:
        ValueError: the atlas's mesh has no faces.
    """
    corners = mesh.corners()
    middle = closest_on_mesh(corners.mean(axis=1), atlas.mesh).faces
    nearest = closest_on_mesh(mesh.vertices, atlas.mesh)
    own = _places(atlas, nearest.faces, nearest.points)[mesh.faces]
    uv_px = np.empty_like(own)
    triangles, chart = atlas.mesh.corners()[middle], _charts(atlas)
    for corner in range(3):
        on_middle = _places(atlas, middle, closest_on_triangles(corners[:, corner], triangles))
        same = chart[nearest.faces[mesh.faces[:, corner]]] == chart[middle]
        uv_px[:, corner] = np.where(same[:, None], own[:, corner], on_middle)
    return replace(atlas, mesh=mesh, uv_px=uv_px.astype(np.float32), view=atlas.view[middle])


def _charts(atlas: Atlas) -> Int32[Array, " m"]:
    """Number of each face's chart: faces that touch one another in the picture, too."""
    origin, faces, _ = atlas.unwelded()
    start, end = faces[:, [0, 1]].ravel(), faces[:, [1, 2]].ravel()
    graph = coo_matrix((np.ones(len(start), dtype=bool), (start, end)), shape=(len(origin), len(origin)))
    chart: Int32[Array, " m"] = connected_components(graph, directed=False)[1][faces[:, 0]]
    return chart


def _places(atlas: Atlas, faces: Array, points: Float64[Array, "n 3"]) -> Float64[Array, "n 2"]:
    """Places in the picture of points on faces, by their barycentric coordinates, pixels."""
    a, b, c = np.moveaxis(atlas.mesh.corners()[faces], 1, 0)
    normal = np.cross(b - a, c - a)
    size = np.maximum(np.einsum("ij,ij->i", normal, normal), 1e-300)
    weights = np.stack(
        [np.einsum("ij,ij->i", np.cross(q - p, points - p), normal) / size for p, q in ((b, c), (c, a), (a, b))]
    )
    found: Float64[Array, "n 2"] = np.einsum("kn,nkj->nj", weights, atlas.uv_px[faces].astype(np.float64))
    return found
