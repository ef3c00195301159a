"""Findings about a calibration, each a sentence with its consequence in millimetres."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np

from mammometry.base.sizes import fitting
from mammometry.calibration.adjust.calibrated import Calibration
from mammometry.calibration.adjust.initialise import LEAST_POINTS
from mammometry.calibration.detection.detect import Detection
from mammometry.calibration.features.pixels import Cause
from mammometry.calibration.judge.pose_motion import MovedCameras
from mammometry.calibration.judge.reconstruction import PairQuality, ViewQuality, sees_badly
from mammometry.calibration.judge.scale import calibrated_sizes
from mammometry.calibration.settings import QualitySettings
from mammometry.calibration.targets.board import Board
from mammometry.geometry.arrays import Array, Float64

_FITS_NOISES = 10.0
"""Largest median error of a picture that fits a shot, in RMS residuals."""
_FITS_PX = 0.1
"""Errors below this always fit, px."""


@dataclass(frozen=True, slots=True)
class PhotographKey:
    """Camera and pose of one photograph."""

    camera: str
    pose: str


def true_shot(calibration: Calibration, detection: Detection) -> PhotographKey | None:
    """Find the camera and pose that a misfitting view really shows. None if none is known."""
    least, found = np.inf, None
    for pose, placed in calibration.world_from_target.items():
        points = placed.apply(calibration.target_points[detection.ids])
        for name, camera in calibration.rig.cameras.items():
            if (name, pose) != (detection.camera, detection.pose) and len(points) >= LEAST_POINTS:
                offset = np.linalg.norm(camera.project(points) - detection.uv, axis=1)
                off_px = float(np.nanmedian(offset)) if np.isfinite(offset).any() else np.inf
                if off_px < least:
                    least, found = off_px, PhotographKey(name, pose)
    return found if least < max(_FITS_NOISES * calibration.rms_px, _FITS_PX) else None


_BIAS_WARN = 8.0
"""Bias of a view (its median residual in standard errors) that gives a warning. Clean ones reach 4–5, a camera moved by
0.01 mm 7–9 at a quarter of the size, 36–46 at full size."""
BIAS_REFUSE = 20.0
"""Bias above which the cameras cannot have stood still."""
_FOCAL_STD_WARN = 2.5e-4
"""Relative standard deviation of a focal length that gives a warning: 0.2 mm of depth at 0.8 m."""
_GEOMETRY_WARN_MM = 0.1
"""RMS of the target's points, reconstructed from a pair, about their nominal shape that gives a warning."""
_GEOMETRY_REFUSE_MM = 0.5
"""The paper's depth error on a flat plate (Results). With a larger one, measuring is not worthwhile."""
_SCALE_WARN_PPM = 300.0
"""Scale error of a pair on the target that gives a warning, millionths of a length. Three times that in volume."""
_SCALE_REFUSE_PPM = 1500.0
"""Scale error of a pair above which volumes are off by half a percent from it alone."""
_EXPECTED_WARN_MM = 0.1
"""Expected error of reconstructed points in the working volume, from the cameras' uncertainty, that gives a warning.
Over the 300 cm² that a pair sees, 0.1 mm is 3 cc."""
_EXPECTED_REFUSE_MM = _GEOMETRY_REFUSE_MM
"""Expected error above which measuring is not worthwhile, likewise."""
_MOVED_REFUSE_MM = 0.05
"""Displacement of measured points by a movement between poses above which the poses must not be used together."""
_COVERAGE_WARN = 0.4
"""Share of a photograph, in cells of an 8 × 6 grid, in which the target was seen. Below it the lens is untested."""
_VOLUME_COVERAGE_WARN = 0.25
"""Share of the working volume near which the target was shown. Below it the volume is untested where skin will be."""
RESIDUAL_GOOD_MM = _GEOMETRY_REFUSE_MM / 10
"""RMS residual at the target's distance up to which it is called good: a tenth of what the paper's plate allows."""
_RESIDUAL_WARN_MM = 0.2
"""RMS residual at the target's distance above which the pictures or the target are wrong."""
_LEFT_OUT_WARN = 1.2
"""Residuals of poses left out over those of the same poses fitted, corrected for the number of unknowns. Above it, the
cameras are not trusted elsewhere. 1.0 if points err independently, 1.05–1.1 if a photograph's points err together, 1.25
and more with three such poses."""
_BLURRED_RATIO = 5.0
"""RMS of a view over that of the others above which it is called blurred."""
_REJECTED_WARN = 0.15
"""Share of a view's points left out as outliers that gives a warning. Clean views lose up to a tenth: corners at the
board's rim, or out of focus, err more than their σ."""

