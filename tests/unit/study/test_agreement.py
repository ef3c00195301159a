"""Agreement statistics against the paper's Table 1, Bland and Altman's own example, and closed forms."""

import csv
import math
from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest
from scipy import stats

from mammometry.io.paired_tables import read_pairs, read_published
from mammometry.study.agreement import PairedMeasurements, PublishedFigure, agreement, check_published

PAPER = Path(str(files("mammometry.study").joinpath("paper")))


def pairs(reference: np.ndarray, measured: np.ndarray) -> PairedMeasurements:
    return PairedMeasurements(
        names=tuple(str(k) for k in range(len(reference))),
        reference=np.asarray(reference, dtype=np.float64),
        measured=np.asarray(measured, dtype=np.float64),
        reference_name="a",
        measured_name="b",
        unit="cc",
    )


@pytest.mark.requirement("R-VOL-10")
def test_table_1_is_reproduced() -> None:
    """The paper's figures, and those that the usual estimators give (see the project's notes on section 2.7)."""
    data = read_pairs(PAPER / "table_1.csv", reference="water_cc", measured="imaging_cc")
    figures = agreement(data).figures()
    assert data.unit == "cc"
    assert figures["mean_difference"] == pytest.approx(11.12, abs=0.005)
    assert figures["sd"] == pytest.approx(23.23, abs=0.005)
    assert figures["sem"] == pytest.approx(7.742, abs=5e-4)
    assert figures["t"] == pytest.approx(1.4365, abs=5e-5)
    assert figures["p"] == pytest.approx(0.1888, abs=5e-5)
    assert figures["student_99"] == pytest.approx(3.355, abs=5e-4)
    assert figures["icc_1_1"] == pytest.approx(0.99450, abs=5e-6)
    assert figures["icc_2_1"] == pytest.approx(0.99450, abs=5e-6)
    assert figures["icc_3_1"] == pytest.approx(0.99508, abs=5e-6)
    assert figures["mdc_of_mean"] == pytest.approx(21.46, abs=0.005)
    assert figures["sem_of_measurement"] == pytest.approx(16.42, abs=0.005)
    assert figures["mdc"] == pytest.approx(45.5, abs=0.05)
    assert figures["lower_limit"] == pytest.approx(-34.4, abs=0.05)
    assert figures["upper_limit"] == pytest.approx(56.6, abs=0.05)
    assert figures["slope"] == pytest.approx(0.078, abs=5e-4)


def test_what_does_not_follow_from_table_1() -> None:
    data = read_pairs(PAPER / "table_1.csv", reference="water_cc", measured="imaging_cc")
    checked = check_published(agreement(data), read_published(PAPER / "published.toml"))
    assert {each.published.published for each in checked if not each.follows} == {"21.85", "11.22"}
    assert len([each for each in checked if each.follows]) == 7
    assert all(each.published.note for each in checked if not each.follows)


@pytest.mark.data
@pytest.mark.requirement("R-VOL-10")
def test_bland_and_altmans_peak_flow(shared_data: Path) -> None:
    """Lancet 1986: first readings, large less mini meter: −2.1, SD 38.8; limits −79.7 and 75.5 with 2 SD.

    Their intervals of the limits rest on the approximation SE² = 3 s²/n; the exact ones lie farther out.
    """
    with (shared_data / "stats" / "pefr_1986.csv").open(encoding="utf-8") as lines:
        rows = list(csv.DictReader(lines))
    data = pairs(np.array([float(row["mini1"]) for row in rows]), np.array([float(row["wright1"]) for row in rows]))
    found = agreement(data)
    assert found.mean_difference.value == pytest.approx(-2.1, abs=0.05)
    assert found.sd.value == pytest.approx(38.8, abs=0.05)
    assert found.mean_difference.value - 2 * found.sd.value == pytest.approx(-79.7, abs=0.1)
    assert found.mean_difference.interval == pytest.approx((-22.0, 17.8), abs=0.1)  # as printed
    low, high = found.lower_limit.interval
    assert low < -114.3 + 2
    assert -45.1 < high + 10 < -45.1 + 10  # printed: −114.3 to −45.1


def test_exact_intervals_of_the_limits_hold_as_often_as_they_say() -> None:
    rng = np.random.default_rng(3)
    n, draws = 9, 1500
    d = rng.normal(size=(draws, n))
    one = agreement(pairs(np.zeros(n) + np.arange(n), np.arange(n) + d[0]))
    near, far = ((bound - d[0].mean()) / d[0].std(ddof=1) for bound in one.upper_limit.interval)
    mean, sd = d.mean(axis=1), d.std(axis=1, ddof=1)
    held = np.mean((mean + near * sd <= 1.959964) & (mean + far * sd >= 1.959964))
    assert held == pytest.approx(0.95, abs=0.017)  # three standard errors
    low, high = one.lower_limit.interval
    assert (low - d[0].mean(), high - d[0].mean()) == pytest.approx((-far * sd[0], -near * sd[0]))


def test_trend_and_test_are_scipys() -> None:
    rng = np.random.default_rng(8)
    reference = rng.uniform(100, 900, 15)
    measured = 1.03 * reference + rng.normal(0, 6, 15)
    found = agreement(pairs(reference, measured))
    line = stats.linregress((reference + measured) / 2, measured - reference)
    assert found.trend.slope.value == pytest.approx(line.slope)
    assert found.trend.intercept == pytest.approx(line.intercept)
    assert found.trend.p == pytest.approx(line.pvalue)
    half = stats.t.ppf(0.975, 13) * line.stderr
    assert found.trend.slope.interval == pytest.approx((line.slope - half, line.slope + half))
    assert found.trend_on_reference.slope.value == pytest.approx(
        stats.linregress(reference, measured - reference).slope
    )
    paired = stats.ttest_rel(measured, reference)
    assert (found.t, found.p) == pytest.approx((paired.statistic, paired.pvalue))
    assert found.mean_difference.interval == pytest.approx(tuple(paired.confidence_interval()))


def test_two_methods_that_agree_perfectly() -> None:
    values = np.array([100.0, 200, 300, 400])
    found = agreement(pairs(values, values))
    assert (found.sd.value, found.lower_limit.value, found.upper_limit.value) == (0, 0, 0)
    assert math.isnan(found.t)
    assert math.isnan(found.normality_p)
    offset = agreement(pairs(values, values + 0.1))
    assert offset.t == math.inf
    assert offset.p == 0
    assert offset.mean_difference.value == pytest.approx(0.1)


def test_subjects_of_one_size_have_no_trend() -> None:
    found = agreement(pairs(np.full(4, 100.0), np.array([99.0, 101, 99, 101])))
    assert math.isnan(found.trend_on_reference.slope.value)


def test_bad_values_are_refused() -> None:
    with pytest.raises(ValueError, match=r"\b3\b"):
        pairs(np.ones(2), np.ones(2))
    with pytest.raises(ValueError, match="finite"):
        pairs(np.ones(3), np.array([1, np.nan, 2]))
    figure = PublishedFigure(what="x", figure="nonsense", published="1.0")
    with pytest.raises(ValueError, match="'nonsense'"):
        check_published(agreement(pairs(np.arange(3.0), np.array([0.0, 2, 2]))), [figure])
