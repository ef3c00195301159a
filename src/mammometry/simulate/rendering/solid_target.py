"""Pictures of solid targets, a dotted cylinder and a dotted box: rays met with the exact shape, not with facets."""

from __future__ import annotations

import math

import numpy as np
from scipy.ndimage import binary_dilation, maximum_filter, minimum_filter
from scipy.spatial import cKDTree

from mammometry.calibration.targets.target import DottedCylinderTarget, PointsTarget, Target
from mammometry.geometry.arrays import Array, Float32, Float64
from mammometry.geometry.camera import Camera
from mammometry.geometry.transform import Transform
from mammometry.simulate.rendering import kernels
from mammometry.simulate.rendering.board import INKS, FlatTarget, irradiance, render_board
from mammometry.simulate.rendering.sampling import (
    PINHOLE,
    Aperture,
    disc_offsets,
    lens_parameters,
    lens_rays,
    net_offsets,
    picture_window,
)

_EDGE_SAMPLES = 16
_END_ROWS = (1.0, 1.8)
"""How far the cylinder reaches beyond its first and last rows of dots, in row pitches."""
_LABEL_ROWS = (0.55, 1.25)
"""The labels' strip beyond the last row, in row pitches."""
_LABEL_CELLS = 4
_LABEL_WIDTH = 0.7
"""Of a column's pitch."""
_CHUNK = 500_000


