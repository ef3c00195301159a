"""Meshes of objects in the frame of the given points: bars, sheets, boxes, cloth around a body.

All sizes here are made up; no measurement uses them.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from embreex.mesh_construction import TriangleMesh as EmbreeMesh
from embreex.rtcore_scene import EmbreeScene
from numpy.typing import ArrayLike
from scipy.spatial import ConvexHull

from mammometry.geometry import Array, Float64, Int32, TriangleMesh
from mammometry.simulate.rendering.props import Props

_NOT_FOUND_MM = 150.0  # radius assumed if a ray from the axis hits no skin, as beyond the ends of a body, mm
_BOX_STEP_MM, _AROUND_CLOTH = 40.0, 180  # edge length on a box's faces, and points around the trunk


def bar(line: Float64[Array, "j 3"], radius_mm: float | Sequence[float], sides: int = 16) -> Props:
    """Round bar along a line, with closed ends. One radius for each point, or one for all."""
    radius = np.broadcast_to(np.asarray(radius_mm, dtype=np.float64), len(line))
    along = np.gradient(line, axis=0)
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    across = np.cross(along[0], [0.31, 0.52, 0.79])
    frames = []
    for direction in along:  # propagates the frame without twist
        across = across - across @ direction * direction
        across = across / np.linalg.norm(across)
        frames.append((across, np.cross(direction, across)))
    angle = np.arange(sides) * (2.0 * math.pi / sides)
    normals = np.array([np.cos(angle)[:, None] * a + np.sin(angle)[:, None] * b for a, b in frames])
    rings = line[:, None] + radius[:, None, None] * normals
    vertices = np.concatenate([rings.reshape(-1, 3), line[[0, -1]]])
    ring, end = np.arange(sides), (len(line) - 1) * sides + np.arange(sides)
    first, last = np.full(sides, len(line) * sides), np.full(sides, len(line) * sides + 1)
    faces = [
        _around(len(line), sides),
        np.stack([first, np.roll(ring, -1), ring], axis=1),
        np.stack([last, end, np.roll(end, -1)], axis=1),
    ]
    return _props(vertices, np.concatenate([normals.reshape(-1, 3), [-along[0], along[-1]]]), np.concatenate(faces))


def straight(start: ArrayLike, end: ArrayLike, step_mm: float = 15.0) -> Float64[Array, "j 3"]:
    """Points between two points."""
    first, way = np.asarray(start, dtype=np.float64), np.subtract(end, start)
    share = np.linspace(0.0, 1.0, max(2, math.ceil(float(np.linalg.norm(way)) / step_mm) + 1))
    points: Float64[Array, "j 3"] = first + share[:, None] * way
    return points


def sheet(middle: ArrayLike, right: ArrayLike, up: ArrayLike, step_mm: float = 30.0) -> Props:
    """Flat sheet spanned by `right` and `up`, centred on its middle. It faces right × up."""
    a, b = np.asarray(right, dtype=np.float64), np.asarray(up, dtype=np.float64)
    columns, rows = (max(1, math.ceil(2.0 * float(np.linalg.norm(side)) / step_mm)) for side in (a, b))
    s, t = np.meshgrid(np.linspace(-1.0, 1.0, columns + 1), np.linspace(-1.0, 1.0, rows + 1))
    vertices = np.asarray(middle) + s.ravel()[:, None] * a + t.ravel()[:, None] * b
    normal = np.cross(a, b)
    normals = np.broadcast_to(normal / np.linalg.norm(normal), vertices.shape)
    row, column = (grid.ravel() for grid in np.meshgrid(np.arange(rows), np.arange(columns), indexing="ij"))
    corner = row * (columns + 1) + column
    beside, above = corner + 1, corner + columns + 1
    faces = [np.stack([corner, beside, above + 1], axis=1), np.stack([corner, above + 1, above], axis=1)]
    return _props(vertices, normals, np.concatenate(faces))


def box(middle: ArrayLike, size: ArrayLike) -> Props:
    """Box along the axes."""
    sides = []
    for axis in range(3):
        out, right, up = (0.5 * np.asarray(size)[k % 3] * np.eye(3)[k % 3] for k in (axis, axis + 1, axis + 2))
        sides += [sheet(np.asarray(middle) + sign * out, sign * right, up, _BOX_STEP_MM) for sign in (1.0, -1.0)]
    return together(sides)


def ball(middle: ArrayLike, radius_mm: float) -> Props:
    """Ball with few faces."""
    height = np.linspace(-0.5 * math.pi, 0.5 * math.pi, 13)
    line = np.asarray(middle) + radius_mm * np.stack([np.zeros(13), np.sin(height), np.zeros(13)], axis=1)
    return bar(line, (radius_mm * np.maximum(np.cos(height), 0.02)).tolist(), sides=20)


def together(pieces: Sequence[Props]) -> Props:
    """Several meshes as one. Each keeps the numbers of its materials."""
    starts = np.cumsum([0, *(len(piece.vertices) for piece in pieces[:-1])])
    faces = [piece.faces + start for piece, start in zip(pieces, starts, strict=True)]
    return Props(
        vertices=np.concatenate([piece.vertices for piece in pieces]),
        normals=np.concatenate([piece.normals for piece in pieces]),
        faces=np.concatenate(faces).astype(np.int32),
        material=np.concatenate([piece.material for piece in pieces]),
    )


def merged(pieces: Sequence[Props]) -> TriangleMesh:
    """Several meshes as one, without colours."""
    whole = together(pieces)
    return TriangleMesh(vertices=whole.vertices, faces=whole.faces)


class Outside:
    """The skin of a body, y up, on which cloth is placed."""

    def __init__(self, mesh: TriangleMesh) -> None:
        self.mesh = mesh
        self._rays = EmbreeScene()
        EmbreeMesh(self._rays, mesh.vertices.astype(np.float32), mesh.faces)

    def radius_mm(self, height_mm: Array, angle_rad: Array, axis_z_mm: float = 0.0) -> Float64[Array, " n"]:
        """Distance of the skin from the point (0, height, axis_z), by angle from straight ahead to the left."""
        height, angle = (np.ravel(array) for array in np.broadcast_arrays(height_mm, angle_rad))
        origins = np.stack([np.zeros(len(height)), height, np.full(len(height), axis_z_mm)], axis=1)
        ahead = np.stack([np.sin(angle), np.zeros(len(height)), np.cos(angle)], axis=1)
        hit = self._rays.run(origins.astype(np.float32), ahead.astype(np.float32), output=True)
        return np.where(hit["primID"] >= 0, hit["tfar"], _NOT_FOUND_MM).astype(np.float64)

    def cloth(self, heights_mm: Float64[Array, " h"], gap_mm: Array) -> Props:
        """Taut cloth around the trunk between two heights, at a fixed distance from its convex hull."""
        angle = np.arange(_AROUND_CLOTH) * (2.0 * math.pi / _AROUND_CLOTH)
        rings = np.array(
            [_hulled(self.radius_mm(np.full(_AROUND_CLOTH, height), angle), angle) for height in heights_mm]
        )
        rings = rings + gap_mm
        x, z = rings * np.sin(angle), rings * np.cos(angle)
        y = np.broadcast_to(np.asarray(heights_mm)[:, None], x.shape)
        mesh = TriangleMesh(
            vertices=np.stack([x, y, z], axis=-1).reshape(-1, 3), faces=_around(len(heights_mm), _AROUND_CLOTH)
        )
        if (mesh.vertex_normals() * mesh.vertices * [1.0, 0.0, 1.0]).sum() < 0:
            mesh = TriangleMesh(vertices=mesh.vertices, faces=mesh.faces[:, ::-1].copy())
        return _props(mesh.vertices, mesh.vertex_normals(), mesh.faces)

    def shell(self, covered: Array, gap_mm: Array) -> Props:
        """Cloth over the faces that are completely covered, at a distance from the skin."""
        chosen = self.mesh.faces[covered[self.mesh.faces].all(axis=1)]
        used = np.unique(chosen)
        gap = np.broadcast_to(gap_mm, len(self.mesh.vertices))[used]
        vertices = self.mesh.vertices[used] + gap[:, None] * self.mesh.vertex_normals()[used]
        new = np.zeros(len(self.mesh.vertices), dtype=np.int32)
        new[used] = np.arange(len(used))
        mesh = TriangleMesh(vertices=vertices, faces=new[chosen])
        return _props(mesh.vertices, mesh.vertex_normals(), mesh.faces)


def _props(vertices: Array, normals: Array, faces: Array) -> Props:
    """A mesh with one material."""
    return Props(
        vertices=np.asarray(vertices, dtype=np.float64),
        normals=np.asarray(normals, dtype=np.float64),
        faces=np.asarray(faces, dtype=np.int32),
        material=np.zeros(len(faces), dtype=np.uint8),
    )


def _hulled(radius_mm: Float64[Array, " a"], angle_rad: Float64[Array, " a"]) -> Float64[Array, " a"]:
    """Radius of a section's convex hull, at the same angles."""
    ahead = np.stack([np.sin(angle_rad), np.cos(angle_rad)], axis=1)
    edges = ConvexHull(radius_mm[:, None] * ahead).equations  # normal · point + offset = 0
    slope = ahead @ edges[:, :2].T
    with np.errstate(divide="ignore"):
        reach = np.where(slope > 1e-9, -edges[:, 2] / slope, np.inf)
    nearest: Float64[Array, " a"] = reach.min(axis=1)
    return nearest


def _around(rings: int, sides: int) -> Int32[Array, "m 3"]:
    """Faces of a tube of rings."""
    ring, side = (grid.ravel() for grid in np.mgrid[0 : rings - 1, 0:sides])
    a, b = ring * sides + side, ring * sides + (side + 1) % sides
    c, d = a + sides, b + sides
    return np.concatenate([np.stack([a, b, d], axis=1), np.stack([a, d, c], axis=1)]).astype(np.int32)
