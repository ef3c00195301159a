"""Possible sizes of subjects, and probable units of a length."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TypeAlias

Range: TypeAlias = tuple[float, float]

SUBJECT_MM: Range = (40.0, 2500.0)
"""Longest side of a subject, from a small cast to a whole body."""
_USUAL_SUBJECT_MM: Range = (60.0, 1500.0)
"""Usual longest side of a subject: from casts of one breast to trunks with arms."""
UNITS: Mapping[str, float] = {"cm": 10.0, "m": 1000.0, "inches": 25.4, "tenths of a mm": 0.1, "micrometres": 1e-3}
"""Unit that a length stated in mm may really have → its size in mm, most probable first."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Size:
    """A length that follows from the user's values, mm, with its possible and usual ranges."""

    mm: float
    name: str
    """Name of the length in codes of notices, such as ``view``."""
    possible_mm: Range
    usual_mm: Range
    words: str
    """End of a sentence with a placeholder for the length: ``the cameras stand {} apart``."""

    @property
    def is_possible(self) -> bool:
        """Whether the length is within the possible range."""
        return self.possible_mm[0] <= self.mm <= self.possible_mm[1]

    def is_usual(self, factor: float = 1.0) -> bool:
        """Whether the length, multiplied by `factor`, is within the usual range."""
        return self.usual_mm[0] <= self.mm * factor <= self.usual_mm[1]

    def __str__(self) -> str:
        """The end of the sentence, with the length."""
        return self.words.format(f"{self.mm:,.3g} mm" if self.mm < 10 else f"{self.mm:,.0f} mm")

    @property
    def expected(self) -> str:
        """The possible range as text."""
        return f"{self.possible_mm[0]:,g} to {self.possible_mm[1]:,g} mm"


def subject_extent(mm: float) -> Size:
    """Longest side of the surface to be measured."""
    return Size(
        mm=mm, name="extent", possible_mm=SUBJECT_MM, usual_mm=_USUAL_SUBJECT_MM, words="its longest side is {}"
    )


def likely_units(sizes: Sequence[Size]) -> dict[str, float]:
    """Units in which all sizes would be usual → their size in mm, most probable first."""
    return {unit: factor for unit, factor in UNITS.items() if all(size.is_usual(factor) for size in sizes)}


def fitting_values(stated_mm: float, sizes: Sequence[Size]) -> list[str]:
    """Values in mm that would make all sizes usual if the stated one has another unit, such as ``25 mm``."""
    units = likely_units(sizes)
    return [
        f"{stated_mm * factor:.4g} mm" + (" (if it was in inches)" if unit == "inches" and len(units) > 1 else "")
        for unit, factor in units.items()
    ]


def fitting(stated_mm: float, sizes: Sequence[Size]) -> str:
    """End of a sentence that suggests `fitting_values`: ``: 25 mm would fit``. Empty if no unit fits."""
    values = fitting_values(stated_mm, sizes)
    return f": {' or '.join(values)} would fit" if values else ""
