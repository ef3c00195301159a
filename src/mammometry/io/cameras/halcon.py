"""Cameras in HALCON's text files: internal parameters (write_cam_par) and poses (write_pose).

HALCON's lens model maps distorted points to ideal ones, Brown's maps ideal points to distorted ones. So Brown's
coefficients are fitted, and a lens with a residual above 0.01 px is refused. Pixel centres are at integers, as ours.
Lengths are in metres. A pose is that of the camera in the rig's frame, as returned by ``get_camera_setup_param`` and as
``RelPose`` of ``binocular_calibration``: it maps points from the camera to the rig.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from mammometry.base.parse import number, parsing, read_text, whole
from mammometry.geometry import Array, Camera, Float64, lens
from mammometry.io.cameras.own import camera_from_entry, camera_name, pair_of_two, unfit

Lens: TypeAlias = Mapping[str, float]
_PARAMETER = re.compile(r"^[ \t]*(\w+)[ \t]*:[ \t]*[A-Za-z_]\w*[ \t]*:[ \t]*([^;:\n]+);", re.MULTILINE)
_POSE = re.compile(r"^[ \t]*([frt])[ \t]+(\S.*)$", re.MULTILINE)
_NEEDED = ("focus", "sx", "sy", "cx", "cy", "imagewidth", "imageheight")
_POLYNOMIAL = ("poly1", "poly2", "poly3", "poly4", "poly5")
_KNOWN = frozenset({*_NEEDED, *_POLYNOMIAL, "kappa"})
_ORDERS = {0: "XYZ", 2: "ZYX", 4: ""}  # Rp+T of points, by rotations gba, abg or Rodriguez's vector
_MM_PER_M = 1000.0  # HALCON's unit is the metre
_MISS_PX = 0.01  # largest residual of the fitted lens: a tenth of the standard deviation of a corner
_GRID = 41  # points along each side of the image for the fit


def read_halcon(paths: Sequence[Path], pair_names: Mapping[str, tuple[str, str]]) -> dict[str, Camera]:
    """Read cameras, named by their files. A pose file's name contains the camera's name.

    A single pose for the two cameras of a pair is that of the second camera in the first one's frame.

    Raises:
        SessionError: a lens that Brown's model does not fit, a camera without a pose, or an invalid value.
    """
    lenses: dict[str, tuple[str, Lens]] = {}
    poses: dict[Path, tuple[Any, Any]] = {}
    for path in paths:
        text = read_text(path, path.name, "HALCON text", most_mib=1)
        with parsing("an invalid value", path.name, "a camera or pose as HALCON writes it"):
            if "ParGroup" in text:
                lenses[path.stem] = path.name, _lens(path.name, text)
            else:
                poses[path] = _pose(path.name, text)
    placed = _placed(lenses, poses, pair_names)
    cameras = {}
    for name, (file, values) in lenses.items():
        rotation, centre_m = placed[name]
        with parsing("an invalid value", file, "a camera as HALCON writes it"):
            entry = _entry(file, values) | {"R": rotation.T, "t": -rotation.T @ centre_m * _MM_PER_M}
        cameras[name] = camera_from_entry(file, name, entry)
    return cameras


def _lens(file: str, text: str) -> Lens:
    if re.search(r"ParGroup\s*:\s*Camera\s*:\s*Parameter", text) is None:
        raise unfit(file, "another parameter group", "ParGroup: Camera: Parameter, of an area scan camera")
    values: dict[str, float] = {}
    for name, value in _PARAMETER.findall(text):
        if name == "ParGroup":
            continue
        key = name.lower()
        if key not in _KNOWN:
            if key == "cameratype" and value.strip(' "') in ("area_scan_division", "area_scan_polynomial"):
                continue
            raise unfit(file, f"{name}: {value.strip()}", "an area scan camera with division or polynomial distortion")
        if key in values:
            raise unfit(file, f"two values of {name}", "one value")
        values[key] = number(value.strip())
    if missing := [name for name in _NEEDED if name not in values]:
        raise unfit(file, f"no {', '.join(missing)}", "Focus, Sx, Sy, Cx, Cy, ImageWidth and ImageHeight")
    if values["focus"] <= 0 or values["sx"] <= 0 or values["sy"] <= 0:
        raise unfit(file, "Focus, Sx or Sy not above zero", "positive values in metres (no telecentric lens)")
    return values


def _pose(file: str, text: str) -> tuple[Any, Any]:
    """Rotation and position (m) of a camera in the rig's frame."""
    from scipy.spatial.transform import Rotation

    rows = {key: [number(word) for word in rest.split()] for key, rest in _POSE.findall(text)}
    if {key: len(row) for key, row in rows.items()} != {"f": 1, "r": 3, "t": 3}:
        raise unfit(file, "no pose", "a pose as write_pose writes it: lines f, r and t")
    code = whole(rows["f"][0])
    if code not in _ORDERS:
        raise unfit(file, f"a pose of type {code}", "type 0, 2 or 4 (convert_pose_type to 'Rp+T' and 'point')")
    if code == 4:  # the length of Rodriguez's vector is the tangent of half the angle
        rotation = Rotation.from_quat([*rows["r"], 1.0])
    else:
        angles = rows["r"] if code == 0 else rows["r"][::-1]
        rotation = Rotation.from_euler(_ORDERS[code], angles, degrees=True)
    return rotation.as_matrix(), np.array(rows["t"])


