"""Pictures of calibration targets: rays meet their exact shape, not facets."""

from __future__ import annotations

import math

import numpy as np
from scipy.ndimage import binary_dilation, maximum_filter, minimum_filter

from mammometry.calibration.targets.board import FlatBody
from mammometry.calibration.targets.target import Target
from mammometry.geometry.arrays import Array, Float32, Float64
from mammometry.geometry.camera import Camera
from mammometry.geometry.transform import Transform
from mammometry.simulate.rendering import kernels
from mammometry.simulate.rendering.objects.board import INKS, irradiance, render_board
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
"""Rays for a pixel near an edge. All others have one."""
_EDGE_STEP = 1.05
"""Factor between neighbours that marks a pixel near an edge: light alone changes less."""
_MARGIN_PX = 4
"""Margin of the window around the target's picture, px, beyond the defocus. Chosen by eye."""
_CHUNK = 500_000
"""Rays followed at a time. Memory then stays below some hundred megabytes."""


def render_target(
    camera: Camera,
    rig_from_target: Transform,
    target: Target,
    lights: Float64[Array, "l 4"],
    *,
    aperture: Aperture = PINHOLE,
    background: float = 0.0,
) -> Float32[Array, "h w"]:
    """Render a calibration target: radiance, full scale 1, without blur.

    A regular pattern on a board goes to its own kernel. All else is met by rays, more of them near edges.

    Args:
        camera: in the rig's frame.
        rig_from_target: the pose.
        target: of any kind.
        lights: position, rig frame, mm, and irradiance × mm² at distance 1.
        aperture: of the lens.
        background: radiance where there is no target.
    """
    body = target.body
    if isinstance(body, FlatBody) and (pattern := body.board.pattern) is not None:
        return render_board(camera, rig_from_target, body, pattern, lights, aperture=aperture, background=background)
    target_from_rig = rig_from_target.inverse()
    image = np.full(camera.shape_hw, background, dtype=np.float32)
    margin_px = _MARGIN_PX + math.ceil(_unsharp_px(camera, rig_from_target, aperture))
    top, bottom, left, right = picture_window(camera, rig_from_target.apply(body.hull_target), margin_px=margin_px)
    if left >= right or top >= bottom:
        return image

    def radiance(uv: Float64[Array, "n 2"], places: Float64[Array, "n 2"]) -> Float64[Array, " n"]:
        directions = np.empty((len(uv), 3), dtype=np.float32)
        kernels.rays(uv, lens_parameters(camera), camera.camera_from_world.rotation.copy(), directions)
        origins, directions = lens_rays(camera, directions, aperture, places)
        hits = body.meet(
            target_from_rig.apply(origins.astype(np.float64)), target_from_rig.rotate(directions.astype(float))
        )
        light = irradiance(hits.points, hits.normals, target_from_rig.apply(lights[:, :3]), lights[:, 3])
        return np.where(np.isfinite(hits.white), np.where(hits.white > 0.5, INKS[1], INKS[0]) * light, background)

    row, column = np.mgrid[top:bottom, left:right]
    middle = np.stack([column.ravel(), row.ravel()], axis=1).astype(np.float64)
    plain = radiance(middle, np.zeros_like(middle)).reshape(row.shape)
    high, low = maximum_filter(plain, 3), minimum_filter(plain, 3)
    edge = high > _EDGE_STEP * low
    if margin_px > _MARGIN_PX + 1:
        edge = binary_dilation(edge, iterations=margin_px - _MARGIN_PX)
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
    """Radius of the defocus disc of the target's middle, px."""
    depth_mm = float(camera.camera_from_world.apply(rig_from_target.translation_mm)[2])
    return 0.5 * aperture.diameter_mm * float(camera.matrix[0, 0]) * abs(1.0 / depth_mm - 1.0 / aperture.focus_mm)
