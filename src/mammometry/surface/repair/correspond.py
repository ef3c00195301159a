"""Plausible points: closest valid datum of each vertex, and similarity."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mammometry.base.machine.cores import in_bands
from mammometry.geometry import Array, Bool, Camera, Float32, Float64, Int32, Int64
from mammometry.surface.ranges import image_kernels
from mammometry.surface.ranges.range_image import NORMAL_MM, SIGMA_FLOOR_MM, RangeImage, thinned_camera
from mammometry.surface.repair import elastic_kernels
from mammometry.surface.settings import TAPER_MM

_SPACINGS = 0.5  # between data, in spacings of the mesh; chosen by eye
_BESIDE_SPACINGS = 0.75  # a datum's own ground: half a spacing each way, and its diagonal
_LEAST_COSINE = 0.05  # 87°: a smaller cosine would divide the spacing to infinity


@dataclass(frozen=True, slots=True, kw_only=True)
class Gates:
    """Limits of plausible data for a vertex: the constants of `repair` of the same names."""

    reach_mm: float
    normal_angle_deg: float
    tangential_mm: float
    similarity_mm: float
    blend: bool
    """Whether the target is the mean of all views' plausible points, not the closest one."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ViewData:
    """Valid data of one view for searching, thinned to the mesh's spacing."""

    camera: Camera
    """The view's. The pixels are those of the thinned data."""
    points: Float32[Array, "h w 3"]
    """Camera frame, mm. NaN where there is no datum."""
    normals: Float32[Array, "h w 3"]
    """Towards the camera, camera frame."""
    rows: Int32[Array, "h w"]
    columns: Int32[Array, "h w"]
    """The datum nearest to each pixel."""
    sigma_mm: Float32[Array, "h w"]
    """Expected standard deviation across the surface, mm."""
    cosine: Float32[Array, "h w"]
    """Cosine of the angle between normal and line of sight."""
    spacing_mm: float
    """Between data that face the camera, mm."""
    trust: Float32[Array, "h w"]
    """0.05 at the edge of the view's data, rising to 1 inside, since windows at the edge see past the surface."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Correspondences:
    """For each vertex what the range data say of its place."""

    found: Bool[Array, " n"]
    """The paper's TRUE: a plausible point exists."""
    targets: Float64[Array, "n 3"]
    """ṽ: place of the vertex according to the data, mm. The vertex itself if nothing was found."""
    similarity: Float64[Array, " n"]
    """ω of Eq. 5, 0…1."""
    sigma_mm: Float32[Array, " n"]
    """Expected standard deviation of the target along the normal, mm. NaN if nothing was found."""
    pair_bits: Int32[Array, " n"]
    """Bit k set: view k has a plausible point."""


def view_data(
    image: RangeImage, spacing_mm: float, normal_mm: float = NORMAL_MM, taper_mm: float = TAPER_MM
) -> ViewData | None:
    """Valid data of a view, thinned and with normals. None without data.

    The spacing is about half the mesh's.
    """
    if not image.valid.any():
        return None
    stride = max(1, int(_SPACINGS * spacing_mm / image.pixel_mm()))
    thin = (slice(None, None, stride), slice(None, None, stride))
    normals = np.ascontiguousarray(image.normals_camera(normal_mm)[thin])
    camera = thinned_camera(image.camera, stride)
    known = image.valid[thin] & np.isfinite(normals[..., 0])
    if not known.any():
        return None
    intrinsics = camera.intrinsics
    cosine = np.clip(image_kernels.incidence_cosines(normals, intrinsics), np.float32(_LEAST_COSINE), np.float32(1.0))
    rows, columns = image_kernels.nearest_true(known)
    return ViewData(
        camera=camera,
        points=image_kernels.camera_points(np.ascontiguousarray(image.range_mm[thin]), known, intrinsics),
        normals=normals,
        rows=rows,
        columns=columns,
        sigma_mm=image.sigma_mm[thin] * cosine,
        cosine=cosine,
        spacing_mm=stride * image.pixel_mm(),
        trust=image.trust(taper_mm)[thin],
    )


