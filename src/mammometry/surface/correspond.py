"""Plausible points: for each vertex the closest point of the valid range data, and how alike the surfaces are."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import ndimage
from scipy.spatial import cKDTree

from mammometry.geometry.arrays import Array, Bool, Float32, Float64, Int32
from mammometry.surface.range_image import RangeImage


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ViewData:
    """The valid data of one view, thinned to the mesh's spacing, ready to be searched."""

    tree: cKDTree
    points: Float64[Array, "n 3"]
    normals: Float64[Array, "n 3"]
    sigma_mm: Float64[Array, " n"]
    """Expected standard deviation across the surface, mm."""
    cosine: Float64[Array, " n"]
    """Cosine of the angle between normal and line of sight."""
    spacing_mm: Float64[Array, " n"]
    """Distance to the next datum down the slope, mm."""
    trust: Float64[Array, " n"]
    """0.05 at the edge of the view's data, rising to 1 inside: windows at the edge see past the surface."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Correspondences:
    """For each vertex what the range data say of its place."""

    found: Bool[Array, " n"]
    """The paper's TRUE: a plausible point exists."""
    targets: Float64[Array, "n 3"]
    """ṽ: where the data have the vertex, mm; the vertex itself where nothing was found."""
    similarity: Float64[Array, " n"]
    """ω of Eq. 5, 0…1."""
    sigma_mm: Float32[Array, " n"]
    """Expected standard deviation of the target along the normal, mm; NaN where nothing was found."""
    pair_bits: Int32[Array, " n"]
    """Bit k set: view k has a plausible point."""


def view_data(image: RangeImage, spacing_mm: float, normal_mm: float, taper_mm: float) -> ViewData | None:
    """Thin one view's valid data to about half the mesh's spacing and give each its normal; None without data."""
    if not image.valid.any():
        return None
    stride = max(1, int(0.5 * spacing_mm / image.pixel_mm()))
    normals = image.normals_world(normal_mm)
    chosen = np.zeros(image.valid.shape, dtype=bool)
    chosen[::stride, ::stride] = True
    chosen &= image.valid & np.isfinite(normals[..., 0])
    if not chosen.any():
        return None
    points = image.keeping(chosen).valid_points_world()
    towards = image.camera.centre_world - points
    towards /= np.linalg.norm(towards, axis=1, keepdims=True)
    cosine = np.clip(np.einsum("ij,ij->i", normals[chosen], towards), 0.05, 1.0)
    inside_mm = ndimage.distance_transform_edt(np.pad(image.valid, 1))[1:-1, 1:-1] * image.pixel_mm()
    return ViewData(
        tree=cKDTree(points),
        points=points,
        normals=normals[chosen],
        sigma_mm=image.sigma_mm[chosen] * cosine,
        cosine=cosine,
        spacing_mm=stride * image.pixel_mm() / cosine,
        trust=np.clip(inside_mm[chosen] / max(taper_mm, 1e-6), 0.05, 1.0),
    )


def correspond(
    vertices: Float64[Array, "n 3"],
    normals: Float64[Array, "n 3"],
    views: list[ViewData | None],
    *,
    reach_mm: float,
    normal_angle_rad: float,
    tangential_mm: float,
    similarity_mm: float,
    blend: bool,
    sigma_floor_mm: float,
    workers: int = 2,
) -> Correspondences:
    """Find each vertex's plausible point on the valid range data (ṽ and ω of Eq. 5).

    In each view the nearest datum; plausible when it lies within `reach_mm`, faces the same way within
    `normal_angle_rad` and lies beside the vertex by at most `tangential_mm` (or three quarters of the data's
    spacing, where that is more). The target is the vertex's foot on the datum's tangent plane, the similarity
    ω = cos²(angle between the normals) · exp(−(distance/`similarity_mm`)²), less near the edge of a view's data. Of
    several views the closest counts (the paper), or with `blend` their mean, weighted by cos²/(σ² + floor²).
    """
    n = len(vertices)
    nearest = np.full(n, np.inf)
    total, weight = np.zeros((n, 3)), np.zeros(n)
    similarity, information = np.zeros(n), np.zeros(n)
    bits = np.zeros(n, dtype=np.int32)
    for k, view in enumerate(views):
        if view is None:
            continue
        found_by_tree = view.tree.query(vertices, distance_upper_bound=reach_mm, workers=workers)
        distance, number = np.asarray(found_by_tree[0]), np.asarray(found_by_tree[1])
        index = np.flatnonzero(np.isfinite(distance))
        number = number[index]
        normal = view.normals[number]
        offset = view.points[number] - vertices[index]
        height = np.einsum("ij,ij->i", offset, normal)
        alike = np.einsum("ij,ij->i", normal, normals[index])
        beside2 = np.maximum(distance[index] ** 2 - height**2, 0.0)
        beside_limit = np.maximum(tangential_mm, 0.75 * view.spacing_mm[number])
        plausible = (alike > np.cos(normal_angle_rad)) & (beside2 <= beside_limit**2)
        index, number, height, normal = index[plausible], number[plausible], height[plausible], normal[plausible]
        omega = alike[plausible] ** 2 * np.exp(-((height / similarity_mm) ** 2)) * view.trust[number]
        bits[index] |= np.int32(1 << k)
        variance = view.sigma_mm[number] ** 2 + sigma_floor_mm**2
        information[index] += 1.0 / variance
        if blend:
            share = view.cosine[number] ** 2 * view.trust[number] / variance
            total[index] += (share * height)[:, None] * normal
            weight[index] += share
            similarity[index] += share * omega
        else:
            closer = distance[index] < nearest[index]
            index = index[closer]
            nearest[index] = distance[index]
            total[index] = height[closer][:, None] * normal[closer]
            weight[index] = 1.0
            similarity[index] = omega[closer]
    found = weight > 0
    share = np.where(found, weight, 1.0)
    with np.errstate(divide="ignore"):
        sigma = np.where(found, 1.0 / np.sqrt(information), np.nan)
    return Correspondences(
        found=found,
        targets=vertices + total / share[:, None],
        similarity=similarity / share,
        sigma_mm=sigma.astype(np.float32),
        pair_bits=bits,
    )
