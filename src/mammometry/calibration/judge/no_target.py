"""Errors for photographs without the target: cause and remedy first, then details."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from mammometry.base.errors import CalibrationError
from mammometry.base.photograph import Photograph
from mammometry.calibration.adjust.initialise import TooFewViewsError
from mammometry.calibration.detection.detect import MissedView, Observations, detect_in
from mammometry.calibration.features.pixels import Cause
from mammometry.calibration.targets.target import Target

_TRIED = 4
"""Number of photographs in which targets that are commonly confused with this one are searched."""

Photographs = Mapping[tuple[str, str], Photograph]


@dataclass(frozen=True, slots=True, kw_only=True)
class _Reading:
    """A target that matches a common mistake in the description."""

    cause: Cause
    target: Target


def no_target(target: Target, parts: Sequence[Observations], photographs: Photographs) -> CalibrationError:
    """Return the error that no photograph shows the target, with what they show instead.

    Args:
        target: as described.
        parts: all detections.
        photographs: (pose, camera) → photograph of this target; read only if the cause is not known otherwise.
    """
    missed = [view for part in parts for view in part.missed]
    shown = _fitting_reading(target, photographs, sorted(photographs)) or _common_cause(missed)
    words, remedy = shown or ("", "Compare [target] in session.toml with the target that was photographed")
    error = CalibrationError(
        "calibration photographs",
        found=f"no {target.kind} target in any of {len(missed)} photographs" + (f": {words}" if words else ""),
        expected="the target of session.toml, upright and not mirrored, in most of them",
        remedy=remedy,
    )
    error.details = _lines(missed, remedy)
    return error


def with_causes(error: CalibrationError, parts: Sequence[Observations], photographs: Photographs) -> CalibrationError:
    """Add the photographs that could not be used to an error of the adjustment.

    If cameras have too few views for this reason, the error says so first.

    Args:
        error: of the adjustment.
        parts: detections of the rig's target, then of others.
        photographs: (pose, camera) → photograph of the rig's target; read only if the cause is not known otherwise.
    """
    every = [view for part in parts for view in part.missed]
    cameras = error.cameras if isinstance(error, TooFewViewsError) else ()
    missed = [view for view in every if not cameras or view.camera in cameras]
    shown = None
    if cameras or len(missed) > sum(len(part.detections) for part in parts):
        keys = [(view.pose, view.camera) for view in missed if (view.pose, view.camera) in photographs]
        shown = _fitting_reading(parts[0].target, photographs, keys)
    if cameras:
        shown = shown or _common_cause(missed)
    if shown is not None:
        words, remedy = shown
        found = f"{error.found}: where it is missing, {words}"
        error = CalibrationError(error.subject, found=found, expected=error.expected, remedy=remedy)
    error.details = _lines(every, error.remedy)
    return error


def _lines(missed: Sequence[MissedView], remedy: str) -> tuple[str, ...]:
    """One line per camera and cause. The error's own remedy is not repeated."""
    poses: dict[tuple[str, str, str], list[str]] = {}
    for view in missed:
        if view.remedy:
            poses.setdefault((view.camera, view.found, view.remedy), []).append(view.pose)
    return tuple(
        f"{camera}, {'pose' if len(names) == 1 else 'poses'} {', '.join(names)}: {found}"
        + (f". {own}" if own != remedy else "")
        for (camera, found, own), names in sorted(poses.items())
    )


def _common_cause(missed: Sequence[MissedView]) -> tuple[str, str] | None:
    """Return what most photographs without detection show instead, as text, and its remedy."""
    causes = [view for view in missed if view.remedy]
    if not causes:
        return None
    remedies = [view.remedy for view in causes]
    remedy = max(remedies, key=remedies.count)
    shown = [view.found for view in causes if view.remedy == remedy]
    return f"{len(shown)} of {len(missed)} photographs show {max(shown, key=shown.count)}", remedy


def _fitting_reading(
    target: Target, photographs: Photographs, keys: Sequence[tuple[str, str]]
) -> tuple[str, str] | None:
    """Common mistake that explains most of some photographs without detection, as text, and its remedy."""
    some = [photographs[keys[k]] for k in np.unique(np.linspace(0, len(keys) - 1, _TRIED).astype(int)) if keys]
    for reading in _other_targets(target):
        fitting = sum(_fits(reading, photograph) for photograph in some[:2])
        if fitting:
            fitting += sum(_fits(reading, photograph) for photograph in some[2:])
        if 2 * fitting > len(some):
            return (
                f"{fitting} of {len(some)} photographs that were examined again show {reading.cause.found}",
                reading.cause.remedy,
            )
    return None


def _fits(reading: _Reading, photograph: Photograph) -> bool:
    return detect_in(photograph, reading.target, camera="", pose="") is not None


def _other_targets(target: Target) -> Iterator[_Reading]:
    for keys, other in target.mistaken():
        remedy = f"Write {keys} in [target] of session.toml, or photograph the described board"
        cause = Cause(found=f"a board with {keys}", remedy=remedy)
        yield _Reading(cause=cause, target=other)
