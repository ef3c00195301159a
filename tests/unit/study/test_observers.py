"""Several persons' drawings: published correlations, closed forms of the components, distances between circles."""

import math

import numpy as np
import pytest

from mammometry.study.icc import intraclass_correlations
from mammometry.study.observers import WHOLE, ObservedCurve, distances_by_region_mm, observer_study, scatter_of

# Shrout and Fleiss 1979, Table 2: four judges, six targets.
SHROUT_FLEISS = [[9, 2, 5, 8], [6, 1, 3, 2], [8, 4, 6, 8], [7, 1, 2, 6], [10, 5, 6, 9], [6, 2, 4, 7]]


def circle(radius_mm: float = 60.0, middle_mm: tuple[float, float] = (0.0, 0.0)) -> np.ndarray:
    t = 2 * np.pi * np.arange(720) / 720
    return np.stack([middle_mm[0] + radius_mm * np.cos(t), middle_mm[1] + radius_mm * np.sin(t), 0 * t], axis=1)


CIRCLE = circle(1.0)  # so small that its distances take no time


def drawing(breast: str, observer: str, repeat: int, cc: float, curve: np.ndarray | None = None) -> ObservedCurve:
    return ObservedCurve(
        breast=breast,
        observer=observer,
        repeat=str(repeat),
        volume_cc=cc,
        base_cm2=113.0,
        lateral_up_mm=circle() if curve is None else curve,
    )


def test_shrout_and_fleiss_own_example() -> None:
    drawings = [
        drawing(f"target {row}", f"judge {column}", 1, value)
        for row, values in enumerate(SHROUT_FLEISS)
        for column, value in enumerate(values)
    ]
    found = observer_study(drawings)
    assert found.icc_between is not None
    assert found.icc_between.value == pytest.approx(0.29, abs=0.005)  # published
    assert found.icc_between.interval == pytest.approx((0.02, 0.76), abs=0.006)
    assert found.between is not None
    assert found.between.sem.value == pytest.approx(math.sqrt(6.26), abs=0.002)  # their WMS, 18 degrees of freedom
    assert found.between.df == pytest.approx(18)
    assert found.within is None
    assert not found.apart_within


def test_the_same_example_as_repeats_of_one_person() -> None:
    drawings = [
        drawing(f"target {row}", "anna", column, value)
        for row, values in enumerate(SHROUT_FLEISS)
        for column, value in enumerate(values)
    ]
    found = observer_study(drawings)
    assert found.within is not None
    assert found.within.sem.value == pytest.approx(math.sqrt(6.26), abs=0.002)
    assert found.within.mdc.value == pytest.approx(1.96 * math.sqrt(2) * found.within.sem.value)
    assert found.icc_within["anna"].value == pytest.approx(0.29, abs=0.005)
    assert found.between is None


def test_components_of_one_breast_in_closed_form() -> None:
    """Two persons with two drawings each: MS_W = (2 + 8) / 2 = 5."""
    found = observer_study(
        [
            drawing("a", "anna", 1, 99.0),
            drawing("a", "anna", 2, 101.0),
            drawing("a", "ben", 1, 108.0),
            drawing("a", "ben", 2, 112.0),
        ]
    )
    assert found.within is not None
    assert found.between is not None
    assert found.within.sem.value == pytest.approx(math.sqrt(5))
    # Means 100 and 110 of two drawings each: MS_B = 2 (5² + 5²) = 100; persons' variance (100 − 5)/2, repeats' 5.
    assert found.between.sem.value == pytest.approx(math.sqrt(47.5 + 5))
    assert found.between.df == pytest.approx(52.5**2 / (50**2 / 1 + 2.5**2 / 2))
    assert found.within.percent == pytest.approx(100 * math.sqrt(5) / 105)
    assert found.icc_between is None  # one breast says nothing about the scatter of breasts


