"""Cameras in OpenCV's YAML and XML (`cv::FileStorage`): x_cam = R x_world + T, pixel centres at integers."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from mammometry.geometry.arrays import Array, Float64
from mammometry.geometry.camera import Camera
from mammometry.io.cameras import camera_from_entry, unfit


def read_opencv(path: Path, pair_names: Mapping[str, tuple[str, str]]) -> dict[str, Camera]:
    """Read one camera, named as the file, or a stereo rig, whose first camera then is the world.

    A camera has ``camera_matrix`` or ``K``, ``distortion_coefficients`` or ``D``, ``image_width``, ``image_height``
    and, where the rig needs a pose, ``R`` and ``T``; a stereo rig has ``M1 D1 M2 D2 R T``.

    Args:
        path: the file.
        pair_names: the session's pairs, which say which cameras a stereo file's are.

    Raises:
        SessionError: it cannot be parsed, or lacks something.
    """
    import cv2

    try:
        storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_READ)
    except (cv2.error, SystemError):
        raise unfit(path.name, "a file that OpenCV cannot parse", "OpenCV YAML or XML") from None

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
        raise unfit(path.name, "no image_width and image_height", "the size that the calibration holds for")
    names: tuple[str, ...] = (path.stem,)
    if stereo:
        if len(pair_names) != 1:
            raise unfit(path.name, f"a stereo rig, and a session of {len(pair_names)} pairs", "a session of one pair")
        (names,) = pair_names.values()
    cameras = {}
    for index, (name, (intrinsic, lens)) in enumerate(zip(names, found, strict=True)):
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


def opencv_text(camera: Camera) -> str:
    """One camera as a YAML file that `read_opencv` and ``cv::FileStorage`` read; T in mm."""
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
