"""Find boards of dark circles: OpenCV finds the grid, centroids of darkness measure it."""

from __future__ import annotations

import cv2
import numpy as np

from mammometry.base.photograph import Photograph
from mammometry.calibration.features.board_map import BoardMap, fit_board_map, search_tolerance_px
from mammometry.calibration.features.dots import MAX_OFF, ROUNDS, SIZE_OFF, mark_size, measure_dots
from mammometry.calibration.features.pixels import Cause, FoundPoints, enlarge, grey_bytes, linear_luma, reduced
from mammometry.calibration.targets.kinds.circles import CirclesTarget
from mammometry.geometry.arrays import Array, Float64, UInt8

_MIN_AREA_PX = 12.0
"""Smallest blob in the reduced picture, px²: a circle 4 px wide."""
_MAX_MISFIT = 0.15
"""RMS distance from the map, in pitches, above which the grid was read in the wrong order."""


def find_circles(target: CirclesTarget, photograph: Photograph, search_width_px: int) -> FoundPoints | Cause | None:
    """Find the circle centres of a board that is completely visible.

    None if it is not found, a cause if the circles have another size. If the grid is unchanged by a half turn, the
    board's x axis points right in the image.
    """
    small, scale = reduced(grey_bytes(photograph), search_width_px)
    grid = _search(small, target)
    if grid is None:
        return None
    centres_mm = target.points_target[:, :2].copy()
    tolerance_px = search_tolerance_px(photograph.size_wh, scale)
    board_map = _orient(enlarge(grid, scale), centres_mm, target, tolerance_px)
    if board_map is None:
        return None
    linear = linear_luma(photograph)
    size = mark_size(linear, board_map.image, centres_mm, shape="disc", reach_mm=target.nearest_mm / 2)
    if size is not None and size.contradicts(target.diameter_mm / 2, SIZE_OFF):
        return size.cause(("diameter_mm", target.diameter_mm), ("pitch_mm", target.pitch_mm))
    for _ in range(ROUNDS):
        dots = measure_dots(
            linear,
            board_map.image,
            centres_mm,
            shape="disc",
            half_mm=target.diameter_mm / 2,
            pitch_mm=(target.nearest_mm, target.nearest_mm),
        )
        found = fit_board_map(centres_mm[dots.ok], dots.uv[dots.ok], tolerance_px=tolerance_px)
        if found is None:
            return None
        board_map = found[0]
    size_px = np.sqrt(np.abs(np.linalg.det(board_map.jacobian(centres_mm)))) * target.diameter_mm
    good = dots.ok & (np.linalg.norm(board_map.image(centres_mm) - dots.uv, axis=1) < MAX_OFF * size_px)
    return FoundPoints(ids=np.flatnonzero(good), uv=dots.uv[good], covariance_px2=dots.covariance_px2[good])


def _search(small: UInt8[Array, "h w"], target: CirclesTarget) -> Float64[Array, "r c 2"] | None:
    parameters = cv2.SimpleBlobDetector.Params()
    parameters.minArea = _MIN_AREA_PX
    parameters.maxArea = small.size / (target.grid[0] * target.grid[1])
    parameters.minDistBetweenBlobs = 3.0
    detector = cv2.SimpleBlobDetector.create(parameters)
    kind = cv2.CALIB_CB_ASYMMETRIC_GRID if target.asymmetric else cv2.CALIB_CB_SYMMETRIC_GRID
    for flags in (kind, kind | cv2.CALIB_CB_CLUSTERING):
        found, centres = cv2.findCirclesGrid(small, target.grid, flags=flags, blobDetector=detector)
        if found and centres is not None:
            return np.asarray(centres, np.float64).reshape(target.grid[1], target.grid[0], 2)
    return None


def _orient(
    grid: Float64[Array, "r c 2"], centres_mm: Float64[Array, "n 2"], target: CirclesTarget, tolerance_px: float
) -> BoardMap | None:
    """Map of the reading order that fits. If several fit, the one whose x axis points most to the right."""
    orders = [grid, grid[::-1], grid[:, ::-1], grid[::-1, ::-1]]
    if target.grid[0] == target.grid[1] and not target.asymmetric:
        orders += [order.transpose(1, 0, 2) for order in orders]
    fits: list[tuple[float, BoardMap]] = []
    for order in orders:
        uv = np.ascontiguousarray(order.reshape(-1, 2))
        found = fit_board_map(centres_mm, uv, tolerance_px=tolerance_px)
        if found is None:
            continue
        jacobian = found[0].jacobian(centres_mm)
        pitch_px = float(np.median(np.sqrt(np.abs(np.linalg.det(jacobian))))) * target.pitch_mm
        misfit = float(np.sqrt(np.square(found[0].image(centres_mm) - uv).sum(axis=1).mean()))
        if misfit < _MAX_MISFIT * pitch_px:
            fits.append((float(np.median(jacobian[:, 0, 0])), found[0]))
    return max(fits, key=lambda fit: fit[0])[1] if fits else None
