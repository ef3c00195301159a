"""Domes of breasts among ridges, slopes and shoulders."""

import numpy as np
import pytest

from mammometry.measure.boundary.prominence import breast_middles, level_pair, roundness_per_mm
from mammometry.measure.trunk.skin_map import PIXEL_MM, Relief
from mammometry.measure.trunk.thorax import Trunk

AXES = np.arange(-200.0, 200.1, PIXEL_MM)
X, Y = np.meshgrid(AXES, AXES)
TRUNK = Trunk(frame=np.eye(3), origin=np.zeros(3), half_width_mm=150.0)


def relief_of(bulge_mm: np.ndarray) -> Relief:
    return Relief(
        low=np.array([-200.0, -200.0]),
        bulge_mm=bulge_mm,
        known=np.ones(X.shape, dtype=bool),
        arm=np.zeros(X.shape, dtype=bool),
    )


def cap(across: float, up: float, reach_mm: float, top_mm: float) -> np.ndarray:
    return np.asarray(top_mm * np.clip(1 - ((X - across) ** 2 + (Y - up) ** 2) / reach_mm**2, 0, None) ** 2)


def ridge() -> np.ndarray:
    """A muscle: round across itself alone, and higher than both breasts."""
    return np.asarray(60.0 * np.exp(-(((X + Y - 120.0) / 40.0) ** 2)))


def test_breasts_are_domes_whatever_stands_beside_them() -> None:
    slope = 0.2 * Y - 0.1 * X + 15.0  # of a trunk that was fitted badly
    shoulders = np.clip(np.abs(X) + Y - 230.0, 0, None)
    middles = breast_middles(relief_of(cap(75, 5, 60, 20) + cap(-70, -8, 50, 35) + slope + shoulders), TRUNK)
    left, right = middles["left"], middles["right"]
    assert left is not None
    assert right is not None
    assert left.flat == pytest.approx((75, 5), abs=4)
    assert right.flat == pytest.approx((-70, -8), abs=4)
    assert right.roundness_per_mm > left.roundness_per_mm


def test_a_ridge_is_no_dome() -> None:
    inside = np.abs(X) + np.abs(Y) < 100
    breast = roundness_per_mm(relief_of(cap(0, 0, 60, 20)))
    assert roundness_per_mm(relief_of(ridge()))[inside].max() < 0.05 * breast.max()
    assert breast_middles(relief_of(ridge()), TRUNK) == {"left": None, "right": None}


def test_a_pair_lies_alike_on_both_sides() -> None:
    """The rounder of two domes on the right, a belly's, has no partner."""
    middles = breast_middles(relief_of(cap(70, 0, 60, 30) + cap(-70, 0, 60, 30) + cap(-60, -105, 40, 30)), TRUNK)
    right = middles["right"]
    assert right is not None
    assert right.flat == pytest.approx((-70, 0), abs=6)


def test_a_wide_dome_has_a_wide_base() -> None:
    """Of a cap with the base π a²: its root is 1.77 a, drawn towards the usual 130 mm."""
    bases = []
    for reach in (50.0, 75.0):
        left = breast_middles(relief_of(cap(80, 0, reach, 30.0)), TRUNK)["left"]
        assert left is not None
        bases.append(left.base_mm)
        assert left.base_mm == pytest.approx(np.sqrt(np.pi) * reach, rel=0.25)
    assert bases[1] > 1.2 * bases[0]


def test_a_high_breast_whose_top_gravity_gathers_has_the_base_of_its_half_height() -> None:
    """Its dome alone would tell a base of 121 mm for 160. A low breast's half height would add a muscle to it."""
    away = np.hypot(X - 95, Y)
    form = 0.6 * np.clip(1 - (away / 90) ** 2, 0, None) + 0.4 * np.exp(-((away / 20) ** 2) / 2)
    high = breast_middles(relief_of(100 * form), TRUNK)["left"]
    low = breast_middles(relief_of(30 * form), TRUNK)["left"]
    over_a_muscle = breast_middles(relief_of(30 * form + 18 * np.clip((Y + 20) / 40, 0, 1)), TRUNK)["left"]
    assert high is not None
    assert low is not None
    assert over_a_muscle is not None
    assert high.base_mm == pytest.approx(np.sqrt(np.pi) * 90, rel=0.12)
    assert over_a_muscle.base_mm == pytest.approx(low.base_mm, rel=0.1)


def test_the_breasts_are_the_domes_at_one_height() -> None:
    """Beside two breasts, an arm that the photographs cut off is as round as the rounder one, and 60 mm higher."""
    breasts = cap(-20, 0, 50, 26) + cap(-160, -5, 50, 32)
    pair = level_pair(relief_of(breasts + cap(140, 62, 50, 32)))
    assert pair is not None
    assert pair[0] == pytest.approx((-20, 0), abs=6)
    assert pair[1] == pytest.approx((-160, -5), abs=12)
    alone = level_pair(relief_of(breasts))
    assert alone is not None
    np.testing.assert_allclose(pair, alone, atol=2.0)


def test_of_domes_one_above_the_other_a_third_makes_no_pair() -> None:
    """Lying across the frame: only the two roundest count there."""
    across = relief_of(cap(0, 75, 50, 34) + cap(0, -75, 50, 32) + cap(120, -75, 50, 20))
    assert level_pair(across, most=2) is None
