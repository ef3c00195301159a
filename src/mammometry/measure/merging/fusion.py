"""Fuse registered scans in one signed distance field, and record which scan shows each vertex."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import binary_dilation

from mammometry.base.value import value
from mammometry.geometry import Array, Bool, Float64, Int64, TriangleMesh, UInt8
from mammometry.geometry.nearest import barycentric, closest_on_mesh, point_tree
from mammometry.measure.merging.registration import edge_distance_mm
from mammometry.measure.scan_repair import largest_part
from mammometry.surface.fusion.marching import march

_CUBE_MM = (1.0, 2.0)  # least and greatest edge of the field's cubes
_CUBE_PER_EDGE = 0.7  # edge of a cube between these limits, relative to the finest mesh's median edge
_MOST_CORNERS = 60_000_000  # most corners of the grid, 0.5 GB; larger bodies get larger cubes
_BAND_CUBES = 3.0  # distance from a scan up to which the field is computed, in cubes
_MARGIN_CUBES = 5  # margin of the grid around the scans, so that the surface never reaches its border
_TAPER_MM = 25.0
"""Distance from a scan's edge over which its weight rises from 0 to 1, mm. Skin near an edge is seen at a grazing angle
and is the least certain. The taper also avoids a step at the seam where the scans differ."""
_SAME_SKIN_MM = 6.0  # largest distance between nearest points of two scans on the same skin
_FACING = 0.3  # least cosine between normals of the same skin (73°)
_STRAIGHT = 0.5  # least cosine between the offset to the nearest point and its normal; below it the point is on an edge
_LEAST_WEIGHT = 1e-6  # weight of skin at a scan's edge, so that it counts where no other scan shows it
_LEAST_SHARE = 0.05  # share of the weight from which a scan counts as showing a vertex
_OFF_LEVEL = 1e-3  # least absolute value of the field, in cubes: marching cubes need a sign


@value(eq=False)
class ColouredMesh:
    """A scan's mesh and its colours."""

    mesh: TriangleMesh
    """mm, faces outwards."""
    colours: UInt8[Array, "n 3"]
    """sRGB of each vertex."""


@value(eq=False)
class FusedScans:
    """Several scans as one mesh."""

    mesh: TriangleMesh
    """One connected surface, open where no scan shows skin, mm, in the scans' common frame."""
    sources: UInt8[Array, " n"]
    """Scans that show each vertex, as bits: 1 the first, 2 the second, 3 both, 4 the third."""
    colours: UInt8[Array, "n 3"]
    """sRGB of each vertex."""


@dataclass(frozen=True, slots=True, kw_only=True)
class _ScanView:
    """Signed distances of points from one scan."""

    seen: Bool[Array, " n"]
    """Whether the scan shows the nearest skin."""
    distance_mm: Float64[Array, " n"]
    """Signed, positive outside."""
    weight: Float64[Array, " n"]
    closest: Float64[Array, "n 3"]
    outward: Float64[Array, "n 3"]


def fuse_scans(scans: Sequence[ColouredMesh]) -> FusedScans:
    """One mesh of several scans in the same frame.

    Where several show the same skin, the result is the mean of their signed distances, each weighted by the distance
    from its scan's edge. Where none shows skin, the mesh is open.

    Args:
        scans: at most eight.
    """
    meshes = [scan.mesh for scan in scans]
    low = np.min([mesh.vertices.min(axis=0) for mesh in meshes], axis=0)
    size = np.max([mesh.vertices.max(axis=0) for mesh in meshes], axis=0) - low
    cube_mm = max(_cube_mm(meshes), float((np.prod(size) / _MOST_CORNERS) ** (1 / 3)))
    origin = low - _MARGIN_CUBES * cube_mm
    shape = tuple((np.ceil(size / cube_mm) + 2 * _MARGIN_CUBES + 1).astype(int).tolist())
    near = _near(meshes, origin, cube_mm, shape)
    points = origin + cube_mm * np.stack(np.unravel_index(near, shape), axis=1)
    band_mm = _BAND_CUBES * cube_mm
    known, distance_mm = _fused([_view(points, mesh, band_mm) for mesh in meshes])
    off_mm = _OFF_LEVEL * cube_mm
    distance_mm = np.where(np.abs(distance_mm) < off_mm, np.where(distance_mm < 0, -off_mm, off_mm), distance_mm)
    field = np.full(shape, band_mm, dtype=np.float32)
    seen = np.zeros(shape, dtype=bool)
    field.ravel()[near] = np.where(known, distance_mm, band_mm)
    seen.ravel()[near] = known
    vertices, faces = march(field, _whole_cells(seen))
    mesh = largest_part(TriangleMesh(vertices=origin + cube_mm * vertices, faces=faces))
    return _with_sources(mesh, scans)