def render_target(
    camera: Camera,
    rig_from_target: Transform,
    target: Target,
    lights: Float64[Array, "l 4"],
    *,
    aperture: Aperture = PINHOLE,
    background: float = 0.0,
) -> Float32[Array, "h w"]:
    """Radiance of a calibration target of any kind, full scale 1, before the lens's blur.

    Args:
        camera: in the rig's frame.
        rig_from_target: the pose.
        target: flat, a dotted cylinder, or the points of a dotted box around the origin.
        lights: position, rig frame, mm, and irradiance × mm² at distance 1.
        aperture: of the lens.
        background: radiance where there is no target.
    """
    if isinstance(target, FlatTarget):
        return render_board(camera, rig_from_target, target, lights, aperture=aperture, background=background)
    target_from_rig = rig_from_target.inverse()
    image = np.full(camera.shape_hw, background, dtype=np.float32)
    margin_px = 4 + math.ceil(_unsharp_px(camera, rig_from_target, aperture))
    top, bottom, left, right = picture_window(camera, rig_from_target.apply(_corners(target)), margin_px=margin_px)
    if left >= right or top >= bottom:
        return image

    def radiance(uv: Float64[Array, "n 2"], places: Float64[Array, "n 2"]) -> Float64[Array, " n"]:
        directions = np.empty((len(uv), 3), dtype=np.float32)
        kernels.rays(uv, lens_parameters(camera), camera.camera_from_world.rotation.copy(), directions)
        origins, directions = lens_rays(camera, directions, aperture, places)
        points, normals, white = _hit(
            target, target_from_rig.apply(origins.astype(np.float64)), target_from_rig.rotate(directions.astype(float))
        )
        light = irradiance(points, normals, target_from_rig.apply(lights[:, :3]), lights[:, 3])
        return np.where(np.isfinite(white), np.where(white > 0.5, INKS[1], INKS[0]) * light, background)

    row, column = np.mgrid[top:bottom, left:right]
    middle = np.stack([column.ravel(), row.ravel()], axis=1).astype(np.float64)
    plain = radiance(middle, np.zeros_like(middle)).reshape(row.shape)
    high, low = maximum_filter(plain, 3), minimum_filter(plain, 3)
    edge = high > 1.05 * low
    if margin_px > 5:
        edge = binary_dilation(edge, iterations=margin_px - 4)
    net, disc = net_offsets(_EDGE_SAMPLES), disc_offsets(_EDGE_SAMPLES)
    chosen = middle[edge.ravel()]
    fine = np.empty(len(chosen))
    for start in range(0, len(chosen), _CHUNK // _EDGE_SAMPLES):
        part = chosen[start : start + _CHUNK // _EDGE_SAMPLES]
        samples = radiance((part[:, None] + net).reshape(-1, 2), np.tile(disc, (len(part), 1)))
        fine[start : start + len(part)] = samples.reshape(len(part), -1).mean(axis=1)
    plain[edge] = fine
    image[top:bottom, left:right] = plain
    return image


def _unsharp_px(camera: Camera, rig_from_target: Transform, aperture: Aperture) -> float:
    """Radius of the disc that a point in the middle of the target makes, px."""
    depth_mm = float(camera.camera_from_world.apply(rig_from_target.translation_mm)[2])
    return 0.5 * aperture.diameter_mm * float(camera.matrix[0, 0]) * abs(1.0 / depth_mm - 1.0 / aperture.focus_mm)


def _corners(target: DottedCylinderTarget | PointsTarget) -> Float64[Array, "n 3"]:
    """Points whose pictures enclose the target's."""
    if isinstance(target, DottedCylinderTarget):
        arc = np.tile(np.linspace(0.0, 2 * math.pi * target.radius_mm, 48), 2)
        return target.on_surface(arc, np.repeat(_ends(target), 48))
    half = float(np.abs(target.points_target).max())
    return half * np.array([[x, y, z] for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)])


def _ends(target: DottedCylinderTarget) -> tuple[float, float]:
    """Heights of the cylinder's ends, mm."""
    return -_END_ROWS[0] * target.row_pitch_mm, (target.dots[0] - 1 + _END_ROWS[1]) * target.row_pitch_mm


def _hit(
    target: DottedCylinderTarget | PointsTarget, origins: Float64[Array, "n 3"], directions: Float64[Array, "n 3"]
) -> tuple[Float64[Array, "n 3"], Float64[Array, "n 3"], Float64[Array, " n"]]:
    """Where rays first meet the target: points and outward normals, and 1 on paper, 0 on ink, NaN beside it."""
    with np.errstate(divide="ignore", invalid="ignore"):
        if isinstance(target, DottedCylinderTarget):
            return _hit_cylinder(target, origins, directions)
        return _hit_box(target, origins, directions)


def _hit_cylinder(
    target: DottedCylinderTarget, origins: Float64[Array, "n 3"], directions: Float64[Array, "n 3"]
) -> tuple[Float64[Array, "n 3"], Float64[Array, "n 3"], Float64[Array, " n"]]:
    o, d = origins[:, :2], directions[:, :2]
    a, b = (d * d).sum(axis=1), (o * d).sum(axis=1)
    root = np.sqrt(b * b - a * ((o * o).sum(axis=1) - target.radius_mm**2))  # NaN: beside the cylinder
    points = origins + ((-b - root) / a)[:, None] * directions
    low, high = _ends(target)
    side = (points[:, 2] >= low) & (points[:, 2] <= high)
    normals = points * np.array([1.0, 1.0, 0.0]) / target.radius_mm
    arc = np.arctan2(points[:, 1], points[:, 0]) * target.radius_mm / target.column_pitch_mm
    column = np.round(arc)
    across, row = arc - column, points[:, 2] / target.row_pitch_mm
    near = np.clip(np.round(row), 0, target.dots[0] - 1)
    half = 0.5 * (target.dot_mm or 0.5 * min(target.row_pitch_mm, target.column_pitch_mm))
    dark = np.abs(across) * target.column_pitch_mm <= half
    dark &= np.abs(row - near) * target.row_pitch_mm <= half
    dark |= _label_dark(target, column, across, row - (target.dots[0] - 1))
    white = np.where(side, np.where(dark, 0.0, 1.0), np.nan)
    # The open side of the tube is closed by a white lid.
    for height, sign in ((low, -1.0), (high, 1.0)):
        lid = origins + ((height - origins[:, 2]) / directions[:, 2])[:, None] * directions
        on_lid = ~side & (sign * directions[:, 2] < 0) & (np.hypot(lid[:, 0], lid[:, 1]) <= target.radius_mm)
        points[on_lid], normals[on_lid], white[on_lid] = lid[on_lid], [0.0, 0.0, sign], 1.0
    return points, normals, white


def _label_dark(target: DottedCylinderTarget, column: Array, across: Array, above: Array) -> Array:
    """Whether a place of the strip beyond the last row is ink: every column has its own random square of cells."""
    columns = target.dots[1]
    cells = np.random.default_rng(columns).random((columns, _LABEL_CELLS, _LABEL_CELLS)) < 0.5
    low, high = _LABEL_ROWS
    x = np.floor((across / _LABEL_WIDTH + 0.5) * _LABEL_CELLS)
    y = np.floor((above - low) / (high - low) * _LABEL_CELLS)
    inside = (x >= 0) & (y >= 0) & (x < _LABEL_CELLS) & (y < _LABEL_CELLS)
    index = np.where(inside, column, 0).astype(np.int64) % columns
    return inside & cells[index, np.where(inside, y, 0).astype(np.int64), np.where(inside, x, 0).astype(np.int64)]


def _hit_box(
    target: PointsTarget, origins: Float64[Array, "n 3"], directions: Float64[Array, "n 3"]
) -> tuple[Float64[Array, "n 3"], Float64[Array, "n 3"], Float64[Array, " n"]]:
    dots = target.points_target
    half = float(np.abs(dots).max())
    enter = (-np.sign(directions) * half - origins) / directions
    leave = (np.sign(directions) * half - origins) / directions
    axis = np.argmax(enter, axis=1)
    rows = np.arange(len(origins))
    t = enter[rows, axis]
    points = origins + t[:, None] * directions
    normals = np.zeros_like(points)
    normals[rows, axis] = -np.sign(directions[rows, axis])
    white = np.where((t > 0) & (t <= leave.min(axis=1)), 1.0, np.nan)
    radius = 0.5 * (target.dot_diameter_mm or 0.0)
    hit = np.flatnonzero(np.isfinite(white))
    white[hit[cKDTree(dots).query(points[hit])[0] <= radius]] = 0.0
    return points, normals, white
