"""How a board's adjusted points differ from its description: stretched by the printer, or bent."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from mammometry.calibration.adjust.calibrated import Calibration
from mammometry.calibration.features.found_points import Cause
from mammometry.calibration.judge.findings import Finding
from mammometry.calibration.targets.board import Board
from mammometry.geometry.arrays import Array, Float64

_STRETCH_WARN, _STRETCH_REFUSE = 3e-3, 1e-2
"""Difference of a board's two scales, relative. Half of it may be in every length, one and a half times in volumes."""
_BOW_WARN_MM = 1.0
"""Bow above which a board hardly keeps its shape while it is moved. Chosen by eye."""


def board_faults(calibration: Calibration) -> Iterator[tuple[bool, Cause]]:
    """Yield what is wrong with a board's shape as it was adjusted, and whether sizes are lost by it."""
    if not isinstance(calibration.observations.target, Board):
        return
    stretch, bow_mm = _stretch_and_bow(calibration.observations.target.points_target, calibration.target_points)
    if abs(stretch) > _STRETCH_WARN:
        found = (
            f"a board that is {100 * abs(stretch):.2f} % {'shorter' if stretch < 0 else 'longer'} along its rows than "
            f"[target] says, compared with its columns. Volumes may be {150 * abs(stretch):.1f} % off"
        )
        remedy = "Print it without scaling, the same both ways, and measure both edges"
        yield abs(stretch) > _STRETCH_REFUSE, Cause(found=found, remedy=remedy)
    if bow_mm > _BOW_WARN_MM:
        found = f"a board that is bent by {bow_mm:.1f} mm"
        yield False, Cause(found=found, remedy="Fix it on a flat, stiff plate, so that it keeps its shape")


def about_target(calibration: Calibration) -> Iterator[Finding]:
    """Report a board that is stretched or bent, if its points were adjusted."""
    for sizes_are_lost, fault in board_faults(calibration):
        yield "refuse" if sizes_are_lost else "warn", f"the calibration shows {fault.found}. {fault.remedy}"


def _stretch_and_bow(nominal: Float64[Array, "n 3"], points: Float64[Array, "n 3"]) -> tuple[float, float]:
    """Scale along x over that along y, less one, and height of the quadratic form, mm."""
    x, y = (nominal[:, :2] - nominal[:, :2].mean(axis=0)).T
    flat = np.stack([np.ones_like(x), x, y], axis=1)
    along_x, along_y = np.linalg.norm(np.linalg.lstsq(flat, points, rcond=None)[0][1:], axis=1)
    curves = np.stack([x * x, x * y, y * y], axis=1)
    heights = np.linalg.lstsq(np.concatenate([flat, curves], axis=1), points[:, 2], rcond=None)[0]
    form = curves @ heights[3:]
    level = form - flat @ np.linalg.lstsq(flat, form, rcond=None)[0]
    return float(along_x / along_y) - 1.0, float(np.ptp(level))
