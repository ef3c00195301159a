"""Numbers with no more digits than their uncertainty justifies."""

from __future__ import annotations

from mammometry.base.normal import COVERAGE_95

_COARSE = 5.0
"""Half-width of a 95 % interval, mm or cc, from which tenths are left out: a tenth is then at most 2 % of it, and
rounding to a whole number adds less than 1 % to it (root of the sum of squares)."""
_FINEST = 0.1  # mm or cc: smallest half-width that is stated, and step of all stated numbers


def decimals(half: float | None) -> int:
    """Decimals of a number in mm or cc whose 95 % interval has this half-width. One where it is not known."""
    return 0 if half is not None and half >= _COARSE else 1


def half_width(interval: tuple[float, float] | None) -> float | None:
    """Half of the width of an interval. None without one."""
    return None if interval is None else (interval[1] - interval[0]) / 2


def rounded(value: float, half: float | None) -> float:
    """A number in mm or cc, rounded by the half-width of its 95 % interval. Never a negative zero."""
    return round(value, decimals(half)) + 0.0


def rounded_words(value: float, half: float | None, unit: str = "", *, sign: bool = False, alone: bool = False) -> str:
    """A number with the half-width of its 95 % interval, both rounded by it: "127 ± 25 mm", "+4.2 ± 2.8".

    Args:
        value: in mm or cc.
        half: the half-width, in the same unit. None: not known; the number stands alone, with tenths.
        unit: what follows the numbers.
        sign: whether a positive number gets a sign, too. Zero has none.
        alone: whether the half-width is left out.
    """
    digits = decimals(half)
    words = f"{value:{'+' if sign else ''}z.{digits}f}"
    if not float(words):
        words = words.lstrip("+-")
    if half is not None and not alone:
        words += f" ± {max(half, _FINEST):.{digits}f}"
    return f"{words} {unit}".rstrip().replace("-", "−")


def at_95(value: float, sigma: float | None, unit: str = "", *, sign: bool = False, alone: bool = False) -> str:
    """Words for a number and its standard uncertainty, given as 95 % half-width.

    Arguments and result as of `rounded_words`.
    """
    return rounded_words(value, None if sigma is None else COVERAGE_95 * sigma, unit, sign=sign, alone=alone)
