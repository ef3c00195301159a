"""Number of women and captures that a claim needs, and whether a study supports the claim.

The claim is that the smallest detectable change is at most a stated value. It is shown if the upper 95 % bound of the
standard error of measurement, from χ², is small enough, as in tests of conformance with a QIBA profile: Raunig et al.,
Statistical Methods in Medical Research 24 (2015) 27.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np
import scipy  # scipy.stats, which takes half a second to import, is imported on first use

from mammometry.base.value import value
from mammometry.geometry.arrays import Array, Float64

DETECTABLE = float(scipy.special.ndtri(0.975)) * math.sqrt(2)
"""Ratio of smallest detectable change to standard error of measurement: 1.96 √2."""
CAPTURES = (2, 3, 4, 5)
"""Numbers of captures for which a plan is shown."""
_CONFIDENCE = 0.95  # one-sided confidence of the upper bound
_MOST_WOMEN = 2000  # plans with more women are not shown
Verdict: TypeAlias = Literal["shown", "undecided", "contradicted"]


@value
class CapturePlan:
    """Numbers of women and captures for a claim."""

    claim_cc: float
    """Smallest detectable change to be shown, cc."""
    sem_cc: float
    """Expected standard error of measurement, cc."""
    power: float
    """Probability that the study shows the claim if the expected error is right."""
    sizes: tuple[tuple[int, int], ...]
    """Captures per woman, and number of women. Empty: the expected error is too large for the claim."""


def plan(claim_cc: float, sem_cc: float, power: float = 0.8) -> CapturePlan:
    """Find the least number of women for each number of captures.

    Each woman counts once, even if both breasts are measured, because they are in the same capture.
    """
    return CapturePlan(claim_cc=claim_cc, sem_cc=sem_cc, power=power, sizes=tuple(_sizes(claim_cc, sem_cc, power)))


def _sizes(claim_cc: float, sem_cc: float, power: float) -> Iterator[tuple[int, int]]:
    women = np.arange(2, _MOST_WOMEN + 1)
    for captures in CAPTURES:
        enough = women[chance_to_show(claim_cc, sem_cc, women * (captures - 1.0)) >= power]
        if len(enough):
            yield captures, int(enough[0])


def chance_to_show(claim_cc: float, sem_cc: float, df: Float64[Array, " n"]) -> Float64[Array, " n"]:
    """Probability that the upper bound of the detectable change does not exceed the claim."""
    ratio = (claim_cc / (DETECTABLE * sem_cc)) ** 2
    return np.asarray(scipy.stats.chi2.cdf(ratio * scipy.stats.chi2.ppf(1 - _CONFIDENCE, df), df))


def upper_bound(deviation: float, df: float) -> float:
    """One-sided upper 95 % bound of a standard deviation. Infinite without degrees of freedom."""
    return deviation * math.sqrt(df / scipy.stats.chi2.ppf(1 - _CONFIDENCE, df)) if df > 0 else math.inf


def lower_bound(deviation: float, df: float) -> float:
    """One-sided lower 95 % bound of a standard deviation."""
    return deviation * math.sqrt(df / scipy.stats.chi2.ppf(_CONFIDENCE, df)) if df > 0 else 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class ClaimCheck:
    """Result of checking whether a study supports a claim."""

    claim_cc: float
    detectable_cc: float
    """Smallest detectable change of the study, cc."""
    upper_cc: float
    """Its one-sided upper 95 % bound, cc."""
    verdict: Verdict
    """``shown``: the upper bound does not exceed the claim. ``contradicted``: the lower bound exceeds it."""


def check_claim(claim_cc: float, sem_cc: float, df: float) -> ClaimCheck:
    """Decide on a claim from a standard error of measurement and its degrees of freedom."""
    upper, lower = (DETECTABLE * bound(sem_cc, df) for bound in (upper_bound, lower_bound))
    verdict: Verdict = "shown" if upper <= claim_cc else "contradicted" if lower > claim_cc else "undecided"
    return ClaimCheck(claim_cc=claim_cc, detectable_cc=DETECTABLE * sem_cc, upper_cc=upper, verdict=verdict)
