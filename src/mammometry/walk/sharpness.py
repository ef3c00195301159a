"""Sharpness and size of the board in each photograph of a walk.

The fit of a chess corner has the blur of its edges as a parameter (`calibration.features.corners`).
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from mammometry.base.photograph import Photograph
from mammometry.base.value import value
from mammometry.calibration.detection.detect import Detection
from mammometry.calibration.features.board_map import LENS_TOLERANCE, BoardMap, fit_board_map
from mammometry.calibration.features.corners import MarkerArea, fit_corners
from mammometry.calibration.features.pixels import linear_luma
from mammometry.calibration.targets.board import SquaresBoard
from mammometry.calibration.targets.kinds.charuco import CharucoTarget
from mammometry.calibration.targets.target import Target
from mammometry.walk.inputs import LeftOut

_WINDOW_SQUARES = 0.48  # half-width of the fitted window, as for the detection of corners
_BLUR_PX, _BLUR_FACTOR = 1.5, 2.0
"""Largest blur, px and relative to the median of all photographs: a photograph that meets either limit is used."""
FEWEST_SQUARE_PX = 20.0
"""Fewest pixels along a square's side. The clean walk's mean error is 0.14 mm with 65, 0.37 with 34, 0.57 with 27; with
24, only three of 32 boards are found (decision 52)."""
_RIM_PX = 2.5  # width of a marker's blurred edge, as for the detection of corners


@value
class BoardImage:
    """Appearance of the board in a photograph."""

    blur_px: float
    """Median standard deviation of the blur of its edges, pixels."""
    square_px: float
    """Median length of a square's side, where it is not foreshortened, pixels."""


def board_image(photograph: Photograph, detection: Detection, board: SquaresBoard) -> BoardImage | None:
    """Measure a detected board's blur and size. None if its corners cannot be fitted again."""
    found = board_map_of(detection, board, photograph.size_wh)
    if found is None:
        return None
    points_mm = board.points_target[detection.ids, :2]
    blank = None
    if isinstance(board, CharucoTarget):
        blank = MarkerArea(square_mm=board.square_mm, marker_mm=board.marker_mm, rim_px=_RIM_PX)
    fits = fit_corners(
        linear_luma(photograph),
        found.image(points_mm),
        points_mm,
        found.board,
        window_mm=_WINDOW_SQUARES * board.square_mm,
        blank=blank,
    )
    if not fits.ok.any():
        return None
    longest_px = np.linalg.svd(found.jacobian(points_mm), compute_uv=False)[:, 0] * board.square_mm
    return BoardImage(blur_px=float(np.median(fits.sigma_px[fits.ok])), square_px=float(np.median(longest_px)))


def board_map_of(detection: Detection, board: Target, size_wh: tuple[int, int]) -> BoardMap | None:
    """The map from a detected board to its photograph. None if its corners do not determine one."""
    fitted = fit_board_map(
        board.points_target[detection.ids, :2], detection.uv, tolerance_px=LENS_TOLERANCE * max(size_wh)
    )
    return None if fitted is None else fitted[0]


def judge_images(images: Mapping[str, BoardImage]) -> dict[str, LeftOut]:
    """Photographs that are too blurred or show the board too small, with reasons.

    Args:
        images: number of a photograph → appearance of its board.
    """
    if not images:
        return {}
    usual_px = float(np.median([image.blur_px for image in images.values()]))
    limit_px = max(_BLUR_PX, _BLUR_FACTOR * usual_px)
    out = {}
    for name, image in images.items():
        if image.square_px < FEWEST_SQUARE_PX:
            out[name] = LeftOut(
                code="too-small",
                found=f"{image.square_px:.0f} pixels for each square of the board",
                expected=f"at least {FEWEST_SQUARE_PX:.0f}",
                remedy="Copy the original files, not through a messenger, and take the pictures from 50 to 65 cm",
            )
        elif image.blur_px > limit_px:
            out[name] = LeftOut(
                code="blurred",
                found=f"edges blurred by {image.blur_px:.1f} pixels",
                expected=f"at most {limit_px:.1f}; in most pictures {usual_px:.1f}",
                remedy="Lock the focus on the board, hold the telephone still, and use more light",
            )
    return out