def _placed(
    lenses: Collection[str], poses: Mapping[Path, tuple[Any, Any]], pair_names: Mapping[str, tuple[str, str]]
) -> dict[str, tuple[Any, Any]]:
    """Rotation and position of each camera."""
    named = {name: pose for path, pose in poses.items() if (name := camera_name((path.stem,), lenses, within=True))}
    pair = pair_of_two(pair_names)
    if len(poses) == 1 and pair is not None and set(pair) == set(lenses):
        (pose,) = poses.values()
        return {pair[0]: (np.eye(3), np.zeros(3)), pair[1]: pose}
    if missing := [name for name in lenses if name not in named]:
        raise unfit(
            f"the pose of {', '.join(missing)}",
            f"poses {', '.join(path.name for path in poses) or 'of no camera'}",
            "a pose of each camera, written by write_pose into a file with the camera's name, such as "
            f"{missing[0]}_pose.dat",
        )
    return named


def _entry(file: str, values: Lens) -> dict[str, Any]:
    focus, sx, sy = values["focus"], values["sx"], values["sy"]
    width, height = whole(values["imagewidth"]), whole(values["imageheight"])
    focal_px = np.array([focus / sx, focus / sy])
    row, column = np.meshgrid(*(np.linspace(0, side - 1, _GRID) for side in (height, width)), indexing="ij")
    seen = np.stack([(column.ravel() - values["cx"]) * sx, (row.ravel() - values["cy"]) * sy], axis=1)
    coefficients, miss_px = _brown(_ideal(seen, values) / focus, seen / focus, focal_px)
    if not miss_px <= _MISS_PX:
        found = f"a lens that Brown's model fits with an error of {miss_px:.2g} pixels"
        raise unfit(file, found, f"at most {_MISS_PX:g}: calibrate for OpenCV, or with less distortion")
    return {
        "K": [[focal_px[0], 0.0, values["cx"]], [0.0, focal_px[1], values["cy"]], [0.0, 0.0, 1.0]],
        "dist": coefficients,
        "image_size": (width, height),
    }


def _ideal(seen: Float64[Array, "n 2"], values: Lens) -> Float64[Array, "n 2"]:
    """Ideal points on the sensor, m, from distorted ones, by HALCON's formulas (chapter "Calibration")."""
    r2 = (seen**2).sum(axis=1, keepdims=True)
    if "kappa" in values:
        return seen / (1.0 + values["kappa"] * r2)
    k1, k2, k3, p1, p2 = (values.get(name, 0.0) for name in _POLYNOMIAL)
    x, y = seen[:, :1], seen[:, 1:]
    radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
    return np.concatenate(
        [
            x * radial + p1 * (r2 + 2.0 * x * x) + 2.0 * p2 * x * y,
            y * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * y * y),
        ],
        axis=1,
    )


def _brown(
    ideal: Float64[Array, "n 2"], seen: Float64[Array, "n 2"], focal_px: Float64[Array, 2]
) -> tuple[Float64[Array, 5], float]:
    """Coefficients that map ideal points to the distorted ones, and the largest residual, px."""
    x, y = ideal.T
    r2 = x * x + y * y
    along = ideal[:, :, None] * np.stack([r2, r2**2, r2**3], axis=1)[:, None, :]
    p1 = np.stack([2.0 * x * y, r2 + 2.0 * y * y], axis=1)
    p2 = np.stack([r2 + 2.0 * x * x, 2.0 * x * y], axis=1)
    terms = np.stack([along[:, :, 0], along[:, :, 1], p1, p2, along[:, :, 2]], axis=2) * focal_px[:, None]
    moved = (seen - ideal) * focal_px
    scale = np.abs(terms).max(axis=(0, 1)) + np.finfo(float).tiny
    solved = np.linalg.lstsq((terms / scale).reshape(-1, 5), moved.ravel(), rcond=None)[0] / scale
    again = np.stack(lens.distorted(x, y, solved), axis=1)
    return solved, float(np.abs((again - seen) * focal_px).max())
