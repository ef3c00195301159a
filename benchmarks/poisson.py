"""Screened Poisson reconstruction on a regular grid, a rival for comparison only (Kazhdan and Hoppe 2013).

The indicator χ of the solid, −½ inside and ½ outside, has the samples' normals for its gradient and is 0 at them: it
minimises ∫|∇χ − V|² + α Σ aₚ χ(p)², with V = Σ aₚ nₚ K(x − p), aₚ the area for which a sample stands, K trilinear.
The paper's octree is replaced by a grid and conjugate gradients, preconditioned by the cosine transform.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.fft import dctn, idctn
from skimage.measure import marching_cubes

from mammometry.geometry.arrays import Array
from mammometry.geometry.mesh import TriangleMesh
from mammometry.surface.fusion.fuse import largest_part
from mammometry.surface.ranges.range_image import RangeImage
from mammometry.surface.ranges.visibility import gap_mm

_AROUND_MM = 25.0
_SAME_MM = 1.0
_TOLERANCE, _ITERATIONS = 1e-3, 60


def screened_poisson(
    range_images: Sequence[RangeImage], *, spacing_mm: float = 0.8, alpha_per_mm: float = 2.0
) -> TriangleMesh:
    """Surface of all range data, closed where they end as smoothly as may be; world frame, mm."""
    points, normals, areas = samples(range_images)
    low = points.min(axis=0) - _AROUND_MM
    shape = tuple((np.ceil((points.max(axis=0) + _AROUND_MM - low) / spacing_mm)).astype(int) + 1)
    at = (points - low) / spacing_mm
    density = areas / spacing_mm**3
    sheet = splatted(at, density, shape)
    divergence = np.zeros(shape, dtype=np.float32)
    for axis in range(3):
        field = splatted(at, density * normals[:, axis], shape)
        divergence += np.gradient(field, spacing_mm, axis=axis, edge_order=1).astype(np.float32)
    indicator = solved(alpha_per_mm * sheet, -divergence, spacing_mm)
    for axis in range(3):  # what the data leave open is closed at the box
        np.moveaxis(indicator, axis, 0)[[0, -1]] = 0.5
    vertices, faces = marching_cubes(indicator, 0.0, gradient_direction="descent")[:2]  # type: ignore[no-untyped-call]
    mesh = TriangleMesh(vertices=low + vertices.astype(np.float64) * spacing_mm, faces=faces.astype(np.int32))
    return largest_part(mesh)


def samples(range_images: Sequence[RangeImage]) -> tuple[Array, Array, Array]:
    """Points, outward normals, and the area in mm² for which each stands, shared among the views that see it."""
    points, normals, areas = [], [], []
    for image in range_images:
        normal = image.normals_world()[image.valid]
        known = np.isfinite(normal[:, 0])
        own = image.valid_points_world()[known]
        towards = image.camera.centre_world - own
        distance = np.linalg.norm(towards, axis=1)
        cosine = np.clip(np.einsum("ij,ij->i", towards, normal[known]) / distance, 0.1, 1.0)
        sharing = np.ones(len(own))
        for other in range_images:
            if other is not image:
                with np.errstate(invalid="ignore"):
                    sharing += np.abs(gap_mm(own, other)) < _SAME_MM
        focal = image.camera.matrix[0, 0] * image.camera.matrix[1, 1]
        points.append(own)
        normals.append(normal[known])
        areas.append(distance**2 / focal / cosine / sharing)
    return np.concatenate(points), np.concatenate(normals), np.concatenate(areas)


def splatted(at: Array, values: Array, shape: tuple[int, ...]) -> Array:
    """Values shared trilinearly among the grid's eight corners around each place."""
    first = np.floor(at).astype(np.int64)
    part = at - first
    total = np.zeros(int(np.prod(shape)))
    for corner in np.ndindex(2, 2, 2):
        share = np.prod(np.where(corner, part, 1 - part), axis=1)
        flat = np.ravel_multi_index(tuple((first + corner).T), shape)
        total += np.bincount(flat, share * values, minlength=len(total))
    return total.reshape(shape).astype(np.float32)


def solved(screen: Array, right: Array, spacing_mm: float) -> Array:
    """χ of (−Δ + screen) χ = right; nothing flows through the box's sides."""
    eigenvalues = sum(
        ((2 - 2 * np.cos(np.pi * np.arange(n) / n)) / spacing_mm**2).reshape(
            [-1 if axis == k else 1 for axis in range(3)]
        )
        for k, n in enumerate(screen.shape)
    )
    scale = (1.0 / (eigenvalues + float(screen.mean()))).astype(np.float32)

    def applied(x: Array) -> Array:
        result = screen * x
        for axis in range(3):
            step = np.diff(x, axis=axis) / spacing_mm**2
            result += np.diff(np.pad(-step, [(1, 1) if k == axis else (0, 0) for k in range(3)]), axis=axis)
        return result

    x = np.zeros_like(right)
    residual = right.copy()
    z = idctn(scale * dctn(residual))
    direction, rz = z.copy(), float(np.vdot(residual, z))
    goal = _TOLERANCE**2 * rz
    for _ in range(_ITERATIONS):
        image = applied(direction)
        step = np.float32(rz / float(np.vdot(direction, image)))
        x += step * direction
        residual -= step * image
        z = idctn(scale * dctn(residual))
        rz, before = float(np.vdot(residual, z)), rz
        if rz < goal:
            break
        direction = z + np.float32(rz / before) * direction
    return x
