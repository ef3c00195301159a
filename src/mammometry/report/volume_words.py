"""A volume and its 95 % interval in words, with as many digits as the interval justifies."""

from __future__ import annotations


def is_coarse(interval_cc: tuple[float, float] | None) -> bool:
    """Whether tenths of a cc would say too much: from ± 5 cc on."""
    return interval_cc is not None and interval_cc[1] - interval_cc[0] >= 10.0


def volume_words(volume_cc: float, interval_cc: tuple[float, float] | None = None) -> str:
    """A volume with as many digits as its interval justifies: tenths of a cc below ± 5 cc or without an interval."""
    return f"{volume_cc:.0f} cc" if is_coarse(interval_cc) else f"{volume_cc:.1f} cc"


def interval_words(interval_cc: tuple[float, float] | None) -> str:
    """The 95 % interval in words, half its width first unless it ends at zero, short of that width."""
    if interval_cc is None:
        return "no interval yet: the error of this volume is not known"
    low, high = interval_cc
    digits = 0 if is_coarse(interval_cc) else 1
    if low <= 0:
        return f"between 0 and {high:.{digits}f} cc (95 %)"
    return f"± {(high - low) / 2:.{digits}f} cc (95 %: {low:.{digits}f} to {high:.{digits}f} cc)"