Verdict: TypeAlias = Literal["pass", "warn", "refuse"]
Finding: TypeAlias = tuple[Verdict, str, *tuple[PhotographKey, ...]]
"""Verdict, sentence, and the photographs that it is about."""


@dataclass(frozen=True, slots=True)
class Doubt:
    """A finding that deserves a look."""

    sentence: str
    shots: tuple[PhotographKey, ...] = ()
    """The photographs that it is about. Empty: it is about the whole calibration."""


_SQUARE_PIXELS, _SURE_SIGMA = 0.01, 5.0
"""Share by which pixels may differ from squares, and standard deviations by which they then must. Real cameras are
below .001; prints are stretched by up to .005."""


def about_names(calibration: Calibration) -> Iterator[Finding]:
    """Report pictures under the wrong name."""
    aside = {(view.camera, view.pose): view.residual_px for view in calibration.set_aside}
    by_shot = {(seen.camera, seen.pose): seen for seen in calibration.observations.detections}
    truly = {shot: true_shot(calibration, by_shot[shot]) for shot in aside if shot in by_shot}
    reported = set()
    for (camera, pose), residual_px in aside.items():
        other = truly.get((camera, pose))
        if other is None:
            yield (
                "warn",
                f"pose {pose}: the picture of {camera} does not fit the others (off by {residual_px:.2g} px) and was "
                "set aside. Check that it is the right file, and was exposed together with the others",
                PhotographKey(camera, pose),
            )
        elif truly.get((other.camera, other.pose)) == PhotographKey(camera, pose):
            if (other.camera, other.pose) not in reported:
                reported.add((camera, pose))
                where = f"pose {pose}" if other.pose == pose else f"poses {pose} and {other.pose}"
                names = f"{camera} and {other.camera}" if other.camera != camera else camera
                sentence = f"{where}: the pictures of {names} are exchanged. They were set aside"
                yield "warn", sentence, PhotographKey(camera, pose), other
        else:
            yield (
                "warn",
                f"pose {pose}: the picture of {camera} does not fit the others. It is the one of {other.camera} in "
                f"pose {other.pose}. It was set aside",
                PhotographKey(camera, pose),
                other,
            )


def about_missed(calibration: Calibration) -> Iterator[Finding]:
    """Report photographs that should show the target and cannot be used.

    Where the finished calibration says that the camera looked at the target's back, its edge or past it, all is well.
    """
    for view in calibration.observations.missed:
        if view.remedy and not sees_badly(calibration, view.camera, view.pose):
            yield "warn", str(view), PhotographKey(view.camera, view.pose)


def about_inverse(calibration: Calibration) -> Iterator[Finding]:
    """Report a target that is printed white on black."""
    seen = calibration.observations.detections
    count = sum(view.inverse for view in seen)
    if count:
        yield (
            "pass",
            f"the target is white on black in {count} of {len(seen)} photographs, which were read in the inverse. If "
            "it is printed black on white, these photographs are negatives",
        )


def about_movements(movements: Sequence[MovedCameras]) -> Iterator[Finding]:
    """Report cameras that moved during the calibration."""
    for movement in movements:
        size = f"{np.linalg.norm(movement.shift_mm):.3f} mm and {np.degrees(np.linalg.norm(movement.turn_rad)):.4f}°"
        seen = f"{movement.shift_px:.2f} px on the target, {movement.sigma:.0f} standard errors"
        if len(movement.cameras) > 1:
            sentence = f"pose {movement.first}: {' and '.join(movement.cameras)} were not exposed together with the "
            sentence += f"others, or the target moved between ({size}; {seen})"
        elif movement.only:
            sentence = f"pose {movement.first}: {movement.cameras[0]} was not exposed together with the "
            sentence += f"others, or moved in this pose alone ({size}; {seen}). Take this picture out"
        else:
            sentence = f"{movement.cameras[0]} moved before pose {movement.first}, by {size} ({seen}). "
            sentence += (
                f"Poses before and after do not belong together. Points would be {movement.effect_mm:.2f} mm off"
            )
        shots = (PhotographKey(camera, movement.first) for camera in movement.cameras)
        yield "refuse" if movement.effect_mm > _MOVED_REFUSE_MM else "warn", sentence, *shots


