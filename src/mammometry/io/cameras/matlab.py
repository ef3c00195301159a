"""Cameras of MATLAB's Computer Vision Toolbox, in a MAT-file.

MATLAB's objects cannot be read without MATLAB: ``toStruct`` makes structures of them. Pixels are counted from 1, at
their centres. Matrices named ``IntrinsicMatrix`` and ``Rotation…`` are for row vectors, the transposes of ours.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from mammometry.base.errors import SessionError
from mammometry.base.parse import numbers, parsing, read_bytes, shown
from mammometry.geometry.camera import Camera
from mammometry.io.cameras.own import camera_from_entry, pair_of_two, unfit
from mammometry.io.parsing.mat_file import OBJECT, read_variables

_EXPECTED = "a structure of stereoParameters, or of cameraParameters with rotationMatrix and translationVector"
_MOST_MIB = 64  # with all points of the board's pictures
_HDF5 = b"MATLAB 7.3 MAT-file"
_MM = {
    **dict.fromkeys(("mm", "millimeters", "millimetres", ""), 1.0),
    **dict.fromkeys(("cm", "centimeters", "centimetres"), 10.0),
    **dict.fromkeys(("m", "meters", "metres"), 1000.0),
    **dict.fromkeys(("in", "inches"), 25.4),
}
_FROM_ONE = 1.0  # px: the first pixel's centre is at 1
_AS_STRUCT = "In MATLAB: s = toStruct(stereoParams); save('rig.mat', 's', '-v7')"


def read_matlab(path: Path, pair_names: Mapping[str, tuple[str, str]]) -> dict[str, Camera]:
    """Read a pair of cameras, or one camera that is named as the file.

    The world is the frame of the pair's first camera; or the board, as ``extrinsics`` gives rotationMatrix and
    translationVector beside a single camera.

    Raises:
        SessionError: it holds objects or no such structures, or a lens or unit that cannot be.
    """
    variables = _variables(path)
    structures = [value for value in variables.values() if isinstance(value, Mapping)]
    pairs = [value for value in structures if "CameraParameters1" in value]
    names: tuple[str, ...]
    singles = [value for value in structures if {"IntrinsicMatrix", "K"} & set(value)]
    if len(pairs) == 1:
        pair = pair_of_two(pair_names)
        if pair is None:
            found = f"a pair of cameras, and a session of {len(pair_names)} pairs"
            raise unfit(path.name, found, "a session of one pair, or a file for each camera")
        names, stereo = pair, pairs[0]
        lenses = [_part(path, stereo, "CameraParameters1"), _part(path, stereo, "CameraParameters2")]
        turned, moved = _part(path, stereo, "RotationOfCamera2"), _part(path, stereo, "TranslationOfCamera2")
        poses: list[tuple[Any, Any]] = [(np.eye(3), np.zeros(3)), (turned, moved)]
    elif len(singles) == 1:
        names, lenses = (path.stem,), singles
        if not {"rotationMatrix", "translationVector"} <= set(variables):
            raise unfit(path.name, "one camera without its place in the rig", _EXPECTED)
        poses = [(variables["rotationMatrix"], variables["translationVector"])]
    elif any(value is OBJECT for value in variables.values()):
        raise SessionError(path.name, found="MATLAB's objects", expected=_EXPECTED, remedy=_AS_STRUCT)
    else:
        raise unfit(path.name, f"variables {', '.join(variables) or 'none'}", _EXPECTED)
    cameras = {}
    for name, lens, (rotation, translation) in zip(names, lenses, poses, strict=True):
        with parsing("an unfit value", f"{path.name}, camera {name}", _EXPECTED):
            entry = _lens(path, lens) | {"R": numbers(rotation, 3, 3).T, "t": numbers(translation, 3) * _mm(path, lens)}
        cameras[name] = camera_from_entry(path.name, name, entry)
    return cameras


def _variables(path: Path) -> dict[str, Any]:
    content = read_bytes(path, path.name, "a MAT-file", most_mib=_MOST_MIB)
    if content.startswith(_HDF5):
        raise SessionError(path.name, found="a MAT-file of version 7.3", expected="version 7", remedy=_AS_STRUCT)
    with parsing("no MAT-file", path.name, "a MAT-file of version 7"):
        return read_variables(content)


def _part(path: Path, table: Mapping[str, Any], name: str) -> Any:
    if name not in table:
        raise unfit(path.name, f"no {name}", _EXPECTED)
    return table[name]


def _lens(path: Path, table: Any) -> dict[str, Any]:
    if table is OBJECT:
        raise SessionError(path.name, found="MATLAB's objects", expected=_EXPECTED, remedy=_AS_STRUCT)
    matrix = numbers(_part(path, table, "K"), 3, 3) if "K" in table else _rows(path, table)
    radial = numbers(_part(path, table, "RadialDistortion"), -1)
    tangential = numbers(table.get("TangentialDistortion", [0.0, 0.0]), 2)
    if not 2 <= len(radial) <= 3:
        raise ValueError(f"{len(radial)} radial coefficients")
    size = numbers(_part(path, table, "ImageSize"), -1)
    if len(size) < 2:
        raise ValueError("no ImageSize: give it to estimateCameraParameters")
    matrix = matrix.copy()
    matrix[:2, 2] -= _FROM_ONE
    return {"K": matrix, "dist": [radial[0], radial[1], *tangential, *radial[2:]], "image_size": (size[1], size[0])}


def _rows(path: Path, table: Mapping[str, Any]) -> Any:
    return numbers(_part(path, table, "IntrinsicMatrix"), 3, 3).T


def _mm(path: Path, table: Mapping[str, Any]) -> float:
    unit = table.get("WorldUnits", "mm")
    unit = unit if isinstance(unit, str) else ""
    if unit.lower() not in _MM:
        raise unfit(path.name, f"lengths in {shown(unit)}", "WorldUnits in mm, cm, m or in")
    return _MM[unit.lower()]
