"""Findings about a calibration, as notices with their consequence in millimetres."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np

from mammometry.base.notices import Level, Notice
from mammometry.base.sizes import fitting_values
from mammometry.calibration.adjust.calibrated import Calibration
from mammometry.calibration.adjust.initialise import LEAST_POINTS
from mammometry.calibration.detection.detect import Detection
from mammometry.calibration.judge.pose_motion import MovedCameras
from mammometry.calibration.judge.reconstruction import PairQuality, ViewQuality, sees_badly
from mammometry.calibration.judge.scale import calibrated_sizes
from mammometry.calibration.settings import QualitySettings
from mammometry.calibration.targets.board import Board
from mammometry.geometry.arrays import Array, Float64

_FITS_NOISES = 10.0
"""Ratio of a picture's median error to the RMS residual up to which the picture fits a camera and pose."""
_FITS_PX = 0.1
"""Errors below this always fit, px."""


@dataclass(frozen=True, slots=True)
class PhotographKey:
    """Camera and pose of one photograph."""

    camera: str
    pose: str


def true_shot(calibration: Calibration, detection: Detection) -> PhotographKey | None:
    """Find the camera and pose that a misfitting view really shows. None if there is none."""
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
"""Bias above which a camera must have moved."""
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
"""Expected error above which the rig is too inaccurate to measure with."""
_MOVED_REFUSE_MM = 0.05
"""Displacement of measured points, by motion between poses, above which the poses must not be used together."""
_COVERAGE_WARN = 0.4
"""Share of a photograph, in cells of an 8 × 6 grid, in which the target was seen. Below it the lens is untested."""
_VOLUME_COVERAGE_WARN = 0.25
"""Share of the working volume near which the target was shown. Below it, parts where skin will be are untested."""
RESIDUAL_GOOD_MM = _GEOMETRY_REFUSE_MM / 10
"""RMS residual at the target's distance up to which it is called good: a tenth of the limit from the paper's plate."""
_RESIDUAL_WARN_MM = 0.2
"""RMS residual at the target's distance above which the pictures or the target are wrong."""
_LEFT_OUT_WARN = 1.2
"""Ratio of left-out to fitted residuals of the same poses, corrected for the number of unknowns. Above it, the cameras
are inaccurate elsewhere. 1.0 if points have independent errors, 1.05–1.1 if a photograph's points have common errors,
1.25 or more with three such poses."""
_BLURRED_RATIO = 5.0
"""RMS of a view over that of the others above which it is called blurred."""
_REJECTED_WARN = 0.15
"""Share of a view's points excluded as outliers that gives a warning. Clean views lose up to a tenth: corners at the
board's edge, or out of focus, have errors larger than their σ."""

Verdict: TypeAlias = Literal["pass", "warn", "refuse"]
Values: TypeAlias = Mapping[str, float | str]


@dataclass(frozen=True, slots=True)
class CalibrationFinding:
    """A fact about a calibration, and its verdict."""

    verdict: Verdict
    notice: Notice
    """Its ``photographs`` are those concerned. Empty: it concerns the whole calibration."""


def _found(
    verdict: Verdict, code: str, *about: str, shots: Iterable[PhotographKey] = (), values: Values | None = None
) -> CalibrationFinding:
    photographs = tuple(f"calibration/{shot.pose}/{shot.camera}" for shot in shots)
    level: Level = "note" if verdict == "pass" else "warning"
    return CalibrationFinding(
        verdict, Notice(code=code, level=level, about=about, photographs=photographs, values=values or {})
    )


_SQUARE_PIXELS, _SURE_SIGMA = 0.01, 5.0
"""Relative difference of fx and fy, and the same in standard deviations: pixels are not square above both. Real cameras
have less than 0.001; prints are stretched by up to 0.005."""


