"""Agreement with a truth for every definition of the volume, and offsets between the definitions."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from mammometry.base.value import value
from mammometry.study.agreement import LEAST_SUBJECTS, Agreement, PairedMeasurements, agreement
from mammometry.study.repeated import repeated_differences
from mammometry.study.validation.regression import Line, concordance, deming, passing_bablok


@value
class ValidationCase:
    """One breast: its true volume, and its volumes measured by one or several definitions."""

    woman: str
    side: str = ""
    truth_cc: float
    truth_sd_cc: float
    """Standard uncertainty of the true volume, cc. NaN if unknown."""
    measured_cc: Mapping[str, float]
    """Definition → volume, cc."""

    @property
    def breast(self) -> str:
        """Woman and side."""
        return f"{self.woman}, {self.side}" if self.side else self.woman


@value(eq=False)
class DefinitionAgreement:
    """Agreement of one definition with the truth."""

    definition: str
    data: PairedMeasurements
    agreement: Agreement
    deming: Line
    passing_bablok: Line
    """All rows are treated as independent, even both breasts of a woman."""
    concordance: float
    """Lin's coefficient."""
    truth_sd_cc: float
    """Root mean square of the true volumes' own standard uncertainties, cc, which are part of the scatter. NaN if
    unknown."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Offset:
    """One definition minus another one for the same breasts, cc.

    Neither is wrong: they measure different things.
    """

    first: str
    second: str
    breasts: int
    mean_cc: float
    """Second minus first."""
    sd_cc: float
    percent: float
    """Offset in % of the mean of the first."""
    concordance: float


@value(eq=False)
class ValidationStudy:
    """All definitions against the truth."""

    truth: str
    """Kind of truth: ``water``, ``weight``, ``segmentation`` or ``volume``."""
    cases: tuple[ValidationCase, ...]
    """One per breast."""
    ratio: float
    """Error variance of the measurement divided by that of the truth, for Deming's line."""
    definitions: tuple[DefinitionAgreement, ...]
    offsets: tuple[Offset, ...]

    @property
    def women(self) -> int:
        """Number of women."""
        return len({case.woman for case in self.cases})


def validation(cases: Sequence[ValidationCase], truth: str, sem_cc: float | None = None) -> ValidationStudy:
    """Compare measured volumes with true ones.

    Args:
        cases: one per breast.
        truth: kind of truth.
        sem_cc: standard error of the measurement from a repeatability study. With the truth's own uncertainty, it gives
            the ratio of errors for Deming's line. None: equal errors are assumed.

    Raises:
        ValueError: there are fewer than three women with a true volume and a common definition.
    """
    own = math.sqrt(float(np.mean([case.truth_sd_cc**2 for case in cases]))) if cases else math.nan
    ratio = (sem_cc / own) ** 2 if sem_cc is not None and own > 0 else 1.0
    names = tuple(dict.fromkeys(name for case in cases for name in case.measured_cc))
    found = [one for name in names if (one := _against(name, cases, ratio)) is not None]
    if not found:
        raise ValueError(f"fewer than {LEAST_SUBJECTS} women with a truth and a measured volume")
    return ValidationStudy(
        truth=truth,
        cases=tuple(cases),
        ratio=ratio,
        definitions=tuple(found),
        offsets=tuple(_offsets(names, cases)),
    )


def _against(name: str, cases: Sequence[ValidationCase], ratio: float) -> DefinitionAgreement | None:
    own = [case for case in cases if name in case.measured_cc]
    women = tuple(case.woman for case in own)
    if len(set(women)) < LEAST_SUBJECTS:
        return None
    truth = np.array([case.truth_cc for case in own])
    measured = np.array([case.measured_cc[name] for case in own])
    data = PairedMeasurements(
        names=tuple(case.breast for case in own),
        reference=truth,
        measured=measured,
        reference_name="truth",
        measured_name=name,
        unit="cc",
        subjects=women if len(set(women)) < len(own) else (),
    )
    return DefinitionAgreement(
        definition=name,
        data=data,
        agreement=agreement(data),
        deming=deming(truth, measured, data.clusters, ratio),
        passing_bablok=passing_bablok(truth, measured),
        concordance=concordance(truth, measured),
        truth_sd_cc=math.sqrt(float(np.mean([case.truth_sd_cc**2 for case in own]))),
    )


def _offsets(names: Sequence[str], cases: Sequence[ValidationCase]) -> Iterator[Offset]:
    for first, second in itertools.combinations(names, 2):
        own = [case for case in cases if {first, second} <= case.measured_cc.keys()]
        if len({case.woman for case in own}) < 2:
            continue
        one, other = (np.array([case.measured_cc[name] for case in own]) for name in (first, second))
        women = {name: place for place, name in enumerate(dict.fromkeys(case.woman for case in own))}
        clusters = np.array([women[case.woman] for case in own], dtype=np.int64)
        apart = other - one
        repeated = len(women) < len(own)
        yield Offset(
            first=first,
            second=second,
            breasts=len(own),
            mean_cc=float(apart.mean()),
            sd_cc=repeated_differences(apart, clusters).sd if repeated else float(apart.std(ddof=1)),
            percent=100 * float(apart.mean() / one.mean()),
            concordance=concordance(one, other),
        )
