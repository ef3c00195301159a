"""Rounding takes noise away, and no more than it says."""

import numpy as np
import pytest

from mammometry.geometry.arrays import to_bits, to_step

RNG = np.random.default_rng(5)


@pytest.mark.parametrize("step", [2.0**-10, 2.0**-8, 0.5])
def test_a_step_is_missed_by_half_of_it_at_most(step: float) -> None:
    values = RNG.uniform(-900, 900, (50, 40)).astype(np.float32)
    rounded = to_step(values.copy(), step)
    assert np.abs(rounded - values).max() <= step / 2
    assert np.abs(rounded - values).max() > step / 4
    assert not np.any(np.mod(rounded / step, 1))
    assert to_step(rounded.copy(), step).tobytes() == rounded.tobytes()


def test_no_zero_has_a_sign_and_nothing_else_is_lost() -> None:
    rounded = to_step(np.array([-0.0, -0.001, np.nan, 3.25], np.float32), 0.25)
    assert not np.signbit(rounded[:2]).any()
    assert np.isnan(rounded[2])
    assert rounded[3] == 3.25


@pytest.mark.parametrize("bits", [3, 5, 8])
def test_digits_are_missed_by_half_of_the_last_one(bits: int) -> None:
    values = np.exp(RNG.uniform(-20, 20, 5000)).astype(np.float32)
    relative = to_bits(values.copy(), bits) / values - 1
    assert np.abs(relative).max() <= 2.0 ** -(bits + 1) * 1.0001
    assert np.abs(relative).max() > 2.0 ** -(bits + 2)
    assert abs(relative.mean()) < 2.0 ** -(bits + 5), "rounded up as often as down"
    again = to_bits(to_bits(values.copy(), bits), bits)
    assert again.tobytes() == to_bits(values.copy(), bits).tobytes()


def test_what_is_no_number_stays_what_it_is() -> None:
    rounded = to_bits(np.array([0.0, np.inf, np.nan], np.float32), 5)
    assert rounded[0] == 0
    assert rounded[1] == np.inf
    assert np.isnan(rounded[2])
