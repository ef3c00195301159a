"""Repeated captures: components of variance against closed forms, another program and published tables; coverage."""

import math

import numpy as np
import pytest
from scipy import stats

from mammometry.study.icc import intraclass_correlations, mean_squares
from mammometry.study.repeatability.components import components
from mammometry.study.repeatability.design import ANOTHER_DAY, ANYBODY, SAME_DAY, Reading, design
from mammometry.study.repeatability.limits import repeated_limits
from mammometry.study.repeatability.plan import DETECTABLE, chance_to_show, check_claim, plan
from mammometry.study.repeatability.study import repeatability

# Bland and Altman, BMJ 313 (1996) 744, Table 1 (doi 10.1136/bmj.313.7059.744): peak expiratory flow of 20 children,
# four times each, l/min.
FLOWS = """190 220 200 200  220 200 240 230  260 260 240 280  210 300 280 265  270 265 280 270
280 280 270 275  260 280 280 300  275 275 275 305  280 290 300 290  320 290 300 290
300 300 310 300  270 250 330 370  320 330 330 330  335 320 335 375  350 320 340 365
360 320 350 345  330 340 380 390  335 385 360 370  400 420 425 420  430 460 480 470"""
# Woman, rater and volume of an unbalanced table, and what statsmodels 0.15 (MixedLM, REML, crossed effects) gives.
UNBALANCED = """0 0 403.6 425.5;0 1 421.1 415.1 389.8;0 2 408.6 410.9 408.2 418.8;1 1 549.2 556.4 565.6 568.4;
1 2 560.8 567.0;2 0 585.0 573.9 590.4 577.8;2 1 562.4 576.8;2 2 581.0 575.0 575.3;3 0 495.6 477.0;
3 2 484.7 481.1 461.5 475.4;
4 0 502.3 515.9 509.3;4 1 473.5 473.2 462.2 457.7;4 2 480.4 477.9;5 0 409.9 408.8 406.5 413.8;5 1 407.5 401.8;
6 0 361.4 356.6;6 1 357.0 366.0 373.4;6 2 367.0 374.6 378.0 386.6;7 0 365.0 373.5 364.6;7 1 363.7 356.4 374.4 378.6;
7 2 397.0 375.0;8 1 358.7 354.5;8 2 341.0 360.2 355.4"""
STATSMODELS = {"woman": 6909.08, "rater": 10.320, "rater × woman": 74.091, "repositioning": 74.529}


def table(women: int, raters: int, captures: int, rng: np.random.Generator, sds: tuple[float, ...]) -> list[Reading]:
    """A balanced table with known standard deviations: woman, rater, rater × woman, capture."""
    woman, rater, both, capture = sds
    of_woman, of_rater = rng.normal(0, woman, women), rng.normal(0, rater, raters)
    of_both = rng.normal(0, both, (women, raters))
    return [
        Reading(
            woman=f"w{i}",
            rater=f"r{j}" if raters > 1 else "",
            capture=str(k),
            volume_cc=900 + of_woman[i] + of_rater[j] + of_both[i, j] + rng.normal(0, capture),
        )
        for i in range(women)
        for j in range(raters)
        for k in range(captures)
    ]


def flows() -> list[Reading]:
    numbers = np.array(FLOWS.split(), dtype=float).reshape(20, 4)
    return [
        Reading(woman=str(child), capture=str(k), volume_cc=flow)
        for child, own in enumerate(numbers)
        for k, flow in enumerate(own)
    ]


@pytest.mark.requirement("R-REP-1")
def test_bland_and_altmans_repeated_flows() -> None:
    found = repeatability(flows())
    one = found.repetitions[0]
    assert one.sem_cc.value**2 == pytest.approx(460.52, abs=0.01)  # residual mean square, as printed
    assert one.df == pytest.approx(60)
    assert one.detectable_cc.value == pytest.approx(60, abs=0.6)  # "60 l/min"
    woman = found.components[0].variance_cc2
    assert 4 * woman + one.sem_cc.value**2 == pytest.approx(15016.78, abs=0.05)  # between children, as printed
    low, high = (math.sqrt(60 * one.sem_cc.value**2 / stats.chi2.ppf(q, 60)) for q in (0.975, 0.025))
    assert one.sem_cc.interval == pytest.approx((low, high))
    ratings = np.array(FLOWS.split(), dtype=float).reshape(20, 4)
    assert one.icc.value == pytest.approx(intraclass_correlations(ratings)[0].value)


