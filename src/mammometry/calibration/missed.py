"""What photographs that could not be used show instead, in words."""

from __future__ import annotations

from collections.abc import Sequence

from mammometry.calibration.detect import Observations
from mammometry.errors import CalibrationError


def with_causes(error: CalibrationError, observations: Observations) -> CalibrationError:
    """The error, and the photographs that could not be used: they may be why the others do not suffice."""
    causes = [f"pose {view.pose}, {view.camera}: {view.found}" for view in observations.missed if view.remedy]
    if not causes:
        return error
    found = f"{error.found} (and could not use {'; '.join(causes)})"
    return CalibrationError(error.subject, found=found, expected=error.expected, remedy=error.remedy)


def commonest_cause(parts: Sequence[Observations]) -> str:
    """What most of the photographs that show no target show instead, in words; nothing where that is not known."""
    causes = [view.found for part in parts for view in part.missed if view.remedy]
    return f" ({max(causes, key=causes.count)})" if causes else ""
