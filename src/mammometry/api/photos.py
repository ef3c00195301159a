"""Photographs by one telephone and a printed board: from a folder of pictures to a session.

::

    from mammometry.api.photos import prepare_walk

    session = prepare_walk(Path("photos"), Path("anna")).folder
    print(mm.open_session(session).run().volumes_cc)
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from PIL import Image

from mammometry.base.errors import SessionError
from mammometry.base.listing import visible
from mammometry.base.parse import LimitSettings, read_text, toml_table
from mammometry.base.photograph import Photograph
from mammometry.base.progress import Progress, no_progress
from mammometry.calibration.judge.expected_error import expected_error
from mammometry.calibration.targets.table import target_from_table
from mammometry.calibration.targets.target import Target
from mammometry.geometry import Array, Bool, Camera, Rig
from mammometry.io.cameras.own import cameras_table
from mammometry.io.looked_up import LazyMapping
from mammometry.io.photographs.images import EXTENSIONS, read_photograph
from mammometry.walk.pairs import choose_pairs
from mammometry.walk.region import Region, region_above
from mammometry.walk.stations import Stations, find_stations

BOARD = "board.toml"
PRINT_STD = 0.01
"""Relative standard uncertainty of a printed board that nobody measured: printers scale pages by up to a few per cent."""
_TELEPHONE_BOARD = {
    "kind": "charuco",
    "squares": [11, 7],
    "square_mm": 24.0,
    "marker_mm": 17.0,
    "dictionary": "DICT_5X5_100",
}
"""The board that `mammometry target --telephone` prints."""
_MARGIN_PX = 32  # kept around the region's picture, for windows at its edge


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PreparedWalk:
    """A session made of a walk's photographs."""

    folder: Path
    stations: Stations
    pair_names: Mapping[str, tuple[str, str]]
    region: Region
    scale_std: float
    point_std_mm: float


def prepare_walk(
    folder: Path,
    out: Path,
    *,
    posture: str = "standing",
    subject: str | None = None,
    progress: Progress = no_progress,
) -> PreparedWalk:
    """Find where the telephone was at each photograph, choose pairs, and write a session that can be measured.

    The session holds the photographs of the pairs, cropped to the body's region, without EXIF data.

    Args:
        folder: the photographs, and ``board.toml`` where the board is another than ours.
        out: the session's folder, which is made.
        posture: of the patient.
        subject: pseudonym.
        progress: of the search for the board.

    Raises:
        SessionError: no photographs, or a ``board.toml`` that is not as documented.
        CalibrationError: the photographs do not show where they were taken.
    """
    target, scale_std = read_board(folder)
    photographs = walk_photographs(folder)
    stations = find_stations(photographs, target, progress=progress)
    region = region_above(target)
    pairs = choose_pairs(stations.rig, region.middle_world)
    in_pairs = sorted({name for pair in pairs.values() for name in pair})
    chosen = Rig(
        name="telephone",
        cameras={name: stations.rig.cameras[name] for name in in_pairs},
        pair_names=pairs,
        target_middle_world=region.middle_world,
    )
    expected = np.concatenate(list(expected_error(replace(stations.expanded, rig=chosen)).std_mm.values()))
    point_std_mm = float(np.sqrt(np.nanmean(expected**2)))
    walk = PreparedWalk(
        folder=out,
        stations=stations,
        pair_names=pairs,
        region=region,
        scale_std=stations.expanded.scale_std or scale_std,
        point_std_mm=point_std_mm,
    )
    _write(walk, chosen, photographs, posture, subject)
    return walk


def read_board(folder: Path) -> tuple[Target, float]:
    """The board of a walk, and the relative standard uncertainty of its size.

    Raises:
        SessionError: ``board.toml`` is not as documented.
    """
    path = folder / BOARD
    if not path.is_file():
        return target_from_table(dict(_TELEPHONE_BOARD)), PRINT_STD
    table = toml_table(read_text(path, str(path), "TOML", most_mib=1), str(path), "a board as [target] of session.toml")
    target = target_from_table(table.get("target", table))
    return target, target.scale_std or PRINT_STD


def walk_photographs(folder: Path) -> Mapping[str, Photograph]:
    """The photographs of a walk by name, in their order, read when looked up.

    Raises:
        SessionError: there are none.
    """
    files = {path.stem: path for path in visible(folder) if path.suffix.lower() in EXTENSIONS and path.is_file()}
    if not files:
        raise SessionError(
            str(folder),
            found="no photographs" if folder.is_dir() else "no such folder",
            expected="12 to 60 photographs of one walk around the patient, JPEG or PNG",
            remedy="Copy them from the telephone into one folder",
        )
    return LazyMapping(dict(sorted(files.items())), lambda _, path: read_photograph(path, path.name, LimitSettings()))


def _write(
    walk: PreparedWalk, rig: Rig, photographs: Mapping[str, Photograph], posture: str, subject: str | None
) -> None:
    capture, masks = walk.folder / "capture", walk.folder / "masks"
    capture.mkdir(parents=True)
    masks.mkdir()
    cameras = {}
    for name, camera in rig.cameras.items():
        mask = walk.region.mask(camera)
        rows, columns = _box(mask)
        cameras[name] = _cropped(camera, rows, columns)
        pixels = photographs[name].pixels[rows, columns]
        Image.fromarray(np.ascontiguousarray(pixels)).save(capture / f"{name}.png", compress_level=1)
        Image.fromarray(mask[rows, columns]).save(masks / f"{name}.png")
    (walk.folder / "cameras.json").write_text(json.dumps(cameras_table(cameras), indent=1), encoding="utf-8")
    (walk.folder / "session.toml").write_text(_manifest(walk, posture, subject), encoding="utf-8")


def _box(mask: Bool[Array, "h w"]) -> tuple[slice, slice]:
    rows, columns = (np.flatnonzero(mask.any(axis=axis)) for axis in (1, 0))
    return (
        slice(max(0, int(rows[0]) - _MARGIN_PX), int(rows[-1]) + 1 + _MARGIN_PX),
        slice(max(0, int(columns[0]) - _MARGIN_PX), int(columns[-1]) + 1 + _MARGIN_PX),
    )


def _cropped(camera: Camera, rows: slice, columns: slice) -> Camera:
    """The camera of a part of its picture."""
    width, height = camera.size_wh
    matrix = camera.matrix.copy()
    matrix[0, 2] -= columns.start
    matrix[1, 2] -= rows.start
    size_wh = (min(columns.stop, width) - columns.start, min(rows.stop, height) - rows.start)
    return replace(camera, matrix=matrix, size_wh=size_wh)


def _manifest(walk: PreparedWalk, posture: str, subject: str | None) -> str:
    pairs = "\n".join(
        f'    {{ name = "{name}", left = "{left}", right = "{right}" }},'
        for name, (left, right) in walk.pair_names.items()
    )
    named = "" if subject is None else f"id = {json.dumps(subject)}\n"
    corners = [[round(float(x), 3) for x in corner] for corner in (walk.region.low_world, walk.region.high_world)]
    return (
        "# Made by `mammometry photos`: photographs by one telephone and a printed board.\n"
        'format = 1\nunits = "mm"\n\n'
        f'[rig]\nname = "telephone"\npairs = [\n{pairs}\n]\n\n'
        f'[subject]\nkind = "torso"\n{named}posture = "{posture}"\n\n'
        f"[walk]\nregion_mm = {corners}\nscale_std = {walk.scale_std:.4g}\npoint_std_mm = {walk.point_std_mm:.3g}\n"
    )
