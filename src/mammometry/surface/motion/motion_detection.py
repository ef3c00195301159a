"""Detect, explain and correct motion between the calibration and the capture.

If a camera turned after the calibration, or the body moved between the pairs' exposures, pairs disagree about common
skin, and matched rows are off. `rigid_motion` estimates the most probable motions. If nothing moved, nothing is
changed. Otherwise, the cameras get their most probable poses, and if rigid motions do not suffice, as with a breathing
chest, the points are moved smoothly as well (docs/decisions/0027).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np

from mammometry.base.errors import SurfaceError
from mammometry.base.notices import Notice
from mammometry.base.value import value
from mammometry.calibration.adjust.calibrated import ParameterCovariance
from mammometry.calibration.adjust.linear_model import Fit
from mammometry.geometry import Array, Camera, Float64, Rig, Transform
from mammometry.geometry.twist import rigid_motions, without
from mammometry.matching.foreground.outlines_first import outline_first
from mammometry.surface.motion.agreement import RowErrors, differences
from mammometry.surface.motion.feature_evidence import CorrectionEvidence, SharedFeatures, weigh_correction
from mammometry.surface.motion.moved_images import displaced, retriangulated
from mammometry.surface.motion.rigid_motion import (
    BREATHS_MM,
    LEAST_EVIDENCE,
    Found,
    MotionParameters,
    Observed,
    most_probable,
    motion_parameters,
    observed,
    without_contradicted_rows,
    without_outliers,
)
from mammometry.surface.ranges.range_image import SIGMAS, RangeImage
from mammometry.surface.settings import StillnessSettings

LEAST_MM = 0.06
"""RMS displacement of the worst pair's points below which nothing is corrected, mm: two thirds of a clean surface's
error."""
_FIRST_OTHER_SKIN_MM = 12.0
"""`OTHER_SKIN_MM` of the first round, mm: a turn of 0.1° of a camera of the reference rig moves skin this far."""
_LEAST_SIGMAS = 2.0  # least significance of a displacement, standard deviations: small, noisy images seem to have moved
_SURE = 5.0  # multiple of `LEAST_EVIDENCE` from which motion is certain, even if its effect on each pair is not
_EXPLAINED_SHARE = 0.5
"""Largest share of the distance between pairs that may remain if features neither confirm nor refute the motion. True
motions leave a seventh, false ones on matte plaster two thirds."""
_UNEXPLAINED_MM = 0.12
"""Remaining disagreement above which a motion is not rigid, mm; clean captures leave at most 0.05 (decision 27)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Turn:
    """Turn of a camera about its own centre."""

    camera: str
    turn_deg: float
    std_deg: float
    """Standard deviation of the turn along its own axis."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Displaced:
    """Displacement of a pair's points by the motions, without a common motion of all pairs."""

    pair: str
    effect_mm: float
    """RMS displacement, mm."""
    std_mm: float
    """Its uncertainty, RMS standard deviation, mm."""
    body_mm: float
    """Part of it caused by the body, or by both cameras together, not by a turn of one camera."""


@value(eq=False)
class MotionEstimate:
    """Estimated motion between calibration and exposures."""

    compared: bool
    """Whether two pairs see common skin. If not, only the vertical disparity of each pair is known."""
    moved: bool
    """Whether anything moved."""
    corrected: bool
    """Whether `motions` are applied."""
    parameters: MotionParameters
    motions: Float64[Array, " p"]
    """Most probable motions. 0 if nothing moved."""
    covariance: Float64[Array, "p p"]
    """Covariance of the motion that remains after the correction. 0 if nothing moved."""
    rest_mm: float
    """Disagreement that no motion explains, standard deviation, mm. 0 if nothing moved."""
    evidence: float
    """Rise of the log probability of the observations due to the motions."""
    distance_mm: tuple[float, float]
    """RMS distance between pairs' surfaces, measured and after correction, mm."""
    unexplained: bool = False
    """Whether the rest exceeds matching errors, so that the motion is not rigid."""
    alone: str | None = None
    """Camera or pair whose motion alone explains everything, if any."""
    turns: tuple[Turn, ...] = ()
    """Cameras that certainly turned, largest turn first."""
    displaced: tuple[Displaced, ...] = ()
    """All pairs, most displaced first."""
    confirmation: CorrectionEvidence | None = None
    """Test of the motions with features, from which they were not estimated. None: not tested."""

    @property
    def refuted(self) -> bool:
        """Whether features show that nothing moved although the pairs disagree."""
        return self.confirmation is not None and self.confirmation.verdict == "refuted"

    @property
    def breathed(self) -> bool:
        """Whether the body deformed smoothly."""
        return bool(self.motions[self.parameters.of_breath].any())

    def rig(self, calibrated: Rig) -> Rig:
        """The cameras in their most probable poses."""
        return _moved_rig(calibrated, self.parameters, self.motions) if self.corrected else calibrated

    def apply_motion(self, image: RangeImage, calibrated: Rig) -> RangeImage:
        """A range image with the cameras in their most probable poses and a body that did not breathe."""
        return _apply(image, calibrated, self.parameters, self.motions) if self.corrected else image