def about_fit(calibration: Calibration, views: Sequence[ViewQuality]) -> Iterator[Finding]:
    """Findings about an adjustment that did not settle, and views that fit badly or lost many points."""
    if not calibration.converged:
        yield "warn", f"the adjustment had not settled after {calibration.iterations} steps"
    aside = {(view.camera, view.pose) for view in calibration.set_aside}
    taking_part = [view for view in views if (view.camera, view.pose) not in aside]
    typical = float(np.nanmedian([view.rms_px for view in taking_part])) if taking_part else float("nan")
    for view in sorted(taking_part, key=lambda view: -view.rejected):
        if view.rejected > _REJECTED_WARN * view.points and view.rejected > 1:
            yield (
                "warn",
                f"pose {view.pose}: {view.rejected} of {view.points} points of {view.camera} were left out as outliers",
                PhotographKey(view.camera, view.pose),
            )
        if view.rms_px > _BLURRED_RATIO * typical:
            yield (
                "warn",
                f"pose {view.pose}: points of {view.camera} are measured only to {view.rms_px:.2f} px, others to "
                f"{typical:.2f} px. Is the picture blurred, shaken or badly lit?",
                PhotographKey(view.camera, view.pose),
            )


def about_bias(calibration: Calibration, views: Sequence[ViewQuality]) -> Iterator[Finding]:
    """Findings about views with one-sided residuals without a rigid movement."""
    aside = {(view.camera, view.pose) for view in calibration.set_aside}
    for view in sorted(views, key=lambda view: -view.bias):
        if view.bias > _BIAS_WARN and (view.camera, view.pose) not in aside:
            yield (
                "refuse" if view.bias > BIAS_REFUSE else "warn",
                f"pose {view.pose}: all points that {view.camera} saw are shifted together by {view.bias:.0f} standard "
                f"errors (limit {BIAS_REFUSE:.0f}). A camera or the target moved, or the target bent",
                PhotographKey(view.camera, view.pose),
            )


def about_cameras(
    calibration: Calibration,
    focal_std: Mapping[str, float],
    coverage: Mapping[str, float],
    volume_coverage: float,
    settings: QualitySettings,
) -> Iterator[Finding]:
    """Report how well each lens is known, and what was never tested."""
    places = np.median([placed.translation_mm for placed in calibration.world_from_target.values()], axis=0)
    for name, std in focal_std.items():
        if std > min(_FOCAL_STD_WARN, settings.focal_std_refuse):
            depth_mm = float(np.linalg.norm(places - calibration.rig.cameras[name].centre_world)) * std
            separate = calibration.intrinsics_observations.get(name)
            seen = calibration.observations.detections + (separate.detections if separate else ())
            views = sum(view.camera == name for view in seen)
            yield (
                "refuse" if std > settings.focal_std_refuse else "warn",
                f"the focal length of {name} is known only to {100 * std:.3f} % (limit "
                f"{100 * settings.focal_std_refuse:.2f} %) from {views} views. That is {depth_mm:.2f} mm in depth. Add "
                "poses, and tilt the target more",
            )
    for name, share in coverage.items():
        if share < _COVERAGE_WARN:
            yield "warn", f"the target covered only {100 * share:.0f} % of the photographs of {name}. Add poses there"
    if volume_coverage < _VOLUME_COVERAGE_WARN:
        yield (
            "warn",
            f"the target was shown in only {100 * volume_coverage:.0f} % of the space that the pairs see. Hold it also "
            "nearer, farther and to the sides, where skin will be",
        )


def about_pixels(calibration: Calibration) -> Iterator[Finding]:
    """Report pixels that are not square: two of the target's sizes, or the pictures, are stretched."""
    for name, camera in calibration.rig.cameras.items():
        std = calibration.independent_std[name]
        ratio = float(camera.matrix[0, 0] / camera.matrix[1, 1])
        ratio_std = float(np.hypot(std["fx_px"], std["fy_px"]) / camera.matrix[1, 1])
        if abs(ratio - 1.0) > max(_SQUARE_PIXELS, _SURE_SIGMA * ratio_std):
            solid = calibration.observations.target.is_surveyed
            yield (
                "refuse" if solid else "warn",
                f"the pixels of {name} are {ratio:.3f} times as high as wide, where cameras have square ones. "
                + ("Two sizes in [target] contradict one another, or" if solid else "The board or")
                + " the photographs were stretched",
            )


