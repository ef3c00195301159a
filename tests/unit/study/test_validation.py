"""Validation against a truth: lines with errors in both, specimens, definitions."""

import math

import numpy as np
import pytest
from scipy import optimize, stats

from mammometry.study.validation.regression import concordance, deming, passing_bablok
from mammometry.study.validation.study import ValidationCase, validation
from mammometry.study.validation.truths import density, skin_left, water, water_density, weight


def drawn(rng: np.random.Generator, n: int, slope: float, sds: tuple[float, float]) -> tuple[np.ndarray, np.ndarray]:
    truth = rng.uniform(150, 900, n)
    return truth + rng.normal(0, sds[0], n), 10 + slope * truth + rng.normal(0, sds[1], n)


@pytest.mark.requirement("R-TRUTH-1")
def test_demings_line_of_equal_errors_is_the_principal_axis() -> None:
    x, y = drawn(np.random.default_rng(3), 25, 1.08, (12.0, 12.0))
    _, _, axes = np.linalg.svd(np.stack([x - x.mean(), y - y.mean()], axis=1))
    line = deming(x, y, np.arange(25))
    assert line.slope.value == pytest.approx(axes[0, 1] / axes[0, 0])
    assert line.intercept.value == pytest.approx(y.mean() - line.slope.value * x.mean())
    stretched = deming(x, 3 * y, np.arange(25), ratio=9.0)  # errors three times as large are weighted alike
    assert stretched.slope.value == pytest.approx(3 * line.slope.value)
    exact = deming(x, y, np.arange(25), ratio=1e12)  # all errors in y: least squares
    assert exact.slope.value == pytest.approx(np.polyfit(x, y, 1)[0], rel=1e-6)


@pytest.mark.requirement("R-TRUTH-1")
def test_demings_line_of_a_published_example() -> None:
    """NCSS Statistical Software, chapter 303: line and jackknife, errors of x four times as large in variance."""
    x = np.array([7.0, 8.3, 10.5, 9.0, 5.1, 8.2, 10.2, 10.3, 7.1, 5.9])
    y = np.array([7.9, 8.2, 9.6, 9.0, 6.5, 7.3, 10.2, 10.6, 6.3, 5.2])
    line = deming(x, y, np.arange(10), ratio=0.25)
    assert (line.slope.value, line.intercept.value) == pytest.approx((1.00119, -0.08974), abs=5e-6)
    low, high = line.intercept.interval
    assert (high - low) / 2 / stats.t.ppf(0.975, 9) == pytest.approx(1.72199, abs=5e-6)


@pytest.mark.requirement("R-TRUTH-1")
@pytest.mark.parametrize("ratio", [0.3, 1.0, 5.0])
def test_demings_line_is_the_likeliest_with_free_true_values(ratio: float) -> None:
    """Least squares over the line and every breast's true value, by scipy."""
    x, y = drawn(np.random.default_rng(8), 20, 0.93, (15.0, 15.0 * math.sqrt(ratio)))

    def rest(unknowns: np.ndarray) -> np.ndarray:
        slope, intercept, *true = unknowns
        return np.concatenate([x - true, (y - intercept - slope * np.array(true)) / math.sqrt(ratio)])

    found = optimize.least_squares(rest, [1.0, 0.0, *x], xtol=1e-15, ftol=1e-15, gtol=1e-15, x_scale="jac").x
    line = deming(x, y, np.arange(20), ratio)
    assert line.slope.value == pytest.approx(found[0], rel=1e-6)
    assert line.intercept.value == pytest.approx(found[1], abs=1e-3)


