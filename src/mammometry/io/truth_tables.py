"""Read a table of breasts with reference volumes: specimens, segmentations, volumes."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType

import numpy as np

from mammometry.base.errors import SessionError, TableError
from mammometry.base.identity import folded
from mammometry.geometry.arrays import Array, Float64
from mammometry.io.csv_tables import CsvTable, read_table
from mammometry.io.label_maps.read import is_label_map, segment_cc
from mammometry.io.meshes.foreign import read_foreign
from mammometry.io.subject_columns import SIDES, SUBJECTS, column_named, side_in
from mammometry.study.validation.truths import TrueVolume, skin_left, water, weight

_COLUMNS: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {
        "water": ("displaced_g", "water_c", "skin_left_cm2", "skin_mm", "displaced_sd_cc"),
        "weight": ("weight_g", "age", "glandular_percent", "skin_left_cm2", "skin_mm"),
        "segmentation": ("segmentation", "units", "segment", "truth_sd_cc"),
        "volume": ("truth_cc", "truth_sd_cc"),
    }
)
"""Kind of truth → its columns, of which the first is required."""
KINDS = tuple(_COLUMNS)
"""Kinds of truth."""
_EXAMPLES = MappingProxyType(
    {
        "water": ("512.0", "21", "35", "", ""),
        "weight": ("498", "57", "", "35", ""),
        "segmentation": ("segmentations/W1-left.stl", "mm", "", "10"),
        "volume": ("530", "10"),
    }
)
_MOST = MappingProxyType({"water_c": 40.0, "age": 120.0, "glandular_percent": 100.0})
"""Column → its largest value. For the water, it is the limit of the formula for its density."""
_ROOM_C = 20.0  # temperature of water if the table does not give it, °C; 10 °C more or less change the volume by 0.2 %
_FOLDER = "folder"
_CC = "_cc"


@dataclass(frozen=True, slots=True, kw_only=True)
class TruthRow:
    """One breast of the table: its truth, and its measured volumes or the folder with its results."""

    woman: str
    side: str
    truth: TrueVolume
    measured_cc: Mapping[str, float]
    folder: Path | None
    """A session or a scan, from which the volumes by all definitions are read."""


def template(kind: str) -> str:
    """An example of a table for a kind of truth: one line with columns, two with breasts."""
    columns, example = _COLUMNS[kind], _EXAMPLES[kind]
    lines = [("woman", "side", *columns, "measured_cc")]
    lines += [("W1", side, *(cell.replace("left", side) for cell in example), "520") for side in ("left", "right")]
    return "\n".join(",".join(line) for line in lines) + "\n"


def read_truths(path: Path, kind: str | None = None) -> tuple[str, tuple[TruthRow, ...]]:
    """Read a table of breasts with a truth.

    Columns: woman (or patient, subject, …), side, those of one kind of truth (see `template`), and either ``folder``
    with sessions or scans, or one column per definition of the measured volume, such as ``flat_chest_cc``.

    Args:
        path: the table. Folders and segmentations are relative to its folder.
        kind: kind of truth. None: the kind of which the table has a column.

    Returns:
        Kind of truth, and the rows.

    Raises:
        TableError: a column is missing, there are two kinds of truth and none is chosen, or a cell is invalid.
        SessionError: a segmentation cannot be read or is not closed.
    """
    table = read_table(path, str(path), "a CSV table, one row per breast", refusal=TableError)
    there = [name for name, columns in _COLUMNS.items() if columns[0] in table.columns]
    if (kind is None and len(there) != 1) or (kind is not None and kind not in there):
        raise _refused(
            table,
            f"the truth as {' and '.join(there)}" if there else "no column of a truth",
            f"a column {_COLUMNS[kind][0]}" if kind else "one of " + ", ".join(own[0] for own in _COLUMNS.values()),
            "Choose one: --truth water, weight, segmentation or volume" if len(there) > 1 else "Add the column",
        )
    chosen = kind or there[0]
    who = column_named(table, SUBJECTS)
    if who is None:
        raise _refused(table, f"columns {', '.join(table.columns)}", "a column woman", "Name the column of the women")
    which = column_named(table, SIDES)
    women = [folded(name) and name for name in table.texts(who)]
    sides = [side_in(table, row, word) for row, word in enumerate(table.texts(which))] if which else [""] * len(women)
    _require_once(table, list(zip(women, sides, strict=True)))
    used = {who, which, *(name for columns in _COLUMNS.values() for name in columns)}
    definitions = [name for name in table.columns if name.endswith(_CC) and name not in used]
    folders = table.texts(_FOLDER) if _FOLDER in table.columns else ("",) * len(women)
    if not definitions and not any(folders):
        raise _refused(table, "no measured volume", "columns such as measured_cc, or a column folder", "Add one")
    measured = table.numbers(*definitions, blank=True, alike=True) if definitions else np.zeros((len(women), 0))
    for name, column in zip(definitions, measured.T, strict=True):
        table.require(name, ~(column <= 0), "a volume of more than 0, or an empty cell")
    truths = _truths(table, path, chosen)
    rows = tuple(
        TruthRow(
            woman=women[row],
            side=sides[row],
            truth=truths[row],
            measured_cc={
                name.removesuffix(_CC).replace("_", " "): float(volume)
                for name, volume in zip(definitions, measured[row], strict=True)
                if not math.isnan(volume)
            },
            folder=(path.parent / folders[row]).resolve() if folders[row] else None,
        )
        for row in range(len(women))
    )
    return chosen, rows


def _truths(table: CsvTable, path: Path, kind: str) -> list[TrueVolume]:
    count = len(table.rows)
    numbers = {
        name: _optional(table, name, needed=place == 0)
        for place, name in enumerate(_COLUMNS[kind])
        if name not in ("segmentation", "units", "segment")
    }
    value = {name: [None if math.isnan(number) else float(number) for number in column]
             for name, column in numbers.items()}  # fmt: skip
    if kind == "segmentation":
        files = table.texts("segmentation")
        units, segments = (
            table.texts(name) if name in table.columns else ("",) * count for name in ("units", "segment")
        )
        return [
            TrueVolume(volume_cc=_segmented_cc(path.parent / file, unit or None, segment), sd_cc=_or_nan(sd))
            for file, unit, segment, sd in zip(files, units, segments, value["truth_sd_cc"], strict=True)
        ]
    if kind == "volume":
        return [
            TrueVolume(volume_cc=float(volume), sd_cc=_or_nan(sd))
            for volume, sd in zip(numbers["truth_cc"], value["truth_sd_cc"], strict=True)
        ]
    skins = [
        skin_left(area or 0.0, thickness)
        for area, thickness in zip(value["skin_left_cm2"], value["skin_mm"], strict=True)
    ]
    if kind == "water":
        return [
            water(float(grams), _ROOM_C if degrees is None else degrees, skin, sd)
            for grams, degrees, sd, skin in zip(
                numbers["displaced_g"], value["water_c"], value["displaced_sd_cc"], skins, strict=True
            )
        ]
    return [
        weight(float(grams), age, percent, skin)
        for grams, age, percent, skin in zip(
            numbers["weight_g"], value["age"], value["glandular_percent"], skins, strict=True
        )
    ]


def _optional(table: CsvTable, name: str, *, needed: bool) -> Float64[Array, " n"]:
    """A column of numbers of 0 or more, NaN if empty or missing. If needed, complete and above 0."""
    if name not in table.columns and not needed:
        return np.full(len(table.rows), math.nan)
    found = table.numbers(name, blank=not needed)[:, 0]
    most = _MOST.get(name, math.inf)
    if needed:
        table.require(name, found > 0, "a value of more than 0")
    else:
        table.require(name, ~((found < 0) | (found > most)), f"a value of 0 to {most:g}")
    return found


def _segmented_cc(file: Path, units: str | None, segment: str) -> float:
    """Volume of a closed mesh, or of a segment in a label map, cc."""
    if is_label_map(file):
        return segment_cc(file, segment, units)
    mesh = read_foreign(file, units).mesh
    if not mesh.is_watertight():
        raise SessionError(
            str(file),
            found="a mesh with holes",
            expected="the closed surface of a segmented breast",
            remedy="Close the surface in the program that segmented it, and export it again",
        )
    return abs(mesh.volume_mm3()) / 1000.0


def _or_nan(number: float | None) -> float:
    return math.nan if number is None else number


def _require_once(table: CsvTable, breasts: Sequence[tuple[str, str]]) -> None:
    for row, breast in enumerate(breasts):
        if not breast[0] or breast in breasts[:row]:
            raise TableError(
                f"{table.name}, row {table.lines[row]}",
                found=f"{' '.join(breast).strip()} twice" if breast[0] else "no woman",
                expected="each breast once",
                remedy="Correct or remove the row",
            )


def _refused(table: CsvTable, found: str, expected: str, remedy: str) -> TableError:
    return TableError(table.name, found=found, expected=expected, remedy=remedy)
