"""Subjects and sides of a table's rows. Summary rows are refused."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mammometry.base.errors import TableError
from mammometry.base.identity import folded
from mammometry.base.parse import shown
from mammometry.geometry.arrays import Array, Float64
from mammometry.io.csv_tables import CsvTable

SUBJECTS = ("patient", "subject", "woman", "participant", "person", "pseudonym", "case", "id", "name", "model")
"""Names of the column of subjects, most certain first."""
SIDES = ("side", "breast", "laterality", "seite")
"""Names of the column of sides."""
SIDE_WORDS = {
    "left": "left", "l": "left", "li": "left", "links": "left", "gauche": "left", "izquierda": "left",
    "right": "right", "r": "right", "re": "right", "rechts": "right", "droite": "right", "derecha": "right",
}  # fmt: skip
"""Word for a side, normalised → ``left`` or ``right``."""
_SIDE_ENDING = re.compile(r"(?P<who>.+?)(?:[\s_,.;:/-]+\(?(?P<word>[^\W\d_]+)\)?|(?<=\d)(?P<letter>[lr]))")
_SUMMARIES = frozenset(
    ("mean", "average", "avg", "median", "sd", "std", "stddev", "stdev", "standarddeviation", "sem", "variance",
     "total", "sum", "range", "cv", "mean±sd", "mean(sd)", "mittelwert", "durchschnitt", "mittel", "standardabweichung",
     "summe", "gesamt", "moyenne", "médiane", "écart-type", "media", "mediana", "desviación", "promedio", "suma",
     "média", "gemiddelde", "medelvärde", "gennemsnit", "gjennomsnitt", "keskiarvo", "średnia", "průměr", "átlag",
     "ortalama", "среднее", "平均", "平均値", "평균")
)  # fmt: skip
"""Names of summary rows."""
_FIRST_WORDS = frozenset(("mean", "average", "median", "sd", "mittelwert", "moyenne", "promedio"))
"""Those that cannot be the beginning of a patient's name."""
_LEAST_ROWS = 3  # fewest rows above a row that may be their mean
_ROUNDING = 5e-6  # relative rounding of numbers with six digits, as written by %g
_MOST_DECIMALS = 9  # most decimals of a printed number
_TELLING = 20.0  # a value of this many rounding steps equals the mean by chance in fewer than 1 of 400 rows
_LAST_ROWS = 6  # last rows of a table that may be summaries: mean, SD, median, minimum, maximum, count


def column_named(table: CsvTable, names: Sequence[str], without: str | None = None) -> str | None:
    """First column of a table with one of these names, in the order of the names. None if there is none.

    Args:
        table: the table.
        names: names of columns, normalised.
        without: a column to ignore.
    """
    known = {folded(name): name for name in reversed(table.columns) if name and name != without}
    return next((known[name] for name in names if name in known), None)


def side_in(table: CsvTable, row: int, word: str) -> str:
    """Side of a row: ``left``, ``right``, or empty if the cell is empty.

    Raises:
        TableError: the cell contains another word.
    """
    if word and folded(word) not in SIDE_WORDS:
        raise TableError(
            f"{table.name}, row {table.lines[row]}", found=f"the side {shown(word)}", expected="left or right",
            remedy="Correct the side",
        )  # fmt: skip
    return SIDE_WORDS[folded(word)] if word else ""


@dataclass(frozen=True, slots=True, kw_only=True)
class SubjectRows:
    """Subjects of a table, one entry per row."""

    names: tuple[str, ...]
    """Name of the row: the subject, and the side if there is a column for it."""
    subjects: tuple[str, ...]
    """Subject of the row. Case and the encoding of accented letters are ignored."""


def subject_rows(table: CsvTable, measured: tuple[str, str], pairs: Float64[Array, "n 2"]) -> SubjectRows:
    """Find the subject of each row.

    The subjects are in a column named patient, subject, id or similar, or else in the first column if it is not
    measured. Otherwise each row is a different subject. Names that differ only by a side (``P7 left``, ``P7 right``)
    are one subject.

    Args:
        table: the whole table.
        measured: names of the two columns of measurements.
        pairs: the measurements.

    Raises:
        TableError: a row has no subject, is a summary, or repeats another row.
    """
    column = _subject_column(table, measured)
    side = next((name for name in table.columns if folded(name) in SIDES and name not in measured), None)
    count = len(table.rows)
    own = table.texts(column) if column else tuple(str(row + 1) for row in range(count))
    sides = table.texts(side) if side else ("",) * count
    for row in range(count):
        _require_subject(table, row, own if column else None, pairs)
    subjects = _without_sides([folded(name) for name in own])
    _require_once(table, [(who, folded(part)) for who, part in zip(subjects, sides, strict=True)], pairs, bool(column))
    names = tuple(f"{name}, {part}" if part else name for name, part in zip(own, sides, strict=True))
    return SubjectRows(names=names, subjects=tuple(subjects))


