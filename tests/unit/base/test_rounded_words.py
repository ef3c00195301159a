"""Numbers with no more digits than their uncertainty justifies."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mammometry.base.rounding import at_95, decimals, half_width, rounded, rounded_words


@pytest.mark.parametrize(
    ("value", "half", "words"),
    [
        (126.7, 25.1, "127 ± 25 mm"),
        (212.34, 4.12, "212.3 ± 4.1 mm"),
        (-4.51, 5.9, "−5 ± 6 mm"),
        (-0.02, None, "0.0 mm"),
        (-0.3, 60.0, "0 ± 60 mm"),
        (84.85, 0.004, "84.8 ± 0.1 mm"),  # never known without any error
    ],
)
def test_a_number_is_rounded_by_its_uncertainty(value: float, half: float | None, words: str) -> None:
    assert rounded_words(value, half, "mm") == words


def test_a_difference_has_a_sign_but_zero_has_none() -> None:
    assert rounded_words(4.21, 2.8, sign=True) == "+4.2 ± 2.8"
    assert rounded_words(0.3, 7.0, sign=True) == "0 ± 7"
    assert rounded_words(-61.2, 73.0, "cc", sign=True, alone=True) == "−61 cc"
    assert at_95(126.7, 12.8, "mm") == "127 ± 25 mm"
    assert at_95(126.7, None, "mm") == "126.7 mm"
    assert half_width(None) is None


@given(st.floats(-3000, 3000), st.floats(0.05, 500))
def test_rounding_adds_little_to_the_uncertainty(value: float, half: float) -> None:
    """Half of the last place is at most a tenth of the half-width, or .05."""
    step = 10.0 ** -decimals(half)
    assert abs(rounded(value, half) - value) <= step / 2 + 1e-9
    assert step / 2 <= max(0.1 * half, 0.05)
