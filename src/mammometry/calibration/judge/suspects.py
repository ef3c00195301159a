"""All photographs that spoil a calibration, and what is left without them.

A bad photograph pulls the others, and may hide a second one. So suspects are taken out, the rest is adjusted and judged
again, until it is fit to measure with or nothing more can be spared.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np

from mammometry.base.errors import CalibrationError
from mammometry.calibration.adjust.calibrated import Calibration, SetAside
from mammometry.calibration.detection.detect import Observations
from mammometry.calibration.features.pixels import Cause
from mammometry.calibration.judge.findings import BIAS_REFUSE, board_faults
from mammometry.calibration.judge.quality import CalibrationQuality, assess
from mammometry.calibration.settings import QualitySettings

_MOST = 1 / 3
"""Share of the photographs that may be suspect. With more, it is the rest that may be wrong."""
_WORST = 0.5
"""Share of the largest bias from which a view is suspect as well: a bad view biases its neighbours, but by less."""

Shot: TypeAlias = tuple[str, str]
"""Pose and camera of a photograph."""
Recalibrate: TypeAlias = Callable[[Observations, tuple[float, float, float] | None], Calibration]
"""Adjust observations. If standard deviations in x, y and z, mm, are given, the board's points with them as well."""
_ANY_SHAPE_MM = (10.0, 10.0, 10.0)
"""Standard deviations of a board's points that let it have any shape."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Suspects:
    """Photographs that do not fit the others, and the calibration without them."""

    reasons: Mapping[Shot, str]
    """Photograph → why it is suspect. In the order of pose, then camera."""
    rest: CalibrationQuality | None
    """Judgement of the calibration without them. None where they cannot be spared."""
    views: Mapping[str, int]
    """Camera → photographs that are left."""

    @property
    def suffices(self) -> bool:
        """Whether the rest is fit to measure with."""
        return self.rest is not None and self.rest.verdict != "refuse"

    def rest_words(self) -> str:
        """The views that are left without them, in a sentence."""
        if self.rest is None:
            return "Without them, too few photographs are left to calibrate"
        worst_mm = max(self.rest.expected_mm.values(), default=float("nan"))
        words = (
            f"Without them, {len(self.rest.rms_px_per_pose)} poses are left, at least {min(self.views.values())} "
            f"for each camera. Residuals are then {self.rest.rms_px:.3f} px, and points known to {worst_mm:.3f} mm"
        )
        return words if self.suffices else f"{words}. It would be refused as well: {self.rest.refusals[0]}"


class SuspectPhotographsError(CalibrationError):
    """A calibration that is refused for some photographs.

    Args:
        suspects: the photographs, and what is left without them.
    """

    code = "suspect-photographs"

    def __init__(self, suspects: Suspects) -> None:
        named = [f"{camera} in pose {pose}" for pose, camera in suspects.reasons]
        listed = " and ".join(part for part in (", ".join(named[:-1]), named[-1]) if part)
        count = f"{len(named)} photographs" if len(named) > 1 else "a photograph"
        leave = "Take them out, and calibrate again" if suspects.suffices else "Take these poses again"
        super().__init__(
            "calibration",
            found=f"{count} that the others contradict: {listed}",
            expected="all cameras exposed together in each pose, and none moved between poses",
            remedy=f"{leave}. {suspects.rest_words()}",
        )
        self.suspects = suspects
        self.details = tuple(f"pose {pose}, {camera}: {why}" for (pose, camera), why in suspects.reasons.items())


def refusal(
    calibration: Calibration, quality: CalibrationQuality, recalibrate: Recalibrate, settings: QualitySettings
) -> CalibrationError:
    """Return the error of a calibration that is not fit to measure with.

    Args:
        calibration: that is refused.
        quality: its judgement.
        recalibrate: the adjustment of other observations, with or without the board's shape.
        settings: limits.
    """
    fault = _board_fault(calibration, recalibrate)
    suspects = None if fault else find_suspects(calibration, quality, recalibrate, settings)
    if suspects is not None:
        return SuspectPhotographsError(suspects)
    error = (
        CalibrationError(
            "calibration target",
            found=fault.found,
            expected="a flat board, printed the same both ways, as [target] describes it",
            remedy=fault.remedy,
        )
        if fault
        else CalibrationError(
            "calibration",
            found=f"that {quality.refusals[0].rstrip('.')}",
            expected="a calibration fit to measure with",
            remedy="Take the calibration photographs again",
        )
    )
    error.details = quality.reasons if fault else quality.reasons[1:]
    return error


def _board_fault(calibration: Calibration, recalibrate: Recalibrate) -> Cause | None:
    """Find out whether it is the board that does not fit, where its shape was not adjusted.

    Few poses do not separate it from the cameras well, but show how much better they fit with it.
    """
    if np.ptp(calibration.target_points - calibration.observations.target.points_target) > 0:
        return next((fault for sizes_are_lost, fault in board_faults(calibration) if sizes_are_lost), None)
    try:
        freed = recalibrate(calibration.observations, _ANY_SHAPE_MM)
    except CalibrationError:
        return None
    return next((fault for _, fault in board_faults(freed)), None) if freed.rms_px < calibration.rms_px / 2 else None


def find_suspects(
    calibration: Calibration, quality: CalibrationQuality, recalibrate: Recalibrate, settings: QualitySettings
) -> Suspects | None:
    """Find all photographs without which the rest is fit to measure with.

    None if it is not for single photographs that the calibration is refused.

    Args:
        calibration: that is refused.
        quality: its judgement.
        recalibrate: the adjustment of other observations, with or without the board's shape.
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
"""Photographs of a camera that must agree without the one that is left out. Two or three agree with anything."""


def spared_photograph(
    calibration: Calibration, quality: CalibrationQuality, recalibrate: Recalibrate, settings: QualitySettings
) -> tuple[Calibration, CalibrationQuality] | None:
    """Leave out the one photograph for which a calibration is refused, if all others agree without it.

    A camera's last photograph is not left out: if the camera moved before it, the subject's photographs, which come
    later, would be measured from the wrong place.

    Args:
        calibration: that is refused.
        quality: its judgement.
        recalibrate: the adjustment of other observations, with or without the board's shape.
        settings: limits.

    Returns:
        The calibration without the photograph, which it names as set aside, and its judgement. None where several
        photographs contradict one another, or a camera moved for good.
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
    """The photograph that contradicts the others most. None where it is more than one, or something else."""
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
            if (
                not movement.only and shot[0] < movement.first
            ):  # the photographs of the subject come after the last pose
                yield shot, f"taken before {shot[1]} moved ({size})"
    if quality.movements:
        return
    limit = max(BIAS_REFUSE, _WORST * max((view.bias for view in quality.views), default=0.0))
    for view in quality.views:
        if view.bias > limit:
            yield (view.pose, view.camera), f"all points shifted together by {view.bias:.0f} standard errors"
