"""A breast's change between two dates, in the words that every page, document and command uses."""

from __future__ import annotations

import datetime

from mammometry.report.words.volume_words import is_coarse

Interval = tuple[float, float]

MORE = "more than the measurement error"
WITHIN = "within the measurement error"
UNKNOWN = "no verdict, because the error of the change is not known"


def date_words(date: datetime.date) -> str:
    """A date inside a sentence: 3 November 2026."""
    return f"{date.day} {date:%B %Y}"


def verdict_words(beyond_error: bool | None) -> str:
    """Whether a change is larger than its measurement error.

    Args:
        beyond_error: whether the 95 % interval of the change leaves out zero. None: it is not known.
    """
    return UNKNOWN if beyond_error is None else MORE if beyond_error else WITHIN


def change_sentence(
    breast: str, change_cc: float, interval_cc: Interval | None, beyond_error: bool | None, before: datetime.date | None
) -> str:
    """One breast's change of volume and its verdict, in one sentence.

    Args:
        breast: "left" or "right".
        change_cc: later volume less the earlier one, cc.
        interval_cc: its 95 % interval, cc.
        beyond_error: whether that leaves out zero.
        before: the earlier date. None: it is not known.
    """
    digits = 0 if is_coarse(interval_cc) else 1
    than = "before" if before is None else f"on {date_words(before)}"
    if not float(f"{change_cc:.{digits}f}"):
        amount = f"as large as {than}"
    else:
        amount = f"{abs(change_cc):.{digits}f} cc {'larger' if change_cc > 0 else 'smaller'} than {than}"
    span = "" if interval_cc is None else f" (95 %: {_span(interval_cc, digits)})"
    return f"{breast.capitalize()} breast: {amount}{span}: {verdict_words(beyond_error)}."


def _span(interval_cc: Interval, digits: int) -> str:
    """Both ends in the direction of the change, or each with its own where they differ."""
    low, high = interval_cc
    if low < 0.0 < high:
        return f"{-low:.{digits}f} cc smaller to {high:.{digits}f} cc larger"
    near, far = sorted((abs(low), abs(high)))
    return f"{near:.{digits}f} to {far:.{digits}f}"