def find(
    rig: Rig,
    range_images: Sequence[RangeImage],
    rows: Mapping[str, RowErrors],
    covariance: ParameterCovariance | None = None,
    settings: StillnessSettings = StillnessSettings(),
    shared: Callable[[], Sequence[SharedFeatures]] | None = None,
) -> MotionEstimate:
    """Estimate what moved since the calibration, from the pairs' disagreement.

    A motion is corrected only if independent evidence confirms it.

    Args:
        rig: as calibrated.
        range_images: range images of all pairs with this rig.
        rows: pair → its vertical disparity.
        covariance: covariance of the calibration. None for given cameras.
        settings: limits.
        shared: returns the features that cameras of different pairs share; called only if something seems to have
            moved. None: there are no photographs, and motions need no confirmation.

    Raises:
        SurfaceError: motions of cameras do not explain the disagreement, or are too large to be corrected.
    """
    apart = differences(range_images, _FIRST_OTHER_SKIN_MM)
    compared = {name for comparison in apart for name in (comparison.first, comparison.second)}
    rows = {name: rows[name] for name in rig.pair_names if name in rows and len(rows[name].points)}
    pairs = [name for name in rig.pair_names if name in compared or name in rows]
    centre = np.concatenate([comparison.points for comparison in apart]).mean(axis=0) if apart else np.zeros(3)
    parameters = motion_parameters(rig, pairs, centre)
    if not apart:
        return _nothing(parameters, compared=False)

    def most_probably(
        seen: Observed, parameters: MotionParameters, breaths_mm: Sequence[float] = (0.0,)
    ) -> tuple[Observed, Found]:
        kept = without_contradicted_rows(without_outliers(seen, parameters), parameters)
        return kept, most_probable(kept, parameters, breaths_mm)

    seen, moved = most_probably(observed(rig, apart, rows, covariance, parameters.effects), parameters)
    before_mm = seen.rms_mm()
    expected_mm = float(np.median(np.concatenate([comparison.expected_mm for comparison in apart])))
    limit_mm = max(_UNEXPLAINED_MM, expected_mm)
    evidence = moved.expected.log_evidence - moved.still.log_evidence
    if evidence < LEAST_EVIDENCE and moved.rest_mm < limit_mm:
        return _nothing(parameters, distance_mm=before_mm, evidence=evidence)
    breaths_mm: Sequence[float] = (0.0,)
    breathing = parameters.breathing(rig, np.concatenate([comparison.points for comparison in apart]))
    kept, smooth = most_probably(observed(rig, apart, rows, covariance, breathing.effects), breathing, BREATHS_MM)
    rigid = most_probable(kept, breathing)
    if smooth.expected.log_evidence - rigid.expected.log_evidence >= LEAST_EVIDENCE:
        parameters, moved, breaths_mm = breathing, smooth, BREATHS_MM
        evidence = moved.expected.log_evidence - moved.still.log_evidence
    # Estimate again, with the pairs compared where the corrected cameras see them.
    so_far = moved.expected.motions
    images = [_apply(image, rig, parameters, so_far) for image in range_images]
    again = observed(_moved_rig(rig, parameters, so_far), differences(images), rows, covariance, parameters.effects)
    values = again.values + np.where(again.distances, again.by_unknown @ so_far, 0.0)
    seen, moved = most_probably(replace(again, values=values), parameters, breaths_mm)
    best = moved.expected
    found = replace(_judged(rig, rows, moved, parameters), unexplained=moved.rest_mm >= limit_mm)
    found = replace(found, evidence=evidence, distance_mm=(before_mm, seen.rms_mm(best.motions)))
    sigmas = 0.0 if evidence >= _SURE * LEAST_EVIDENCE else _LEAST_SIGMAS
    matters = any(
        displacement.effect_mm >= max(LEAST_MM, sigmas * displacement.std_mm) for displacement in found.displaced
    )
    if not (matters or found.unexplained):
        return _nothing(parameters, distance_mm=before_mm, evidence=evidence)
    if shared is not None and evidence >= LEAST_EVIDENCE:
        found = replace(found, confirmation=_confirmed(rig, found, shared()))
    if found.refuted:
        return _matched_badly(found, moved.still_rest_mm, before_mm)
    _refuse(found, settings, expected_mm)
    if evidence >= LEAST_EVIDENCE and _is_trusted(found):
        return replace(found, corrected=True)
    return replace(found, covariance=found.covariance + np.outer(found.motions, found.motions))


