"""Pictures of calibration targets. Rays are intersected with their exact shapes instead of facets."""

from __future__ import annotations

import math

import numpy as np
from scipy.ndimage import binary_dilation, maximum_filter, minimum_filter

from mammometry.calibration.targets.board import FlatBody
from mammometry.calibration.targets.sheet import SheetPattern
from mammometry.calibration.targets.target import Target
from mammometry.geometry import Array, Camera, Float32, Float64, Transform
from mammometry.simulate.rendering import kernels
from mammometry.simulate.rendering.kernels import board as board_kernel
from mammometry.simulate.rendering.sampling import (
    PINHOLE,
    Aperture,
    disc_offsets,
    lens_parameters,
    lens_rays,
    net_offsets,
    picture_window,
)

INKS = (0.032, 0.72)
"""Reflectance of black ink and white paper, typical of laser prints. No result depends on it."""
_UNSHARP_EDGE_SAMPLES = 64  # rays per pixel on an edge, through a lens's aperture
_LIGHT_STEP_MM = 10.0
"""Distance of the points where light is computed, mm. Linear interpolation is accurate to 1e-4."""
_RIM_STEPS = 21  # points along each edge of the paper, so that the window includes edges bent by distortion
_GRIDS = {"squares": 0.0, "circles": 1.0, "staggered": 2.0}  # number of a pattern's grid in the kernel's layout


def render_board(
    camera: Camera,
    rig_from_board: Transform,
    body: FlatBody,
    pattern: SheetPattern,
    lights: Float64[Array, "l 4"],
    *,
    aperture: Aperture = PINHOLE,
    background: float = 0.0,
) -> Float32[Array, "h w"]:
    """Radiance of the board at the camera, full scale 1, without blur.

    Args:
        camera: camera in the rig's frame.
        rig_from_board: pose of the board.
        body: the board on its paper.
        pattern: the print.
        lights: position, rig frame, mm, and irradiance × mm² at distance 1.
        aperture: aperture of the lens.
        background: radiance outside the board.
    """
    board_from_rig = rig_from_board.inverse()
    paper = body.paper_mm
    image = np.full(camera.shape_hw, background, dtype=np.float32)
    rim = np.linspace(0.0, 1.0, _RIM_STEPS)[:, None]
    corners = body.hull_target
    outline = np.concatenate([a + rim * (b - a) for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True)])
    window = picture_window(camera, rig_from_board.apply(outline))
    samples = _EDGE_SAMPLES if aperture.diameter_mm == 0.0 else _UNSHARP_EDGE_SAMPLES
    board_kernel(
        lens_parameters(camera),
        np.ascontiguousarray(board_from_rig.rotation @ camera.camera_from_world.rotation.T),
        board_from_rig.apply(camera.centre_world),
        np.array([_GRIDS[pattern.grid], *pattern.count, pattern.pitch_mm, pattern.mark_mm, *paper.ravel()]),
        pattern.cells,
        _irradiance(paper, board_from_rig, lights),
        np.array([*INKS, background]),
        net_offsets(samples),
        0.5 * aperture.diameter_mm * disc_offsets(samples),
        aperture.focus_mm,
        np.array(window),
        image,
    )
    return image


def _irradiance(
    paper: Float64[Array, "2 2"], board_from_rig: Transform, lights: Float64[Array, "l 4"]
) -> Float64[Array, "r c"]:
    """Irradiance on the printed side at steps of at most `_LIGHT_STEP_MM`."""
    columns, rows = np.ceil((paper[1] - paper[0]) / _LIGHT_STEP_MM).astype(int) + 1
    x, y = np.meshgrid(*(np.linspace(paper[0, k], paper[1, k], count) for k, count in enumerate((columns, rows))))
    points = np.stack([x, y, np.zeros_like(x)], axis=-1)
    return irradiance(points, np.array([0.0, 0.0, -1.0]), board_from_rig.apply(lights[:, :3]), lights[:, 3])


def irradiance(
    points: Float64[Array, "*n 3"],
    normals: Float64[Array, "*n 3"],
    positions: Float64[Array, "l 3"],
    strengths: Float64[Array, " l"],
) -> Float64[Array, "*n"]:
    """Irradiance by point lights: cosine divided by squared distance. White in full light is 1."""
    towards = positions - points[..., None, :]
    cosine = (towards * normals[..., None, :]).sum(axis=-1)
    total: Float64[Array, "*n"] = (strengths * np.maximum(cosine, 0.0) / np.linalg.norm(towards, axis=-1) ** 3).sum(
        axis=-1
    )
    return total


_EDGE_SAMPLES = 16
"""Rays per pixel near an edge, through a pinhole. Other pixels have one."""
_EDGE_STEP = 1.05  # ratio between neighbours above which a pixel is near an edge: light alone changes less
_MARGIN_PX = 4  # margin of the window around the target's picture in addition to the defocus, px
_CHUNK = 500_000  # rays traced at a time: limits memory to some hundred megabytes


def render_target(
    camera: Camera,
    rig_from_target: Transform,
    target: Target,
    lights: Float64[Array, "l 4"],
    *,
    aperture: Aperture = PINHOLE,
    background: float = 0.0,
) -> Float32[Array, "h w"]:
    """Radiance of a calibration target at the camera, full scale 1, without blur.

    Regular patterns on boards have their own kernel. Other targets are traced, with more rays near edges.

    Args:
        camera: camera in the rig's frame.
        rig_from_target: pose of the target.
        target: target of any kind.
        lights: position, rig frame, mm, and irradiance × mm² at distance 1.
        aperture: aperture of the lens.
        background: radiance outside the target.
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
    """Radius of the defocus disc at the target's centre, px."""
    depth_mm = float(camera.camera_from_world.apply(rig_from_target.translation_mm)[2])
    return 0.5 * aperture.diameter_mm * float(camera.matrix[0, 0]) * abs(1.0 / depth_mm - 1.0 / aperture.focus_mm)
