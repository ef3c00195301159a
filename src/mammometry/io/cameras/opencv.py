"""Cameras in OpenCV's YAML and XML (`cv::FileStorage`).

x_cam = R x_world + T. Pixel centres are at integers.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from mammometry.base.parse import number, numbers, parsing, read_text, whole
from mammometry.geometry import Array, Camera, Float64
from mammometry.io.cameras.foreign_text import read_xml, yaml_value
from mammometry.io.cameras.own import camera_from_entry, pair_of_two, unfit

_YAML = "tag:yaml.org,2002:"
_MATRICES = (f"{_YAML}opencv-matrix", f"{_YAML}opencv-nd-matrix")


def read_opencv(path: Path, pair_names: Mapping[str, tuple[str, str]]) -> dict[str, Camera]:
    """Read one camera, named after the file, or a stereo rig, whose first camera is the world.

    A camera has ``camera_matrix`` or ``K``, ``distortion_coefficients`` or ``D``, ``image_width``, ``image_height``
    and, if the rig needs a pose, ``R`` and ``T``. A stereo rig has ``M1 D1 M2 D2 R T``.

    Args:
        path: the file.
        pair_names: the session's pairs, which name the cameras of a stereo file.

    Raises:
        SessionError: it cannot be parsed, or a value is missing.
    """
    from scipy.spatial.transform import Rotation

    storage = _storage(path)
    with parsing("a value that cannot be read", path.name, "OpenCV YAML or XML"):
        size = _first(storage, "image_size", "size")
        width, height = _first(storage, "image_width", "width"), _first(storage, "image_height", "height")
        if size is not None:
            width, height = numbers(size, -1)[:2]
        rotation, translation = (_array(storage, *keys) for keys in (("R",), ("T", "t")))
        stereo = "M1" in storage
        if stereo:
            lenses = [(_array(storage, "M1"), _array(storage, "D1")), (_array(storage, "M2"), _array(storage, "D2"))]
        else:
            lens = _array(storage, "distortion_coefficients", "D", "dist")
            lenses = [(_array(storage, "camera_matrix", "K", "M"), lens)]
    if (rotation is None) != (translation is None) or (stereo and rotation is None):
        missing = " and ".join(name for name, value in (("R", rotation), ("T", translation)) if value is None)
        raise unfit(path.name, f"no {missing}", "R and T, the camera's pose in the rig's frame, T in millimetres")
    if width is None or height is None:
        raise unfit(path.name, "no image_width and image_height", "the image size of the calibration")
    names: tuple[str, ...] = (path.stem,)
    if stereo:
        pair = pair_of_two(pair_names)
        if pair is None:
            raise unfit(path.name, f"a stereo rig for a session of {len(pair_names)} pairs", "a session of one pair")
        names = pair
    cameras = {}
    for index, (name, (intrinsic, lens)) in enumerate(zip(names, lenses, strict=True)):
        if intrinsic is None:
            raise unfit(path.name, "no camera matrix", "camera_matrix or K")
        posed = not stereo or index == 1
        if rotation is not None and rotation.size == 3:
            rotation = Rotation.from_rotvec(rotation.ravel()).as_matrix()
        entry = {
            "K": intrinsic,
            "dist": np.zeros(5) if lens is None else lens.ravel(),
            "R": np.eye(3) if rotation is None or not posed else rotation,
            "t": np.zeros(3) if translation is None or not posed else translation.ravel(),
            "image_size": (width, height),
        }
        cameras[name] = camera_from_entry(path.name, name, entry)
    return cameras


def _storage(path: Path) -> dict[str, Any]:
    """The file's values by name.

    `cv::FileStorage` is not used: it crashes on deeply nested files.
    """
    text = read_text(path, path.name, "OpenCV YAML or XML", most_mib=1).lstrip()
    if text.startswith("<?xml"):
        return _xml_storage(path)
    body = text.partition("\n")[2] if text.startswith("%YAML") else text
    table = yaml_value(body, path.name, "OpenCV YAML", tags=dict.fromkeys(_MATRICES, _matrix))
    if not isinstance(table, dict):
        raise unfit(path.name, "no names with values", "OpenCV YAML, such as camera_matrix: …")
    return table


def _xml_storage(path: Path) -> dict[str, Any]:
    root = read_xml(path, "OpenCV XML")
    with parsing("a file that cannot be parsed", path.name, "OpenCV XML"):
        names = [node.tag for node in root]
        for name in names:
            if names.count(name) > 1:
                raise ValueError(f"two values of {name}")
        return {node.tag: _xml_value(node) for node in root}


def _xml_value(node: ElementTree.Element) -> Any:
    """A matrix, a list of numbers, a number, or text."""
    if f"{_YAML}{node.get('type_id')}" in _MATRICES:
        return _matrix({part.tag: _xml_value(part) for part in node})
    words = (node.text or "").split()
    try:
        values = [number(word) for word in words]
    except ValueError:
        return node.text
    return values[0] if len(values) == 1 and node.tag != "data" else values


def _matrix(table: Mapping[str, Any]) -> Float64[Array, ...]:
    """A matrix from its size (rows and cols, or sizes) and its data, which must agree."""
    size = numbers(table["sizes"] if "sizes" in table else [table["rows"], table["cols"]], -1)
    shape, values = tuple(whole(length) for length in size), numbers(table["data"], -1)
    if min(shape) < 1 or math.prod(shape) != len(values):
        raise ValueError(f"{len(values)} values in a matrix of {' × '.join(map(str, shape))}")
    return values.reshape(shape)


def _first(storage: Mapping[str, Any], *names: str) -> Any:
    return next((storage[name] for name in names if name in storage), None)


def _array(storage: Mapping[str, Any], *names: str) -> Float64[Array, ...] | None:
    """The first of these values that exists, as numbers."""
    value = _first(storage, *names)
    return None if value is None else value if isinstance(value, np.ndarray) else numbers(value, -1)


def opencv_text(camera: Camera) -> str:
    """One camera as YAML for `read_opencv` and ``cv::FileStorage``. T in mm."""
    import cv2

    storage = cv2.FileStorage(".yml", cv2.FILE_STORAGE_WRITE | cv2.FILE_STORAGE_MEMORY)
    width, height = camera.size_wh
    storage.write("image_width", width)
    storage.write("image_height", height)
    storage.write("camera_matrix", np.array(camera.matrix))
    storage.write("distortion_coefficients", np.array(camera.distortion).reshape(1, 5))
    storage.write("R", np.array(camera.camera_from_world.rotation))
    storage.write("T", np.array(camera.camera_from_world.translation_mm).reshape(3, 1))
    return str(storage.releaseAndGetString())
