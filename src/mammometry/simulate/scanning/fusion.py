"""Fuse depth pictures into one open surface, as telephones do (Curless and Levoy 1996)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mammometry.geometry.arrays import Array, Float64
from mammometry.geometry.mesh import TriangleMesh
from mammometry.simulate.scanning.depth_camera import DepthPicture
from mammometry.simulate.scanning.fusion_kernels import add_picture
from mammometry.surface.fusion.marching import march

_TRUNCATION_CUBES = 4.0  # as voxel grids of telephones have; ARKit's and Open3D's samples: 3 to 5
_MARGIN_CUBES = 3  # around the body, so that the level never meets the grid's edge
_OFF_LEVEL = 1e-3  # share of a cube by which a value of 0 is moved, since marching cubes wants none
_LEAST_WEIGHT = 0.5  # of a corner: about one picture that looks at it nearly straight


def fuse(
    pictures: Sequence[DepthPicture], low: Float64[Array, 3], high: Float64[Array, 3], cube_mm: float
) -> TriangleMesh:
    """Fuse depth pictures on a grid of cubes, and return the largest piece of the surface.

    Args:
        pictures: with the places at which the telephone believes that it took them.
        low: lower corner of the box that is scanned, mm.
        high: its upper corner, mm.
        cube_mm: edge of a cube.
    """
    origin = low - _MARGIN_CUBES * cube_mm
    shape = tuple((np.ceil((high - origin) / cube_mm) + _MARGIN_CUBES + 1).astype(int))
    total, weight = np.zeros(shape, dtype=np.float32), np.zeros(shape, dtype=np.float32)
    for picture in pictures:
        camera = picture.camera_from_world
        matrix = np.column_stack([camera.rotation * cube_mm, camera.apply(origin[None])[0]])
        add_picture(
            total, weight, picture.depth_mm, picture.trust, np.ascontiguousarray(matrix), picture.focal_px,
            _TRUNCATION_CUBES * cube_mm,
        )  # fmt: skip
    seen = weight > _LEAST_WEIGHT
    field = np.where(seen, total / np.maximum(weight, 1e-6), np.float32(_TRUNCATION_CUBES * cube_mm))
    off = np.float32(_OFF_LEVEL * cube_mm)
    field = np.where(np.abs(field) < off, np.where(field < 0, -off, off), field)
    cells = np.ones(tuple(n - 1 for n in shape), dtype=bool)
    for corner in np.ndindex(2, 2, 2):
        cells &= seen[tuple(slice(c, n - 1 + c) for c, n in zip(corner, shape, strict=True))]
    vertices, faces = march(field, cells)
    mesh = TriangleMesh(vertices=origin + cube_mm * vertices, faces=faces)
    _, label = mesh.components()
    return mesh.submesh(label[mesh.faces[:, 0]] == np.argmax(np.bincount(label[mesh.faces[:, 0]])))
