"""Test whether a rig's size fits its subject, or its lengths are in a wrong unit.

A whole capture can have a wrong scale without any residual. A wrong unit shows in the width of the field of view at the
subject, which must contain a cast or a body.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence

import numpy as np

from mammometry.base.errors import CalibrationError, SessionError
from mammometry.base.notices import Notice
from mammometry.base.sizes import SUBJECT_MM, Range, Size, fitting, likely_units
from mammometry.calibration.adjust.calibrated import Calibration
from mammometry.calibration.judge.expected_error import meeting_point
from mammometry.geometry.camera import Rig

_MARGIN = 1.25
"""Smallest width of the field of view, in widths of the subject."""
_BREAST_MM = 120.0
"""Smallest width of a torso's part that a camera must see. Real bases are 110 to 150 mm wide, plus skin around them."""
_USUAL_VIEW_MM: Range = (120.0, 1200.0)
"""Usual width of the field of view at the subject. Simulated rigs have 280 to 440 mm, known real ones 150 to 450."""
_BASELINE_MM: Range = (10.0, 2500.0)
"""Possible distance between a pair's cameras: the smallest stereo modules have 18 mm."""
_USUAL_BASELINE_MM: Range = (30.0, 1500.0)
"""Usual distance between a pair's cameras. Simulated rigs and known real ones have 100 to 450 mm."""
_PARALLEL_COSINE = float(np.cos(np.radians(5.0)))
"""Largest angle between optical axes that count as parallel, so that they meet nowhere: 5°."""


def require_scale(calibration: Calibration, subject_kind: str) -> None:
    """Refuse a calibration whose target size gives a rig that cannot see its subject.

    Args:
        calibration: its target has the sizes in session.toml.
        subject_kind: ``model``, ``torso`` or ``surface``.

    Raises:
        CalibrationError: names the size in session.toml, and the one that would fit.
    """
    sizes = calibrated_sizes(calibration, subject_kind)
    wrong = _impossible(sizes)
    if wrong is None:
        return
    name, stated_mm = calibration.observations.target.stated_size
    raise CalibrationError(
        f"session.toml: target.{name}",
        found=f"{stated_mm:g} mm, with which {wrong}",
        expected=wrong.expected,
        remedy=f"Measure the target, and enter its sizes in millimetres{fitting(stated_mm, sizes)}",
    )


def require_camera_scale(file: str, rig: Rig, subject_kind: str) -> tuple[Notice, ...]:
    """Refuse imported cameras that cannot see their subject.

    Args:
        file: the cameras' file or files, for the message.
        rig: the cameras and pairs.
        subject_kind: ``model``, ``torso`` or ``surface``.

    Returns:
        Warnings about doubtful lengths. Empty if they are usual.

    Raises:
        SessionError: names the file and the unit that would fit.
    """
    sizes = _rig_sizes(rig, subject_kind)
    units = [f"{unit} (multiply by {factor:g})" for unit, factor in likely_units(sizes).items()]
    seem = f": they seem to be in {' or '.join(units)}" if units else ""
    wrong = _impossible(sizes)
    if wrong is not None:
        raise SessionError(
            file,
            found=f"translations with which {wrong}",
            expected=wrong.expected,
            remedy=f"Give the cameras' translations in millimetres{seem}",
        )
    fits = " or ".join(units) or "none"
    return tuple(
        Notice(code=f"imported-{size.name}-rare", values={"mm": size.mm, "units": fits})
        for size in sizes
        if not size.is_usual()
    )


def _impossible(sizes: Sequence[Size]) -> Size | None:
    return next((size for size in sizes if not size.is_possible), None)


def calibrated_sizes(calibration: Calibration, subject_kind: str = "model") -> tuple[Size, ...]:
    """Sizes of a calibrated rig, with the target at the subject's position."""
    depths: dict[str, list[float]] = {}
    for seen in calibration.observations.detections:
        if seen.pose in calibration.world_from_target:
            camera = calibration.rig.cameras[seen.camera]
            camera_from_target = camera.camera_from_world @ calibration.world_from_target[seen.pose]
            depth_mm = float(camera_from_target.apply(calibration.target_points[seen.ids])[:, 2].mean())
            depths.setdefault(seen.camera, []).append(depth_mm)
    depths_mm = {name: float(np.median(values)) for name, values in depths.items()}
    return _sizes(calibration.rig, depths_mm, subject_kind, "where the target was held")


