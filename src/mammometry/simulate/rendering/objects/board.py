"""Pictures of a board with a regular pattern. The kernel knows the pattern's edges exactly."""

from __future__ import annotations

import numpy as np

from mammometry.calibration.targets.board import FlatBody
from mammometry.calibration.targets.sheet import Pattern
from mammometry.geometry.arrays import Array, Float32, Float64
from mammometry.geometry.camera import Camera
from mammometry.geometry.transform import Transform
from mammometry.simulate.rendering.kernels import board as board_kernel
from mammometry.simulate.rendering.sampling import (
    PINHOLE,
    Aperture,
    disc_offsets,
    lens_parameters,
    net_offsets,
    picture_window,
)

INKS = (0.032, 0.72)
"""Reflectance of black ink and white paper. Typical of laser prints, chosen by eye."""
_EDGE_SAMPLES = 16
"""Rays for a pixel on an edge, through a pinhole."""
_UNSHARP_EDGE_SAMPLES = 64
"""Rays for a pixel on an edge, through a lens's opening."""
_LIGHT_STEP_MM = 10.0
"""Spacing of the places where light is computed, mm. Linear interpolation is right to a ten-thousandth."""
_RIM_STEPS = 21
"""Points along each edge of the paper, so that a bent edge stays inside the picture's window."""
_GRIDS = {"squares": 0.0, "circles": 1.0, "staggered": 2.0}
"""Number of a pattern's grid in the kernel's layout."""


def render_board(
    camera: Camera,
    rig_from_board: Transform,
    body: FlatBody,
    pattern: Pattern,
    lights: Float64[Array, "l 4"],
    *,
    aperture: Aperture = PINHOLE,
    background: float = 0.0,
) -> Float32[Array, "h w"]:
    """Radiance of the board at the camera, full scale 1, without blur.

    Args:
        camera: in the rig's frame.
        rig_from_board: the pose.
        body: the board on its paper.
        pattern: what is printed on it.
        lights: position, rig frame, mm, and irradiance × mm² at distance 1.
        aperture: of the lens.
        background: radiance where there is no board.
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
    """Irradiance on the printed side every `_LIGHT_STEP_MM` or finer."""
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
    """Irradiance by point lights, white under full light = 1. Cosine over the square of the distance."""
    towards = positions - points[..., None, :]
    cosine = (towards * normals[..., None, :]).sum(axis=-1)
    total: Float64[Array, "*n"] = (strengths * np.maximum(cosine, 0.0) / np.linalg.norm(towards, axis=-1) ** 3).sum(
        axis=-1
    )
    return total