def assumed_still(rig: Rig) -> MotionEstimate:
    """An estimate without motion, for rigs that are not tested. `rig`: as calibrated."""
    return _nothing(motion_parameters(rig, list(rig.pair_names), np.zeros(3)), compared=False)


def _confirmed(rig: Rig, found: MotionEstimate, shared: Sequence[SharedFeatures]) -> CorrectionEvidence:
    """Test of motions with the features that cameras of different pairs share."""
    parameters, motions = found.parameters, found.motions

    def breathed_mm(camera: str, points: Float64[Array, "n 3"]) -> Float64[Array, "n 3"]:
        pair = next(pair for pair in rig.pair_names if camera in rig.pair_names[pair])
        if not (found.breathed and _within(parameters, pair)):
            return np.zeros_like(points)
        along_mm = parameters.breath_mm(pair, points) @ motions[parameters.of_breath]
        return along_mm[:, None] * parameters.breath_direction

    return weigh_correction(rig, _moved_rig(rig, parameters, motions), breathed_mm, shared)


def _is_trusted(found: MotionEstimate) -> bool:
    """Whether features confirm the motions, or are silent and the motions explain the disagreement."""
    if found.confirmation is None or found.confirmation.verdict == "confirmed":
        return True
    before_mm, after_mm = found.distance_mm
    return not found.unexplained and after_mm < _EXPLAINED_SHARE * before_mm


def _matched_badly(found: MotionEstimate, rest_mm: float, before_mm: float) -> MotionEstimate:
    """An estimate without motion: the disagreement is a matching error, which the interval covers."""
    return replace(
        found,
        motions=np.zeros_like(found.motions),
        covariance=np.zeros_like(found.covariance),
        rest_mm=rest_mm,
        distance_mm=(before_mm, before_mm),
        alone=None,
        turns=(),
        unexplained=True,
    )


def _nothing(
    parameters: MotionParameters, *, compared: bool = True, distance_mm: float = 0.0, evidence: float = 0.0
) -> MotionEstimate:
    return MotionEstimate(
        compared=compared,
        moved=False,
        corrected=False,
        parameters=parameters,
        motions=np.zeros(parameters.count),
        covariance=np.zeros((parameters.count, parameters.count)),
        rest_mm=0.0,
        evidence=evidence,
        distance_mm=(distance_mm, distance_mm),
    )


def _apply(image: RangeImage, rig: Rig, parameters: MotionParameters, motions: Float64[Array, " p"]) -> RangeImage:
    """A pair's data with moved cameras and a body that did not breathe."""
    there = _moved_rig(rig, parameters, motions).pair(image.name)
    image = retriangulated(image, rig.pair(image.name), there)
    breath = motions[parameters.of_breath]
    if not breath.any() or not _within(parameters, image.name):
        return image
    along_mm = parameters.breath_mm(image.name, image.valid_points_world()) @ breath
    return displaced(image, along_mm[:, None] * parameters.breath_direction)


