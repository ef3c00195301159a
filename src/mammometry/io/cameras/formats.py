"""Import and export of cameras in all formats."""

import json
from collections.abc import Collection, Iterable, Mapping, Sequence
from itertools import combinations
from pathlib import Path
from typing import Literal, TypeAlias

import numpy as np

from mammometry.base.errors import SessionError
from mammometry.base.notices import Notice
from mammometry.calibration.judge.scale import require_camera_scale, require_sides
from mammometry.geometry.camera import Camera, Rig
from mammometry.io.cameras.agisoft import read_agisoft
from mammometry.io.cameras.colmap import colmap_texts, read_colmap
from mammometry.io.cameras.halcon import read_halcon
from mammometry.io.cameras.kalibr import kalibr_text, read_kalibr
from mammometry.io.cameras.opencv import opencv_text, read_opencv
from mammometry.io.cameras.own import READERS, cameras_table, read_cameras, require_plausible, unfit

CameraFormat: TypeAlias = Literal["json", "opencv", "colmap", "kalibr"]
_HEAD_BYTES = 1024  # number of bytes from which a file's format is recognised


def import_cameras(paths: Sequence[Path], pair_names: Mapping[str, tuple[str, str]]) -> dict[str, Camera]:
    """Read cameras from other programs' files.

    A ``.json`` is our own. ``.yml``, ``.yaml`` and ``.xml`` are OpenCV's (`read_opencv`), Kalibr's if they do not start
    with OpenCV's mark (`read_kalibr`), or Agisoft's ``<document>`` (`read_agisoft`). ``cameras.txt`` with
    ``images.txt`` are COLMAP's (`read_colmap`). A ``.mat`` is MATLAB's (`read_matlab`). ``.dat`` and ``.cal`` are
    HALCON's (`read_halcon`). `READERS` may have others.

    Args:
        paths: the files.
        pair_names: the session's pairs, which name the first and second camera of a stereo file.

    Raises:
        SessionError: a file of unknown type, a missing value, a duplicate camera, or an impossible one.
    """
    cameras: dict[str, Camera] = {}

    def add(file: str, by_name: Mapping[str, Camera]) -> None:
        for name in by_name:
            if name in cameras:
                raise unfit(file, f"a second camera called {name}", "each camera once")
        require_plausible(file, by_name)
        cameras.update(by_name)

    known = _names(pair_names)
    texts = {path.name: path for path in paths if path.suffix == ".txt"}
    halcon = [path for path in paths if path.suffix.lower() in (".dat", ".cal")]
    for path in paths:
        if not path.is_file():
            raise unfit(str(path), "no file", "an existing file")
        if path.suffix.lower() in READERS:
            add(path.name, READERS[path.suffix.lower()](path, pair_names))
        elif path not in halcon and path.suffix != ".txt":
            expected = "files of OpenCV, Kalibr, COLMAP, Agisoft, MATLAB or HALCON, or a cameras.json"
            raise unfit(path.name, "an unknown file type", expected)
    if halcon:
        add(", ".join(path.name for path in halcon), read_halcon(halcon, pair_names))
    if texts:
        if not {"cameras.txt", "images.txt"} <= set(texts) <= {"cameras.txt", "images.txt", "points3D.txt"}:
            raise unfit(", ".join(texts), "part of a COLMAP model", "both cameras.txt and images.txt")
        add("images.txt", read_colmap(texts["cameras.txt"], texts["images.txt"], known))
    return cameras


def camera_texts(cameras: Mapping[str, Camera], form: CameraFormat) -> dict[str, str]:
    """Cameras in another program's format: file name → content.

    Raises:
        SessionError: a lens that the format cannot represent.
    """
    match form:
        case "opencv":
            return {f"{name}.yml": opencv_text(camera) for name, camera in cameras.items()}
        case "colmap":
            return colmap_texts(cameras)
        case "kalibr":
            return {"camchain.yaml": kalibr_text(cameras)}
        case "json":
            return {"cameras.json": json.dumps(cameras_table(cameras), indent=1) + "\n"}


def camera_file_names(names: Iterable[str], form: CameraFormat) -> tuple[str, ...]:
    """Names of the files that `camera_texts` writes for cameras with these names."""
    match form:
        case "opencv":
            return tuple(f"{name}.yml" for name in names)
        case "colmap":
            return ("cameras.txt", "images.txt", "points3D.txt")
        case "kalibr":
            return ("camchain.yaml",)
        case "json":
            return ("cameras.json",)


@READERS.add(".json")
def _read_own(path: Path, pair_names: Mapping[str, tuple[str, str]]) -> dict[str, Camera]:
    return read_cameras(path)


@READERS.add(".yml")
@READERS.add(".yaml")
@READERS.add(".xml")
def _read_marked(path: Path, pair_names: Mapping[str, tuple[str, str]]) -> dict[str, Camera]:
    """Read a YAML or XML file of the program whose mark it starts with.

    OpenCV's YAML starts with an outdated header that other programs do not write. The root of Agisoft's XML is
    ``document``.
    """
    known = _names(pair_names)
    with path.open("rb") as file:
        start = file.read(_HEAD_BYTES).removeprefix(b"\xef\xbb\xbf").lstrip()
    if b"<document" in start:
        return read_agisoft(path, known)
    is_opencv = path.suffix.lower() == ".xml" or start.startswith((b"%YAML", b"<?xml"))
    return read_opencv(path, pair_names) if is_opencv else read_kalibr(path, known)


def _names(pair_names: Mapping[str, tuple[str, str]]) -> list[str]:
    return [name for pair in pair_names.values() for name in pair]


_ONE_PLACE_MM = 1e-6  # distance below which two cameras are at the same position, apart from rounding


def require_rig(
    files: str,
    cameras: Mapping[str, Camera],
    pair_names: Mapping[str, tuple[str, str]],
    subject_kind: str,
    upside_down: Collection[str] = (),
) -> tuple[Notice, ...]:
    """Refuse imported cameras that are at one position, swapped, or in another unit.

    Args:
        files: names of the cameras' files, for messages.
        cameras: all cameras of the pairs.
        pair_names: pair → its left and right camera.
        subject_kind: ``model``, ``torso`` or ``surface``.
        upside_down: cameras that are mounted upside down.

    Returns:
        Warnings about doubtful lengths. Empty if they are usual.

    Raises:
        SessionError: names the files, what was found, and the unit that would fit.
        CalibrationError: names the pair whose right camera is to the left of the left one.
    """
    for camera_pair, other in combinations(dict.fromkeys(name for pair in pair_names.values() for name in pair), 2):
        distance_mm = np.linalg.norm(cameras[camera_pair].centre_world - cameras[other].centre_world)
        if distance_mm < _ONE_PLACE_MM:
            raise SessionError(
                files,
                found=f"R and T that put cameras {camera_pair} and {other} at one position",
                expected="R and T of each camera, all in one frame, T in millimetres",
                remedy="Export the cameras with their poses, from a calibration of the whole rig",
            )
    rig = Rig(name="imported", cameras=dict(cameras), pair_names=dict(pair_names))
    require_sides(rig, upside_down)
    return require_camera_scale(files, rig, subject_kind)
