"""Check from one later exposure whether a camera of the rig has moved, and which one.

Each camera alone gives the target's placement (`sighting`). If nothing moved, all placements agree within their noise
and that of the calibration. Otherwise the smallest set of cameras without which the rest agrees has moved
(`moved_cameras`). Only relative motion is visible: if most cameras moved in the same way, the others are named.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Literal, TypeAlias

import numpy as np

from mammometry.base.errors import CalibrationError, ImageError
from mammometry.base.value import value
from mammometry.calibration.adjust.calibrated import Calibration, ParameterCovariance
from mammometry.calibration.adjust.initialise import resect
from mammometry.calibration.adjust.linear_model import FREE
from mammometry.calibration.adjust.projection import intrinsics_of
from mammometry.calibration.detection.detect import Detection, Observations
from mammometry.calibration.judge.camera_names import check_board_names
from mammometry.calibration.judge.moved_cameras import CameraMotion, MotionProblem
from mammometry.calibration.judge.reconstruction import MovedPair, moved_pair
from mammometry.calibration.judge.sighting import Sighting, disagreement, sight, sightings
from mammometry.calibration.settings import CheckSettings
from mammometry.calibration.targets.target import Target
from mammometry.geometry import Array, Camera, Float64, Rig, Transform
from mammometry.geometry.twist import as_twist, moved_camera

_CHANCE = 1e-6
"""Probability of a disagreement in a rig that did not move, below which it is reported as a motion. It is very small
because real noise has longer tails than the normal distribution."""
_LEAST_INFLATION = 1.5
"""Least factor on the exposure's noise: neighbouring corners have common errors. The factor is larger if the
calibration's own views disagree more."""
_LENS_RATIO = 3.0
"""Ratio of a camera's residual to that in its calibration above which its lens, or the target, must have changed."""

CheckVerdict: TypeAlias = Literal["unmoved", "moved", "refuse"]
_ROUNDS = 3
"""Number of linearisations about the placements. With small residuals, each squares the relative error of a motion:
three reduce 0.1 to 1e-8."""
_UNKNOWN_ERRORS = 5.0  # factor on one exposure's noise for given cameras, whose errors are unknown


@value(eq=False)
class Reference:
    """Calibrated rig to compare an exposure with, and its known errors."""

    rig: Rig
    target_points: Float64[Array, "p 3"]
    """Target frame, mm."""
    volume_world: Float64[Array, "v 3"]
    """Points of the working volume, mm: target points of the calibration. If empty, those of the exposure are used."""
    covariance: ParameterCovariance | None = None
    """Covariance of the cameras. None for given cameras."""
    noise_factor: float = 1.0
    """Standard deviation of the residuals in units of the detections' own."""
    inflation: float = _UNKNOWN_ERRORS
    """Factor by which views of one pose disagree beyond their own noise."""
    rms_px: Mapping[str, float] = field(default_factory=dict)
    """Camera → median residual of its views in the calibration, px."""

    @classmethod
    def of(cls, calibration: Calibration) -> Reference:
        """Reference of a calibration."""
        seen = sightings(calibration)
        places = [placed.apply(calibration.target_points) for placed in calibration.world_from_target.values()]
        cameras = dict.fromkeys(sighting.camera for sighting in seen)
        return cls(
            rig=calibration.rig,
            target_points=calibration.target_points,
            volume_world=np.concatenate(places),
            covariance=calibration.covariance,
            noise_factor=calibration.noise_factor,
            inflation=scatter(calibration, seen),
            rms_px={name: float(np.median([o.rms_px for o in seen if o.camera == name])) for name in cameras},
        )

    @classmethod
    def of_cameras(cls, rig: Rig, target: Target) -> Reference:
        """Reference of given cameras, whose errors are not known."""
        return cls(rig=rig, target_points=target.points_target, volume_world=np.empty((0, 3)))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CameraCheck:
    """Motion of one camera relative to those that did not move."""

    camera: str
    moved: bool
    motion: CameraMotion
    shift_px: float
    """RMS displacement of the target in its picture, px."""
    rms_px: float
    """Residual when this camera alone places the target, px. Large if its lens or the target has changed."""