def _moved_rig(rig: Rig, parameters: MotionParameters, motions: Float64[Array, " p"]) -> Rig:
    cameras = dict(rig.cameras)
    for name in parameters.cameras:
        pair = next(pair for pair in rig.pair_names if name in rig.pair_names[pair] and _within(parameters, pair))
        cameras[name] = _moved(
            rig.cameras[name], motions[parameters.of_camera(name)], motions[parameters.of_group(pair)], parameters
        )
    return replace(rig, cameras=cameras)


def _within(parameters: MotionParameters, pair: str) -> bool:
    return any(pair in group for group in parameters.groups)


def _moved(camera: Camera, turn: Float64[Array, 3], motion: Float64[Array, 6], parameters: MotionParameters) -> Camera:
    """Turn a camera about its centre, then move it with its group."""
    turned = Transform.from_rotation_vector(turn.copy(), np.zeros(3)).rotation @ camera.camera_from_world.rotation
    about = Transform.from_rotation_vector(motion[:3].copy(), np.zeros(3)).rotation
    centre = about @ (camera.centre_world - parameters.centre_world) + parameters.centre_world + motion[3:]
    rotation = turned @ about.T
    return replace(camera, camera_from_world=Transform(rotation=rotation, translation_mm=-rotation @ centre))


def _judged(rig: Rig, rows: Mapping[str, RowErrors], moved: Found, parameters: MotionParameters) -> MotionEstimate:
    """The estimate with what moved, by how much, and the effect on each pair."""
    best, alone = moved.expected, moved.alone
    named = best if alone is None else alone[1]
    turns = [turn for turn in (_turn(name, named, parameters) for name in parameters.cameras) if turn is not None]
    effect = np.concatenate([parameters.effects(rig, name, seen.points).points_mm for name, seen in rows.items()])
    points = np.concatenate([seen.points for seen in rows.values()])
    free = without(rigid_motions(points - points.mean(axis=0)), effect)
    shift_alone = best.motions.copy()
    shift_alone[: 3 * len(parameters.cameras)] = 0.0
    displaced, start = [], 0
    for name, seen in rows.items():
        own = free[start : start + len(seen.points)]
        start += len(seen.points)
        spread = np.einsum("nip,pq,niq->n", own, best.covariance, own)
        displaced.append(
            Displaced(
                pair=name,
                effect_mm=_rms(own @ best.motions),
                std_mm=float(np.sqrt(np.mean(spread))),
                body_mm=_rms(own @ shift_alone),
            )
        )
    return MotionEstimate(
        compared=True,
        moved=True,
        corrected=False,
        parameters=parameters,
        motions=best.motions,
        covariance=best.covariance,
        rest_mm=moved.rest_mm,
        evidence=0.0,
        distance_mm=(0.0, 0.0),
        alone=None if alone is None else alone[0],
        turns=tuple(sorted(turns, key=lambda turn: -turn.turn_deg)),
        displaced=tuple(sorted(displaced, key=lambda displacement: -displacement.effect_mm)),
    )


def _turn(name: str, best: Fit, parameters: MotionParameters) -> Turn | None:
    """Turn of a camera. None if it is not certain."""
    where = parameters.of_camera(name)
    turn, spread = best.motions[where], best.covariance[where, where]
    size = float(np.linalg.norm(turn))
    std = float(np.sqrt(turn @ spread @ turn) / size) if size > 0 else 0.0
    certain = size > SIGMAS * std
    return Turn(camera=name, turn_deg=float(np.degrees(size)), std_deg=float(np.degrees(std))) if certain else None


def _rms(vectors: Float64[Array, "n 3"]) -> float:
    return float(np.sqrt(np.mean(np.sum(vectors**2, axis=1))))


