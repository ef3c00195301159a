"""Find all photographs because of which a calibration is refused, and calibrate without them.

A bad photograph affects the others and may hide a second one. So suspects are excluded, and the rest is adjusted and
assessed again, until it is good enough or nothing more can be spared.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np

from mammometry.base.errors import CalibrationError
from mammometry.base.notices import Notice, words_of
from mammometry.calibration.adjust.calibrated import Calibration, SetAside
from mammometry.calibration.detection.detect import Observations
from mammometry.calibration.judge.findings import BIAS_REFUSE, about_target
from mammometry.calibration.judge.quality import CalibrationQuality, assess
from mammometry.calibration.settings import QualitySettings

_MOST = 1 / 3
"""Largest share of photographs that may be suspect. With more, the rest may be wrong instead."""
_WORST = 0.5
"""Share of the largest bias above which a view is suspect too: a bad view also biases its neighbours, but less."""

Shot: TypeAlias = tuple[str, str]
"""Pose and camera of a photograph."""
Recalibrate: TypeAlias = Callable[[Observations, tuple[float, float, float] | None], Calibration]
"""Adjust observations. With standard deviations in x, y and z, mm, the board's points are adjusted too."""
_ANY_SHAPE_MM = (10.0, 10.0, 10.0)
"""Standard deviations of a board's points that allow any shape."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Suspects:
    """Photographs that do not fit the others, and the calibration without them."""

    reasons: Mapping[Shot, str]
    """Photograph → reason why it is suspect, in order of pose, then camera."""
    rest: CalibrationQuality | None
    """Assessment of the calibration without them. None if they cannot be spared."""
    views: Mapping[str, int]
    """Camera → number of remaining photographs."""

    @property
    def suffices(self) -> bool:
        """Whether the rest is good enough to measure with."""
        return self.rest is not None and self.rest.verdict != "refuse"

    def rest_words(self) -> str:
        """Sentence about the remaining views."""
        if self.rest is None:
            return "Without them, too few photographs are left to calibrate"
        worst_mm = max(self.rest.expected_mm.values(), default=float("nan"))
        words = (
            f"Without them, {len(self.rest.rms_px_per_pose)} poses are left, at least {min(self.views.values())} "
            f"for each camera. Residuals are then {self.rest.rms_px:.3f} px, and points known to {worst_mm:.3f} mm"
        )
        return words if self.suffices else f"{words}. It would be refused too: {words_of(self.rest.refusals[0])}"


class SuspectPhotographsError(CalibrationError):
    """A calibration is refused because of some photographs.

    Args:
        suspects: the photographs, and the calibration without them.
    """

    code = "suspect-photographs"

    def __init__(self, suspects: Suspects) -> None:
        named = [f"{camera} in pose {pose}" for pose, camera in suspects.reasons]
        listed = " and ".join(part for part in (", ".join(named[:-1]), named[-1]) if part)
        count = f"{len(named)} photographs" if len(named) > 1 else "a photograph"
        leave = "Remove them, and calibrate again" if suspects.suffices else "Take these poses again"
        super().__init__(
            "calibration",
            found=f"{count} that contradict the others: {listed}",
            expected="all cameras exposed together in each pose, and no camera moved between poses",
            remedy=f"{leave}. {suspects.rest_words()}",
        )
        self.suspects = suspects
        self.details = tuple(f"pose {pose}, {camera}: {why}" for (pose, camera), why in suspects.reasons.items())


def refusal(
    calibration: Calibration, quality: CalibrationQuality, recalibrate: Recalibrate, settings: QualitySettings
) -> CalibrationError:
    """Return the error of a calibration that is not good enough to measure with.

    Args:
        calibration: the refused calibration.
        quality: its assessment.
        recalibrate: adjustment of other observations, with or without the board's shape.
        settings: limits.
    """
    fault = _board_fault(calibration, recalibrate)
    reasons = tuple(map(words_of, quality.notices))
    suspects = None if fault else find_suspects(calibration, quality, recalibrate, settings)
    if suspects is not None:
        return SuspectPhotographsError(suspects)
    error = (
        CalibrationError(
            "calibration target",
            found=_phrase(fault),
            expected="a flat board, printed at the same scale in both directions, as described in [target]",
            remedy="Correct the board, and take the calibration photographs again",
        )
        if fault
        else CalibrationError(
            "calibration",
            found=_phrase(quality.refusals[0]),
            expected="a calibration that is good enough to measure with",
            remedy="Take the calibration photographs again",
        )
    )
    error.details = reasons if fault else reasons[1:]
    return error


def _phrase(notice: Notice) -> str:
    """A finding as a clause of a sentence."""
    words = words_of(notice).rstrip(".")
    return f"that {words[0].lower()}{words[1:]}"


def _board_fault(calibration: Calibration, recalibrate: Recalibrate) -> Notice | None:
    """Test whether the board is at fault, if its shape was not adjusted.

    A few poses are not enough to calibrate the board's shape, but they show how much better they fit if it is adjusted.
    """
    if np.ptp(calibration.target_points - calibration.observations.target.points_target) > 0:
        return next((fault.notice for fault in about_target(calibration) if fault.verdict == "refuse"), None)
    try:
        freed = recalibrate(calibration.observations, _ANY_SHAPE_MM)
    except CalibrationError:
        return None
    if freed.rms_px >= calibration.rms_px / 2:
        return None
    return next((fault.notice for fault in about_target(freed)), None)


def find_suspects(
    calibration: Calibration, quality: CalibrationQuality, recalibrate: Recalibrate, settings: QualitySettings
) -> Suspects | None:
    """Find all photographs without which the calibration is good enough.

    None if it is not refused because of single photographs.

    Args:
        calibration: the refused calibration.
        quality: its assessment.
        recalibrate: adjustment of other observations, with or without the board's shape.
        settings: limits.
    """
    reasons: dict[Shot, str] = {}
    rest: CalibrationQuality | None = quality
    observations = calibration.observations
    most = _MOST * len(observations.detections)
    while rest is not None and rest.verdict == "refuse":
        new = dict(_suspicious(calibration, rest))
        if not new or len(reasons) + len(new) > most:
            break
        reasons |= new
        observations = replace(
            observations,
            detections=tuple(seen for seen in observations.detections if (seen.pose, seen.camera) not in new),
        )
        try:
            calibration = recalibrate(observations, None)
            rest = assess(calibration, settings)
        except CalibrationError:
            rest = None
    if not reasons:
        return None
    aside = {(view.pose, view.camera) for view in calibration.set_aside}
    kept = Counter(seen.camera for seen in observations.detections if (seen.pose, seen.camera) not in aside)
    return Suspects(reasons=dict(sorted(reasons.items())), rest=rest, views=kept)


_LEAST_AGREEING = 5
"""Fewest photographs of a camera besides the one that is left out. Two or three always agree."""


def spared_photograph(
    calibration: Calibration, quality: CalibrationQuality, recalibrate: Recalibrate, settings: QualitySettings
) -> tuple[Calibration, CalibrationQuality] | None:
    """Exclude the one photograph for which a calibration is refused, if all others agree without it.

    A camera's last photograph is not excluded: if the camera moved before it, the subject's photographs, which come
    later, would be measured with a wrong pose.

    Args:
        calibration: the refused calibration.
        quality: its assessment.
        recalibrate: adjustment of other observations, with or without the board's shape.
        settings: limits.

    Returns:
        The calibration without the photograph, which is listed as excluded, and its assessment. None if several
        photographs contradict each other, or a camera moved permanently.
    """
    shot = _worst_photograph(quality)
    if shot is None:
        return None
    pose, camera = shot
    seen = {(view.pose, view.camera): view for view in calibration.observations.detections}
    aside = {(view.pose, view.camera) for view in calibration.set_aside}
    others = [other for other, seer in seen if seer == camera and other != pose and (other, seer) not in aside]
    if len(others) < _LEAST_AGREEING or pose > max(others):
        return None
    left = tuple(view for key, view in seen.items() if key != shot)
    try:
        without = recalibrate(replace(calibration.observations, detections=left), None)
    except CalibrationError:
        return None
    if pose not in without.world_from_target:
        return None
    points = without.world_from_target[pose].apply(without.target_points[seen[shot].ids])
    off_px = np.linalg.norm(without.rig.cameras[camera].project(points) - seen[shot].uv, axis=1)
    left_out = SetAside(camera=camera, pose=pose, residual_px=float(np.median(off_px)))
    without = replace(without, set_aside=(*without.set_aside, left_out))
    judged = assess(without, settings)
    return (without, judged) if judged.verdict != "refuse" else None


def _worst_photograph(quality: CalibrationQuality) -> Shot | None:
    """The photograph that contradicts the others most. None if there are several, or another cause."""
    if quality.movements:
        worst = quality.movements[0]
        return (worst.first, worst.cameras[0]) if worst.only and len(worst.cameras) == 1 else None
    view = max(quality.views, key=lambda view: view.bias)
    return (view.pose, view.camera) if view.bias > BIAS_REFUSE else None


def _suspicious(calibration: Calibration, quality: CalibrationQuality) -> Iterator[tuple[Shot, str]]:
    shots = [(seen.pose, seen.camera) for seen in calibration.observations.detections]
    for movement in quality.movements:
        size = f"{movement.shift_px:.2f} px, {movement.sigma:.0f} standard errors"
        for shot in shots:
            if shot[1] not in movement.cameras:
                continue
            if movement.only and shot[0] == movement.first:
                yield shot, f"not exposed together with the others, or moved ({size})"
            if not movement.only and shot[0] < movement.first:  # the subject's photographs come after the last pose
                yield shot, f"taken before {shot[1]} moved ({size})"
    if quality.movements:
        return
    limit = max(BIAS_REFUSE, _WORST * max((view.bias for view in quality.views), default=0.0))
    for view in quality.views:
        if view.bias > limit:
            yield (view.pose, view.camera), f"all points shifted together by {view.bias:.0f} standard errors"
