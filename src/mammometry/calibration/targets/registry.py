"""Kinds of calibration target.

A new kind is one file in the folder `kinds`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from mammometry.base.registry import Registry

if TYPE_CHECKING:
    from mammometry.calibration.targets.target import Target

TARGETS: Registry[type[Target]] = Registry("calibration target", package="mammometry.calibration.targets.kinds")
"""Kind, as ``[target] kind`` names it, → class of the target."""
