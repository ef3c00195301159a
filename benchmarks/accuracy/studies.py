"""Intervals of agreement and repeatability studies: in order, around the estimates, and how often they hold the truth.

    python -m benchmarks.accuracy.studies --tables 2000
    python -m benchmarks.accuracy.studies --repeated 300
    python -m benchmarks.accuracy.studies --lines 1000

The first draws tables of n subjects by k methods whose true intraclass correlation is ρ, and of women with one or both
breasts. The second draws tables of repeated captures of five designs with known components of variance. The third draws
validations against a truth that has errors of its own: lines with errors in both, and least squares for comparison.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from mammometry.geometry.arrays import Array, Float64
from mammometry.study.agreement import PairedMeasurements, agreement
from mammometry.study.icc import intraclass_correlations
from mammometry.study.repeatability.design import ANOTHER_DAY, ANYBODY, SAME_DAY, Reading
from mammometry.study.repeatability.study import repeatability
from mammometry.study.tables import TextTable
from mammometry.study.validation.regression import deming, passing_bablok

_SIZES = ((3, 2), (6, 2), (9, 2), (20, 2), (6, 3), (3, 4))  # subjects × methods
_CORRELATIONS = (0.0, 0.5, 0.95)
_WOMEN = ((6, 3), (10, 5), (20, 20))  # women, and how many of them have both breasts measured
_SPREADS = ((1.0, 0.5), (0.5, 1.0))  # standard deviations of differences between women and within one
_SIDES = ("left", "right")


@dataclass(frozen=True, kw_only=True)
class RepeatedDesign:
    """Design of a study of repeated captures, and standard deviations of its effects, cc."""

    name: str
    women: int
    captures: int
    raters: int = 1
    days: int = 1
    both: bool = False
    """Both breasts of each woman."""
    missing: float = 0.0
    """Share of the captures that are missing, at random."""
    woman_cc: float = 100.0
    breast_cc: float = 30.0
    rater_cc: float = 4.0
    rater_woman_cc: float = 5.0
    day_cc: float = 5.0
    capture_cc: float = 6.0
    side_cc: float = 3.0
    """Of one breast in a capture, if both are measured."""

    def true_sems_cc(self) -> dict[str, float]:
        """Level of repetition → standard error of one measurement, cc."""
        same = math.hypot(self.capture_cc, self.side_cc if self.both else 0.0)
        found = {SAME_DAY: same}
        if self.days > 1:
            found[ANOTHER_DAY] = math.hypot(same, self.day_cc)
        if self.raters > 1:
            found[ANYBODY] = math.hypot(same, self.rater_cc, self.rater_woman_cc)
        return found

    def drawn(self, rng: np.random.Generator) -> Iterator[Reading]:
        """One random table."""
        sides = _SIDES if self.both else ("",)
        raters = rng.normal(0, self.rater_cc, self.raters)
        for woman in range(self.women):
            own = 900 + rng.normal(0, self.woman_cc)
            breasts = {side: own + (rng.normal(0, self.breast_cc) if side else 0.0) for side in sides}
            for rater in range(self.raters):
                by_rater = {side: raters[rater] + rng.normal(0, self.rater_woman_cc) for side in sides}
                for day in range(self.days):
                    on_day = rng.normal(0, self.day_cc)
                    for capture in range(self.captures):
                        again = rng.normal(0, self.capture_cc)
                        if rng.random() < self.missing:
                            continue
                        for side, volume in breasts.items():
                            yield Reading(
                                woman=str(woman), side=side, capture=str(capture),
                                rater=str(rater) if self.raters > 1 else "", day=str(day) if self.days > 1 else "",
                                volume_cc=volume + again + (by_rater[side] if self.raters > 1 else 0.0) +
                                (on_day if self.days > 1 else 0.0) + (rng.normal(0, self.side_cc) if side else 0.0),
                            )  # fmt: skip


REPEATED = (
    RepeatedDesign(name="20 women, 2 captures", women=20, captures=2),
    RepeatedDesign(name="12 women, both breasts, 3 captures", women=12, captures=3, both=True),
    RepeatedDesign(name="10 women, 3 raters, 2 captures", women=10, captures=2, raters=3),
    RepeatedDesign(name="12 women, 3 days, 2 captures", women=12, captures=2, days=3),
    RepeatedDesign(name="15 women, 3 raters, 2 captures, a fifth missing", women=15, captures=2, raters=3, missing=0.2),
)


def repeated_captures(tables: int, seed: int) -> TextTable:
    """Coverage of the intervals of a study of repeated captures."""
    rows = []
    for place, wanted in enumerate(REPEATED):
        rng = np.random.default_rng([seed, place])
        between = math.hypot(wanted.woman_cc, wanted.breast_cc if wanted.both else 0.0)
        truth = wanted.true_sems_cc()
        held = {level: np.zeros(2) for level in truth}
        for _ in range(tables):
            found = {one.level: one for one in repeatability(tuple(wanted.drawn(rng))).repetitions}
            for level, sem in truth.items():
                correlation = between**2 / (between**2 + sem**2)
                pairs = ((found[level].sem_cc, sem), (found[level].icc, correlation))
                held[level] += [one.interval[0] <= value <= one.interval[1] for one, value in pairs]
        for level, sem in truth.items():
            rows.append((wanted.name, level, f"{sem:.1f}", *(f"{100 * share / tables:.1f}" for share in held[level])))
    columns = ("design", "repetition", "true SEM, cc", "SEM and detectable change held, %", "ICC held, %")
    return TextTable(title="Repeated captures", columns=columns, rows=tuple(rows))


_LINES = (
    (15, False, 10.0, 10.0),
    (30, False, 10.0, 10.0),
    (30, False, 40.0, 10.0),
    (30, False, 10.0, 40.0),
    (15, True, 10.0, 10.0),
)
"""Women, whether both breasts of each are measured, standard deviations of the truth and of the measurement, cc."""
_SLOPE, _INTERCEPT_CC = 1.08, 10.0


def lines(tables: int, seed: int) -> TextTable:
    """Slopes of Deming's and of Passing and Bablok's lines, and how often their intervals hold the true one."""
    rows = []
    for place, (women, both, truth_sd, measured_sd) in enumerate(_LINES):
        rng = np.random.default_rng([seed, place])
        whose = np.repeat(np.arange(women), 2 if both else 1)
        slopes, held = np.zeros((tables, 3)), np.zeros(2)
        for table in range(tables):
            volumes = rng.uniform(200, 700, women)[whose] + (rng.normal(0, 40, len(whose)) if both else 0.0)
            truth = volumes + rng.normal(0, truth_sd, len(whose))
            measured = _INTERCEPT_CC + _SLOPE * volumes + rng.normal(0, measured_sd, len(whose))
            found = (deming(truth, measured, whose, (measured_sd / truth_sd) ** 2), passing_bablok(truth, measured))
            slopes[table] = [np.polyfit(truth, measured, 1)[0], *(line.slope.value for line in found)]
            held += [line.slope.interval[0] <= _SLOPE <= line.slope.interval[1] for line in found]
        name = f"{women} women, {'both breasts' if both else 'one breast'}"
        means, shares = slopes.mean(axis=0), 100 * held / tables
        rows.append(
            (name, f"{truth_sd:g}, {measured_sd:g}", f"{means[0]:.3f}", f"{means[1]:.3f}", f"{shares[0]:.1f}",
             f"{means[2]:.3f}", f"{shares[1]:.1f}")
        )  # fmt: skip
    columns = ("table", "SD of truth, of measurement, cc", "mean slope, least squares", "Deming", "held, %",
               "Passing–Bablok", "held, %")  # fmt: skip
    return TextTable(title=f"Lines with errors in both, true slope {_SLOPE:g}", columns=columns, rows=tuple(rows))


def correlations(tables: int, rng: np.random.Generator) -> TextTable:
    """Faulty intervals of all six forms, and coverage of ICC(2,1)."""
    rows = []
    for n, k in _SIZES:
        for rho in _CORRELATIONS:
            faulty, held = 0, 0
            for _ in range(tables):
                ratings = np.sqrt(rho) * rng.normal(size=(n, 1)) + np.sqrt(1 - rho) * rng.normal(size=(n, k))
                forms = {form.shrout_fleiss: form for form in intraclass_correlations(ratings)}
                faulty += any(not form.interval[0] <= form.value <= form.interval[1] <= 1 for form in forms.values())
                low, high = forms["ICC(2,1)"].interval
                held += low <= rho <= high
            rows.append((f"{n} × {k}", f"{rho:g}", f"{100 * faulty / tables:.1f}", f"{100 * held / tables:.1f}"))
    columns = ("subjects × methods", "true ρ", "tables with a faulty interval, %", "ICC(2,1) held, %")
    return TextTable(title="Intraclass correlations", columns=columns, rows=tuple(rows))


def breasts(tables: int, rng: np.random.Generator) -> TextTable:
    """Both breasts of some women: intervals as independent rows and as rows of women."""
    rows = []
    for women, both in _WOMEN:
        whose = np.array([*range(women), *range(both)])
        for between, within in _SPREADS:
            held = np.zeros((2, 2))
            for _ in range(tables):
                difference = between * rng.normal(size=women)[whose] + within * rng.normal(size=len(whose))
                held += _held(difference, whose, 1.959964 * float(np.hypot(between, within)))
            shares = [f"{100 * share / tables:.1f}" for share in held.ravel()]
            rows.append((f"{women}, {both}", f"{between:g}, {within:g}", *shares))
    columns = ("women, of them with both breasts", "SD between, within women", "bias held, independent rows, %",
               "upper limit held, independent rows, %", "bias held, rows of women, %",
               "upper limit held, rows of women, %")  # fmt: skip
    return TextTable(title="Both breasts of one woman", columns=columns, rows=tuple(rows))


def _held(difference: Float64[Array, " n"], whose: Float64[Array, " n"], limit: float) -> Float64[Array, "2 2"]:
    """Whether the intervals of bias and upper limit contain the truth, by both analyses."""
    names = tuple(map(str, range(len(whose))))
    found = []
    for subjects in ((), tuple(map(str, whose))):
        study = agreement(
            PairedMeasurements(
                names=names, reference=np.arange(len(whose), dtype=np.float64), measured=np.arange(len(whose)) +
                difference, reference_name="a", measured_name="b", unit="", subjects=subjects,
            )
        )  # fmt: skip
        intervals = (study.mean_difference.interval, study.upper_limit.interval)
        found.append([low <= truth <= high for truth, (low, high) in zip((0.0, limit), intervals, strict=True)])
    return np.array(found, dtype=np.float64)


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--tables", type=int, default=2000, help="random tables for each row")
    parser.add_argument("--repeated", type=int, default=0, help="instead: tables for each design of repeated captures")
    parser.add_argument("--lines", type=int, default=0, help="instead: tables for each validation against a truth")
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    if arguments.repeated:
        print(repeated_captures(arguments.repeated, arguments.seed).as_markdown())
        return
    if arguments.lines:
        print(lines(arguments.lines, arguments.seed).as_markdown())
        return
    rng = np.random.default_rng(arguments.seed)
    print(correlations(arguments.tables, rng).as_markdown())
    print(breasts(arguments.tables, rng).as_markdown())


if __name__ == "__main__":
    main()