def _cube_mm(meshes: Sequence[TriangleMesh]) -> float:
    """Edge of the field's cubes, mm."""
    edges = []
    for mesh in meshes:
        ends = mesh.vertices[mesh.edges()]
        edges.append(float(np.median(np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1))))
    return float(np.clip(_CUBE_PER_EDGE * min(edges), *_CUBE_MM))


def _near(
    meshes: Sequence[TriangleMesh], origin: Float64[Array, 3], cube_mm: float, shape: tuple[int, ...]
) -> Int64[Array, " k"]:
    """Flat indices of the grid's corners within the band around any scan."""
    marked = np.zeros(shape, dtype=bool)
    for mesh in meshes:
        corners = mesh.corners()
        longest = float(np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max())
        steps = int(np.ceil(longest / cube_mm)) + 1
        for i in range(steps + 1):
            for j in range(steps + 1 - i):
                share = np.array([i, j, steps - i - j]) / steps
                cells = np.rint((np.einsum("k,fkx->fx", share, corners) - origin) / cube_mm).astype(np.int64)
                marked[tuple(cells.T)] = True
    reach = int(np.ceil(_BAND_CUBES)) + 1
    return np.flatnonzero(binary_dilation(marked, iterations=reach))


def _view(points: Float64[Array, "n 3"], mesh: TriangleMesh, band_mm: float) -> _ScanView:
    """Signed distances of points from one scan."""
    closest = closest_on_mesh(points, mesh)
    faces = mesh.faces[closest.faces]
    shares = barycentric(closest.points, mesh.vertices[faces])
    outward = np.einsum("nk,nkx->nx", shares, mesh.vertex_normals()[faces])
    outward /= np.maximum(np.linalg.norm(outward, axis=1, keepdims=True), 1e-12)
    away = points - closest.points
    along = (away * outward).sum(axis=1)
    edge_mm = edge_distance_mm(closest.points, mesh)
    straight = np.abs(along) > _STRAIGHT * closest.distances_mm
    return _ScanView(
        seen=(closest.distances_mm < band_mm) & (straight | (closest.distances_mm < 1e-9)) & (edge_mm > 0),
        distance_mm=np.where(along < 0, -1.0, 1.0) * closest.distances_mm,
        weight=np.clip(edge_mm / _TAPER_MM, _LEAST_WEIGHT, 1.0),
        closest=closest.points,
        outward=outward,
    )


def _fused(views: Sequence[_ScanView]) -> tuple[Bool[Array, " n"], Float64[Array, " n"]]:
    """Whether any scan shows skin, and the weighted mean signed distance from the nearest skin, mm."""
    every = np.arange(len(views[0].seen))
    distances = np.array([np.where(view.seen, np.abs(view.distance_mm), np.inf) for view in views])
    nearest = np.argmin(distances, axis=0)
    closest = np.array([view.closest for view in views])[nearest, every]
    outward = np.array([view.outward for view in views])[nearest, every]
    total, weights = np.zeros(len(every)), np.zeros(len(every))
    for view in views:
        same = np.linalg.norm(view.closest - closest, axis=1) < _SAME_SKIN_MM
        same &= (view.outward * outward).sum(axis=1) > _FACING
        weight = np.where(view.seen & same, view.weight, 0.0)
        total += weight * view.distance_mm
        weights += weight
    return np.isfinite(distances.min(axis=0)), total / np.maximum(weights, 1e-12)


def _whole_cells(seen: Bool[Array, "x y z"]) -> Bool[Array, "i j k"]:
    """Cells whose eight corners are known."""
    cells = np.ones(tuple(n - 1 for n in seen.shape), dtype=bool)
    for corner in np.ndindex(2, 2, 2):
        cells &= seen[tuple(slice(c, n - 1 + c) for c, n in zip(corner, seen.shape, strict=True))]
    return cells


def _with_sources(mesh: TriangleMesh, scans: Sequence[ColouredMesh]) -> FusedScans:
    """Find the scans that show each vertex of a mesh, and its colour."""
    weights = np.zeros((len(scans), len(mesh.vertices)))
    painted = np.zeros((len(mesh.vertices), 3))
    for own, scan in zip(weights, scans, strict=True):
        closest = closest_on_mesh(mesh.vertices, scan.mesh)
        near = closest.distances_mm < _SAME_SKIN_MM
        own[near] = np.clip(edge_distance_mm(closest.points[near], scan.mesh) / _TAPER_MM, _LEAST_WEIGHT, 1.0)
        nearest = np.asarray(point_tree(scan.mesh.vertices).query(mesh.vertices)[1])
        painted += own[:, None] * scan.colours[nearest]
    shares = weights / np.maximum(weights.sum(axis=0), 1e-12)
    bits = (shares > _LEAST_SHARE).T @ (1 << np.arange(len(scans)))
    colours = np.round(painted / np.maximum(weights.sum(axis=0), 1e-12)[:, None])
    return FusedScans(mesh=mesh, sources=bits.astype(np.uint8), colours=colours.clip(0, 255).astype(np.uint8))