def _refuse(found: MotionEstimate, settings: StillnessSettings, expected_mm: float) -> None:
    if found.rest_mm > max(settings.most_unexplained_mm, SIGMAS * expected_mm):
        raise SurfaceError(
            "pairs of the capture",
            found=f"surfaces {found.distance_mm[0]:.2f} mm apart (RMS), {found.distance_mm[1]:.2f} mm with the best "
            "motion of every camera and pair",
            expected=f"at most {settings.most_unexplained_mm:g} mm that no such motion explains",
            remedy="The body probably moved or breathed between the exposures: expose all cameras together, and repeat",
        )
    worst = found.displaced[0] if found.displaced else None
    if worst is not None and worst.effect_mm > settings.most_mm:
        names = ", ".join(f"{turn.camera} by {turn.turn_deg:.2f}°" for turn in found.turns[:2])
        raise SurfaceError(
            f"pair {worst.pair}",
            found=f"points {worst.effect_mm:.1f} mm from the other pairs'" + (f" ({names})" if names else ""),
            expected=f"at most {settings.most_mm:g} mm, which can be corrected",
            remedy="A camera has moved since the calibration: calibrate again"
            if found.confirmation is None or found.confirmation.verdict == "confirmed"
            else "A camera has moved since the calibration, or pairs were matched badly, as on skin without texture: "
            "calibrate again, or give the subject texture and light",
        )


_MOST_PART, _LITTLE = 0.7, 0.35
"""Share of a displacement above which only the body moved, and below which only cameras did. For texts only."""
_NAMED = 3  # most cameras in a sentence


def concerns(found: MotionEstimate, missing: Mapping[str, Sequence[str]] = MappingProxyType({})) -> Iterator[Notice]:
    """Yield the warnings about motion that concern the volume.

    Args:
        found: the estimate.
        missing: pair → its cameras without an outline, which must be drawn before a cause is named.
    """
    if not found.moved:
        return
    before_mm, after_mm = found.distance_mm
    if found.refuted:
        yield Notice(code="pairs-matched-less-well", values={"mm": before_mm})
        return
    worst = found.displaced[0]
    yield outline_first(missing[worst.pair]) if missing.get(worst.pair) else cause(found)
    code = "motion-corrected" if found.corrected else "motion-not-corrected"
    yield Notice(
        code=code if found.corrected or found.confirmation is None else "motion-not-confirmed",
        about=(worst.pair,),
        values={"mm": worst.effect_mm, "std_mm": worst.std_mm, "before_mm": before_mm, "after_mm": after_mm},
    )
    if found.unexplained:
        yield Notice(code="motion-unexplained", values={"mm": found.rest_mm})


def cause(found: MotionEstimate) -> Notice:
    """Notice of what moved, with the remedy."""
    worst = found.displaced[0]
    share = worst.body_mm / worst.effect_mm if worst.effect_mm > 0 else 0.0
    turns = found.turns[:_NAMED]
    cameras = tuple(turn.camera for turn in turns)
    named = ", ".join(f"{turn.camera} {turn.turn_deg:.3f} ± {turn.std_deg:.3f}°" for turn in turns)
    if found.alone in found.parameters.cameras:
        if named:
            return Notice(code="camera-turned", about=cameras, values={"turns": named})
        return Notice(code="camera-turned-probably", about=(str(found.alone),))
    if share >= _MOST_PART or found.alone is not None:
        code = "body-breathed" if found.breathed else "body-moved"
        return Notice(code=code, about=(worst.pair,), values={"mm": worst.body_mm})
    values: dict[str, float | str] = {"turns": named or "which ones is not certain"}
    if share > _LITTLE:
        return Notice(code="cameras-and-body-moved", about=cameras, values=values | {"mm": worst.body_mm})
    return Notice(code="cameras-turned", about=cameras, values=values)


def summary(found: MotionEstimate) -> str:
    """One line about motion for the technician."""
    if not found.compared:
        return "not compared: no two pairs see the same skin"
    if not found.moved:
        return f"nothing moved; pairs agree to {found.distance_mm[0]:.3f} mm (RMS)"
    if found.refuted:
        return f"nothing moved, although pairs agree only to {found.distance_mm[0]:.3f} mm (RMS)"
    pairs = ", ".join(
        f"{displacement.pair} {displacement.effect_mm:.2f} ± {displacement.std_mm:.2f} mm"
        for displacement in found.displaced
    )
    return (
        f"{'corrected' if found.corrected else 'not corrected'}: {pairs}; pairs agree to {found.distance_mm[1]:.3f} mm"
    )