def about_pairs(pairs: Sequence[PairQuality]) -> Iterator[Finding]:
    """Report how each pair reconstructs the target."""
    for pair in pairs:
        if not pair.poses:
            yield "warn", f"pair {pair.pair}: both cameras never saw the target in the same pose"
            continue
        if pair.geometry_mm > _GEOMETRY_WARN_MM:
            yield (
                "refuse" if pair.geometry_mm > _GEOMETRY_REFUSE_MM else "warn",
                f"pair {pair.pair} reconstructs the target to {pair.geometry_mm:.2f} mm RMS (limit "
                f"{_GEOMETRY_REFUSE_MM} mm)",
            )
        if abs(pair.scale_ppm) > _SCALE_WARN_PPM:
            yield (
                "refuse" if abs(pair.scale_ppm) > _SCALE_REFUSE_PPM else "warn",
                f"pair {pair.pair} reconstructs the target {pair.scale_ppm / 1e4:+.3f} % too large, "
                f"{3 * pair.scale_ppm / 1e4:+.2f} % in volume",
            )


def about_expected(expected_mm: Mapping[str, float]) -> Iterator[Finding]:
    """Report the error of measured points by the cameras' uncertainty."""
    known = {pair: error_mm for pair, error_mm in expected_mm.items() if np.isfinite(error_mm)}
    if known:
        pair = max(known, key=lambda name: known[name])
        error_mm = known[pair]
        verdict: Verdict = "pass"
        if error_mm > _EXPECTED_WARN_MM:
            verdict = "refuse" if error_mm > _EXPECTED_REFUSE_MM else "warn"
        advice = "" if verdict == "pass" else f", refused above {_EXPECTED_REFUSE_MM} mm. Add poses"
        yield (
            verdict,
            f"the cameras' uncertainty moves measured points by {error_mm:.3f} mm RMS (worst pair: {pair}, good up to "
            f"{_EXPECTED_WARN_MM} mm){advice}",
        )


def about_left_out(calibration: Calibration) -> Iterator[Finding]:
    """Report whether poses left out fit as well as those adjusted."""
    left_out = calibration.left_out
    if left_out is None:
        if not calibration.observations.target.is_surveyed:  # of a surveyed target one exposure is enough
            yield "warn", "no pose could be left out for a test, because every one is needed. Add poses"
        return
    many = left_out.excess > _LEFT_OUT_WARN
    yield (
        "warn" if many else "pass",
        f"as a test, poses were left out of the adjustment. They fit to {left_out.left_out_px:.3f} px, "
        f"{left_out.ratio:.2f} times as far as the others and {left_out.excess:.2f} times as far as expected"
        + (f" (limit {_LEFT_OUT_WARN}). Do not trust the cameras where no target was shown. Add poses" if many else ""),
    )


def about_scale(calibration: Calibration) -> Iterator[Finding]:
    """Report how well all lengths are known. No residual shows a print of another scale."""
    name, stated_mm = calibration.observations.target.stated_size
    sizes = calibrated_sizes(calibration)
    if rare := [size for size in sizes if not size.is_usual()]:
        yield (
            "warn",
            f"by target.{name} = {stated_mm:g} mm, {' and '.join(map(str, rare))}, which is rare. If the subject is "
            f"of another size than that, check that the target's sizes are in millimetres{fitting(stated_mm, sizes)}",
        )
    std = calibration.scale_std
    if std is None:
        yield (
            "pass",
            "the printed board was not measured. If it is 0.1 % too large, volumes are 0.3 % too large. Measure its "
            "edge, and enter edge_mm and edge_std_mm",
        )
    else:
        yield ("pass", f"the target was measured: sizes are known to {100 * std:.3f} %, volumes to {300 * std:.2f} %")


def about_residuals(rms_px: float, rms_mm: float) -> Finding:
    """Report whether the residuals are large, by what they are in millimetres."""
    good = rms_mm <= RESIDUAL_GOOD_MM
    fair = rms_mm <= _RESIDUAL_WARN_MM
    word = "good" if good else "fair" if fair else "poor: blur, noise, or a board that is not as described"
    return (
        "pass" if fair else "warn",
        f"the residuals are {rms_px:.3f} px RMS, {rms_mm:.3f} mm at the target (good up to "
        f"{RESIDUAL_GOOD_MM} mm), which is {word}",
    )


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
