"""Cameras in Kalibr's camchain YAML: pinhole lenses with radtan distortion.

Each camera's pose is relative to the previous camera: ``T_cn_cnm1`` maps points from camera n − 1 to camera n, in
metres. ``radtan`` is Brown's model with k1, k2, p1, p2. Pixel centres are at integers, because Kalibr uses OpenCV's
corners.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from mammometry.base.errors import SessionError
from mammometry.base.parse import numbers, parsing, read_text
from mammometry.geometry import Array, Camera, Float64
from mammometry.io.cameras.foreign_text import yaml_value
from mammometry.io.cameras.own import camera_from_entry, camera_name, unfit

_MM_PER_M = 1000.0  # Kalibr writes metres, we write mm
_CAMERA = re.compile(r"^cam(\d+)$")
_COEFFICIENTS: Mapping[str, int] = {"radtan": 4, "none": 0}
_ROUNDED = 1e-3  # largest deviation from a rotation matrix that is due to truncated digits


def read_kalibr(path: Path, known: Collection[str] = ()) -> dict[str, Camera]:
    """Read the cameras of a Kalibr camchain file.

    Its first camera is the world. A camera gets the name of the session's camera that is part of its ``rostopic``, or
    else the first part.

    Args:
        path: the file.
        known: names of the session's cameras.

    Raises:
        SessionError: it is not a camchain, or a lens is not a pinhole with Brown's distortion.
    """
    table = yaml_value(read_text(path, path.name, "YAML", most_mib=1), path.name, "YAML")
    entries = {key: entry for key, entry in table.items() if _CAMERA.match(str(key))} if isinstance(table, dict) else {}
    if not entries:
        raise unfit(path.name, "neither OpenCV's %YAML:1.0 nor cameras cam0, cam1, …", "OpenCV or Kalibr YAML")
    cameras: dict[str, Camera] = {}
    camera_from_world = np.eye(4)
    for number, (key, entry) in enumerate(sorted(entries.items(), key=lambda item: int(item[0][3:]))):
        subject = f"{path.name}, {key}"
        _require(subject, entry, ["camera_model", "distortion_model", "intrinsics", "resolution"])
        if entry["camera_model"] != "pinhole" or str(entry["distortion_model"]) not in _COEFFICIENTS:
            found = f"{entry['camera_model']} with {entry['distortion_model']}"
            raise unfit(subject, f"a lens {found}", "pinhole with radtan or none: other lenses are not Brown's")
        with parsing("an invalid value", subject, "numbers as Kalibr writes them"):
            if number:
                _require(subject, entry, ["T_cn_cnm1"])
                camera_from_world = _rigid(entry["T_cn_cnm1"]) @ camera_from_world
            fx, fy, cx, cy = numbers(entry["intrinsics"], 4)
            count = _COEFFICIENTS[entry["distortion_model"]]
            coefficients = numbers(entry.get("distortion_coeffs", []), count) if count else np.zeros(4)
        topic = str(entry.get("rostopic", key))
        parts = topic.strip("/").split("/")
        name = camera_name(parts, known) or parts[0]
        if name in cameras:
            expected = f"a rostopic with a camera's name: {', '.join(known)}"
            raise unfit(subject, f"a second camera called {name}, by {topic}", expected)
        cameras[name] = camera_from_entry(
            path.name,
            name,
            {
                "K": [[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]],
                "dist": coefficients,
                "R": camera_from_world[:3, :3],
                "t": camera_from_world[:3, 3] * _MM_PER_M,
                "image_size": entry["resolution"],
            },
        )
    return cameras


def kalibr_text(cameras: Mapping[str, Camera]) -> str:
    """All cameras as a camchain, which contains only relative poses.

    Raises:
        SessionError: a lens with k3, which radtan does not have.
    """
    chain: dict[str, dict[str, Any]] = {}
    before: Camera | None = None
    for number, camera in enumerate(cameras.values()):
        if camera.distortion[4]:
            remedy = "Export for OpenCV or COLMAP, or calibrate without k3"
            expected = "k1, k2, p1, p2 only: Kalibr's radtan has no k3"
            raise SessionError(
                f"camera {camera.name}", found=f"k3 = {camera.distortion[4]:g}", expected=expected, remedy=remedy
            )
        entry: dict[str, Any] = {
            "camera_model": "pinhole",
            "intrinsics": camera.matrix[[0, 1, 0, 1], [0, 1, 2, 2]].tolist(),
            "distortion_model": "radtan",
            "distortion_coeffs": camera.distortion[:4].tolist(),
            "resolution": list(camera.size_wh),
            "rostopic": f"/{camera.name}/image_raw",
        }
        if before is not None:
            matrix = (camera.camera_from_world @ before.camera_from_world.inverse()).matrix
            matrix[:3, 3] /= _MM_PER_M
            entry["T_cn_cnm1"] = matrix.tolist()
        chain[f"cam{number}"] = entry
        before = camera
    return str(yaml.safe_dump(chain, sort_keys=False, default_flow_style=None, width=120))


def _require(subject: str, entry: object, keys: Sequence[str]) -> None:
    missing = [key for key in keys if not isinstance(entry, dict) or key not in entry]
    if missing:
        raise unfit(subject, f"no {', '.join(missing)}", "a camera as Kalibr writes it")


def _rigid(rows: object) -> Float64[Array, "4 4"]:
    """A 4 × 4 pose, whose digits may be truncated."""
    from scipy.spatial.transform import Rotation

    matrix = numbers(rows, 4, 4)
    turn = matrix[:3, :3]
    skewed = np.abs(turn @ turn.T - np.eye(3)).max() > _ROUNDED or np.linalg.det(turn) < 0
    if skewed or matrix[3].tolist() != [0.0, 0.0, 0.0, 1.0]:
        raise ValueError("T_cn_cnm1 is not a rigid transform")
    matrix[:3, :3] = Rotation.from_matrix(turn).as_matrix()
    return matrix