@pytest.mark.requirement("R-REP-1")
def test_an_unbalanced_table_gives_what_statsmodels_gives() -> None:
    readings = [
        Reading(woman=woman, rater=rater, capture=str(k), volume_cc=float(volume))
        for row in UNBALANCED.split(";")
        for woman, rater, *volumes in [row.split()]
        for k, volume in enumerate(volumes)
    ]
    found = repeatability(readings)
    assert not found.balanced
    assert {one.name: one.variance_cc2 for one in found.components} == pytest.approx(STATSMODELS, rel=1e-3)
    levels = {one.level: one.sem_cc.value**2 for one in found.repetitions}
    assert levels == pytest.approx({SAME_DAY: 74.529, ANYBODY: 10.320 + 74.091 + 74.529}, rel=1e-3)


@pytest.mark.requirement("R-REP-1")
def test_a_balanced_table_gives_the_textbooks_mean_squares() -> None:
    """Two-way crossed with replicates: Searle, Casella and McCulloch 1992, section 4.7."""
    women, raters, captures = 8, 4, 3
    readings = table(women, raters, captures, np.random.default_rng(4), (90.0, 12.0, 9.0, 6.0))
    volumes = np.array([one.volume_cc for one in readings]).reshape(women, raters, captures)
    means = volumes.mean(axis=2)
    squares = mean_squares(means)
    error = float(volumes.var(axis=2, ddof=1).mean())
    both = squares.residual - error / captures
    expected = [
        (squares.between_subjects - squares.residual) / raters,
        (squares.between_methods - squares.residual) / women,
        both,
        error,
    ]
    found = repeatability(readings)
    assert min(expected) > 0
    assert found.balanced
    assert [one.variance_cc2 for one in found.components] == pytest.approx(expected, rel=1e-5)
    assert [one.moments_cc2 for one in found.components] == pytest.approx(expected, rel=1e-9)


def test_a_negative_component_of_the_closed_form_is_zero() -> None:
    values = np.array([1.0, 5.0, 5.2, 1.1, 1.2, 5.1, 4.9, 1.0])
    found = components(values, [np.repeat(np.arange(4), 2)])
    assert found.moments[0] < 0
    assert found.variances[0] == 0
    assert found.variances[1] == pytest.approx(values.var(ddof=1), rel=1e-6)
    assert found.interval_of([0])[0] == 0


@pytest.mark.slow
@pytest.mark.requirement("R-REP-2")
@pytest.mark.parametrize(
    ("shape", "sds", "least"),
    [((20, 1, 2), (100.0, 0.0, 0.0, 6.0), 92), ((10, 3, 2), (100.0, 4.0, 5.0, 6.0), 90)],
)
def test_intervals_hold_known_components(
    shape: tuple[int, int, int], sds: tuple[float, float, float, float], least: float
) -> None:
    """Of 200 tables; a share of 95 % has a standard error of 1.5 %."""
    rng, held = np.random.default_rng(7), np.zeros(3)
    whole = math.hypot(*sds[1:])
    for _ in range(200):
        found = repeatability(table(*shape, rng, sds))
        narrow, wide = found.repetitions[0], found.repetitions[-1]
        icc = sds[0] ** 2 / (sds[0] ** 2 + whole**2)
        for place, (estimate, truth) in enumerate(((narrow.sem_cc, sds[3]), (wide.sem_cc, whole), (wide.icc, icc))):
            held[place] += estimate.interval[0] <= truth <= estimate.interval[1]
    assert (held / 2 >= least).all(), held / 2


def test_effects_that_a_design_cannot_separate_are_named() -> None:
    once = [
        one
        for one in table(6, 3, 2, np.random.default_rng(1), (90, 5, 5, 5))
        if int(one.woman[1]) % 3 == int(one.rater[1])
    ]
    found = repeatability(once)
    assert ("rater × woman", "woman") in found.merged
    assert [one.level for one in found.repetitions] == [SAME_DAY, ANYBODY]


