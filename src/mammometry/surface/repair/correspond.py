"""Plausible points: closest valid datum of each vertex, and its similarity."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mammometry.base.machine.cores import in_bands
from mammometry.geometry import Array, Bool, Camera, Float32, Float64, Int32, Int64
from mammometry.surface.ranges import image_kernels
from mammometry.surface.ranges.range_image import NORMAL_MM, SIGMA_FLOOR_MM, RangeImage, thinned_camera
from mammometry.surface.repair import elastic_kernels
from mammometry.surface.settings import TAPER_MM

_SPACINGS = 0.5  # spacing of the data over the mesh's; not critical
_TANGENTIAL_SPACINGS = 0.75  # reach of a datum, in spacings: half a spacing along each axis, so 0.71 diagonally
_LEAST_COSINE = 0.05  # 87°: with a smaller cosine the spacing on the surface becomes infinite


@dataclass(frozen=True, slots=True, kw_only=True)
class Gates:
    """Limits for plausible data of a vertex: the constants of `repair` with the same names."""

    reach_mm: float
    normal_angle_deg: float
    tangential_mm: float
    similarity_mm: float
    blend: bool
    """Whether the target is the mean of all views' plausible points, not the closest one."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ViewData:
    """Valid data of one view for the search, thinned to the mesh's spacing."""

    camera: Camera
    """The view's camera, with the pixels of the thinned data."""
    points: Float32[Array, "h w 3"]
    """Camera frame, mm. NaN where there is no datum."""
    normals: Float32[Array, "h w 3"]
    """Towards the camera, camera frame."""
    rows: Int32[Array, "h w"]
    columns: Int32[Array, "h w"]
    """Row and column of the datum nearest to each pixel."""
    sigma_mm: Float32[Array, "h w"]
    """Expected standard deviation across the surface, mm."""
    cosine: Float32[Array, "h w"]
    """Cosine of the angle between normal and line of sight."""
    spacing_mm: float
    """Distance between data that face the camera, mm."""
    trust: Float32[Array, "h w"]
    """Weight: 0.05 at the edge of the view's data, rising to 1 inside (`RangeImage.trust`)."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Correspondences:
    """Target and weight of each vertex from the range data."""

    found: Bool[Array, " n"]
    """The paper's TRUE: vertices with a plausible point."""
    targets: Float64[Array, "n 3"]
    """ṽ: position of the vertex according to the data, mm. Its own position if nothing was found."""
    similarity: Float64[Array, " n"]
    """ω of Eq. 5, 0…1."""
    sigma_mm: Float32[Array, " n"]
    """Expected standard deviation of the target along the normal, mm. NaN if nothing was found."""
    pair_bits: Int32[Array, " n"]
    """Bit k set: view k has a plausible point."""


def view_data(
    image: RangeImage, spacing_mm: float, normal_mm: float = NORMAL_MM, taper_mm: float = TAPER_MM
) -> ViewData | None:
    """Valid data of a view with normals, thinned to about half the mesh's spacing. None without data."""
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
    """Plausible point of each vertex on the valid range data: ṽ and ω of Eq. 5.

    The nearest datum of each view is plausible if it is within `reach_mm`, its normal within `normal_angle_deg`, and
    its tangential distance at most `tangential_mm` (or three quarters of the data's spacing, if that is more). The
    target is the vertex's foot on the datum's tangent plane. The similarity is ω = cos²(angle between the normals) ·
    exp(−(distance/`similarity_mm`)²), less near the edge of a view's data. Of several views the closest datum counts
    (the paper), or with `blend` their mean, weighted by cos²/(σ² + floor²).
    """

    def of(band: slice) -> Correspondences:
        return _correspond(vertices[band], normals[band], views, gates)

    parts = in_bands(of, len(vertices))
    fields = ("found", "targets", "similarity", "sigma_mm", "pair_bits")
    return Correspondences(**{field: np.concatenate([getattr(part, field) for part in parts]) for field in fields})


def _correspond(
    vertices: Float64[Array, "n 3"], normals: Float64[Array, "n 3"], views: list[ViewData | None], gates: Gates
) -> Correspondences:
    """Correspondences of some of the vertices."""
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
        tangential2 = np.einsum("ij,ij->i", offset, offset) - height**2
        limit_mm = np.maximum(gates.tangential_mm, _TANGENTIAL_SPACINGS * view.spacing_mm / _at(view.cosine, number))
        plausible = (alike > np.cos(float(np.radians(gates.normal_angle_deg)))) & (tangential2 <= limit_mm**2)
        index, number, height, normal = index[plausible], number[plausible], height[plausible], normal[plausible]
        tangential2, trust = tangential2[plausible], _at(view.trust, number)
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
            distance2 = height**2 + tangential2
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