@value(eq=False)
class RigCheck:
    """Result of checking a calibration by a later exposure of the target."""

    verdict: CheckVerdict
    """``unmoved``: within noise. ``moved``: certain, but too small to matter. ``refuse``: calibrate again."""
    reasons: tuple[str, ...]
    """One sentence each, worst first."""
    cameras: Mapping[str, CameraCheck]
    """Camera → its check, for those that saw the target. Read-only."""
    unseen: tuple[str, ...]
    """Cameras of the rig that did not see the target together with another."""
    alternatives: tuple[tuple[str, ...], ...]
    """Sets of cameras whose motion explains the disagreement, best first. Empty if nothing moved."""
    pairs: Mapping[str, MovedPair]
    """Pair of a moved camera → effect on the points it measures. Read-only."""
    world_from_target: Mapping[str, Transform]
    """Exposure → placement of the target by the cameras that did not move. Read-only."""
    exchanged: tuple[str, ...] = ()
    """Two cameras whose pictures agree with the calibration if they are swapped. Empty if there are none."""

    @property
    def effect_mm(self) -> float:
        """RMS displacement of the points that the worst pair measures, mm."""
        return max((pair.displacement_mm for pair in self.pairs.values()), default=0.0)


def scatter(calibration: Calibration, seen: Sequence[Sighting]) -> float:
    """Factor by which views of a pose disagree beyond their noise.

    At least 1. Neighbouring corners have common errors (light, focus, print) that each view's covariance does not
    include. Estimated from the median over the poses of the disagreement's χ².
    """
    ratios = []
    for pose, placed in calibration.world_from_target.items():
        views = [sighting for sighting in seen if sighting.pose == pose]
        if len(views) < 2:
            continue
        mean = disagreement(views, {pose: placed}, np.ones((len(views), 1))).fit(np.full(6, FREE))
        ratios.append(mean.misfit / mean.freedom)
    return max(1.0, float(np.sqrt(np.median(ratios)))) if ratios else 1.0


def check(reference: Reference, observations: Observations, settings: CheckSettings = CheckSettings()) -> RigCheck:
    """Compare a later exposure of the target with the calibrated rig.

    Args:
        reference: the calibrated rig.
        observations: of the same target, in one pose or more, all cameras of a pose exposed together.
        settings: limits.

    Raises:
        CalibrationError: no two cameras saw the target together.
        ImageError: the size of a picture is not that of its camera in the calibration.
    """
    _check_sizes(reference.rig, observations)
    seen = _sightings(reference, observations)
    cameras = tuple(name for name in reference.rig.cameras if any(sighting.camera == name for sighting in seen))
    inflation = max(reference.inflation, _LEAST_INFLATION)
    about = partial(
        MotionProblem.about, seen=seen, cameras=cameras, calibrated=reference.covariance, inflation=inflation
    )
    agreement = about(_nearest_to_all(seen))
    candidates = agreement.explanations(_CHANCE)
    for _ in range(_ROUNDS):  # only small motions are linear: linearised again about the placements found
        agreement = about(agreement.placements(candidates[0]))
        candidates = agreement.explanations(_CHANCE)
    chosen = candidates[0]
    checks = {name: _camera_check(agreement, reference.rig.cameras[name], chosen) for name in cameras}
    pairs = _moved_pairs(reference, agreement, checks)
    verdict: CheckVerdict = "unmoved"
    if chosen:
        verdict = (
            "refuse" if max((p.displacement_mm for p in pairs.values()), default=0.0) > settings.refuse_mm else "moved"
        )
    lenses = list(_about_lenses(checks, reference))
    unseen = tuple(name for name in reference.rig.cameras if name not in cameras)
    exchanged = _exchanged(reference.rig, observations) if lenses or verdict == "refuse" else ()
    return RigCheck(
        verdict="refuse" if lenses else verdict,
        reasons=(
            *_about_exchange(exchanged),
            *lenses,
            *_about_moves(checks, candidates, pairs, settings),
            *_about_unseen(unseen),
            *_about_reference(reference),
        ),
        cameras=checks,
        unseen=unseen,
        alternatives=tuple(candidates) if chosen else (),
        pairs=pairs,
        world_from_target=agreement.placed,
        exchanged=exchanged,
    )