def test_both_breasts_of_a_capture_share_its_repositioning() -> None:
    rng = np.random.default_rng(11)
    readings = []
    for woman in range(40):
        base = rng.normal(500, 90)
        for capture in range(3):
            shared = rng.normal(0, 8)
            for side in ("left", "right"):
                readings.append(
                    Reading(
                        woman=str(woman), side=side, capture=str(capture), volume_cc=base + shared + rng.normal(0, 3)
                    )
                )
    found = repeatability(readings)
    sds = {one.name: one.sd_cc.value for one in found.components}
    assert sds["repositioning"] == pytest.approx(8, rel=0.2)
    assert sds["side × repositioning"] == pytest.approx(3, rel=0.2)
    assert found.repetitions[0].sem_cc.value == pytest.approx(math.hypot(8, 3), rel=0.15)


def test_days_are_a_level_of_their_own() -> None:
    rng = np.random.default_rng(2)
    readings = [
        Reading(woman=str(w), day=str(d), capture=str(k), volume_cc=500 + 60 * w + shift + rng.normal(0, 3))
        for w in range(12)
        for d in range(3)
        for shift in [rng.normal(0, 9)]
        for k in range(2)
    ]
    levels = {one.level: one.sem_cc.value for one in repeatability(readings).repetitions}
    assert set(levels) == {SAME_DAY, ANOTHER_DAY}
    assert levels[SAME_DAY] == pytest.approx(3, rel=0.3)
    assert levels[ANOTHER_DAY] == pytest.approx(math.hypot(9, 3), rel=0.3)


@pytest.mark.parametrize(
    "readings",
    [
        table(2, 1, 3, np.random.default_rng(1), (90, 0, 0, 5)),
        table(5, 2, 1, np.random.default_rng(1), (90, 5, 5, 5)),
        [*table(5, 1, 2, np.random.default_rng(1), (90, 0, 0, 5))] * 2,
    ],
)
def test_designs_without_repetition_are_refused(readings: list[Reading]) -> None:
    with pytest.raises(ValueError, match=r"\w"):
        design(readings)


def test_limits_of_repeated_measurements_are_bland_and_altmans() -> None:
    """Section 5.1 and 5.2 by hand: variance of the differences of means plus what the means took away."""
    rng = np.random.default_rng(9)
    first = {str(i): [400 + 30 * i + e for e in rng.normal(0, 5, 2 + i % 2)] for i in range(10)}
    second = {name: [own[0] + 7 + e for e in rng.normal(0, 8, 3)] for name, own in first.items()}
    found = repeated_limits(first, second, 10, names=("rater", "a", "b"))
    assert found is not None
    d = np.array([np.mean(second[name]) - np.mean(first[name]) for name in first])
    within = [
        sum(((np.array(own) - np.mean(own)) ** 2).sum() for own in method.values())
        / sum(len(own) - 1 for own in method.values())
        for method in (first, second)
    ]
    taken = [1 - np.mean([1 / len(own) for own in method.values()]) for method in (first, second)]
    variance = d.var(ddof=1) + taken[0] * within[0] + taken[1] * within[1]
    assert found.bias.value == pytest.approx(d.mean())
    assert found.sd.value == pytest.approx(math.sqrt(variance))
    assert found.upper.value - found.lower.value == pytest.approx(2 * 1.959964 * math.sqrt(variance), rel=1e-6)
    assert found.lower.interval[0] < found.lower.value < found.lower.interval[1] < found.upper.interval[0]


@pytest.mark.requirement("R-REP-1")
def test_limits_in_per_cent_are_those_of_the_logarithms() -> None:
    rng = np.random.default_rng(13)
    readings = [
        Reading(woman=str(w), rater=rater, capture=str(k), volume_cc=(200 + 60 * w) * factor * math.exp(e))
        for w in range(12)
        for rater, factor in (("a", 1.0), ("b", 1.05))
        for k, e in enumerate(rng.normal(0, 0.02, 2))
    ]
    found = repeatability(readings)
    (in_cc,), (in_percent,) = found.limits, found.limits_percent
    own: dict[str, dict[str, list[float]]] = {"a": {}, "b": {}}
    for one in readings:
        own[one.rater].setdefault(one.woman, []).append(math.log(one.volume_cc))
    logarithms = repeated_limits(own["a"], own["b"], 12, names=("rater", "a", "b"))
    assert logarithms is not None
    for name in ("bias", "lower", "upper"):
        expected = getattr(logarithms, name)
        values = [expected.value, *expected.interval]
        shown = getattr(in_percent, name)
        assert [shown.value, *shown.interval] == pytest.approx([100 * (math.exp(value) - 1) for value in values])
    assert in_percent.bias.value == pytest.approx(5, abs=1.5)
    assert in_cc.bias.value == pytest.approx(0.05 * (200 + 60 * 5.5), rel=0.3)


