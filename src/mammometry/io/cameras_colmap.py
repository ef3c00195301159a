"""Cameras in COLMAP's text files: cameras.txt, images.txt, points3D.txt.

COLMAP puts the first pixel's centre at (0.5, 0.5), we (as OpenCV) at (0, 0). Its poses are x_cam = R x_world + t, with
R as a quaternion, w first.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from mammometry.geometry.camera import Camera
from mammometry.io.cameras import camera_from_entry, unfit

_SHIFT = 0.5
# Model → how its parameters read as fx, fy, cx, cy, k1, k2, p1, p2, k3; more than these must be zero.
_MODELS: Mapping[str, Sequence[int | None]] = {
    "SIMPLE_PINHOLE": (0, 0, 1, 2, None, None, None, None, None),
    "PINHOLE": (0, 1, 2, 3, None, None, None, None, None),
    "SIMPLE_RADIAL": (0, 0, 1, 2, 3, None, None, None, None),
    "RADIAL": (0, 0, 1, 2, 3, 4, None, None, None),
    "OPENCV": (0, 1, 2, 3, 4, 5, 6, 7, None),
    "FULL_OPENCV": (0, 1, 2, 3, 4, 5, 6, 7, 8),
}


def read_colmap(cameras_path: Path, images_path: Path) -> dict[str, Camera]:
    """Read cameras, named as their images without the ending; lengths are taken for mm.

    Raises:
        SessionError: a lens model that is not Brown's, or a line that is not as COLMAP documents.
    """
    lenses: dict[str, dict[str, Any]] = {}
    for words in _lines(cameras_path):
        identity, model, width, height, *values = words
        if model not in _MODELS:
            raise unfit(cameras_path.name, f"camera model {model}", f"one of {', '.join(_MODELS)}")
        numbers = [float(value) for value in values]
        places = _MODELS[model]
        if any(numbers[1 + max(place for place in places if place is not None) :]):
            raise unfit(cameras_path.name, f"{model} with k4, k5 or k6", "a lens without them, which Brown's has not")
        fx, fy, cx, cy, *lens = (0.0 if index is None else numbers[index] for index in places)
        lenses[identity] = {
            "K": [[fx, 0, cx - _SHIFT], [0, fy, cy - _SHIFT], [0, 0, 1]],
            "dist": lens,
            "image_size": (int(width), int(height)),
        }
    cameras = {}
    for words in _lines(images_path)[::2]:
        # IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME; the line after it lists 2D points
        if not words:
            continue
        if len(words) < 10 or words[8] not in lenses:
            raise unfit(
                images_path.name, f"the line {' '.join(words)!r}", "IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME"
            )
        w, x, y, z, *translation = (float(value) for value in words[1:8])
        name = Path(words[9]).stem
        entry = {**lenses[words[8]], "R": Rotation.from_quat([x, y, z, w]).as_matrix(), "t": translation}
        cameras[name] = camera_from_entry(images_path.name, name, entry)
    return cameras


def _lines(path: Path) -> list[list[str]]:
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise unfit(path.name, f"a file that cannot be read ({error})", "COLMAP text") from None
    kept = [line.split() for line in lines if not line.startswith("#")]
    return kept if path.name == "images.txt" else [words for words in kept if words]


def colmap_texts(cameras: Mapping[str, Camera]) -> dict[str, str]:
    """All cameras as the text files of a COLMAP model without points; lengths in mm.

    ``OPENCV`` lenses, and ``FULL_OPENCV`` ones where k3 is not zero.
    """
    lenses, images = [], []
    for number, camera in enumerate(cameras.values(), start=1):
        (fx, _, cx), (_, fy, cy), _ = camera.matrix.tolist()
        k1, k2, p1, p2, k3 = camera.distortion.tolist()
        values = [fx, fy, cx + _SHIFT, cy + _SHIFT, k1, k2, p1, p2, *([k3, 0.0, 0.0, 0.0] if k3 else [])]
        width, height = camera.size_wh
        model = "FULL_OPENCV" if k3 else "OPENCV"
        lenses.append(f"{number} {model} {width} {height} {_numbers(values)}")
        x, y, z, w = Rotation.from_matrix(camera.camera_from_world.rotation).as_quat().tolist()
        pose = _numbers([w, x, y, z, *camera.camera_from_world.translation_mm.tolist()])
        images += [f"{number} {pose} {number} {camera.name}.jpg", ""]
    return {
        "cameras.txt": "\n".join(["# CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]; lengths in mm", *lenses]) + "\n",
        "images.txt": "\n".join(["# IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME", *images]) + "\n",
        "points3D.txt": "# POINT3D_ID, X, Y, Z, R, G, B, ERROR, TRACK[]\n",
    }


def _numbers(values: Sequence[float]) -> str:
    return " ".join(repr(float(np.float64(value))) for value in values)
