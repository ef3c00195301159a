"""Which mark stands before decimals in a table's numbers: a point or a comma.

``1,860`` is 1860 to one writer and 1.86 to another. What decides is another cell: ``950,5`` or ``1,860.5``.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from mammometry.base.parse import number

_OTHER = {",": ".", ".": ","}
_GROUPED = {mark: re.compile(rf"[+-]?[1-9][0-9]{{0,2}}(?:[{mark}][0-9]{{3}})+", re.ASCII) for mark in _OTHER}
"""By what separates thousands."""
_SHORT = re.compile(r"[+-]?[1-9][0-9]{0,2}", re.ASCII)
_LONG = re.compile(r"[+-]?[0-9]{4,}", re.ASCII)


@dataclass(frozen=True, slots=True, kw_only=True)
class DecimalMark:
    """How a table writes its numbers."""

    mark: str
    """Before decimals: a point or a comma."""
    groups: bool = False
    """Whether some cell shows that the other mark separates thousands."""
    ambiguous: frozenset[int] = frozenset()
    """Columns in which nothing shows what a mark before three digits means."""

    def number(self, cell: str) -> float:
        """Parse a cell.

        Raises:
            ValueError: it is no number as this table writes them.
        """
        thousands = _OTHER[self.mark]
        whole, point, decimals = cell.partition(self.mark)
        if self.groups and _GROUPED[thousands].fullmatch(whole):
            whole = whole.replace(thousands, "")
        if thousands in whole + decimals:
            raise ValueError(f"{cell!r}, which has a {'comma' if thousands == ',' else 'point'}")
        return number(f"{whole}{'.' if point else ''}{decimals}")


def decimal_mark(columns: Iterable[Sequence[str]]) -> DecimalMark:
    """Find out how a table writes its numbers, from all cells of some columns."""
    marks: list[str] = []
    doubtful: list[str] = []
    ambiguous: set[int] = set()
    long = groups = False
    for place, cells in enumerate(columns):
        before = len(doubtful)
        for cell in cells:
            letters = [letter for letter in cell if letter in _OTHER]
            if not letters:
                long = long or bool(_LONG.fullmatch(cell))
            elif len(letters) == 1:
                (doubtful if _GROUPED[letters[0]].fullmatch(cell) else marks).append(letters[0])
            else:
                groups = True
                several = cell.count(letters[-1]) > 1  # 1.860.000, else 1.860,5
                marks.append(_OTHER[letters[-1]] if several else letters[-1])
        # 1.860 has decimals to most, unless whole numbers stand beside it.
        if "," in doubtful[before:] or (doubtful[before:] and any(map(_SHORT.fullmatch, cells))):
            ambiguous.add(place)
    if marks:
        return DecimalMark(mark=marks[0], groups=groups)
    if long:  # 1860 beside 1,250: whoever separates thousands does so everywhere
        ambiguous.clear()
    return DecimalMark(mark=(doubtful or ["."])[0], ambiguous=frozenset(ambiguous))


def both_readings(cell: str) -> tuple[str, str] | None:
    """What a cell such as ``1,860`` may mean: 1860 or 1.86. None where it means one number or none."""
    marks = {letter for letter in cell if letter in _OTHER}
    if len(marks) != 1 or not _GROUPED[mark := marks.pop()].fullmatch(cell) or cell.count(mark) != 1:
        return None
    return f"{number(cell.replace(mark, '')):g}", f"{number(cell.replace(mark, '.')):g}"
