"""Comparison of a torso's size with adults, to detect a wrong unit or a board of another size.

Several lengths are compared with published distributions. Only their common deviation indicates a wrong scale: a wide
trunk alone is a wide woman (docs/decisions/0048).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from mammometry.base.errors import MeasureError
from mammometry.base.notices import Notice
from mammometry.base.value import value
from mammometry.measure.settings import MeasureSettings

_RARE, _NEVER = 2.33, 3.29  # standard deviations: 2 % and 0.1 % of adults are outside (both sides)
_ALIKE = 1.28  # least deviation of every length, in the same direction, SDs; 80 % of adults are within
_FEWEST = 2  # lengths that must agree before a body is refused
_ALONE = 4.5  # standard deviations at which one length is enough: a trunk wider than 550 mm or narrower than 171
_CORRELATION = 0.5  # between the logarithms of two lengths of adults; assumed, as for two breadths of the trunk


@dataclass(frozen=True, slots=True, kw_only=True)
class AdultLength:
    """Distribution of a length among adults: lognormal, with two spreads around the median."""

    words: str
    """Phrase for messages, with {} for the length."""
    median_mm: float
    below: float
    """Standard deviation of the logarithm below the median."""
    above: float
    """Standard deviation of the logarithm above the median, the obese included."""

    def within_mm(self, deviations: float) -> tuple[float, float]:
        """Least and greatest length within this many standard deviations, mm."""
        return self.median_mm * math.exp(-deviations * self.below), self.median_mm * math.exp(deviations * self.above)


ADULTS: Mapping[str, AdultLength] = {
    "trunk": AdultLength(words="the trunk is {} wide", median_mm=280.0, below=0.11, above=0.15),
    "nipples": AdultLength(words="the nipples are {} apart", median_mm=205.0, below=0.13, above=0.17),
    "notch": AdultLength(words="the sternal notch is {} from a nipple", median_mm=205.0, below=0.13, above=0.25),
}
"""Length → its distribution: published medians, and spreads wider than published (docs/decisions/0048).

- trunk: breadth at the breasts' height. Chest breadth of ANSUR II (NATICK/TR-15/007): women 269 mm, men 289 mm. The
  spread above the median is that of US women's waist girths (NHANES: 95th percentile 1.7 times the 5th).
- nipples: women 203 mm (doi 10.1097/GOX.0000000000002326), men 210 mm (doi 10.1097/00000637-199601000-00007).
- notch, straight to a nipple: women 198 mm (as above, and doi 10.4103/njps.njps_7_20), men 200 mm (as above); 351 mm
  before breast reductions (208 patients, PMID 28403022), which is within the spread.
"""


@value
class BodySize:
    """Lengths of one torso, and their common deviation from adults'."""

    lengths_mm: Mapping[str, float]
    """Name in `ADULTS` → length, mm; only those that were found."""

    @property
    def factor(self) -> float:
        """Scale factor that would make the lengths an average adult's. 1 without any length."""
        return math.exp(-self._common()[0])

    @property
    def deviations(self) -> float:
        """Common deviation from an average adult, in standard deviations, positive if larger."""
        return self._common()[1]

    @property
    def is_rare(self) -> bool:
        """Whether fewer than 2 % of adults are as large or as small, or have one length that is as large.

        One small length is not evidence: nipples of ptotic breasts are close together.
        """
        return abs(self.deviations) > _RARE or self._largest() > _RARE

    @property
    def is_impossible(self) -> bool:
        """Whether fewer than 0.1 % of adults are as large or as small, by several lengths or an extreme one."""
        sign = math.copysign(1.0, self.deviations)
        agree = sum(sign * deviation > _ALIKE for deviation in self._each().values())
        limit = _NEVER if len(self.lengths_mm) >= _FEWEST else _ALONE
        return abs(self.deviations) > limit and agree == len(self.lengths_mm)

    def _each(self) -> dict[str, float]:
        """Each length's own deviation, in standard deviations."""
        found = {}
        for name, mm in self.lengths_mm.items():
            off = math.log(mm / ADULTS[name].median_mm)
            found[name] = off / (ADULTS[name].above if off > 0 else ADULTS[name].below)
        return found

    def _largest(self) -> float:
        """Largest of the lengths' own deviations, in standard deviations."""
        return max(self._each().values(), default=0.0)

    def _common(self) -> tuple[float, float]:
        """Logarithm of the common scale (generalised least squares), and the same in standard deviations."""
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
        """``large`` or ``small``."""
        return "small" if self.deviations < -_RARE or self._largest() < 0 else "large"

    def found(self) -> str:
        """The lengths, as a phrase."""
        return " and ".join(ADULTS[name].words.format(f"{mm:.0f} mm") for name, mm in self.lengths_mm.items())

    def usual(self, deviations: float) -> str:
        """The ranges of these lengths among adults, as a phrase."""
        ranges = (ADULTS[name].within_mm(deviations) for name in self.lengths_mm)
        return " and ".join(f"{low:.0f} to {high:.0f} mm" for low, high in ranges)

    @property
    def notice(self) -> Notice | None:
        """Warning if the size is rare or unknown."""
        if not self.lengths_mm:
            return Notice(code="body-size-unknown")
        if not self.is_rare:
            return None
        ranges = {name: ADULTS[name].within_mm(_RARE) for name in self.lengths_mm}
        lengths = [
            f"{ADULTS[name].words.format(f'{mm:.0f} mm')} ({ranges[name][0]:.0f} to {ranges[name][1]:.0f} mm in 98 of "
            "100 adults)"
            for name, mm in self.lengths_mm.items()
        ]
        factor = self.factor
        return Notice(
            code="body-size-rare",
            values={
                "size": self.words,
                "lengths": " and ".join(lengths),
                "factor": factor,
                "volume_factor": factor**3,
            },
        )


def require_adult(size: BodySize, settings: MeasureSettings) -> None:
    """Raise an error for a torso of a size that no adult has.

    Raises:
        MeasureError: names the lengths, and the factor that would make them usual.
    """
    if not size.is_impossible or settings.size_confirmed:
        return
    then = f"lengths × {size.factor:.2g} would be usual. If the size is right: --set measure.size_confirmed=true"
    raise MeasureError(
        "torso",
        found=f"a body that is too {size.words}: {size.found()}",
        expected=f"{size.usual(_NEVER)}, as in 999 of 1,000 adults",
        remedy=f"Check the size of the printed board in session.toml: {then}",
        mesh_remedy=f"Check --units: {then}",
    )
