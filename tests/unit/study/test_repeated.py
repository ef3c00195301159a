"""Several pairs of one subject: published figures, the usual form where pairs are single, and simulated coverage."""

import numpy as np
import pytest

from mammometry.study.agreement import PairedMeasurements, agreement
from mammometry.study.repeated import repeated_differences

CARDIAC = """
1 7.83 6.57  1 7.42 5.62  1 7.89 6.90  1 7.12 6.57  1 7.88 6.35  2 6.16 4.06  2 7.26 4.29  2 6.71 4.26  2 6.54 4.09
3 4.75 4.71  3 5.24 5.50  3 4.86 5.08  3 4.78 5.02  3 6.05 6.01  3 5.42 5.67  4 4.21 4.14  4 3.61 4.20  4 3.72 4.61
4 3.87 4.68  4 3.92 5.04  5 3.13 3.03  5 2.98 2.86  5 2.85 2.77  5 3.17 2.46  5 3.09 2.32  5 3.12 2.43  6 5.92 5.90
6 6.42 5.81  6 5.92 5.70  6 6.27 5.76  7 7.13 5.09  7 6.62 4.63  7 6.58 4.61  7 6.93 5.09  8 4.54 4.72  8 4.81 4.61
8 5.11 4.36  8 5.29 4.20  8 5.39 4.36  8 5.57 4.20  9 4.48 3.17  9 4.92 3.12  9 3.97 2.96  10 4.22 4.35  10 4.65 4.62
10 4.74 3.16  10 4.44 3.53  10 4.50 3.53  11 6.78 7.20  11 6.07 6.09  11 6.52 7.00  11 6.42 7.10  11 6.41 7.40
11 5.76 6.80  12 5.06 4.50  12 4.72 4.20  12 4.90 3.80  12 4.80 3.80  12 4.90 4.20  12 5.10 4.50
"""
"""Subject, RV and IC: cardiac output by two methods, Bland and Altman 1999, Table 4, and 2007, Table 1."""
TABLE = np.array(CARDIAC.split(), dtype=np.float64).reshape(-1, 3)


def cardiac(subjects: tuple[str, ...]) -> PairedMeasurements:
    return PairedMeasurements(
        names=tuple(map(str, range(len(TABLE)))),
        reference=TABLE[:, 2],
        measured=TABLE[:, 1],
        reference_name="IC",
        measured_name="RV",
        unit="",
        subjects=subjects,
    )


@pytest.mark.requirement("R-VOL-10")
def test_bland_and_altmans_cardiac_output() -> None:
    """2007, section 3: mean 0.6022, mean squares 4.209 and 0.1707, m₀ 4.98, SD 0.991, limits −1.34 and 2.54."""
    found = agreement(cardiac(tuple(str(int(number)) for number in TABLE[:, 0])))
    assert (found.subjects, found.pairs, found.df) == (12, 60, 11)
    assert found.mean_difference.value == pytest.approx(0.6021667, abs=1e-7)
    assert found.sd.value == pytest.approx(0.99062408, abs=1e-6)
    assert found.lower_limit.value == pytest.approx(-1.3394565, abs=1e-4)  # they take 1.96
    assert found.upper_limit.value == pytest.approx(2.5437899, abs=1e-4)
    assert all(np.isnan([*form.interval, form.f, form.p]).all() for form in found.icc)
    assert found.sd.interval[0] < 0.9127**0.5 < found.sd.interval[1]  # variance of the subjects' means
    alone = agreement(cardiac(()))
    assert alone.sd.value == pytest.approx(0.9610571, abs=1e-7)  # "ignoring subjects"
    assert np.ptp(found.mean_difference.interval) > 2 * np.ptp(alone.mean_difference.interval)


def test_the_mean_of_alike_subjects_has_the_standard_error_of_their_means() -> None:
    rng = np.random.default_rng(1)
    differences = (3 * rng.normal(size=(7, 1)) + rng.normal(size=(7, 2))).ravel()
    found = repeated_differences(differences, np.repeat(np.arange(7), 2))
    means = differences.reshape(7, 2).mean(axis=1)
    assert found.mean == pytest.approx(means.mean())
    assert found.sem == pytest.approx(means.std(ddof=1) / np.sqrt(7))
    within = ((differences.reshape(7, 2) - means[:, None]) ** 2).sum() / 7
    assert found.sd**2 == pytest.approx(means.var(ddof=1) + within / 2)  # Zou 2013, equal numbers


@pytest.mark.slow
@pytest.mark.parametrize(("between", "within"), [(1.0, 0.5), (0.3, 1.0)])
def test_intervals_hold_as_often_as_they_say(between: float, within: float) -> None:
    """Both breasts of ten women, five of whom have one: 250 draws; 95 % ± three standard errors of that share.

    Where women differ less than one woman's breasts, the mean's interval is a little too wide.
    """
    rng = np.random.default_rng(4)
    subjects = np.array([*range(10), *range(5)])
    truth = np.hypot(between, within)
    names = tuple(map(str, subjects))
    held = {"mean": 0, "sd": 0, "limit": 0}
    draws = 250
    for _ in range(draws):
        difference = between * rng.normal(size=10)[subjects] + within * rng.normal(size=15)
        data = PairedMeasurements(
            names=names, reference=np.arange(15.0), measured=np.arange(15.0) + difference, reference_name="a",
            measured_name="b", unit="", subjects=names,
        )  # fmt: skip
        found = agreement(data)
        held["mean"] += found.mean_difference.interval[0] <= 0 <= found.mean_difference.interval[1]
        held["sd"] += found.sd.interval[0] <= truth <= found.sd.interval[1]
        held["limit"] += found.upper_limit.interval[0] <= 1.959964 * truth <= found.upper_limit.interval[1]
    for count in held.values():
        assert count / draws > 0.909
        assert count / draws < 0.991 or between < within


def test_too_little_is_refused() -> None:
    with pytest.raises(ValueError, match="subjects"):
        repeated_differences(np.arange(3.0), np.arange(3))
    with pytest.raises(ValueError, match=r"\b3\b"):
        PairedMeasurements(
            names=("a", "b", "c"), reference=np.arange(3.0), measured=np.arange(3.0), reference_name="", 
            measured_name="", unit="", subjects=("a", "a", "b"),
        )  # fmt: skip
