"""Imported cameras as a rig: each has a pose of its own, and lengths are in millimetres."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from itertools import combinations

import numpy as np

from mammometry.base.errors import SessionError
from mammometry.calibration.judge.scale import require_camera_scale, require_sides
from mammometry.geometry.camera import Camera, Rig

_ONE_PLACE_MM = 1e-6  # cameras nearer to each other stand in one place, but for rounding


def require_rig(
    files: str,
    cameras: Mapping[str, Camera],
    pair_names: Mapping[str, tuple[str, str]],
    subject_kind: str,
    upside_down: Collection[str] = (),
) -> tuple[str, ...]:
    """Refuse imported cameras in one place, on exchanged sides, or in another unit.

    Args:
        files: names of the cameras' files, for messages.
        cameras: all cameras of the pairs.
        pair_names: pair → its left and right camera.
        subject_kind: ``model``, ``torso`` or ``surface``.
        upside_down: cameras that are mounted with their tops down.

    Returns:
        Why their lengths are doubtful, in sentences. Empty if they are usual.

    Raises:
        SessionError: names the files, what was found, and the unit that would fit.
        CalibrationError: names the pair whose right camera stands left of the left one.
    """
    for camera_pair, other in combinations(dict.fromkeys(name for pair in pair_names.values() for name in pair), 2):
        distance_mm = np.linalg.norm(cameras[camera_pair].centre_world - cameras[other].centre_world)
        if distance_mm < _ONE_PLACE_MM:
            raise SessionError(
                files,
                found=f"no R and T by which cameras {camera_pair} and {other} stand in different places",
                expected="each camera's own R and T, all in one frame, T in millimetres",
                remedy="Export the cameras with their poses, from a calibration of the whole rig",
            )
    rig = Rig(name="imported", cameras=dict(cameras), pair_names=dict(pair_names))
    require_sides(rig, upside_down)
    return require_camera_scale(files, rig, subject_kind)
