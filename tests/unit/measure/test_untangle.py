"""Curls of a curve laid flat are straightened; simple curves stay."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mammometry.measure.solid.patch import fill
from mammometry.measure.solid.untangle import rounded, self_crossings, signed_area_mm2, uncrossed

ANGLES = np.linspace(0, 2 * np.pi, 600, endpoint=False)
CIRCLE = 90 * np.stack([np.cos(ANGLES), np.sin(ANGLES)], axis=1)  # .94 mm from corner to corner, as on a mesh


def curled(places, radius_mm=2.0, corners=18):
    """The circle with small loops, each the wrong way round."""
    loop = CIRCLE.copy()
    for place in places:
        turn = -np.linspace(0, 2 * np.pi, corners, endpoint=False)
        loop[place : place + corners] = loop[place] + radius_mm * np.stack([np.cos(turn), np.sin(turn)], axis=1)
    return loop


@pytest.mark.slow
@given(st.integers(0, 10_000))
def test_crossings_are_those_of_all_pairs(seed):
    loop = np.random.default_rng(seed).uniform(-1, 1, (12, 2))
    in_space = np.concatenate([loop, np.zeros((12, 1))], axis=1)
    assert self_crossings(loop).tolist() == [list(pair) for pair in _all_pairs(in_space)]


def _all_pairs(loop):
    """Crossings by looking at every pair of edges."""

    def turn(a, b, c):
        return np.cross(b - a, c - a)[2]

    n = len(loop)
    for i in range(n):
        for j in range(i + 2, n - (i == 0)):
            a, b, c, d = loop[i], loop[(i + 1) % n], loop[j], loop[(j + 1) % n]
            if turn(a, b, c) * turn(a, b, d) < 0 and turn(c, d, a) * turn(c, d, b) < 0:
                yield i, j


def test_a_simple_curve_stays_bit_for_bit():
    assert uncrossed(CIRCLE) is CIRCLE


@pytest.mark.parametrize("places", [[50], [50, 300, 580], [100, 119]])
def test_curls_are_straightened_and_nothing_else_moves(places):
    loop = curled(places)
    assert len(self_crossings(loop))
    simple = uncrossed(loop)
    assert not len(self_crossings(simple))
    assert np.abs(np.linalg.norm(simple, axis=1) - 90).max() < 2.1  # a curl's radius: its first points may stay
    assert (simple != loop).any(axis=1).sum() <= 22 * len(places)
    assert signed_area_mm2(simple) == pytest.approx(signed_area_mm2(CIRCLE), rel=5e-3)
    assert fill([simple], 3.0).area_mm2() == pytest.approx(signed_area_mm2(simple), rel=1e-6)


def test_a_curve_without_an_inside_becomes_a_circle_the_same_way_round():
    tangled = np.random.default_rng(0).uniform(-50, 50, (60, 2))
    simple = uncrossed(tangled)
    assert not len(self_crossings(simple))
    circle = rounded(tangled)
    assert np.sign(signed_area_mm2(circle)) == np.sign(signed_area_mm2(tangled))
    assert np.ptp(np.linalg.norm(circle - tangled.mean(axis=0), axis=1)) < 1e-9