def correspond(
    vertices: Float64[Array, "n 3"], normals: Float64[Array, "n 3"], views: list[ViewData | None], gates: Gates
) -> Correspondences:
    """Each vertex's plausible point on the valid range data.

    ṽ and ω of Eq. 5. In each view the nearest datum; plausible when it lies within `reach_mm`, faces the same way
    within `normal_angle_deg` and lies beside the vertex by at most `tangential_mm` (or three quarters of the data's
    spacing, where that is more). The target is the vertex's foot on the datum's tangent plane, the similarity ω =
    cos²(angle between the normals) · exp(−(distance/`similarity_mm`)²), less near the edge of a view's data. Of
    several views the closest counts (the paper), or with `blend` their mean, weighted by cos²/(σ² + floor²).
    """

    def of(band: slice) -> Correspondences:
        return _correspond(vertices[band], normals[band], views, gates)

    parts = in_bands(of, len(vertices))
    fields = ("found", "targets", "similarity", "sigma_mm", "pair_bits")
    return Correspondences(**{field: np.concatenate([getattr(part, field) for part in parts]) for field in fields})


def _correspond(
    vertices: Float64[Array, "n 3"], normals: Float64[Array, "n 3"], views: list[ViewData | None], gates: Gates
) -> Correspondences:
    """Correspondences of some vertices."""
    n = len(vertices)
    nearest = np.full(n, np.inf)
    total, weight = np.zeros((n, 3)), np.zeros(n)
    similarity, information = np.zeros(n), np.zeros(n)
    bits = np.zeros(n, dtype=np.int32)
    for k, view in enumerate(views):
        if view is None:
            continue
        number = _nearest(vertices, view, gates.reach_mm)
        index = np.flatnonzero(number >= 0)
        number = number[index]
        rotation = view.camera.camera_from_world.rotation
        normal = _at(view.normals, number).astype(np.float64) @ rotation
        offset = view.camera.centre_world + _at(view.points, number).astype(np.float64) @ rotation - vertices[index]
        height = np.einsum("ij,ij->i", offset, normal)
        alike = np.einsum("ij,ij->i", normal, normals[index])
        beside2 = np.einsum("ij,ij->i", offset, offset) - height**2
        beside_limit = np.maximum(gates.tangential_mm, _BESIDE_SPACINGS * view.spacing_mm / _at(view.cosine, number))
        plausible = (alike > np.cos(float(np.radians(gates.normal_angle_deg)))) & (beside2 <= beside_limit**2)
        index, number, height, normal = index[plausible], number[plausible], height[plausible], normal[plausible]
        beside2, trust = beside2[plausible], _at(view.trust, number)
        omega = alike[plausible] ** 2 * np.exp(-((height / gates.similarity_mm) ** 2)) * trust
        bits[index] |= np.int32(1 << k)
        variance = _at(view.sigma_mm, number) ** 2 + SIGMA_FLOOR_MM**2
        information[index] += 1.0 / variance
        if gates.blend:
            share = _at(view.cosine, number) ** 2 * trust / variance
            total[index] += (share * height)[:, None] * normal
            weight[index] += share
            similarity[index] += share * omega
        else:
            distance2 = height**2 + beside2
            closer = distance2 < nearest[index]
            index = index[closer]
            nearest[index] = distance2[closer]
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


def _nearest(vertices: Float64[Array, "n 3"], view: ViewData, reach_mm: float) -> Int64[Array, " n"]:
    transform = view.camera.camera_from_world
    numbers: Int64[Array, " n"] = elastic_kernels.feet(
        np.ascontiguousarray(vertices),
        np.ascontiguousarray(transform.rotation),
        np.ascontiguousarray(transform.translation_mm),
        view.camera.intrinsics,
        view.points,
        view.normals,
        view.rows,
        view.columns,
        reach_mm,
    )
    return numbers


def _at(image: Array, number: Int64[Array, " k"]) -> Array:
    """Values of an image at flat pixel numbers."""
    return image.reshape(-1, *image.shape[2:])[number]
