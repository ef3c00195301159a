"""Findings about a calibration, each a sentence with its consequence in millimetres."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Literal, TypeAlias

import numpy as np

from mammometry.base.sizes import fitting
from mammometry.calibration.adjust.bundle import Calibration
from mammometry.calibration.judge.cameras.pose_motion import Movement
from mammometry.calibration.judge.cameras.wrong_camera import Shot, true_shot
from mammometry.calibration.judge.reconstruction import PairQuality
from mammometry.calibration.judge.scale import calibrated_sizes
from mammometry.calibration.judge.view_quality import ViewQuality, sees_badly
from mammometry.calibration.settings import QualitySettings

Verdict: TypeAlias = Literal["pass", "warn", "refuse"]
Finding: TypeAlias = tuple[Verdict, str]
_PRINT_SCALE = 1e-3
"""Relative scale error of a print in the message's example. Chosen by eye."""

_SQUARE_PIXELS, _SURE_SIGMA = 0.01, 5.0
"""Share by which pixels may differ from squares, and standard deviations by which they then must. Real cameras are
below .001; prints are stretched by up to .005.
"""


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
                f"pose {pose}: the picture of {camera} does not fit the others (off by {residual_px:.0f} px) and was "
                "set aside. Check that it is the right file, and was exposed together with the others",
            )
        elif truly.get((other.camera, other.pose)) == Shot(camera, pose):
            if (other.camera, other.pose) not in reported:
                reported.add((camera, pose))
                where = f"pose {pose}" if other.pose == pose else f"poses {pose} and {other.pose}"
                names = f"{camera} and {other.camera}" if other.camera != camera else camera
                yield "warn", f"{where}: the pictures of {names} are exchanged. They were set aside"
        else:
            yield (
                "warn",
                f"pose {pose}: the picture of {camera} does not fit the others. It is the one of {other.camera} in "
                f"pose {other.pose}. It was set aside",
            )


def about_missed(calibration: Calibration) -> Iterator[Finding]:
    """Report photographs that should show the target and cannot be used.

    Where the finished calibration says that the camera looked at the target's back, its edge or past it, all is well.
    """
    for view in calibration.observations.missed:
        if view.remedy and not sees_badly(calibration, view.camera, view.pose):
            yield "warn", str(view)


def about_movements(movements: Sequence[Movement], settings: QualitySettings) -> Iterator[Finding]:
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
        yield "refuse" if movement.effect_mm > settings.moved_refuse_mm else "warn", sentence


def about_fit(calibration: Calibration, views: Sequence[ViewQuality], settings: QualitySettings) -> Iterator[Finding]:
    """Findings about an adjustment that did not settle.

    Also about views that lost many points or fit badly.
    """
    if not calibration.converged:
        yield "warn", f"the adjustment had not settled after {calibration.iterations} steps"
    aside = {(view.camera, view.pose) for view in calibration.set_aside}
    taking_part = [view for view in views if (view.camera, view.pose) not in aside]
    typical = float(np.nanmedian([view.rms_px for view in taking_part])) if taking_part else float("nan")
    for view in sorted(taking_part, key=lambda view: -view.rejected):
        if view.rejected > settings.rejected_warn * view.points and view.rejected > 1:
            yield (
                "warn",
                f"pose {view.pose}: {view.rejected} of {view.points} points of {view.camera} were left out as outliers",
            )
        if view.rms_px > settings.blurred_ratio * typical:
            yield (
                "warn",
                f"pose {view.pose}: points of {view.camera} are measured only to {view.rms_px:.2f} px, others to "
                f"{typical:.2f} px. Is the picture blurred, shaken or badly lit?",
            )


