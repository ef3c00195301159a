"""Errors that say what photographs show instead of the target."""

from __future__ import annotations

from collections.abc import Sequence

from mammometry.base.errors import CalibrationError
from mammometry.calibration.detection.detect import Observations


def with_causes(error: CalibrationError, observations: Observations) -> CalibrationError:
    """Add the unusable photographs to an error.

    They may be the reason why the others do not suffice.
    """
    causes = [f"pose {view.pose}, {view.camera}: {view.found}" for view in observations.missed if view.remedy]
    if not causes:
        return error
    found = f"{error.found} (and could not use {'; '.join(causes)})"
    return CalibrationError(error.subject, found=found, expected=error.expected, remedy=error.remedy)


def no_target(kind: str, parts: Sequence[Observations]) -> CalibrationError:
    """Error that no photograph shows the target.

    It says what most photographs show instead, and what to do.
    """
    causes = [(view.found, view.remedy) for part in parts for view in part.missed if view.remedy]
    instead, remedy = max(causes, key=causes.count) if causes else ("", "")
    return CalibrationError(
        "calibration photographs",
        found=f"no {kind} target in any of them" + (f" ({instead})" if instead else ""),
        expected="the target of session.toml, upright and not mirrored, in most of them",
        remedy=remedy or "Compare [target] in session.toml with the target that was photographed",
    )
