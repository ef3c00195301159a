"""Units of length in other programs' files, and their names."""

from __future__ import annotations

import re
from collections.abc import Mapping

MM_PER_UNIT: Mapping[str, float] = {"mm": 1.0, "cm": 10.0, "m": 1000.0, "in": 25.4, "ft": 304.8}
"""Name, as for `--units` → mm."""
UNIT_TITLES: Mapping[str, str] = {
    "mm": "millimetres", "cm": "centimetres", "m": "metres", "in": "inches", "ft": "feet",
}  # fmt: skip
UNIT_NAMES = "mm, cm, m, in or ft"
_SPELLINGS = {
    "millimetre": "mm", "millimeter": "mm", "milimeter": "mm", "centimetre": "cm", "centimeter": "cm",
    "metre": "m", "meter": "m", "inch": "in", "inche": "in", "foot": "ft", "feet": "ft",
}  # fmt: skip
"""Names in lower case, without a plural s."""
_WORD = r"(?:mm|cm|m|in|ft|milli?met(?:re|er)s?|centimet(?:re|er)s?|met(?:re|er)s?|inch(?:es)?|foot|feet)"
_STATED = (
    re.compile(rf"\bunits?\b\W*(?:\b(?:is|are|in|of|length)\b\W*)*({_WORD})\b", re.IGNORECASE),
    re.compile(rf"^\W*(?:in\W+)?({_WORD})\W*$", re.IGNORECASE),
    re.compile(r"^\s*(mm), world frame", re.IGNORECASE),
)  # after the word "unit"; alone in the comment; as mammometry wrote it before 1.0
_SIZE = re.compile(r"^([0-9.eE+-]+) mm$")


def unit_named(word: str) -> str | None:
    """Name of a unit from a word in a usual spelling, such as ``in`` for ``Inches``. None: not a unit."""
    plain = word.strip().lower()
    if plain in MM_PER_UNIT:
        return plain
    return _SPELLINGS.get(plain) or _SPELLINGS.get(plain.removesuffix("s"))


def unit_of_size(mm: float) -> str:
    """Name of the unit of this size, such as ``in`` for 25.4, or else the size itself: ``20 mm``."""
    named = (name for name, size in MM_PER_UNIT.items() if abs(mm - size) <= 1e-5 * size)
    return next(named, f"{mm:.9g} mm")


def mm_of_unit(name: str) -> float | None:
    """Size of a unit named by `unit_named` or `unit_of_size`, mm. None if it is not a unit."""
    size = _SIZE.match(name)
    return float(size[1]) if size else MM_PER_UNIT.get(name)


def unit_in_comment(comment: str) -> str | None:
    """Unit that is stated in a comment of a mesh file. None if there is none.

    ::

        unit_in_comment("Units = Inches")  # "in"
    """
    stated = next(filter(None, (pattern.search(comment) for pattern in _STATED)), None)
    return None if stated is None else unit_named(stated[1])
