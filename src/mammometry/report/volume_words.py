"""A volume and its 95 % interval in words.

The interval decides the number of digits.
"""

from __future__ import annotations

from mammometry.measure.volume.definitions import DENSITY_G_PER_CC, DefinedVolume

_COARSE_CC = 10.0
"""Width of an interval from which tenths of a cc are left out: a tenth is then 1 % of it. Chosen by eye."""


def is_coarse(interval_cc: tuple[float, float] | None) -> bool:
    """Whether an interval is too wide for tenths of a cc."""
    return interval_cc is not None and interval_cc[1] - interval_cc[0] >= _COARSE_CC


def term_words(half_cc: float) -> str:
    """Half-width of one source of error, cc: tenths below 10 cc."""
    return "< 0.1" if half_cc < 0.05 else f"{half_cc:.{1 if half_cc < 10 else 0}f}"


def volume_words(volume_cc: float, interval_cc: tuple[float, float] | None = None) -> str:
    """A volume in whole cc if coarse, else in tenths."""
    return f"{volume_cc:.0f} cc" if is_coarse(interval_cc) else f"{volume_cc:.1f} cc"


def interval_words(interval_cc: tuple[float, float] | None) -> str:
    """The 95 % interval in words: half-width and both ends.

    Only the ends if it is cut off at zero.
    """
    if interval_cc is None:
        return "no interval: the error of this volume is not known"
    low, high = interval_cc
    digits = 0 if is_coarse(interval_cc) else 1
    if low <= 0:
        return f"between 0 and {high:.{digits}f} cc (95 %)"
    return f"± {(high - low) / 2:.{digits}f} cc (95 %: {low:.{digits}f} to {high:.{digits}f} cc)"


_TITLES = {
    "flat chest": "Above a flat chest",
    "named wall": "Before the named wall",
    "muscle": "Down to the muscle",
    "measured wall": "Before the measured wall",
}


def definition_title(defined: DefinedVolume) -> str:
    """A few words for one meaning of the breast."""
    return _TITLES[defined.meaning]


def definition_words(defined: DefinedVolume) -> str:
    """One definition's volume, interval in cc and %, and weight."""
    low, high = defined.interval_cc
    grams, half_g = defined.weight_g
    weight = f"{grams:.0f} ± {half_g:.0f} g at {DENSITY_G_PER_CC} g/cc"
    if low <= 0:
        return (
            f"{volume_words(defined.volume_cc, defined.interval_cc)}, {interval_words(defined.interval_cc)}; {weight}"
        )
    return f"{defined.volume_cc:.0f} ± {(high - low) / 2:.0f} cc (± {defined.half_percent:.0f} %), {weight}"
