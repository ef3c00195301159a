"""Cameras in COLMAP's text files: cameras.txt, images.txt, points3D.txt.

COLMAP's first pixel centre is (0.5, 0.5), ours and OpenCV's is (0, 0). Poses are x_cam = R x_world + t, with R as a
quaternion, w first.
"""

import math
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np

from mammometry.base.parse import number, parsing, read_text, whole
from mammometry.geometry.camera import Camera
from mammometry.io.cameras.own import camera_from_entry, camera_name, unfit

_SHIFT = 0.5  # px: COLMAP's origin is the first pixel's corner, OpenCV's its centre
_UNIT = 1e-2  # largest deviation of a quaternion's length from 1 in COLMAP's files
_IMAGE = "IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME, followed by a line with its points"
# Model → parameters for fx, fy, cx, cy, k1, k2, p1, p2, k3. Any further parameters must be zero.
_MODELS: Mapping[str, Sequence[int | None]] = {
    "SIMPLE_PINHOLE": (0, 0, 1, 2, None, None, None, None, None),
    "PINHOLE": (0, 1, 2, 3, None, None, None, None, None),
    "SIMPLE_RADIAL": (0, 0, 1, 2, 3, None, None, None, None),
    "RADIAL": (0, 0, 1, 2, 3, 4, None, None, None),
    "OPENCV": (0, 1, 2, 3, 4, 5, 6, 7, None),
    "FULL_OPENCV": (0, 1, 2, 3, 4, 5, 6, 7, 8),
}
_COUNTS = {"SIMPLE_PINHOLE": 3, "PINHOLE": 4, "SIMPLE_RADIAL": 4, "RADIAL": 5, "OPENCV": 8, "FULL_OPENCV": 12}


def read_colmap(cameras_path: Path, images_path: Path, known: Collection[str] = ()) -> dict[str, Camera]:
    """Read cameras, named by their image or by the folder that contains it. Lengths are taken to be in mm.

    Args:
        cameras_path: cameras.txt.
        images_path: images.txt.
        known: names of the session's cameras, which are compared with names of folders.

    Raises:
        SessionError: a lens model other than Brown's, a line not as COLMAP documents it, or two images of one name.
    """
    from scipy.spatial.transform import Rotation

    lenses: dict[str, dict[str, Any]] = {}
    for line, text in _lines(cameras_path):
        if not text:
            continue
        with parsing("a malformed line", f"{cameras_path.name}, line {line}", "CAMERA_ID MODEL WIDTH HEIGHT PARAMS…"):
            identity, lens = _lens(cameras_path.name, text.split())
            if identity in lenses:
                raise ValueError(f"a second camera {identity}")
            lenses[identity] = lens
    cameras: dict[str, Camera] = {}
    for (line, text), (_, points) in _pairs(images_path):
        if not text and not points:
            continue
        with parsing("a malformed line", f"{images_path.name}, line {line}", _IMAGE):
            # limited, because a file name may contain spaces
            _, *pose, identity, image = text.split(maxsplit=9)
            w, x, y, z, *translation = (number(word) for word in pose)
            if abs(math.hypot(w, x, y, z) - 1.0) > _UNIT:
                raise ValueError("a quaternion whose length is not 1")
            _require_points(points)
            if identity not in lenses:
                raise ValueError(f"camera {identity}, which is not in {cameras_path.name}")
            path = PurePosixPath(image.strip().replace("\\", "/"))
            name = camera_name(path.parts, known) or path.stem
            if name in cameras:
                raise ValueError(f"a second image called {name}; a rig has one per camera")
            entry = {**lenses[identity], "R": Rotation.from_quat([x, y, z, w]).as_matrix(), "t": translation}
            cameras[name] = camera_from_entry(images_path.name, name, entry)
    if not cameras:
        raise unfit(images_path.name, "no images", _IMAGE)
    return cameras


def _lens(file: str, words: Sequence[str]) -> tuple[str, dict[str, Any]]:
    """Identity and values of a lens, from the words of a line."""
    identity, model, width, height, *parameters = words
    if model not in _MODELS:
        raise unfit(file, f"camera model {model}", f"one of {', '.join(_MODELS)}")
    places, values = _MODELS[model], [number(word) for word in parameters]
    if len(values) != _COUNTS[model]:
        raise ValueError(f"{len(values)} parameters of {model}, which has {_COUNTS[model]}")
    if any(values[1 + max(place for place in places if place is not None) :]):
        raise unfit(file, f"{model} with k4, k5 or k6", "a lens without them; Brown's model does not have them")
    fx, fy, cx, cy, *lens = (0.0 if place is None else values[place] for place in places)
    return identity, {
        "K": [[fx, 0.0, cx - _SHIFT], [0.0, fy, cy - _SHIFT], [0.0, 0.0, 1.0]],
        "dist": lens,
        "image_size": [whole(number(width)), whole(number(height))],
    }


def _require_points(text: str) -> None:
    """Require a line of points after an image. If another image follows instead, such lines were removed."""
    words = text.split()
    if len(words) % 3 or (words and not words[-1].lstrip("-").isdigit()):
        raise ValueError("no line of points after it (it may be empty)")


def _pairs(path: Path) -> list[tuple[tuple[int, str], tuple[int, str]]]:
    lines = _lines(path)
    return list(zip(lines[::2], [*lines[1::2], (0, "")], strict=False))


def _lines(path: Path) -> list[tuple[int, str]]:
    """Number and text of every line that is not a comment."""
    lines = read_text(path, path.name, "COLMAP text").split("\n")
    return [(place, line.strip()) for place, line in enumerate(lines, start=1) if not line.startswith("#")]


def colmap_texts(cameras: Mapping[str, Camera]) -> dict[str, str]:
    """All cameras as a COLMAP text model without points, mm.

    Lenses are ``OPENCV``, or ``FULL_OPENCV`` if k3 is not zero.
    """
    from scipy.spatial.transform import Rotation

    lenses, images = [], []
    for count, camera in enumerate(cameras.values(), start=1):
        (fx, _, cx), (_, fy, cy), _ = camera.matrix.tolist()
        k1, k2, p1, p2, k3 = camera.distortion.tolist()
        values = [fx, fy, cx + _SHIFT, cy + _SHIFT, k1, k2, p1, p2, *([k3, 0.0, 0.0, 0.0] if k3 else [])]
        width, height = camera.size_wh
        model = "FULL_OPENCV" if k3 else "OPENCV"
        lenses.append(f"{count} {model} {width} {height} {_numbers(values)}")
        x, y, z, w = Rotation.from_matrix(camera.camera_from_world.rotation).as_quat().tolist()
        pose = _numbers([w, x, y, z, *camera.camera_from_world.translation_mm.tolist()])
        images += [f"{count} {pose} {count} {camera.name}.jpg", ""]
    return {
        "cameras.txt": "\n".join(["# CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]; lengths in mm", *lenses]) + "\n",
        "images.txt": "\n".join(["# IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME", *images]) + "\n",
        "points3D.txt": "# POINT3D_ID, X, Y, Z, R, G, B, ERROR, TRACK[]\n",
    }


def _numbers(values: Sequence[float]) -> str:
    return " ".join(repr(float(np.float64(value))) for value in values)