@pytest.mark.parametrize("seed", [1, 159])  # of the second, the correlation's interval has 1e-32 degrees of freedom
def test_persons_who_differ_no_more_than_their_repeats_are_one_person(seed: int) -> None:
    """Then all drawings of a breast are alike, and the pooled standard deviation is the answer."""
    rng = np.random.default_rng(seed)
    values = rng.normal(300, 5, (3, 2, 4))
    values -= values.mean(axis=2, keepdims=True) - values.mean(axis=(1, 2), keepdims=True)  # no person differs
    drawings = [
        drawing(f"b{i}", f"p{j}", k, values[i, j, k], CIRCLE) for i in range(3) for j in range(2) for k in range(4)
    ]
    found = observer_study(drawings)
    assert found.between is not None
    assert found.between.df == 21
    pooled = math.sqrt(sum(values[i].var(ddof=1) for i in range(3)) / 3)
    assert found.between.sem.value == pytest.approx(pooled, rel=1e-9)


@pytest.mark.slow
def test_the_intervals_hold_the_true_scatter() -> None:
    """400 studies of 6 breasts by 3 persons twice, drawn with known components: about 95 % hold both."""
    rng = np.random.default_rng(3)
    held = np.zeros(2)
    for _ in range(400):
        values = 400 + rng.normal(0, 20, (6, 3, 1)) + rng.normal(0, 10, (6, 3, 2))
        for number, (each, true) in enumerate(zip(scatter_of(values), (10.0, math.hypot(20, 10)), strict=True)):
            assert each is not None
            held[number] += each.sem.interval[0] <= true <= each.sem.interval[1]
    assert held / 400 == pytest.approx([0.95, 0.95], abs=0.033)  # three binomial standard deviations


def test_concentric_circles_are_as_far_apart_everywhere() -> None:
    first, second = (drawing("a", name, 1, 300.0, circle(radius)) for name, radius in (("anna", 60.0), ("ben", 64.0)))
    found = distances_by_region_mm(first, second)
    for region, away in found.items():
        assert away == pytest.approx(4.0, abs=0.05), region  # points are 1 mm apart: .5² / 2 / 4 mm
    apart = observer_study([first, second]).apart_between
    assert apart[WHOLE].mean_mm == pytest.approx(4.0, abs=0.02)
    assert apart["upper"].across_mm == pytest.approx(4.0 / math.sqrt(2), abs=0.02)
    assert apart["lateral"].pairs == 1


def test_a_curve_that_reaches_further_towards_the_armpit_differs_there() -> None:
    bulged = circle()
    towards = np.maximum(bulged[:, 0] / 60.0, 0.0) ** 4
    bulged[:, 0] += 8.0 * towards
    found = observer_study([drawing("a", "anna", 1, 300.0), drawing("a", "ben", 1, 310.0, bulged)]).apart_between
    assert found["lateral"].mean_mm > 3.0
    for region in ("upper", "medial", "lower"):
        assert found[region].mean_mm < 0.6


@pytest.mark.parametrize(
    "drawings",
    [
        [drawing("a", "anna", 1, 300.0), drawing("b", "anna", 1, 310.0)],
        [drawing("a", "anna", 1, 300.0), drawing("a", "anna", 1, 310.0)],
    ],
)
def test_what_tells_nothing_is_refused(drawings: list[ObservedCurve]) -> None:
    with pytest.raises(ValueError, match=r"twice|two"):
        observer_study(drawings)


def test_first_drawings_are_those_of_the_first_repeat_whatever_the_order_of_rows() -> None:
    volumes = {("anna", 1): (100, 210, 290), ("anna", 2): (130, 180, 330), ("ben", 1): (104, 205, 296)}
    drawings = [
        drawing(breast, observer, repeat, cc)
        for (observer, repeat), row in volumes.items()
        for breast, cc in zip("xyz", row, strict=True)
    ]
    found, turned = observer_study(drawings), observer_study(drawings[::-1])
    assert found.icc_between is not None
    assert turned.icc_between is not None
    assert turned.icc_between.value == pytest.approx(found.icc_between.value)
    first = np.array([volumes["anna", 1], volumes["ben", 1]], float).T
    (expected,) = (form for form in intraclass_correlations(first) if form.shrout_fleiss == "ICC(2,1)")
    assert found.icc_between.value == pytest.approx(expected.value)