def _exchanged(rig: Rig, observations: Observations) -> tuple[str, ...]:
    """Two cameras whose pictures are swapped. Empty unless every exposure gives the same two."""
    exposures: dict[str, dict[str, Detection]] = {}
    for detection in observations.detections:
        exposures.setdefault(detection.pose, {})[detection.camera] = detection
    found = {check_board_names(rig, seen) for seen in exposures.values()}
    both = found.pop() if len(found) == 1 else None
    return () if both is None else both


def _about_exchange(exchanged: tuple[str, ...]) -> Iterator[str]:
    if exchanged:
        yield (
            f"the pictures of {' and '.join(exchanged)} seem to be exchanged: by the calibration, each shows the "
            "other's view. Give each the name of the camera that took it, and check again"
        )


def _check_sizes(rig: Rig, observations: Observations) -> None:
    for name, size_wh in observations.sizes_wh.items():
        if name in rig.cameras and size_wh != rig.cameras[name].size_wh:
            width, height = rig.cameras[name].size_wh
            raise ImageError(
                f"the exposure of {name}",
                found=f"{size_wh[0]} × {size_wh[1]} pixels",
                expected=f"{width} × {height}, as in its calibration",
                remedy="Photograph and export as for the calibration",
            )


def _sightings(reference: Reference, observations: Observations) -> tuple[Sighting, ...]:
    names = () if reference.covariance is None else reference.covariance.names
    found = []
    for detection in observations.detections:
        camera = reference.rig.cameras.get(detection.camera)
        start = None if camera is None else _start(camera, detection, reference.target_points)
        if camera is not None and start is not None:
            sighting = sight(
                camera,
                detection,
                reference.target_points,
                start,
                noise_factor=reference.noise_factor,
                parameters=names,
            )
            found += [] if sighting is None else [sighting]
    together = tuple(sighting for sighting in found if sum(other.pose == sighting.pose for other in found) > 1)
    if not together:
        raise CalibrationError(
            "the exposure of the target",
            found="no two cameras of the rig that see it together"
            + (f" (only {', '.join(sorted({sighting.camera for sighting in found}))})" if found else ""),
            expected="at least two, better all",
            remedy="Hold the target of the calibration where most cameras see it, and expose them together",
        )
    return together


def _start(camera: Camera, detection: Detection, points: Float64[Array, "p 3"]) -> Transform | None:
    placed = resect(points[detection.ids], detection.uv, intrinsics_of(camera))
    return None if placed is None else camera.camera_from_world.inverse() @ placed


def _nearest_to_all(seen: Sequence[Sighting]) -> dict[str, Transform]:
    """Exposure → the sighting nearest to the others, which a moved camera does not affect."""
    placed = {}
    for pose in sorted({sighting.pose for sighting in seen}):
        views = [sighting for sighting in seen if sighting.pose == pose]
        apart = [
            np.median([view.shift_px(view.twist_from(o.world_from_target)) for o in views if o is not view])
            for view in views
        ]
        placed[pose] = views[int(np.argmin(apart))].world_from_target
    return placed


def _camera_check(agreement: MotionProblem, camera: Camera, chosen: Sequence[str]) -> CameraCheck:
    mine = [sighting for sighting in agreement.seen if sighting.camera == camera.name]
    motion = agreement.motion(camera, chosen, _CHANCE)
    return CameraCheck(
        camera=camera.name,
        moved=camera.name in chosen,
        motion=motion,
        shift_px=float(np.sqrt(np.mean([sighting.shift_px(as_twist(motion.motion)) ** 2 for sighting in mine]))),
        rms_px=float(np.sqrt(np.mean([sighting.rms_px**2 for sighting in mine]))),
    )


