"""Intervals of agreement studies: in order, around their estimates, and how often they hold the truth.

    python -m benchmarks.accuracy.studies --tables 2000

Random tables of n subjects by k methods whose true intraclass correlation is ρ, and of women with one or both breasts.
"""

from __future__ import annotations

import argparse

import numpy as np

from mammometry.geometry.arrays import Array, Float64
from mammometry.study.agreement import PairedMeasurements, agreement
from mammometry.study.icc import intraclass_correlations
from mammometry.study.tables import TextTable

_SIZES = ((3, 2), (6, 2), (9, 2), (20, 2), (6, 3), (3, 4))  # subjects × methods
_CORRELATIONS = (0.0, 0.5, 0.95)
_WOMEN = ((6, 3), (10, 5), (20, 20))  # women, and how many of them have both breasts measured
_SPREADS = ((1.0, 0.5), (0.5, 1.0))  # standard deviations of differences between women and within one


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
    """Print both tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--tables", type=int, default=2000, help="random tables for each row")
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    rng = np.random.default_rng(arguments.seed)
    print(correlations(arguments.tables, rng).as_markdown())
    print(breasts(arguments.tables, rng).as_markdown())


if __name__ == "__main__":
    main()
