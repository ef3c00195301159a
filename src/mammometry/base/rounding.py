"""Round numbers to the digits that their uncertainty justifies."""

from __future__ import annotations

from mammometry.base.normal import COVERAGE_95

_COARSE = 5.0
"""Half-width of a 95 % interval, mm or cc, above which decimals are omitted: a tenth is then at most 2 % of it, and
rounding to a whole number increases the half-width by less than 1 % (root of the sum of squares)."""
_FINEST = 0.1  # mm or cc: smallest half-width that is shown, and finest step of shown numbers


def decimals(half: float | None) -> int:
    """Number of decimals of a value in mm or cc with this half-width of its 95 % interval. 1 if unknown."""
    return 0 if half is not None and half >= _COARSE else 1


def half_width(interval: tuple[float, float] | None) -> float | None:
    """Half the width of an interval. None without one."""
    return None if interval is None else (interval[1] - interval[0]) / 2


def rounded(value: float, half: float | None) -> float:
    """Round a value in mm or cc according to the half-width of its 95 % interval. Never a negative zero."""
    return round(value, decimals(half)) + 0.0


def rounded_words(value: float, half: float | None, unit: str = "", *, sign: bool = False, alone: bool = False) -> str:
    """Format a value and the half-width of its 95 % interval, both rounded: "127 ± 25 mm", "+4.2 ± 2.8".

    Args:
        value: value in mm or cc.
        half: half-width in the same unit. None: unknown; only the value is shown, with one decimal.
        unit: text after the numbers.
        sign: whether positive numbers get a sign. Zero has none.
        alone: whether to omit the half-width.
    """
    digits = decimals(half)
    words = f"{value:{'+' if sign else ''}z.{digits}f}"
    if not float(words):
        words = words.lstrip("+-")
    if half is not None and not alone:
        words += f" ± {max(half, _FINEST):.{digits}f}"
    return f"{words} {unit}".rstrip().replace("-", "−")


def at_95(value: float, sigma: float | None, unit: str = "", *, sign: bool = False, alone: bool = False) -> str:
    """Format a value whose standard uncertainty is known, with the half-width of its 95 % interval.

    For other arguments and the result see `rounded_words`.
    """
    return rounded_words(value, None if sigma is None else COVERAGE_95 * sigma, unit, sign=sign, alone=alone)
