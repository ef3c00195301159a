"""Read a table of repeated captures: one row per volume, or one row per folder of results."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType

from mammometry.base.errors import TableError
from mammometry.base.identity import folded
from mammometry.geometry.arrays import Array, Float64
from mammometry.io.csv_tables import CsvTable, read_table
from mammometry.io.measured_columns import measured_column
from mammometry.io.subject_columns import SIDES, SUBJECTS, column_named, side_in
from mammometry.study.repeatability.design import Reading

_COLUMNS: Mapping[str, Sequence[str]] = MappingProxyType(
    {
        "woman": SUBJECTS,
        "side": SIDES,
        "device": ("device", "scanner", "rig", "telephone", "system"),
        "rater": ("rater", "operator", "technician", "photographer", "examiner"),
        "day": ("day", "date", "visit"),
        "capture": ("capture", "repeat", "repetition", "scan", "take", "position"),
        "reader": ("reader", "observer"),
        "reading": ("reading",),
        "folder": ("folder", "session", "path", "results"),
    }
)
"""Role → names of its column, most certain first."""
_CONDITIONS = ("posture", "breath", "arms", "stand", "seat")
_LENGTH = "_mm"
_CC_PER = MappingProxyType({"": 1.0, "cc": 1.0, "ml": 1.0, "dl": 100.0, "l": 1000.0, "mm3": 0.001})
"""Unit → cc."""
_BOTH = ("left_cc", "right_cc")
VOLUME = "volume_cc"
"""Column of volumes, unless the user names one."""
_EXPECTED = "a CSV table, one row per capture"


@dataclass(frozen=True, slots=True, kw_only=True)
class RepeatedFolder:
    """A folder with the results of one capture, and its row of the table."""

    folder: Path
    woman: str
    device: str = ""
    rater: str = ""
    day: str = ""
    capture: str
    reader: str = ""
    reading: str = ""
    conditions: tuple[tuple[str, str], ...] = ()


def read_repeated(path: Path, measured: str | None = None) -> tuple[Reading, ...] | tuple[RepeatedFolder, ...]:
    """Read a table of repeated captures.

    The columns are found by their names: woman (patient, subject, …), side, device, rater (operator, …), day, capture,
    reader, reading. Without a column of captures, the rows with the same woman, side, device, rater, day and reader are
    numbered. Volumes are in ``volume_cc``, in ``left_cc`` and ``right_cc``, or in the given column. Instead, a column
    ``folder`` may name folders of results, relative to the table's folder.

    Args:
        path: the table.
        measured: column of the volumes. None: found by its name.

    Raises:
        TableError: the table cannot be read, a column is missing, or a cell is empty or not a positive volume.
    """
    table = read_table(path, str(path), _EXPECTED, refusal=TableError)
    roles = {role: column_named(table, names, measured) for role, names in _COLUMNS.items()}
    if roles["woman"] is None:
        raise _refused(table, f"columns {', '.join(table.columns)}", "a column woman", "Name the column of the women")
    texts = {role: table.texts(column) if column else ("",) * len(table.rows) for role, column in roles.items()}
    for role, column in roles.items():
        if column:
            table.require(column, [bool(cell) for cell in texts[role]], "a value in every row")
    conditions = _conditions(table, [*roles.values(), measured])
    if measured is None and roles["folder"] is not None and VOLUME not in table.columns:
        captures = _captures(texts, [""] * len(table.rows))
        return tuple(
            RepeatedFolder(
                folder=(path.parent / folder).resolve(),
                capture=captures[row],
                conditions=conditions[row],
                **{role: texts[role][row] for role in ("woman", "device", "rater", "day", "reader", "reading")},
            )
            for row, folder in enumerate(texts["folder"])
        )
    if measured is None and VOLUME not in table.columns and set(_BOTH) <= set(table.columns):
        sides = {"left": _BOTH[0], "right": _BOTH[1]}
    else:
        sides = {"": measured or VOLUME}
    read: list[Reading] = []
    for side, column in sides.items():
        volumes = _volumes(table, column, blank=bool(side))
        own = [side or side_in(table, row, texts["side"][row]) for row in range(len(table.rows))]
        captures = _captures(texts, own)
        read += [
            Reading(
                side=own[row],
                capture=captures[row],
                volume_cc=float(volumes[row]),
                conditions=conditions[row],
                **{role: texts[role][row] for role in ("woman", "device", "rater", "day", "reader", "reading")},
            )
            for row in range(len(table.rows))
            if volumes[row] == volumes[row]
        ]
    return tuple(read)


def _conditions(table: CsvTable, used: Sequence[str | None]) -> list[tuple[tuple[str, str], ...]]:
    """Conditions of each capture in the table: posture, breath, arms, and lengths in mm."""
    names = [name for name in table.columns if name not in used
             and (folded(name) in _CONDITIONS or name.endswith(_LENGTH))]  # fmt: skip
    lengths = {name: table.numbers(name, blank=True)[:, 0] for name in names if name.endswith(_LENGTH)}
    cells = {name: table.texts(name) for name in names}
    return [
        tuple((name, f"{lengths[name][row]:g}" if name in lengths else cells[name][row])
              for name in names if cells[name][row])
        for row in range(len(table.rows))
    ]  # fmt: skip


def _captures(texts: Mapping[str, Sequence[str]], sides: Sequence[str]) -> list[str]:
    """The column of captures. Without one, numbers in the order of the rows."""
    if any(texts["capture"]):
        return list(texts["capture"])
    counted: dict[tuple[str, ...], int] = {}
    found = []
    for row, side in enumerate(sides):
        key = (side, *(texts[role][row] for role in ("woman", "device", "rater", "day", "reader")))
        counted[key] = counted.get(key, 0) + 1
        found.append(str(counted[key]))
    return found


def _volumes(table: CsvTable, column: str, *, blank: bool) -> Float64[Array, " n"]:
    volumes = table.numbers(column, blank=blank)[:, 0]
    known = measured_column(column, volumes[volumes == volumes]) if (volumes == volumes).any() else None
    unit = "" if known is None else known.unit
    if unit not in _CC_PER:
        raise _refused(table, f"{unit} in column {column}", "volumes", "Choose the column of the volumes: --measured")
    table.require(column, ~(volumes <= 0), "a volume of more than 0")
    return volumes * _CC_PER[unit]


def _refused(table: CsvTable, found: str, expected: str, remedy: str) -> TableError:
    return TableError(table.name, found=found, expected=expected, remedy=remedy)