def _subject_column(table: CsvTable, measured: tuple[str, str]) -> str | None:
    words = {name: folded(re.sub(r"[_\s.-]*(id|no|nr|number|code)$", "", name, flags=re.IGNORECASE) or name)
             for name in table.columns if name and name not in measured}  # fmt: skip
    for word in SUBJECTS:
        found = [name for name, own in words.items() if own == word]
        if found:
            return found[0]
    first = table.columns[0]
    return None if first in measured or words.get(first) in SIDES or not first else first


def _without_sides(names: list[str]) -> list[str]:
    """Names without their side, if there are both sides of a subject."""
    parts: list[tuple[str, str]] = []
    for name in names:
        match = _SIDE_ENDING.fullmatch(name)
        side = "" if match is None else SIDE_WORDS.get(match["word"] or match["letter"], "")
        parts.append((match["who"], side) if match is not None and side else (name, ""))
    seen: dict[str, set[str]] = defaultdict(set)
    for who, side in parts:
        seen[who].add(side)
    both = any({"left", "right"} <= sides for sides in seen.values())
    return [who if both else name for name, (who, _) in zip(names, parts, strict=True)]


def _require_subject(table: CsvTable, row: int, names: tuple[str, ...] | None, pairs: Float64[Array, "n 2"]) -> None:
    """Refuse a row without a subject, or a summary row, which is recognised by its name or its numbers.

    A row whose name has the form of the first one's (``P-07`` and ``P-01``) is a subject, whatever its numbers.
    """
    where = f"{table.name}, row {table.lines[row]}"
    name = "" if names is None else names[row]
    if names is not None and not name:
        remedy = "Name it, or remove the row"
        raise TableError(where, found="no subject", expected="a subject in every row", remedy=remedy)
    words = folded(name).replace(".", "").replace(":", "").split()
    listed = "".join(words) in _SUMMARIES or not _FIRST_WORDS.isdisjoint(words[:1])
    last = max(_LEAST_ROWS, len(pairs) - _LAST_ROWS) <= row
    numbered = names is not None and any(map(str.isdigit, name)) and _shape(name) == _shape(names[0])
    computed = last and not numbered and _computed(pairs[:row], pairs[row])
    if listed or computed:
        found = f"{name!r}, a summary" if listed else f"the {computed} of the rows above it"
        raise TableError(where, found=found, expected="a subject in every row", remedy="Remove summary rows")


def _shape(name: str) -> str:
    """Form of a name: ``P-07`` → ``a-9``."""
    return re.sub(r"\d+", "9", re.sub(r"[^\W\d_]+", "a", name))


def _computed(above: Float64[Array, "m 2"], values: Float64[Array, " 2"]) -> str:
    """Statistic of the rows above that a row's numbers equal. Empty if it is none of the usual ones."""
    kinds = {"mean": above.mean(axis=0), "standard deviation": above.std(axis=0, ddof=1), "sum": above.sum(axis=0)}
    return next((kind for kind, computed in kinds.items() if _rounds_to(computed, values)), "")


def _rounds_to(computed: Float64[Array, " 2"], values: Float64[Array, " 2"]) -> bool:
    """Whether both values equal the computed ones after rounding. Small whole numbers may do so by chance.

    The computed values are from rounded numbers, but the table's summary may be from unrounded ones.
    """
    within = np.array([10.0 ** -_decimals(value) for value in values]) + _ROUNDING * np.abs(computed)
    return bool((np.abs(computed - values) <= within).all() and (np.abs(values) >= _TELLING * within).all())


def _decimals(value: float) -> int:
    return len(f"{value:.{_MOST_DECIMALS}f}".rstrip("0").partition(".")[2])


def _require_once(table: CsvTable, who: list[tuple[str, str]], pairs: Float64[Array, "n 2"], named: bool) -> None:
    """Refuse a subject's numbers twice, and a table in which all numbers occur twice."""
    numbers = [tuple(pair) for pair in pairs.tolist()]
    rows = list(zip(who, numbers, strict=True)) if named else []
    first: dict[object, int] = {}
    for row, key in enumerate(rows):
        if key in first:
            raise TableError(
                f"{table.name}, row {table.lines[row]}",
                found=f"the same subject and numbers as in row {table.lines[first[key]]}",
                expected="each measurement once",
                remedy="Remove one of the two rows",
            )
        first[key] = row
    if len(numbers) > _LEAST_ROWS and all(numbers.count(pair) > 1 for pair in set(numbers)):
        expected, remedy = "each measurement once", "Remove the copy"
        raise TableError(table.name, found="every pair of numbers twice", expected=expected, remedy=remedy)
