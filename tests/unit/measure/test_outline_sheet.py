"""An outline stays on one layer of skin."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mammometry.measure.boundary.breasts import on_one_sheet

TURN = np.linspace(0, 2 * np.pi, 144, endpoint=False)
CHEST_MM = 6 * np.sin(TURN) - 3 * np.cos(2 * TURN)
"""Bulge of a trunk that is no cylinder: up to .4 mm from one place to the next, as outlines of torsos have."""


def test_an_outline_on_one_sheet_stays_bit_for_bit():
    assert on_one_sheet(CHEST_MM) is CHEST_MM


@given(first=st.integers(0, 143), length=st.integers(1, 8), off_mm=st.floats(20.0, 60.0))
def test_a_stretch_on_another_layer_is_laid_between_its_neighbours(first, length, off_mm):
    there = (first + np.arange(length)) % 144
    leapt = CHEST_MM.copy()
    leapt[there] += off_mm * np.where(np.arange(length) % 3 == 1, -1, 1)  # to and fro, as measured behind a rail
    found = on_one_sheet(leapt)
    kept = np.setdiff1d(np.arange(144), there)
    assert np.array_equal(found[kept], CHEST_MM[kept])
    # The chord of a curve with second derivative c over a length L is off by c L²/8 at most: here .034 × 81 / 8.
    assert np.abs(found - CHEST_MM).max() < 0.35


def test_what_leaps_everywhere_is_left_as_it_is():
    wild = np.where(np.arange(144) % 2, 30.0, -30.0)
    found = on_one_sheet(wild)
    assert found.shape == wild.shape
    assert np.isfinite(found).all()


@pytest.mark.parametrize("n", [1, 2, 3])
def test_few_places_stay(n):
    assert np.array_equal(on_one_sheet(np.zeros(n)), np.zeros(n))
