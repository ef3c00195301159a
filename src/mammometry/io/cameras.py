"""Cameras in our own cameras.json, and what the readers of other formats share."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from mammometry.calibration.paper_camera import PaperCamera
from mammometry.calibration.prior import LENS_NAMES, CameraPrior
from mammometry.errors import SessionError
from mammometry.geometry.camera import Camera
from mammometry.geometry.transform import Transform

CONVENTION = (
    "x_cam = R x_world + t; then pinhole with K; dist = k1, k2, p1, p2, k3 (OpenCV); pixel centres at integers; mm"
)
_FORMAT = 1
_ROUNDED = 1e-3  # a matrix this near to a rotation was one before its digits were cut
_KEYS = {"K", "dist", "R", "t", "image_size"}


def cameras_table(
    cameras: Mapping[str, Camera], std: Mapping[str, Mapping[str, float]] | None = None
) -> dict[str, Any]:
    """Cameras as the plain table that cameras.json holds; ``paper`` where the paper's eleven parameters say it all."""
    eleven = {name: PaperCamera.of(camera) for name, camera in cameras.items()}
    return {
        "format": _FORMAT,
        "convention": CONVENTION,
        "cameras": {
            name: {
                "image_size": list(camera.size_wh),
                "K": camera.matrix.tolist(),
                "dist": camera.distortion.tolist(),
                "R": camera.camera_from_world.rotation.tolist(),
                "t": camera.camera_from_world.translation_mm.tolist(),
                **({"std": dict(std[name])} if std and name in std else {}),
                **({"paper": paper.as_table()} if (paper := eleven[name]) else {}),
            }
            for name, camera in cameras.items()
        },
    }


def cameras_from_table(table: object, name: str) -> dict[str, Camera]:
    """Read what `cameras_table` wrote; keys that it does not write are ignored.

    Raises:
        SessionError: a camera lacks a key, or a value is of the wrong shape.
    """
    entries = table.get("cameras") if isinstance(table, Mapping) else None
    if not isinstance(entries, Mapping) or not entries:
        raise unfit(name, "no table of cameras", "{cameras: {NAME: {K, dist, R, t, image_size}}}")
    cameras = {}
    for camera, entry in entries.items():
        missing = _KEYS - set(entry) if isinstance(entry, Mapping) else _KEYS
        if missing:
            raise unfit(f"{name}, camera {camera}", f"no {', '.join(sorted(missing))}", ", ".join(sorted(_KEYS)))
        cameras[str(camera)] = camera_from_entry(name, str(camera), entry)
    return cameras


def read_cameras(path: Path) -> dict[str, Camera]:
    """Read our own cameras.json.

    Raises:
        SessionError: it cannot be read, is no JSON, or lacks something.
    """
    try:
        table = json.loads(path.read_text(encoding="utf-8-sig"))
    except (OSError, UnicodeDecodeError, json.JSONDecodeError) as error:
        raise unfit(path.name, f"a file that cannot be read ({error})", "JSON as cameras.json has it") from None
    return cameras_from_table(table, path.name)


def read_priors(path: Path) -> dict[str, CameraPrior]:
    """Read a cameras.json as what is known beforehand: each camera's lens, as surely as its ``std`` says.

    Raises:
        SessionError: as `read_cameras`, or a standard deviation that is none.
    """
    cameras = read_cameras(path)
    entries = json.loads(path.read_text(encoding="utf-8-sig"))["cameras"]
    try:
        return {
            name: CameraPrior(
                camera=camera,
                std={key: value for key, value in entries[name].get("std", {}).items() if key in LENS_NAMES},
            )
            for name, camera in cameras.items()
        }
    except (ValueError, TypeError, AttributeError) as error:
        raise unfit(path.name, str(error), "std: {fx_px … k3: standard deviation, zero if fixed}") from None


def camera_from_entry(file: str, name: str, entry: Mapping[str, Any]) -> Camera:
    """A camera from ``K``, ``dist``, ``R``, ``t`` (mm) and ``image_size``; up to five coefficients of Brown's model.

    Args:
        file: what to call the file in messages.
        name: the camera's name.
        entry: the values, as lists or arrays.

    Raises:
        SessionError: a value is of the wrong shape, or no camera of ours.
    """
    try:
        distortion = np.zeros(5)
        given = np.asarray(entry["dist"], dtype=np.float64).ravel()
        if np.any(given[5:]):
            raise ValueError(f"{len(given)} distortion coefficients, of which ours has the first five")
        distortion[: min(len(given), 5)] = given[:5]
        width, height = entry["image_size"]
        rotation = np.asarray(entry["R"], dtype=np.float64).reshape(3, 3)
        if 1e-9 < np.abs(rotation @ rotation.T - np.eye(3)).max() < _ROUNDED:
            rotation = Rotation.from_matrix(rotation).as_matrix()
        translation = np.asarray(entry["t"], dtype=np.float64).reshape(3)
        return Camera(
            name=name,
            size_wh=(int(width), int(height)),
            matrix=np.asarray(entry["K"], dtype=np.float64).reshape(3, 3),
            distortion=distortion,
            camera_from_world=Transform(rotation=rotation, translation_mm=translation),
        )
    except (ValueError, TypeError) as error:
        raise unfit(f"{file}, camera {name}", str(error), "K, dist, R, t and image_size of a camera") from None


def unfit(subject: str, found: str, expected: str) -> SessionError:
    """The error of a file that cannot be used."""
    return SessionError(subject, found=found, expected=expected, remedy="Correct the file, or export it anew")
