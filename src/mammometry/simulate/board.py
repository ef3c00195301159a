"""Pictures of a flat printed target: the pattern as cells, rendered by the kernel that knows its edges exactly."""

from __future__ import annotations

import numpy as np

from mammometry.calibration.detect_charuco import charuco_board
from mammometry.calibration.target import CharucoTarget, ChessboardTarget
from mammometry.geometry.arrays import Array, Float32, Float64, UInt8
from mammometry.geometry.camera import Camera
from mammometry.geometry.transform import Transform
from mammometry.simulate.kernels import board as board_kernel
from mammometry.simulate.sampling import lens_parameters, net_offsets, picture_window

BORDER_MM = 10.0
"""White border outside the squares."""
_BLACK, _WHITE, _MARKER = 0, 1, 2
_BLACK_INK, _WHITE_PAPER = 0.032, 0.72
_EDGE_SAMPLES = 16
_LIGHT_STEP_MM = 10.0


def printed_cells(target: CharucoTarget | ChessboardTarget) -> UInt8[Array, "rows columns c c"]:
    """What is printed in every square: [j, i, 0, 0] is 0 black, 1 white, 2 marker; a marker's cells start at [1, 1].

    Raises:
        SessionError: no marker dictionary of the target's name.
    """
    columns, rows = target.squares
    black = (np.arange(rows)[:, None] + np.arange(columns)) % 2 == 0
    if isinstance(target, ChessboardTarget):
        return np.where(black, _BLACK, _WHITE).astype(np.uint8)[:, :, None, None]
    board = charuco_board(target)
    dictionary = board.getDictionary()
    cells = int(dictionary.markerSize) + 2
    printed = np.zeros((rows, columns, cells + 1, cells + 1), dtype=np.uint8)
    for identity, corners in zip(np.ravel(board.getIds()), board.getObjPoints(), strict=True):
        x, y = np.asarray(corners).reshape(4, 3)[:, :2].mean(axis=0) / target.square_mm
        printed[int(y), int(x), 0, 0] = _MARKER
        printed[int(y), int(x), 1:, 1:] = dictionary.generateImageMarker(int(identity), cells) > 0
    return printed


def render_board(
    camera: Camera,
    rig_from_board: Transform,
    target: CharucoTarget | ChessboardTarget,
    printed: UInt8[Array, "rows columns c c"],
    lights: Float64[Array, "l 4"],
    *,
    background: float = 0.0,
) -> Float32[Array, "h w"]:
    """Radiance of the board as the camera sees it, full scale 1, before the lens's blur.

    Args:
        camera: in the rig's frame.
        rig_from_board: the pose.
        target: the board.
        printed: its `printed_cells`.
        lights: position, rig frame, mm, and irradiance × mm² at distance 1.
        background: radiance where there is no board.
    """
    board_from_rig = rig_from_board.inverse()
    marker_mm = target.marker_mm if isinstance(target, CharucoTarget) else target.square_mm
    layout = np.array([*target.squares, target.square_mm, marker_mm, BORDER_MM], dtype=np.float64)
    image = np.full(camera.shape_hw, background, dtype=np.float32)
    rim = np.linspace(0.0, 1.0, 21)[:, None]
    low, high = -BORDER_MM, np.array(target.squares) * target.square_mm + BORDER_MM
    corners = np.array([[low, low], [high[0], low], high, [low, high[1]]])
    outline = np.concatenate([a + rim * (b - a) for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True)])
    window = picture_window(camera, rig_from_board.apply(np.column_stack([outline, np.zeros(len(outline))])))
    board_kernel(
        lens_parameters(camera),
        np.ascontiguousarray(board_from_rig.rotation @ camera.camera_from_world.rotation.T),
        board_from_rig.apply(camera.centre_world),
        layout,
        printed,
        _irradiance(target, board_from_rig, lights),
        np.array([_BLACK_INK, _WHITE_PAPER, background]),
        net_offsets(_EDGE_SAMPLES),
        np.array(window),
        image,
    )
    return image


def _irradiance(
    target: CharucoTarget | ChessboardTarget, board_from_rig: Transform, lights: Float64[Array, "l 4"]
) -> Float64[Array, "r c"]:
    """Irradiance on the printed side every 10 mm or finer; linear between, it is right to a ten-thousandth."""
    sides = np.array(target.squares) * target.square_mm + 2 * BORDER_MM
    columns, rows = np.ceil(sides / _LIGHT_STEP_MM).astype(int) + 1
    x, y = np.meshgrid(np.linspace(0.0, sides[0], columns), np.linspace(0.0, sides[1], rows))
    points = np.stack([x, y, np.zeros_like(x)], axis=-1) - np.array([BORDER_MM, BORDER_MM, 0.0])
    towards = board_from_rig.apply(lights[:, :3]) - points[..., None, :]
    distance = np.linalg.norm(towards, axis=-1)
    total: Float64[Array, "r c"] = (lights[:, 3] * np.maximum(-towards[..., 2], 0.0) / distance**3).sum(axis=-1)
    return total