def test_a_class_of_size_has_its_own_scatter_with_intervals() -> None:
    """Small breasts scatter by 2 % and large ones by 1 %: χ² intervals of 12 and 10 degrees of freedom."""
    rng = np.random.default_rng(17)
    sizes = {"small": (200.0, 0.02, 12), "large": (800.0, 0.01, 10)}
    readings = [
        Reading(woman=f"{name} {w}", capture=str(k), volume_cc=mean * math.exp(e))
        for name, (mean, relative, women) in sizes.items()
        for w in range(women)
        for k, e in enumerate(rng.normal(0, relative, 2))
    ]
    found = repeatability(readings)
    assert [(one.from_cc, one.breasts) for one in found.sizes] == [(0.0, 12), (500.0, 10)]
    for one, (name, (_, relative, women)) in zip(found.sizes, sizes.items(), strict=True):
        pairs = np.array([one.volume_cc for one in readings if one.woman.startswith(name)]).reshape(women, 2)
        variance = float(((pairs[:, 1] - pairs[:, 0]) ** 2).mean() / 2)
        assert one.sem_cc.value == pytest.approx(math.sqrt(variance))
        bounds = [math.sqrt(women * variance / stats.chi2.ppf(q, women)) for q in (0.975, 0.025)]
        assert one.sem_cc.interval == pytest.approx(bounds)
        assert one.detectable_cc.interval == pytest.approx([1.959964 * math.sqrt(2) * bound for bound in bounds])
        assert one.cv_percent.interval[0] < 100 * relative < one.cv_percent.interval[1]
        spread = float(((np.log(pairs[:, 1]) - np.log(pairs[:, 0])) ** 2).mean() / 2)
        assert one.detectable_percent.value == pytest.approx(100 * math.expm1(1.959964 * math.sqrt(2 * spread)))


@pytest.mark.requirement("R-REP-2")
def test_a_plan_shows_its_claim_as_often_as_it_says() -> None:
    planned = plan(25.0, 6.0)
    sizes = dict(planned.sizes)
    assert sizes[2] > sizes[3] > sizes[4]
    df = sizes[2]
    drawn = 6.0 * np.sqrt(np.random.default_rng(5).chisquare(df, 1000) / df)
    shown = np.mean([check_claim(25.0, float(sem), df).verdict == "shown" for sem in drawn])
    fewer, chance = chance_to_show(25.0, 6.0, np.array([df - 1.0, df]))
    assert shown == pytest.approx(chance, abs=0.03)
    assert shown >= 0.77
    assert fewer < 0.8
    assert plan(10.0, 6.0).sizes == ()


def test_a_claim_is_shown_undecided_or_contradicted() -> None:
    assert check_claim(25.0, 5.0, 60).verdict == "shown"
    assert check_claim(25.0, 8.5, 60).verdict == "undecided"
    assert check_claim(25.0, 14.0, 60).verdict == "contradicted"
    assert check_claim(25.0, 5.0, 60).detectable_cc == pytest.approx(5 * DETECTABLE)


def test_what_differs_between_captures_is_listed() -> None:
    readings = table(4, 1, 2, np.random.default_rng(1), (90, 0, 0, 5))
    told = [
        Reading(woman=one.woman, capture=one.capture, volume_cc=one.volume_cc, conditions=(
            ("posture", "sitting" if (one.woman, one.capture) == ("w1", "1") else "standing"),
            ("SN-N left_mm", "215.0" if (one.woman, one.capture) == ("w2", "1") else "210.0"),
            ("N-N_mm", "190.0" if one.capture == "1" else "192.0"),
        ))
        for one in readings
    ]  # fmt: skip
    changes = {(change.woman, change.condition): change.found for change in repeatability(told).changes}
    assert changes == {
        ("w1", "posture"): ("standing", "sitting"),
        ("w2", "SN-N left_mm"): ("210.0", "215.0"),
    }