def _rig_sizes(rig: Rig, subject_kind: str) -> tuple[Size, ...]:
    """Sizes of a rig without calibration photographs, with the subject where the cameras' axes meet."""
    depths_mm = {}
    axes = np.stack([camera.axis_world for camera in rig.cameras.values()])
    if (axes @ axes.T).min() <= _PARALLEL_COSINE:
        middle = meeting_point(rig)
        depths_mm = {
            name: float(camera.camera_from_world.apply(middle[None])[0, 2]) for name, camera in rig.cameras.items()
        }
    return _sizes(rig, depths_mm, subject_kind, "where the cameras' axes meet")


def _sizes(rig: Rig, depths_mm: Mapping[str, float], subject_kind: str, where: str) -> tuple[Size, ...]:
    """Median short side of the fields of view at these depths, and median baseline of the pairs, mm.

    Casts and bodies have usual sizes. A surface may have any size, so no possible size is unusual.
    """
    baselines = [float(np.linalg.norm(pair.left.centre_world - pair.right.centre_world)) for pair in rig.pairs]
    views = [
        depth_mm * min(rig.cameras[name].size_wh) / float(rig.cameras[name].matrix[0, 0])
        for name, depth_mm in depths_mm.items()
        if depth_mm > 0
    ]
    sizes = []
    if views:
        least_mm = _MARGIN * (_BREAST_MM if subject_kind == "torso" else SUBJECT_MM[0])
        possible_mm = (least_mm, SUBJECT_MM[1])
        sizes.append(
            Size(
                mm=float(np.median(views)),
                name="view",
                possible_mm=possible_mm,
                usual_mm=possible_mm if subject_kind == "surface" else _USUAL_VIEW_MM,
                words=f"the shorter side of the field of view is {{}} {where}",
            )
        )
    if baselines:
        sizes.append(
            Size(
                mm=float(np.median(baselines)),
                name="baseline",
                possible_mm=_BASELINE_MM,
                usual_mm=_BASELINE_MM if subject_kind == "surface" else _USUAL_BASELINE_MM,
                words="the two cameras of a pair are {} apart",
            )
        )
    return tuple(sizes)


def require_sides(rig: Rig, upside_down: Collection[str]) -> None:
    """Refuse a pair whose right camera is to the left of the left one.

    A pair is accepted if the left camera is on the left as seen from behind, or in the images. These differ for cameras
    that are mounted upside down. No result depends on which camera is called left.

    Args:
        rig: as calibrated.
        upside_down: cameras that are mounted upside down.

    Raises:
        CalibrationError: names the pair, and what to do.
    """
    for pair in rig.pairs:
        x_mm, y_mm, _ = pair.left.camera_from_world.apply(pair.right.centre_world)
        if pair.left.name in upside_down:
            if pair.right.name in upside_down:
                continue  # left in the images is right from behind: both are accepted
            x_mm = -x_mm
        if x_mm < 0 and abs(x_mm) > abs(y_mm):
            opposed = pair.left.camera_from_world.rotation[0] @ pair.right.camera_from_world.rotation[0] < 0
            reversed_ = pair.left.name in upside_down or pair.right.name in upside_down
            raise CalibrationError(
                f"pair {pair.name}",
                found=f"{pair.right.name} {-x_mm:.0f} mm to the left of {pair.left.name}",
                expected="the right camera to the right of the left one, as seen in their images",
                remedy="State in session.toml which camera is mounted upside down, such as "
                f'rig.mounting = {{ {pair.left.name} = "upside-down" }}'
                if opposed and not reversed_
                else "Exchange left and right in the pair, or the two cameras' files if those are swapped. If all "
                "photographs were mirrored, export them as the cameras took them",
            )
