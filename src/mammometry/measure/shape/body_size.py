"""Compare a torso's size with adults'.

A wrong unit, or a board of another size, makes it too large or too small.
Several lengths of one body are compared with what is published of adults. Only what they have in common speaks of the
scale: a wide trunk alone is a wide woman. See docs/decisions/0048.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from mammometry.base.errors import MeasureError
from mammometry.base.value import value
from mammometry.measure.settings import MeasureSettings

_RARE, _NEVER = 2.33, 3.29
"""Standard deviations outside which 2 % and 0.1 % of adults lie, of both signs."""
_ALIKE = 1.28
"""Standard deviations by which each of several lengths differs at least, all to one side, for the scale to be wrong:
80 % of adults lie within."""
_FEWEST = 2  # lengths that must agree for a refusal
_ALONE = 4.5  # deviations from which one length refuses: a trunk wider than 550 mm or narrower than 171
_CORRELATION = 0.5  # of the logarithms of two of these lengths between adults: assumed, as of two breadths of the trunk


@dataclass(frozen=True, slots=True, kw_only=True)
class AdultLength:
    """A length of adults, women and men, distributed as a logarithm with two spreads."""

    words: str
    """In a sentence, with a place for the length."""
    median_mm: float
    below: float
    """Standard deviation of the logarithm among smaller ones."""
    above: float
    """Among larger ones, the obese included."""

    def within_mm(self, deviations: float) -> tuple[float, float]:
        """Least and largest length within so many standard deviations, mm."""
        return self.median_mm * math.exp(-deviations * self.below), self.median_mm * math.exp(deviations * self.above)


ADULTS: Mapping[str, AdultLength] = {
    "trunk": AdultLength(words="the trunk is {} wide", median_mm=280.0, below=0.11, above=0.15),
    "nipples": AdultLength(words="the nipples are {} apart", median_mm=205.0, below=0.13, above=0.17),
    "notch": AdultLength(words="the sternal notch is {} from a nipple", median_mm=205.0, below=0.13, above=0.25),
}
"""Length → its distribution. Medians of publications, spreads wider than theirs: docs/decisions/0048.

- trunk: breadth at the breasts' height. Chest breadth of ANSUR II (NATICK/TR-15/007), 269 mm women, 289 mm men. Above
  the median the spread is that of waist girths of US women (NHANES: the 95th percentile 1.7 times the 5th).
- nipples: 203 mm women (doi 10.1097/GOX.0000000000002326), 210 mm men (doi 10.1097/00000637-199601000-00007).
- notch, straight to a nipple: 198 mm women (as above, and doi 10.4103/njps.njps_7_20), 200 mm men, as above; 351 mm
  before breast reductions (208 patients, PMID 28403022), which the spread above holds.
"""

UNCHECKED = (
    "The size could not be checked: neither the trunk's sides nor both nipples were found. Check the unit or the "
    "printed board."
)
"""Warning about a body of which no length is known."""


@value
class BodySize:
    """Lengths of one torso, and by what they differ from an adult's in common."""

    lengths_mm: Mapping[str, float]
    """Name in `ADULTS` → length, mm. Without those that were not seen."""

    @property
    def factor(self) -> float:
        """What all lengths would have to be multiplied by to be an average adult's. 1 without any length."""
        return math.exp(-self._common()[0])

    @property
    def deviations(self) -> float:
        """The common difference from an average adult, standard deviations between adults. Above 0: larger."""
        return self._common()[1]

    @property
    def is_rare(self) -> bool:
        """Whether fewer than 2 % of adults are so large or so small, or have one length that is so large.

        One length that is small is no sign: nipples of hanging breasts are near to each other.
        """
        return abs(self.deviations) > _RARE or self._largest() > _RARE

    @property
    def is_impossible(self) -> bool:
        """Whether fewer than 0.1 % of adults are so large or so small.

        Several lengths agree on it, or one is far beyond.
        """
        sign = math.copysign(1.0, self.deviations)
        agree = sum(sign * deviation > _ALIKE for deviation in self._each().values())
        limit = _NEVER if len(self.lengths_mm) >= _FEWEST else _ALONE
        return abs(self.deviations) > limit and agree == len(self.lengths_mm)

    def _each(self) -> dict[str, float]:
        """Standard deviations of each length alone."""
        found = {}
        for name, mm in self.lengths_mm.items():
            off = math.log(mm / ADULTS[name].median_mm)
            found[name] = off / (ADULTS[name].above if off > 0 else ADULTS[name].below)
        return found

    def _largest(self) -> float:
        """Standard deviations of the length that is largest against an adult's."""
        return max(self._each().values(), default=0.0)

    def _common(self) -> tuple[float, float]:
        """Logarithm of the scale that the lengths have in common (generalised least squares), and it in deviations."""
        if not self.lengths_mm:
            return 0.0, 0.0
        off = np.array([math.log(mm / ADULTS[name].median_mm) for name, mm in self.lengths_mm.items()])
        larger = off.sum() > 0
        spread = np.array([ADULTS[name].above if larger else ADULTS[name].below for name in self.lengths_mm])
        covariance = np.outer(spread, spread) * np.where(np.eye(len(spread)) > 0, 1.0, _CORRELATION)
        weights = np.linalg.solve(covariance, np.ones(len(spread)))
        mean = float(weights @ off / weights.sum())
        return mean, mean * math.sqrt(float(weights.sum()))

    @property
    def words(self) -> str:
        """Whether it is large or small."""
        return "small" if self.deviations < -_RARE or self._largest() < 0 else "large"

    def found(self) -> str:
        """The lengths in words."""
        return " and ".join(ADULTS[name].words.format(f"{mm:.0f} mm") for name, mm in self.lengths_mm.items())

    def usual(self, deviations: float = _RARE) -> str:
        """Those that adults have, in words."""
        ranges = (ADULTS[name].within_mm(deviations) for name in self.lengths_mm)
        return " and ".join(f"{low:.0f} to {high:.0f} mm" for low, high in ranges)

    @property
    def warning(self) -> str:
        """A sentence where the body is rare, or its size is unknown. Empty otherwise."""
        if not self.lengths_mm:
            return UNCHECKED
        if not self.is_rare:
            return ""
        return (
            f"The body is {self.words} for an adult: {self.found()}; 98 of 100 adults have {self.usual()}. Check the "
            f"unit or the printed board: lengths × {self.factor:.2g} would be usual, volumes × {self.factor**3:.2g}."
        )


def require_adult(size: BodySize, settings: MeasureSettings) -> None:
    """Refuse a torso of a size that no adult has.

    Raises:
        MeasureError: names the lengths, and the factor that would make them usual.
    """
    if not size.is_impossible or settings.size_confirmed:
        return
    then = f"lengths × {size.factor:.2g} would be usual. If the body is so: --set measure.size_confirmed=true"
    raise MeasureError(
        "torso",
        found=f"a body that is too {size.words}: {size.found()}",
        expected=f"what 999 of 1,000 adults have: {size.usual(_NEVER)}",
        remedy=f"Check the size of the printed board in session.toml: {then}",
        mesh_remedy=f"Check --units: {then}",
    )
