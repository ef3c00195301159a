"""Intraclass correlations against published figures, and against a general linear model fitted by least squares."""

import csv
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.first_cases import first

from mammometry.study.icc import intraclass_correlations, mean_squares

# Shrout and Fleiss 1979, Table 2: four judges, six targets.
SHROUT_FLEISS = np.array([[9, 2, 5, 8], [6, 1, 3, 2], [8, 4, 6, 8], [7, 1, 2, 6], [10, 5, 6, 9], [6, 2, 4, 7]], float)


def test_shrout_and_fleiss_own_example() -> None:
    """Their Tables 3 and 4; intervals as published with the common implementations of their formulas."""
    ms = mean_squares(SHROUT_FLEISS)
    found = (ms.between_subjects, ms.within_subjects, ms.between_methods, ms.residual)
    assert found == pytest.approx((11.24, 6.26, 32.49, 1.02), abs=0.005)
    published = {
        "ICC(1,1)": (0.17, (-0.13, 0.72)),
        "ICC(2,1)": (0.29, (0.02, 0.76)),
        "ICC(3,1)": (0.71, (0.34, 0.95)),
        "ICC(1,k)": (0.44, (-0.88, 0.91)),
        "ICC(2,k)": (0.62, (0.07, 0.93)),
        "ICC(3,k)": (0.91, (0.68, 0.99)),
    }
    forms = intraclass_correlations(SHROUT_FLEISS)
    assert [each.shrout_fleiss for each in forms] == list(published)
    assert [each.mcgraw_wong for each in forms] == ["ICC(1)", "ICC(A,1)", "ICC(C,1)", "ICC(k)", "ICC(A,k)", "ICC(C,k)"]
    for each in forms:
        value, interval = published[each.shrout_fleiss]
        assert each.value == pytest.approx(value, abs=0.006)
        assert each.interval == pytest.approx(interval, abs=0.006)
    assert (forms[0].f, forms[0].df, forms[0].p) == (
        pytest.approx(1.79, abs=0.01),
        (5, 18),
        pytest.approx(0.165, abs=1e-3),
    )
    assert (forms[2].f, forms[2].df, forms[2].p) == (
        pytest.approx(11.03, abs=0.01),
        (5, 15),
        pytest.approx(1.3e-4, rel=0.05),
    )


WINES = np.array(
    [[1, 1, 3, 6, 6, 7, 8, 9], [2, 3, 8, 4, 5, 5, 7, 9], [0, 3, 1, 3, 5, 6, 7, 9], [1, 2, 4, 3, 6, 2, 9, 8]],
    dtype=float,
).T
"""Eight wines by four judges: the example of pingouin's documentation (its data set "icc")."""
TABLE_1 = np.array(
    [
        [364.6, 434.7, 579.0, 231.1, 433.4, 591.6, 596.6, 100.4, 863.1],
        [354.4, 422.3, 613.4, 209.5, 465.1, 610.5, 620.7, 96.1, 902.6],
    ]
).T
PINGOUIN = {
    "wines": (
        WINES,
        [
            (0.7275209, 11.6800259, 2.18135e-06, 0.433773, 0.926696),
            (0.7276888, 11.7866928, 5.02572e-06, 0.434490, 0.926709),
            (0.7294865, 11.7866928, 5.02572e-06, 0.426146, 0.927895),
            (0.9143838, 11.6800259, 2.18135e-06, 0.753955, 0.980608),
            (0.9144500, 11.7866928, 5.02572e-06, 0.754496, 0.980611),
            (0.9151586, 11.7866928, 5.02572e-06, 0.748137, 0.980943),
        ],
    ),
    "Table 1": (
        TABLE_1,
        [
            (0.9945016, 362.741406, 2.25338e-10, 0.977636, 0.998735),
            (0.9945032, 405.610356, 1.27288e-09, 0.976418, 0.998751),
            (0.9950813, 405.610356, 1.27288e-09, 0.978377, 0.998888),
            (0.9972432, 362.741406, 2.25338e-10, 0.988692, 0.999367),
            (0.9972440, 405.610356, 1.27288e-09, 0.988068, 0.999375),
            (0.9975346, 405.610356, 1.27288e-09, 0.989070, 0.999444),
        ],
    ),
}
"""What pingouin 0.7.0 prints: ICC, F, p and interval of the six forms."""


@pytest.mark.parametrize("name", PINGOUIN)
def test_all_forms_are_pingouins(name: str) -> None:
    ratings, printed = PINGOUIN[name]
    for found, (value, f, p, low, high) in zip(intraclass_correlations(ratings), printed, strict=True):
        assert found.value == pytest.approx(value, abs=1e-6)
        assert found.f == pytest.approx(f, rel=1e-6)
        assert found.p == pytest.approx(p, rel=1e-5)
        assert found.interval == pytest.approx((low, high), abs=2e-6)