def about_names(calibration: Calibration) -> Iterator[CalibrationFinding]:
    """Report pictures under the wrong name."""
    aside = {(view.camera, view.pose): view.residual_px for view in calibration.set_aside}
    by_shot = {(seen.camera, seen.pose): seen for seen in calibration.observations.detections}
    truly = {shot: true_shot(calibration, by_shot[shot]) for shot in aside if shot in by_shot}
    reported = set()
    for (camera, pose), residual_px in aside.items():
        other = truly.get((camera, pose))
        own = PhotographKey(camera, pose)
        if other is None:
            yield _found("warn", "photograph-unfitting", camera, shots=[own], values={"pose": pose, "px": residual_px})
            continue
        exchanged = truly.get((other.camera, other.pose)) == own
        if exchanged and (other.camera, other.pose) in reported:
            continue
        reported.add((camera, pose))
        yield _found(
            "warn",
            "photographs-exchanged" if exchanged else "photograph-of-another",
            *dict.fromkeys((camera, other.camera)),
            shots=[own, other],
            values={"camera": camera, "pose": pose, "other_camera": other.camera, "other_pose": other.pose},
        )


def about_missed(calibration: Calibration) -> Iterator[CalibrationFinding]:
    """Report photographs that should show the target and cannot be used.

    A view is fine if, by the finished calibration, the camera saw the target's back or edge, or did not see it at all.
    """
    for view in calibration.observations.missed:
        if view.remedy and not sees_badly(calibration, view.camera, view.pose):
            shots = [PhotographKey(view.camera, view.pose)]
            values = {"pose": view.pose, "found": view.found, "remedy": view.remedy.rstrip(".")}
            yield _found("warn", "target-not-found", view.camera, shots=shots, values=values)


def about_inverse(calibration: Calibration) -> Iterator[CalibrationFinding]:
    """Report a target that is printed white on black."""
    seen = calibration.observations.detections
    count = sum(view.inverse for view in seen)
    if count:
        yield _found("pass", "target-inverse", values={"photographs": count, "total": len(seen)})


def about_movements(movements: Sequence[MovedCameras]) -> Iterator[CalibrationFinding]:
    """Report cameras that moved during the calibration."""
    for movement in movements:
        values: dict[str, float | str] = {
            "pose": movement.first,
            "mm": float(np.linalg.norm(movement.shift_mm)),
            "deg": float(np.degrees(np.linalg.norm(movement.turn_rad))),
            "px": movement.shift_px,
            "sigma": movement.sigma,
        }
        if len(movement.cameras) > 1:
            code = "cameras-not-together"
        elif movement.only:
            code = "camera-not-together"
        else:
            code, values = "camera-moved", {**values, "effect_mm": movement.effect_mm}
        shots = [PhotographKey(camera, movement.first) for camera in movement.cameras]
        verdict: Verdict = "refuse" if movement.effect_mm > _MOVED_REFUSE_MM else "warn"
        yield _found(verdict, code, *movement.cameras, shots=shots, values=values)


def about_fit(calibration: Calibration, views: Sequence[ViewQuality]) -> Iterator[CalibrationFinding]:
    """Report an adjustment that did not converge, and views that fit badly or lost many points."""
    if not calibration.converged:
        yield _found("warn", "not-converged", values={"iterations": calibration.iterations})
    aside = {(view.camera, view.pose) for view in calibration.set_aside}
    taking_part = [view for view in views if (view.camera, view.pose) not in aside]
    typical_px = float(np.nanmedian([view.rms_px for view in taking_part])) if taking_part else float("nan")
    for view in sorted(taking_part, key=lambda view: -view.rejected):
        shots = [PhotographKey(view.camera, view.pose)]
        if view.rejected > _REJECTED_WARN * view.points and view.rejected > 1:
            counts: Values = {"pose": view.pose, "points": view.rejected, "total": view.points}
            yield _found("warn", "points-left-out", view.camera, shots=shots, values=counts)
        if view.rms_px > _BLURRED_RATIO * typical_px:
            sizes: Values = {"pose": view.pose, "px": view.rms_px, "typical_px": typical_px}
            yield _found("warn", "photograph-blurred", view.camera, shots=shots, values=sizes)


