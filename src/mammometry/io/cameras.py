"""Cameras in files: our own cameras.json; OpenCV's YAML and XML and COLMAP's text are read."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from mammometry.errors import SessionError
from mammometry.geometry.arrays import Array, Float64
from mammometry.geometry.camera import Camera
from mammometry.geometry.transform import Transform

CONVENTION = (
    "x_cam = R x_world + t; then pinhole with K; dist = k1, k2, p1, p2, k3 (OpenCV); pixel centres at integers; mm"
)
_FORMAT = 1
_ROUNDED = 1e-3  # a matrix this near to a rotation was one before its digits were cut
_KEYS = {"K", "dist", "R", "t", "image_size"}
# COLMAP puts the first pixel's centre at (0.5, 0.5), we (as OpenCV) at (0, 0).
_COLMAP_SHIFT = 0.5
# COLMAP model → how its parameters read as fx, fy, cx, cy, k1, k2, p1, p2
_COLMAP_MODELS: Mapping[str, Sequence[int | None]] = {
    "SIMPLE_PINHOLE": (0, 0, 1, 2, None, None, None, None),
    "PINHOLE": (0, 1, 2, 3, None, None, None, None),
    "SIMPLE_RADIAL": (0, 0, 1, 2, 3, None, None, None),
    "RADIAL": (0, 0, 1, 2, 3, 4, None, None),
    "OPENCV": (0, 1, 2, 3, 4, 5, 6, 7),
}


def cameras_table(
    cameras: Mapping[str, Camera], std: Mapping[str, Mapping[str, float]] | None = None
) -> dict[str, Any]:
    """Cameras as the plain table that cameras.json holds."""
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
        raise _unfit(name, "no table of cameras", "{cameras: {NAME: {K, dist, R, t, image_size}}}")
    cameras = {}
    for camera, entry in entries.items():
        missing = _KEYS - set(entry) if isinstance(entry, Mapping) else _KEYS
        if missing:
            raise _unfit(f"{name}, camera {camera}", f"no {', '.join(sorted(missing))}", ", ".join(sorted(_KEYS)))
        cameras[str(camera)] = _camera(name, str(camera), entry)
    return cameras


def read_cameras(path: Path) -> dict[str, Camera]:
    """Read our own cameras.json.

    Raises:
        SessionError: it cannot be read, is no JSON, or lacks something.
    """
    try:
        table = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, json.JSONDecodeError) as error:
        raise _unfit(path.name, f"a file that cannot be read ({error})", "JSON as cameras.json has it") from None
    return cameras_from_table(table, path.name)


def import_cameras(paths: Sequence[Path], pair_names: Mapping[str, tuple[str, str]]) -> dict[str, Camera]:
    """Read cameras from other programs' files.

    A ``.json`` is our own; ``.yml``, ``.yaml`` and ``.xml`` are OpenCV's (one camera a file, named as the file, with
    ``camera_matrix`` or ``K``, ``distortion_coefficients`` or ``D``, ``image_width``, ``image_height`` and, where the
    rig needs a pose, ``R`` and ``T``; or one file of a stereo rig with ``M1 D1 M2 D2 R T``, whose left camera then is
    the world); ``cameras.txt`` with ``images.txt`` are COLMAP's, cameras named as the images without their ending.

    Args:
        paths: the files.
        pair_names: the session's pairs, which say which camera a stereo file's first and second one are.

    Raises:
        SessionError: a file of unknown kind, or one that lacks something.
    """
    cameras: dict[str, Camera] = {}
    texts = {path.name: path for path in paths if path.suffix == ".txt"}
    for path in paths:
        if not path.is_file():
            raise _unfit(str(path), "no file", "an existing file")
        if path.suffix == ".json":
            cameras |= read_cameras(path)
        elif path.suffix.lower() in (".yml", ".yaml", ".xml"):
            cameras |= _read_opencv(path, pair_names)
        elif path.suffix != ".txt":
            raise _unfit(path.name, "a file of unknown kind", "OpenCV YAML or XML, COLMAP text, or cameras.json")
    if texts:
        if set(texts) != {"cameras.txt", "images.txt"}:
            raise _unfit(", ".join(texts), "part of a COLMAP model", "both cameras.txt and images.txt")
        cameras |= _read_colmap(texts["cameras.txt"], texts["images.txt"])
    return cameras


def _read_opencv(path: Path, pair_names: Mapping[str, tuple[str, str]]) -> dict[str, Camera]:
    import cv2

    try:
        storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_READ)
    except (cv2.error, SystemError):
        raise _unfit(path.name, "a file that OpenCV cannot parse", "OpenCV YAML or XML") from None

    def matrix(*names: str) -> Float64[Array, ...] | None:
        for name in names:
            node = storage.getNode(name)
            if not node.empty() and node.mat() is not None:
                return np.asarray(node.mat(), dtype=np.float64)
        return None

    def number(*names: str) -> int | None:
        for name in names:
            node = storage.getNode(name)
            if not node.empty():
                return int(node.real())
        return None

    try:
        width, height = number("image_width", "width"), number("image_height", "height")
        size = matrix("image_size", "size")
        if size is not None:
            width, height = (int(value) for value in size.ravel()[:2])
        rotation, translation = matrix("R"), matrix("T", "t")
        stereo = matrix("M1") is not None
        if stereo:
            found = [(matrix("M1"), matrix("D1")), (matrix("M2"), matrix("D2"))]
        else:
            found = [(matrix("camera_matrix", "K", "M"), matrix("distortion_coefficients", "D", "dist"))]
    finally:
        storage.release()
    if width is None or height is None:
        raise _unfit(path.name, "no image_width and image_height", "the size that the calibration holds for")
    names: tuple[str, ...] = (path.stem,)
    if stereo:
        if len(pair_names) != 1:
            raise _unfit(path.name, f"a stereo rig, and a session of {len(pair_names)} pairs", "a session of one pair")
        (names,) = pair_names.values()
    cameras = {}
    for index, (name, (intrinsic, lens)) in enumerate(zip(names, found, strict=True)):
        if intrinsic is None:
            raise _unfit(path.name, "no camera matrix", "camera_matrix or K")
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
        cameras[name] = _camera(path.name, name, entry)
    return cameras


def _read_colmap(cameras_path: Path, images_path: Path) -> dict[str, Camera]:
    lenses: dict[str, dict[str, Any]] = {}
    for words in _colmap_lines(cameras_path):
        identity, model, width, height, *values = words
        if model not in _COLMAP_MODELS:
            raise _unfit(cameras_path.name, f"camera model {model}", f"one of {', '.join(_COLMAP_MODELS)}")
        numbers = [float(value) for value in values]
        fx, fy, cx, cy, *lens = (0.0 if index is None else numbers[index] for index in _COLMAP_MODELS[model])
        lenses[identity] = {
            "K": [[fx, 0, cx - _COLMAP_SHIFT], [0, fy, cy - _COLMAP_SHIFT], [0, 0, 1]],
            "dist": [*lens, 0.0],
            "image_size": (int(width), int(height)),
        }
    cameras = {}
    for words in _colmap_lines(images_path)[::2]:
        # IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME; the line after it lists 2D points
        if not words:
            continue
        if len(words) < 10 or words[8] not in lenses:
            raise _unfit(
                images_path.name, f"the line {' '.join(words)!r}", "IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME"
            )
        w, x, y, z, *translation = (float(value) for value in words[1:8])
        name = Path(words[9]).stem
        entry = {**lenses[words[8]], "R": Rotation.from_quat([x, y, z, w]).as_matrix(), "t": translation}
        cameras[name] = _camera(images_path.name, name, entry)
    return cameras


def _colmap_lines(path: Path) -> list[list[str]]:
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise _unfit(path.name, f"a file that cannot be read ({error})", "COLMAP text") from None
    kept = [line.split() for line in lines if not line.startswith("#")]
    return kept if path.name == "images.txt" else [words for words in kept if words]


def _camera(file: str, name: str, entry: Mapping[str, Any]) -> Camera:
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
        raise _unfit(f"{file}, camera {name}", str(error), "K, dist, R, t and image_size of a camera") from None


def _unfit(subject: str, found: str, expected: str) -> SessionError:
    return SessionError(subject, found=found, expected=expected, remedy="Correct the file, or export it anew")
