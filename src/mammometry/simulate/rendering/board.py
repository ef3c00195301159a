"""Pictures of a flat printed target: rendered by the kernel that knows the pattern's edges exactly."""

from __future__ import annotations

from functools import cache
from typing import TypeAlias

import numpy as np

from mammometry.calibration.targets.charuco import charuco_board
from mammometry.calibration.targets.target import CharucoTarget, ChessboardTarget, CirclesTarget
from mammometry.geometry.arrays import Array, Float32, Float64, UInt8, read_only
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
from mammometry.simulate.rigs.targets import extent_mm

FlatTarget: TypeAlias = CharucoTarget | ChessboardTarget | CirclesTarget
BORDER_MM = 10.0
"""White border outside the pattern."""
INKS = (0.032, 0.72)
"""Reflectance of black ink and of white paper."""
_BLACK, _WHITE, _MARKER = 0, 1, 2
_EDGE_SAMPLES = 16
_UNSHARP_EDGE_SAMPLES = 64
_LIGHT_STEP_MM = 10.0


@cache
def printed_cells(target: FlatTarget) -> UInt8[Array, "rows columns c c"]:
    """What is printed in every square: [j, i, 0, 0] is 0 black, 1 white, 2 marker; a marker's cells start at [1, 1].

    A board of circles has no squares: (0, 0, 1, 1).

    Raises:
        SessionError: no marker dictionary of the target's name.
    """
    if isinstance(target, CirclesTarget):
        return np.zeros((0, 0, 1, 1), dtype=np.uint8)
    columns, rows = target.squares
    black = (np.arange(rows)[:, None] + np.arange(columns)) % 2 == 0
    if isinstance(target, ChessboardTarget):
        return read_only(np.where(black, _BLACK, _WHITE).astype(np.uint8)[:, :, None, None])
    board = charuco_board(target)
    dictionary = board.getDictionary()
    cells = int(dictionary.markerSize) + 2
    printed = np.zeros((rows, columns, cells + 1, cells + 1), dtype=np.uint8)
    for identity, corners in zip(np.ravel(board.getIds()), board.getObjPoints(), strict=True):
        x, y = np.asarray(corners).reshape(4, 3)[:, :2].mean(axis=0) / target.square_mm
        printed[int(y), int(x), 0, 0] = _MARKER
        printed[int(y), int(x), 1:, 1:] = dictionary.generateImageMarker(int(identity), cells) > 0
    return read_only(printed)


def render_board(
    camera: Camera,
    rig_from_board: Transform,
    target: FlatTarget,
    lights: Float64[Array, "l 4"],
    *,
    aperture: Aperture = PINHOLE,
    background: float = 0.0,
) -> Float32[Array, "h w"]:
    """Radiance of the board as the camera sees it, full scale 1, before the lens's blur.

    Args:
        camera: in the rig's frame.
        rig_from_board: the pose.
        target: the board.
        lights: position, rig frame, mm, and irradiance × mm² at distance 1.
        aperture: of the lens.
        background: radiance where there is no board.
    """
    board_from_rig = rig_from_board.inverse()
    paper = extent_mm(target) + BORDER_MM * np.array([[-1.0], [1.0]])
    image = np.full(camera.shape_hw, background, dtype=np.float32)
    rim = np.linspace(0.0, 1.0, 21)[:, None]
    (left, top), (right, bottom) = paper
    corners = np.array([[left, top], [right, top], [right, bottom], [left, bottom]])
    outline = np.concatenate([a + rim * (b - a) for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True)])
    window = picture_window(camera, rig_from_board.apply(np.column_stack([outline, np.zeros(len(outline))])))
    samples = _EDGE_SAMPLES if aperture.diameter_mm == 0.0 else _UNSHARP_EDGE_SAMPLES
    board_kernel(
        lens_parameters(camera),
        np.ascontiguousarray(board_from_rig.rotation @ camera.camera_from_world.rotation.T),
        board_from_rig.apply(camera.centre_world),
        np.array([*_pattern(target), *paper.ravel()]),
        printed_cells(target),
        _irradiance(paper, board_from_rig, lights),
        np.array([*INKS, background]),
        net_offsets(samples),
        0.5 * aperture.diameter_mm * disc_offsets(samples),
        aperture.focus_mm,
        np.array(window),
        image,
    )
    return image


def _pattern(target: FlatTarget) -> tuple[float, ...]:
    """The first five numbers of the kernel's layout."""
    if isinstance(target, CirclesTarget):
        return 2.0 if target.asymmetric else 1.0, *target.grid, target.pitch_mm, 0.5 * target.diameter_mm
    marker_mm = target.marker_mm if isinstance(target, CharucoTarget) else target.square_mm
    return 0.0, *target.squares, target.square_mm, marker_mm


def _irradiance(
    paper: Float64[Array, "2 2"], board_from_rig: Transform, lights: Float64[Array, "l 4"]
) -> Float64[Array, "r c"]:
    """Irradiance on the printed side every 10 mm or finer; linear between, it is right to a ten-thousandth."""
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
    """Irradiance by point lights, white under full light = 1: cosine over the square of the distance."""
    towards = positions - points[..., None, :]
    cosine = (towards * normals[..., None, :]).sum(axis=-1)
    total: Float64[Array, "*n"] = (strengths * np.maximum(cosine, 0.0) / np.linalg.norm(towards, axis=-1) ** 3).sum(
        axis=-1
    )
    return total
