"""Find a surveyed target of round dots by their constellation, and measure the dots as discs."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from mammometry.base.photograph import Photograph
from mammometry.calibration.features.constellation import DotAssignment, TargetCamera, adjusted, read_constellation
from mammometry.calibration.features.dots import MAX_OFF, ROUNDS, Dots, ToImage, measure_dots
from mammometry.calibration.features.lattice import find_dots
from mammometry.calibration.features.pixels import (
    MIN_POINTS,
    Cause,
    FoundPoints,
    enlarge,
    grey_bytes,
    linear_luma,
    reduced,
)
from mammometry.calibration.targets.kinds.points import PointsTarget
from mammometry.geometry.arrays import Array, Bool, Float32, Float64

_SEARCH_WIDTHS = 2
"""Width of the searched image compared with boards: dots are smaller than squares."""
_NEIGHBOURHOODS = (0.05, 0.12)
"""Size of the neighbourhood that a dot must be darker than, image widths."""
_MOST_DOTS = 250
"""Largest number of dots: more are texture. Assumed; its effect has not been measured."""
_START_HALF = 0.15
"""Initial radius if the diameter is unknown, in distances between neighbouring points."""
_AROUND = 6
"""Number of neighbours that determine the surface's inclination at a point."""
_FLAT = 0.12
"""Largest distance of the neighbours from a plane, as a share of their distance, if they are used for the
inclination."""

AMBIGUOUS = Cause(
    found="dots that match the list of points in more than one way",
    remedy="Show more of the target, add points that break its symmetry, or write id,u,v to a .csv file "
    "of the photograph's name",
)
UNREAD = Cause(
    found="no dots that match the list of points",
    remedy="Show at least eight dark round dots on a bright surface, or write id,u,v to a .csv file of the "
    "photograph's name",
)


def find_points(target: PointsTarget, photograph: Photograph, search_width_px: int) -> FoundPoints | Cause:
    """Find the dots of a surveyed target, or explain why not."""
    small, scale = reduced(grey_bytes(photograph), _SEARCH_WIDTHS * search_width_px)
    points = target.points_target
    for neighbourhood in _NEIGHBOURHOODS:
        uv = enlarge(find_dots(small, neighbourhood), scale)
        if not MIN_POINTS <= len(uv) <= _MOST_DOTS:
            continue
        readings = read_constellation(points, uv, photograph.size_wh)
        if len(readings) > 1:
            return AMBIGUOUS
        if readings:
            return _measured(linear_luma(photograph), target, readings[0]) or UNREAD
    return UNREAD


def _measured(linear: Float32[Array, "h w"], target: PointsTarget, reading: DotAssignment) -> FoundPoints | None:
    """Measure the dots of an assignment."""
    points, camera, ids = target.points_target, reading.camera, np.sort(reading.ids)
    nearest_mm = float(np.asarray(cKDTree(points).query(points, k=2)[0])[:, 1].min())
    half_mm = target.dot_diameter_mm / 2 if target.dot_diameter_mm else _START_HALF * nearest_mm
    for _ in range(ROUNDS):
        normals, flat = _normals(points, camera)
        dots = _measure(linear, camera, points[ids], normals[ids], half_mm, nearest_mm)
        if dots.ok.sum() < MIN_POINTS:
            return None
        if target.dot_diameter_mm is None:
            half_mm = float(np.sqrt(np.median(dots.mass_mm2[dots.ok]) / np.pi))
        camera = adjusted(
            camera, points[ids[dots.ok]], dots.uv[dots.ok], free_lens=bool(dots.ok.sum() >= 2 * MIN_POINTS)
        )
    error_px = np.linalg.norm(camera.image(points[ids]) - dots.uv, axis=1)
    size_px = 2 * half_mm * camera.focal_px / np.linalg.norm(points[ids] - camera.centre_mm, axis=1)
    good = dots.ok & (error_px < MAX_OFF * size_px)
    # If the surface's inclination is unknown, the largest error that it could cause is added to the uncertainty.
    doubt_px = np.where(flat[ids], 0.0, size_px**2 / (8 * camera.focal_px))
    covariance = dots.covariance_px2 + (doubt_px**2)[:, None, None] * np.eye(2)
    return FoundPoints(ids=ids[good], uv=dots.uv[good], covariance_px2=covariance[good]) if good.any() else None


def _normals(points: Float64[Array, "n 3"], camera: TargetCamera) -> tuple[Float64[Array, "n 3"], Bool[Array, " n"]]:
    """Unit normal at each point, towards the camera, and whether its neighbours determine it.

    Otherwise the dot is assumed to face the camera.
    """
    distance, near = (np.asarray(part) for part in cKDTree(points).query(points, k=min(_AROUND + 1, len(points))))
    around = points[near] - points[near].mean(axis=1, keepdims=True)
    _, spread, axes = np.linalg.svd(around, full_matrices=False)
    flat: Bool[Array, " n"] = spread[:, 2] / np.sqrt(near.shape[1]) < _FLAT * distance[:, 1]
    flat &= spread[:, 1] > 0.2 * spread[:, 0]
    towards = camera.centre_mm - points
    towards /= np.linalg.norm(towards, axis=1, keepdims=True)
    normal = axes[:, 2] * np.sign((axes[:, 2] * towards).sum(axis=1, keepdims=True))
    flat &= (normal * towards).sum(axis=1) > 0.2
    return np.where(flat[:, None], normal, towards), flat


def _measure(
    linear: Float32[Array, "h w"],
    camera: TargetCamera,
    points: Float64[Array, "n 3"],
    normals: Float64[Array, "n 3"],
    half_mm: float,
    nearest_mm: float,
) -> Dots:
    across = np.where(np.abs(normals[:, :1]) < 0.9, np.array([1.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0]))
    first = np.cross(normals, across)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    second = np.cross(normals, first)

    return measure_dots(
        linear,
        _tangent_planes(camera, points, first, second),
        np.zeros((len(points), 2)),
        shape="disc",
        half_mm=half_mm,
        pitch_mm=(nearest_mm, nearest_mm),
    )


def _tangent_planes(
    camera: TargetCamera, points: Float64[Array, "n 3"], first: Float64[Array, "n 3"], second: Float64[Array, "n 3"]
) -> ToImage:
    """Map from offsets in each point's tangent plane, mm, to pixels. Row k belongs to point k."""

    def to_image(offset_mm: Float64[Array, "n *m 2"]) -> Float64[Array, "n *m 2"]:
        shape = (len(points), *(1,) * (offset_mm.ndim - 2), 3)
        at = (
            points.reshape(shape)
            + offset_mm[..., :1] * first.reshape(shape)
            + offset_mm[..., 1:] * second.reshape(shape)
        )
        return camera.image(at)

    return to_image