def about_bias(calibration: Calibration, views: Sequence[ViewQuality], settings: QualitySettings) -> Iterator[Finding]:
    """Findings about views with one-sided residuals without a rigid movement."""
    aside = {(view.camera, view.pose) for view in calibration.set_aside}
    for view in sorted(views, key=lambda view: -view.bias):
        if view.bias > settings.bias_warn and (view.camera, view.pose) not in aside:
            yield (
                "refuse" if view.bias > settings.bias_refuse else "warn",
                f"pose {view.pose}: all points that {view.camera} saw are shifted together by {view.bias:.0f} standard "
                f"errors (limit {settings.bias_refuse:.0f}). A camera or the target moved, or the target bent",
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
        if std > settings.focal_std_warn:
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
        if share < settings.coverage_warn:
            yield "warn", f"the target covered only {100 * share:.0f} % of the photographs of {name}. Add poses there"
    if volume_coverage < settings.volume_coverage_warn:
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


def about_pairs(pairs: Sequence[PairQuality], settings: QualitySettings) -> Iterator[Finding]:
    """Report how each pair reconstructs the target."""
    for pair in pairs:
        if not pair.poses:
            yield "warn", f"pair {pair.pair}: both cameras never saw the target in the same pose"
            continue
        if pair.geometry_mm > settings.geometry_warn_mm:
            yield (
                "refuse" if pair.geometry_mm > settings.geometry_refuse_mm else "warn",
                f"pair {pair.pair} reconstructs the target to {pair.geometry_mm:.2f} mm RMS (limit "
                f"{settings.geometry_refuse_mm} mm)",
            )
        if abs(pair.scale_ppm) > settings.scale_warn_ppm:
            yield (
                "refuse" if abs(pair.scale_ppm) > settings.scale_refuse_ppm else "warn",
                f"pair {pair.pair} reconstructs the target {pair.scale_ppm / 1e4:+.3f} % too large, "
                f"{3 * pair.scale_ppm / 1e4:+.2f} % in volume",
            )


def about_expected(expected_mm: Mapping[str, float], settings: QualitySettings) -> Iterator[Finding]:
    """Report the error of measured points by the cameras' uncertainty."""
    known = {pair: error_mm for pair, error_mm in expected_mm.items() if np.isfinite(error_mm)}
    if known:
        pair = max(known, key=lambda name: known[name])
        error_mm = known[pair]
        verdict: Verdict = "pass"
        if error_mm > settings.expected_warn_mm:
            verdict = "refuse" if error_mm > settings.expected_refuse_mm else "warn"
        advice = "" if verdict == "pass" else f", refused above {settings.expected_refuse_mm} mm. Add poses"
        yield (
            verdict,
            f"the cameras' uncertainty moves measured points by {error_mm:.3f} mm RMS (worst pair: {pair}, good up to "
            f"{settings.expected_warn_mm} mm){advice}",
        )


def about_left_out(calibration: Calibration, settings: QualitySettings) -> Iterator[Finding]:
    """Report whether poses left out fit as well as those adjusted."""
    left_out = calibration.left_out
    if left_out is None:
        if not calibration.observations.target.is_surveyed:  # of a surveyed target one exposure is enough
            yield "warn", "no pose could be left out for a test, because every one is needed. Add poses"
        return
    many = left_out.excess > settings.left_out_warn
    yield (
        "warn" if many else "pass",
        f"as a test, poses were left out of the adjustment. They fit to {left_out.left_out_px:.3f} px, "
        f"{left_out.ratio:.2f} times as far as the others and {left_out.excess:.2f} times as far as expected"
        + (
            f" (limit {settings.left_out_warn}). Do not trust the cameras where no target was shown. Add poses"
            if many
            else ""
        ),
    )


def about_scale(calibration: Calibration) -> Iterator[Finding]:
    """Report how well all lengths are known. No residual shows a print of another scale."""
    name, stated_mm = calibration.observations.target.stated_size
    sizes = calibrated_sizes(calibration)
    if rare := [size for size in sizes if not size.is_usual()]:
        yield (
            "warn",
            f"by target.{name} = {stated_mm:g} mm, {' and '.join(map(str, rare))}, which is rare. Measure the target, "
            f"and check that its sizes are in millimetres{fitting(stated_mm, sizes)}",
        )
    std = calibration.scale_std
    if std is None:
        yield (
            "pass",
            f"the printed board was not measured. If it is {100 * _PRINT_SCALE:.1f} % too large, volumes are "
            f"{300 * _PRINT_SCALE:.1f} % too large. Measure its edge, and enter edge_mm and edge_std_mm",
        )
    else:
        yield (
            "pass",
            f"the target was measured: sizes are known to {100 * std:.3f} %, volumes to {300 * std:.2f} %",
        )


def about_residuals(rms_px: float, rms_mm: float, settings: QualitySettings) -> Finding:
    """Report whether the residuals are large, by what they are in millimetres."""
    good = rms_mm <= settings.residual_good_mm
    fair = rms_mm <= settings.residual_warn_mm
    word = "good" if good else "fair" if fair else "poor: blur, noise, or a board that is not as described"
    return (
        "pass" if fair else "warn",
        f"the residuals are {rms_px:.3f} px RMS, {rms_mm:.3f} mm at the target (good up to "
        f"{settings.residual_good_mm} mm), which is {word}",
    )