@pytest.mark.data
def test_anxiety_ratings(shared_data: Path) -> None:
    """Known from the documentation of R's irr: two-way model, agreement, single rater: 0.198, F(19, 38) = 1.83."""
    with (shared_data / "stats" / "anxiety.csv").open(encoding="utf-8") as lines:
        ratings = np.array([[float(row[f"rater{k}"]) for k in (1, 2, 3)] for row in csv.DictReader(lines)])
    (agreement,) = (each for each in intraclass_correlations(ratings) if each.shrout_fleiss == "ICC(2,1)")
    assert agreement.value == pytest.approx(0.198, abs=5e-4)
    assert agreement.f == pytest.approx(1.83, abs=5e-3)
    assert agreement.interval == pytest.approx((-0.039, 0.494), abs=2e-3)


@given(st.integers(3, 8), st.integers(2, 4), st.integers(0, 2**32 - 1))
def test_mean_squares_are_those_of_a_linear_model(n: int, k: int, seed: int) -> None:
    ratings = np.random.default_rng(seed).normal(size=(n, k))
    y = ratings.ravel()
    rows = np.kron(np.eye(n), np.ones((k, 1)))
    columns = np.kron(np.ones((n, 1)), np.eye(k))

    def left(*designs: np.ndarray) -> float:
        design = np.concatenate(designs, axis=1)
        return float(((y - design @ np.linalg.lstsq(design, y, rcond=None)[0]) ** 2).sum())

    ones = np.ones((n * k, 1))
    ms = mean_squares(ratings)
    assert ms.residual == pytest.approx(left(rows, columns) / ((n - 1) * (k - 1)))
    assert ms.within_subjects == pytest.approx(left(rows) / (n * (k - 1)))
    assert ms.between_subjects == pytest.approx((left(ones) - left(rows)) / (n - 1))
    assert ms.between_methods == pytest.approx((left(ones) - left(columns)) / (k - 1))


@pytest.mark.slow
def test_intervals_hold_the_truth_as_often_as_they_say() -> None:
    """Two-way random effects, ρ = 4 / (4 + 0.5 + 1): 800 draws; 95 % ± three standard errors."""
    rng = np.random.default_rng(5)
    n, k, draws = 12, 3, 800
    held = {"ICC(2,1)": 0, "ICC(3,1)": 0}
    truth = {"ICC(2,1)": 4 / 5.5, "ICC(3,1)": 4 / 5}
    for _ in range(draws):
        ratings = 2 * rng.normal(size=(n, 1)) + np.sqrt(0.5) * rng.normal(size=k) + rng.normal(size=(n, k))
        for each in intraclass_correlations(ratings):
            if each.shrout_fleiss in held:
                low, high = each.interval
                held[each.shrout_fleiss] += low <= truth[each.shrout_fleiss] <= high
    for count in held.values():
        assert count / draws == pytest.approx(0.95, abs=0.025)


def test_perfect_agreement_constant_offset_and_no_variance() -> None:
    subjects = np.arange(5.0)[:, None]
    same = {each.shrout_fleiss: each for each in intraclass_correlations(subjects + np.zeros(2))}
    assert {each.value for each in same.values()} == {1.0}
    assert same["ICC(2,1)"].interval == (1.0, 1.0)
    offset = {each.shrout_fleiss: each.value for each in intraclass_correlations(subjects + np.array([0.0, 3.0]))}
    assert offset["ICC(3,1)"] == 1.0  # consistency forgives it
    assert offset["ICC(2,1)"] == pytest.approx(2.5 / (2.5 + 4.5))  # σ² of the subjects over that and the methods'
    with np.errstate(all="ignore"):
        assert all(np.isnan(each.value) for each in intraclass_correlations(np.ones((4, 2))))


def test_too_little_is_refused() -> None:
    with pytest.raises(ValueError, match="two"):
        intraclass_correlations(np.ones((1, 2)))
    with pytest.raises(ValueError, match="finite"):
        intraclass_correlations(np.array([[1.0, np.nan], [2, 3]]))


@pytest.mark.parametrize(("n", "k"), first(2, [(3, 2), (3, 4), (6, 2), (2, 3)]))
def test_every_interval_is_in_order_and_holds_its_estimate(n: int, k: int) -> None:
    """Of random tables of six subjects and two methods 30 % had an ICC(2,k) beyond Spearman–Brown's pole."""
    rng = np.random.default_rng(2)
    for share in (0.0, 0.5):
        for _ in range(100):
            ratings = np.sqrt(share) * rng.normal(size=(n, 1)) + np.sqrt(1 - share) * rng.normal(size=(n, k))
            for form in intraclass_correlations(ratings):
                low, high = form.interval
                assert low <= form.value <= high <= 1
                assert form.value >= -1 / (k - 1) - 1e-12 or form.shrout_fleiss.endswith("k)")


def test_two_constant_columns_have_no_correlation() -> None:
    forms = {form.shrout_fleiss: form for form in intraclass_correlations(np.array([[5.0, 7.0]] * 4))}
    assert (forms["ICC(2,1)"].value, forms["ICC(2,1)"].interval) == (0, (0, 0))
    assert np.isnan(forms["ICC(3,1)"].value)
