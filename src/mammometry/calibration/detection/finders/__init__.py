"""Finders of targets in photographs, one file per kind."""

from __future__ import annotations

from functools import singledispatch

from mammometry.base.photograph import Photograph
from mammometry.calibration.detection.finders.charuco import explain_missed_charuco, find_charuco
from mammometry.calibration.detection.finders.chessboard import explain_missed_chessboard, find_chessboard
from mammometry.calibration.detection.finders.circles import find_circles
from mammometry.calibration.detection.finders.cylinder import find_cylinder
from mammometry.calibration.detection.finders.points import find_points
from mammometry.calibration.features.pixels import Cause, FoundPoints
from mammometry.calibration.targets.kinds.charuco import CharucoTarget
from mammometry.calibration.targets.kinds.chessboard import ChessboardTarget
from mammometry.calibration.targets.kinds.circles import CirclesTarget
from mammometry.calibration.targets.kinds.cylinder import DottedCylinderTarget
from mammometry.calibration.targets.kinds.points import PointsTarget
from mammometry.calibration.targets.target import Target
from mammometry.geometry.arrays import Array, UInt8


@singledispatch
def find(target: Target, photograph: Photograph, search_width_px: int) -> FoundPoints | Cause | None:
    """Find a target's points in one photograph. `find.register` adds the finder of a new kind.

    Args:
        target: of a kind that has a finder.
        photograph: of any size.
        search_width_px: width of the reduced image to search.

    Returns:
        The points; the reason why they cannot be used; or None if no target was found.

    Raises:
        SessionError: the target's description is invalid.
    """
    raise NotImplementedError(f"no finder is registered for {type(target).__name__}")


@singledispatch
def explain_miss(target: Target, small: UInt8[Array, "h w"]) -> Cause | None:
    """Describe what a reduced grey image shows instead of the target, if visible."""
    return None


find.register(CharucoTarget, find_charuco)
find.register(ChessboardTarget, find_chessboard)
find.register(CirclesTarget, find_circles)
find.register(DottedCylinderTarget, find_cylinder)
find.register(PointsTarget, find_points)
explain_miss.register(CharucoTarget, explain_missed_charuco)
explain_miss.register(ChessboardTarget, explain_missed_chessboard)