def about_bias(calibration: Calibration, views: Sequence[ViewQuality]) -> Iterator[CalibrationFinding]:
    """Report views with biased residuals that no rigid motion explains."""
    aside = {(view.camera, view.pose) for view in calibration.set_aside}
    for view in sorted(views, key=lambda view: -view.bias):
        if view.bias > _BIAS_WARN and (view.camera, view.pose) not in aside:
            yield _found(
                "refuse" if view.bias > BIAS_REFUSE else "warn",
                "points-shifted",
                view.camera,
                shots=[PhotographKey(view.camera, view.pose)],
                values={"pose": view.pose, "sigma": view.bias, "limit": BIAS_REFUSE},
            )


def about_cameras(
    calibration: Calibration,
    focal_std: Mapping[str, float],
    coverage: Mapping[str, float],
    volume_coverage: float,
    settings: QualitySettings,
) -> Iterator[CalibrationFinding]:
    """Report lenses that are not well determined, and parts of pictures and volume without target points."""
    places = np.median([placed.translation_mm for placed in calibration.world_from_target.values()], axis=0)
    for name, std in focal_std.items():
        if std > min(_FOCAL_STD_WARN, settings.focal_std_refuse):
            depth_mm = float(np.linalg.norm(places - calibration.rig.cameras[name].centre_world)) * std
            separate = calibration.intrinsics_observations.get(name)
            seen = calibration.observations.detections + (separate.detections if separate else ())
            yield _found(
                "refuse" if std > settings.focal_std_refuse else "warn",
                "focal-length-uncertain",
                name,
                values={
                    "percent": 100 * std,
                    "limit_percent": 100 * settings.focal_std_refuse,
                    "views": sum(view.camera == name for view in seen),
                    "mm": depth_mm,
                },
            )
    for name, share in coverage.items():
        if share < _COVERAGE_WARN:
            yield _found("warn", "lens-little-covered", name, values={"percent": 100 * share})
    if volume_coverage < _VOLUME_COVERAGE_WARN:
        yield _found("warn", "space-little-covered", values={"percent": 100 * volume_coverage})


def about_pixels(calibration: Calibration) -> Iterator[CalibrationFinding]:
    """Report pixels that are not square: the target's sizes or the pictures are stretched."""
    for name, camera in calibration.rig.cameras.items():
        std = calibration.independent_std[name]
        ratio = float(camera.matrix[0, 0] / camera.matrix[1, 1])
        ratio_std = float(np.hypot(std["fx_px"], std["fy_px"]) / camera.matrix[1, 1])
        if abs(ratio - 1.0) > max(_SQUARE_PIXELS, _SURE_SIGMA * ratio_std):
            solid = calibration.observations.target.is_surveyed
            yield _found("refuse" if solid else "warn", "pixels-not-square", name, values={"ratio": ratio})


def about_pairs(pairs: Sequence[PairQuality]) -> Iterator[CalibrationFinding]:
    """Report how each pair reconstructs the target."""
    for pair in pairs:
        if not pair.poses:
            yield _found("warn", "pair-without-target", pair.pair)
            continue
        if pair.geometry_mm > _GEOMETRY_WARN_MM:
            verdict: Verdict = "refuse" if pair.geometry_mm > _GEOMETRY_REFUSE_MM else "warn"
            sizes = {"mm": pair.geometry_mm, "limit_mm": _GEOMETRY_REFUSE_MM}
            yield _found(verdict, "pair-reconstruction-error", pair.pair, values=sizes)
        if abs(pair.scale_ppm) > _SCALE_WARN_PPM:
            verdict = "refuse" if abs(pair.scale_ppm) > _SCALE_REFUSE_PPM else "warn"
            percent = pair.scale_ppm / 1e4
            yield _found(
                verdict, "pair-scale-error", pair.pair, values={"percent": percent, "volume_percent": 3 * percent}
            )


