"""Read the ``truth/`` folder of a virtual capture, and the two files of the landmark benchmark.

Only code that compares with the truth may import this module.
"""

from __future__ import annotations

import errno
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from mammometry.base.errors import SessionError, TableError
from mammometry.base.parse import json_value, numbers, parsing, read_text, shown
from mammometry.geometry import Array, Camera, Float64, Rig, Transform
from mammometry.io.meshes.own import read_ply
from mammometry.study.evaluation import Truth
from mammometry.study.landmarks import FORMS, Places, TrueWoman

_PATIENT = "patient_"


def read_truth(folder: Path, pair_names: Mapping[str, tuple[str, str]]) -> Truth:
    """Read a truth folder.

    `mammometry simulate` writes it; ../shared/data/rendered/*/truth has the same layout. The cameras are in the folder
    itself, or in the ``truth`` folder two levels up if several captures share them.

    Args:
        folder: folder with truth.json, mesh.ply, and boundaries if there are any.
        pair_names: the session's pairs.

    Raises:
        SessionError: the folder or a file is missing or malformed, or does not contain a camera of the session.
    """
    common = folder if (folder / "cameras.json").is_file() else folder.resolve().parent.parent / "truth"
    try:
        facts = _json(folder / "truth.json")
        cameras = read_true_cameras(common)
        boards = common / "boards.json"
        placed = _json(boards)["rig_from_board"] if boards.is_file() else {}
        targets = {pose: Transform.from_matrix(np.array(matrix)) for pose, matrix in placed.items()}
        volumes, boundaries = _volumes(facts), _boundaries(folder)
    except FileNotFoundError as error:
        remedy = "Evaluate a session of `mammometry simulate`, or name its truth with --truth"
        expected = "the truth of a virtual capture: truth.json, mesh.ply and cameras.json"
        raise SessionError(
            str(folder), found=f"no {Path(error.filename).name}", expected=expected, remedy=remedy
        ) from None
    except (OSError, ValueError, KeyError, TypeError, AttributeError, IndexError) as error:
        raise SessionError(
            str(folder),
            found=f"truth files that cannot be read ({type(error).__name__}: {error})",
            expected="truth.json, cameras.json and boundaries as `mammometry simulate` writes them",
            remedy="Simulate the session again",
        ) from None
    mesh = folder / "mesh.ply"
    missing = sorted({name for pair in pair_names.values() for name in pair} - set(cameras))
    if missing:
        remedy = "Name the truth of this session with --truth"
        expected = f"also {', '.join(missing)}, which the session's pairs name"
        raise SessionError(
            str(common / "cameras.json"), found=f"cameras {', '.join(cameras)}", expected=expected, remedy=remedy
        )
    return Truth(
        rig=Rig(name="truth", cameras=cameras, pair_names=pair_names),
        rig_from_target=targets,
        mesh=read_ply(mesh)[0],
        volumes_cc=volumes,
        boundaries=boundaries,
    )


def read_volumes(folder: Path) -> dict[str, float]:
    """Read only the volumes in a truth folder, cc, by ``model`` or the patient's ``left`` and ``right``."""
    return _volumes(_json(folder / "truth.json"))


def read_true_cameras(folder: Path) -> dict[str, Camera]:
    """Read a truth folder's cameras.json: camera → camera, rig frame, mm."""
    table = _json(folder / "cameras.json")["cameras"]
    return {
        name: Camera(
            name=name,
            size_wh=(int(entry["image_size"][0]), int(entry["image_size"][1])),
            matrix=np.array(entry["K"], dtype=np.float64),
            distortion=np.array(entry["dist"], dtype=np.float64),
            camera_from_world=Transform(
                rotation=np.array(entry["R"], dtype=np.float64), translation_mm=np.array(entry["t"], dtype=np.float64)
            ),
        )
        for name, entry in table.items()
    }


def _json(path: Path) -> Any:
    if not path.exists():
        raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT), str(path))
    expected = "JSON as `mammometry simulate` writes it"
    return json_value(read_text(path, str(path), expected), str(path), expected)


def _volumes(facts: Mapping[str, Any]) -> dict[str, float]:
    """Breast → true volume, cc, with the main wall of the truth."""
    if "breasts" in facts:
        volumes = {
            name.removeprefix(_PATIENT): float(breast["volume_cc"][breast["primary"]])
            for name, breast in facts["breasts"].items()
        }
        return volumes if "model" in volumes else {"left": 0.0, "right": 0.0} | volumes  # a missing side has no volume
    if "volumes_cc" in facts:
        return {name: float(value) for name, value in facts["volumes_cc"].items()}
    return {"model": float(facts["volume_cc"])}


def _boundaries(folder: Path) -> dict[str, Float64[Array, "n 3"]]:
    """Breast → closed curve, from boundary_base.xyz or boundary_patient_{left,right}.xyz."""
    boundaries = {}
    for path in sorted(folder.glob("boundary_*.xyz")):
        name = path.stem.removeprefix("boundary_").removeprefix(_PATIENT)
        boundaries["model" if name == "base" else name] = numbers(np.loadtxt(path, dtype=np.float64, ndmin=2), -1, 3)
    return boundaries


_FOUND = 'JSON such as {"woman": {"nipple_left": [x, y, z], "border_left": [[x, y, z], …]}}, mm'
_TRUE = "a truth file of the landmark benchmark"
_FEWEST: Mapping[str, int] = {"point": 1, "line": 2, "curve": 3}


def read_found_landmarks(path: Path) -> dict[str, Places]:
    """Landmarks that a program found: woman → name → positions, mm, frame of her mesh. null: not found.

    Raises:
        TableError: the file is not as documented.
    """
    table = _table(path, _FOUND)
    with parsing("landmarks that cannot be read", str(path), _FOUND, TableError):
        return {woman: _places(own, woman) for woman, own in table.items()}


def read_true_landmarks(path: Path) -> dict[str, TrueWoman]:
    """Truth of the landmark benchmark: woman → mesh, kind of input, positions.

    Raises:
        TableError: the file is not as documented.
    """
    table = _table(path, _TRUE)
    with parsing("a truth that cannot be read", str(path), _TRUE, TableError):
        return {
            woman: TrueWoman(
                kind=str(own["kind"]),
                generator=str(own["generator"]),
                mesh=str(own["mesh"]),
                places=_places(own["landmarks"], woman),
                absent=tuple(_known(name, woman) for name in own.get("absent", ())),
            )
            for woman, own in table["women"].items()
        }


def _table(path: Path, expected: str) -> dict[str, Any]:
    table = json_value(
        read_text(path, str(path), expected, refusal=TableError), str(path), expected, refusal=TableError
    )
    if not isinstance(table, dict):
        raise TableError(str(path), found=shown(table), expected=expected, remedy="Correct it")
    return table


def _places(own: Mapping[str, Any], woman: str) -> Places:
    places = {}
    for name, value in own.items():
        form = FORMS[_known(name, woman)]
        if value is None:
            continue
        try:
            flat = isinstance(value, list) and not any(isinstance(item, list) for item in value)
            points = numbers([value] if form == "point" and flat else value, -1, 3)
        except ValueError as error:
            raise ValueError(f"{name} of {woman}: {error}") from None
        if len(points) < _FEWEST[form] or (form == "point" and len(points) > 1):
            raise ValueError(f"{name} of {woman}: {len(points)} points for a {form}")
        places[name] = points
    return places


def _known(name: str, woman: str) -> str:
    if name not in FORMS:
        raise ValueError(f"{name!r} of {woman}, which is none of {', '.join(FORMS)}")
    return name
