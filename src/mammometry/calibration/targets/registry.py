"""Kinds of calibration target.

A new kind is one file in this folder and one line here.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from mammometry.base.registry import Registry

if TYPE_CHECKING:
    from mammometry.calibration.targets.target import Target

TARGETS: Registry[type[Target]] = Registry(
    "calibration target",
    modules=(
        "mammometry.calibration.targets.charuco",
        "mammometry.calibration.targets.chessboard",
        "mammometry.calibration.targets.circles",
        "mammometry.calibration.targets.cylinder",
        "mammometry.calibration.targets.points",
    ),
)
"""Kind, as ``[target] kind`` names it, → class of the target."""