def about_expected(expected_mm: Mapping[str, float]) -> Iterator[CalibrationFinding]:
    """Report the errors of measured points due to the cameras' uncertainty."""
    known = {pair: error_mm for pair, error_mm in expected_mm.items() if np.isfinite(error_mm)}
    if known:
        pair = max(known, key=lambda name: known[name])
        values = {"mm": known[pair], "good_mm": _EXPECTED_WARN_MM}
        if known[pair] <= _EXPECTED_WARN_MM:
            yield _found("pass", "expected-error", pair, values=values)
        else:
            verdict: Verdict = "refuse" if known[pair] > _EXPECTED_REFUSE_MM else "warn"
            yield _found(verdict, "expected-error-large", pair, values={**values, "limit_mm": _EXPECTED_REFUSE_MM})


def about_left_out(calibration: Calibration) -> Iterator[CalibrationFinding]:
    """Report whether left-out poses fit as well as those that were used."""
    left_out = calibration.left_out
    if left_out is None:
        if not calibration.observations.target.is_surveyed:  # one exposure of a surveyed target is enough
            yield _found("warn", "no-pose-left-out")
        return
    values = {"px": left_out.left_out_px, "ratio": left_out.ratio, "excess": left_out.excess}
    if left_out.excess > _LEFT_OUT_WARN:
        yield _found("warn", "left-out-misfit", values={**values, "limit": _LEFT_OUT_WARN})
    else:
        yield _found("pass", "left-out-fit", values=values)


def about_scale(calibration: Calibration) -> Iterator[CalibrationFinding]:
    """Report the uncertainty of all lengths. No residual shows a print of another scale."""
    name, stated_mm = calibration.observations.target.stated_size
    sizes = calibrated_sizes(calibration)
    for size in sizes:
        if not size.is_usual():
            fits = " or ".join(fitting_values(stated_mm, sizes)) or "none"
            values: dict[str, float | str] = {"name": name, "stated_mm": stated_mm, "mm": size.mm, "fits": fits}
            yield _found("warn", f"target-{size.name}-rare", values=values)
    std = calibration.scale_std
    if std is None:
        yield _found("pass", "target-not-measured")
    else:
        yield _found("pass", "target-measured", values={"percent": 100 * std, "volume_percent": 300 * std})


def about_residuals(rms_px: float, rms_mm: float) -> CalibrationFinding:
    """Report whether the residuals are large. Their limits are in millimetres."""
    values: dict[str, float | str] = {"px": rms_px, "mm": rms_mm, "good_mm": RESIDUAL_GOOD_MM}
    if rms_mm > _RESIDUAL_WARN_MM:
        return _found("warn", "residuals-large", values=values)
    grade = "good" if rms_mm <= RESIDUAL_GOOD_MM else "fair"
    return _found("pass", "residuals", values={**values, "grade": grade})


_STRETCH_WARN, _STRETCH_REFUSE = 3e-3, 1e-2
"""Relative difference of a board's scales along x and y. Half of it may affect every length, and one and a half times
it volumes."""
_BOW_WARN_MM = 1.0
"""Bow above which a board may not keep its shape while it is moved, mm. Assumed."""


def about_target(calibration: Calibration) -> Iterator[CalibrationFinding]:
    """Report a board that is stretched or bent, if its points were adjusted."""
    if not isinstance(calibration.observations.target, Board):
        return
    stretch, bow_mm = _stretch_and_bow(calibration.observations.target.points_target, calibration.target_points)
    if abs(stretch) > _STRETCH_WARN:
        yield _found(
            "refuse" if abs(stretch) > _STRETCH_REFUSE else "warn",
            "board-stretched",
            values={
                "percent": 100 * abs(stretch),
                "longer": "shorter" if stretch < 0 else "longer",
                "volume_percent": 150 * abs(stretch),
            },
        )
    if bow_mm > _BOW_WARN_MM:
        yield _found("warn", "board-bent", values={"mm": bow_mm})


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