@pytest.mark.requirement("R-TRUTH-1")
@pytest.mark.parametrize("n", [12, 31])
def test_passing_and_bablok_by_the_angles_of_all_pairs(n: int) -> None:
    """Angles between −45° and 135°: their median is the slope's, and ranks by Kendall's variance bound it."""
    x, y = (np.round(values, -1) for values in drawn(np.random.default_rng(n), n, 1.1, (30.0, 30.0)))  # with ties
    turned = []
    for i in range(n):
        for j in range(i):
            if (x[i], y[i]) != (x[j], y[j]):
                angle = math.degrees(math.atan2(y[i] - y[j], x[i] - x[j])) % 180
                if angle != 135:
                    turned.append(angle - 180 if angle > 135 else angle)
    turned.sort()
    count = len(turned)
    slope = [math.tan(math.radians(turned[place])) for place in ((count - 1) // 2, count // 2)]
    lowest = round((count - 1.959964 * math.sqrt(n * (n - 1) * (2 * n + 5) / 18)) / 2)
    bounds = [math.tan(math.radians(turned[place])) for place in (lowest - 1, count - lowest)]
    line = passing_bablok(x, y)
    assert line.slope.value == pytest.approx(sum(slope) / 2)
    assert line.slope.interval == pytest.approx(bounds)
    intercepts = [float(np.median(y - value * x)) for value in (line.slope.value, bounds[1], bounds[0])]
    assert [line.intercept.value, *line.intercept.interval] == pytest.approx(intercepts)


@pytest.mark.requirement("R-TRUTH-1")
def test_passing_and_bablok_by_counting_slopes() -> None:
    x, y = np.array([1.0, 2.0, 3.0, 4.0, 6.0]), np.array([1.2, 1.9, 3.4, 3.8, 6.5])
    slopes = sorted((y[j] - y[i]) / (x[j] - x[i]) for i in range(5) for j in range(i + 1, 5))
    line = passing_bablok(x, y)
    assert line.slope.value == pytest.approx((slopes[4] + slopes[5]) / 2)
    assert line.intercept.value == pytest.approx(np.median(y - line.slope.value * x))
    first, second = drawn(np.random.default_rng(5), 31, 1.1, (9.0, 9.0))
    forth, back = passing_bablok(first, second), passing_bablok(second, first)
    assert forth.slope.value * back.slope.value == pytest.approx(1, rel=1e-6)  # both methods are treated alike
    outlier = second.copy()
    outlier[0] += 400
    assert passing_bablok(first, outlier).slope.value == pytest.approx(forth.slope.value, abs=0.03)


@pytest.mark.slow
@pytest.mark.requirement("R-TRUTH-1")
def test_intervals_hold_the_true_slope() -> None:
    rng, held, tables = np.random.default_rng(11), np.zeros(2), 300
    for _ in range(tables):
        x, y = drawn(rng, 24, 1.05, (10.0, 20.0))
        for place, line in enumerate((deming(x, y, np.arange(24), 4.0), passing_bablok(x, y))):
            held[place] += line.slope.interval[0] <= 1.05 <= line.slope.interval[1]
    assert (held / tables > 0.91).all(), held / tables


def test_lins_concordance() -> None:
    values = np.array([1.0, 2.0, 3.0, 4.0])
    assert concordance(values, values) == pytest.approx(1)
    assert concordance(values, values + 1) == pytest.approx(2 * 1.25 / (1.25 + 1.25 + 1))
    assert concordance(values, -values) < 0


@pytest.mark.requirement("R-TRUTH-2")
def test_a_specimen_in_water_and_on_a_scale() -> None:
    for celsius, density_g_per_cc in ((4.0, 0.999975), (20.0, 0.998207), (25.0, 0.997047), (37.0, 0.993331)):  # IAPWS
        assert water_density(celsius) == pytest.approx(density_g_per_cc, abs=5e-5)
    nothing = skin_left(0.0, None)
    specimen = water(499.1, 20.0, nothing)
    assert specimen.volume_cc == pytest.approx(500.0, abs=0.1)
    assert specimen.sd_cc == pytest.approx(5.0, abs=0.01)
    skin = skin_left(100.0, 2.0)
    assert water(499.1, 20.0, skin, 0.0).volume_cc == pytest.approx(520.0, abs=0.1)
    assert water(499.1, 20.0, skin, 0.0).sd_cc == pytest.approx(2.0)
    assert density(40.0, 50.0)[0] == pytest.approx(0.985)  # composition is surer than age
    assert (density(49.0, None), density(50.0, None)) == ((1.01, 0.08), (0.96, 0.04))
    heavy = weight(480.0, 60.0, None, nothing)
    assert heavy.volume_cc == pytest.approx(500.0)
    assert heavy.sd_cc == pytest.approx(500 * math.hypot(0.04 / 0.96, 1 / 480))


@pytest.mark.requirement("R-TRUTH-2")
def test_definitions_stand_side_by_side_with_their_offsets() -> None:
    rng = np.random.default_rng(2)
    cases = [
        ValidationCase(
            woman=f"w{number}",
            side=side,
            truth_cc=truth,
            truth_sd_cc=5.0,
            measured_cc={"flat chest": truth + 4 + noise, "muscle": 1.1 * truth + noise},
        )
        for number in range(12)
        for side in ("left", "right")
        for truth, noise in [(float(rng.uniform(200, 800)), float(rng.normal(0, 6)))]
    ]
    found = validation(cases, "water", sem_cc=10.0)
    assert found.ratio == pytest.approx(4.0)
    flat, muscle = found.definitions
    assert flat.agreement.mean_difference.value == pytest.approx(4, abs=4)
    assert flat.agreement.subjects == 12
    assert not flat.deming.proportional
    assert muscle.deming.proportional
    assert muscle.deming.slope.value == pytest.approx(1.1, abs=0.02)
    (offset,) = found.offsets
    truth = np.array([case.truth_cc for case in cases])
    assert offset.mean_cc == pytest.approx(0.1 * truth.mean() - 4)
    own = [np.array([case.measured_cc[name] for case in cases]) for name in ("flat chest", "muscle")]
    assert offset.concordance == pytest.approx(concordance(*own))
    with pytest.raises(ValueError, match="women"):
        validation(cases[:4], "water")