def _moved_pairs(
    reference: Reference, agreement: MotionProblem, checks: Mapping[str, CameraCheck]
) -> dict[str, MovedPair]:
    volume = reference.volume_world
    if not len(volume):
        volume = np.concatenate([placed.apply(reference.target_points) for placed in agreement.placed.values()])
    after = {
        name: moved_camera(camera, checks[name].motion.motion) if name in checks and checks[name].moved else camera
        for name, camera in reference.rig.cameras.items()
    }
    effects = {
        pair.name: moved_pair(pair, after[pair.left.name], after[pair.right.name], volume)
        for pair in reference.rig.pairs
        if after[pair.left.name] is not pair.left or after[pair.right.name] is not pair.right
    }
    return {name: effect for name, effect in effects.items() if effect is not None}


def _about_moves(
    checks: Mapping[str, CameraCheck],
    candidates: Sequence[tuple[str, ...]],
    pairs: Mapping[str, MovedPair],
    settings: CheckSettings,
) -> Iterator[str]:
    if not candidates[0]:
        most = max(checks.values(), key=lambda camera_check: camera_check.shift_px)
        yield (
            f"{len(checks)} cameras agree where the target stands to within their noise, at most "
            f"{most.shift_px:.3f} px ({most.camera})"
        )
        return
    for camera_check in sorted(checks.values(), key=lambda camera_check: -camera_check.shift_px):
        if camera_check.moved:
            yield (
                f"{camera_check.camera} moved: {motion_words(camera_check.motion)}, "
                f"{camera_check.shift_px:.2f} px on the target, {camera_check.motion.sigma:.0f} standard errors"
            )
    if len(candidates) > 1:
        others = " or ".join(" with ".join(names) for names in candidates[1:4])
        yield f"this exposure cannot distinguish that from {others}: it shows only relative motion. Add an exposure"
    for name, pair in sorted(pairs.items(), key=lambda item: -item[1].displacement_mm):
        yield (
            f"pair {name} now measures points {pair.displacement_mm:.3f} mm from where they are (limit "
            f"{settings.refuse_mm} mm), their shape {pair.shape_mm:.3f} mm wrong, sizes {pair.scale_ppm / 1e4:+.3f} %"
        )


def motion_words(motion: CameraMotion) -> str:
    """A motion in millimetres and degrees."""
    if motion.kind == "either":
        return f"{motion.alone_mm:.3f} mm if it slid, or {np.degrees(motion.alone_rad):.4f}° if it turned"
    size_mm, size_deg = np.linalg.norm(motion.shift_mm), np.degrees(np.linalg.norm(motion.turn_rad))
    shift = f"{size_mm:.3f} ± {motion.shift_std_mm:.3f} mm"
    turn = f"{size_deg:.4f} ± {np.degrees(motion.turn_std_rad):.4f}°"
    return {"shift": shift, "turn": turn}.get(motion.kind, f"{shift} and {turn}")


def _about_lenses(checks: Mapping[str, CameraCheck], reference: Reference) -> Iterator[str]:
    typical = float(np.median([camera_check.rms_px for camera_check in checks.values()]))
    for camera_check in checks.values():
        before = reference.rms_px.get(camera_check.camera, typical)
        if camera_check.rms_px > _LENS_RATIO * before:
            yield (
                f"what {camera_check.camera} sees fits no place of the target "
                f"({camera_check.rms_px:.3f} px left, {before:.3f} before): "
                "its focus or zoom, or the target, has changed"
            )


def _about_unseen(unseen: Sequence[str]) -> Iterator[str]:
    if unseen:
        yield f"not checked, as they did not see the target: {', '.join(unseen)}"


def _about_reference(reference: Reference) -> Iterator[str]:
    if reference.covariance is None:
        yield "the cameras came ready-made: their own errors are not known, and may pass for small motions"
