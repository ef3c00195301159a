"""Volumes, intervals, definitions, cautions and changes between two dates, as text."""

from __future__ import annotations

import datetime

from mammometry.base.rounding import decimals, half_width, rounded_words
from mammometry.measure.volume.measurement import DENSITY_G_PER_CC, DefinedVolume

_MIDDLE_CC = 0.05  # distance from the interval's centre above which the interval was cut off at zero


def term_words(half_cc: float) -> str:
    """Half-width due to one source of error, cc."""
    return "< 0.1" if half_cc < 0.05 else f"{half_cc:.{decimals(half_cc)}f}"


def volume_words(volume_cc: float, interval_cc: tuple[float, float] | None = None) -> str:
    """A volume without interval, rounded according to it, such as "284 cc"."""
    return rounded_words(volume_cc, half_width(interval_cc), "cc", alone=True)


def measured_words(volume_cc: float, interval_cc: tuple[float, float] | None, *, sign: bool = False) -> str:
    """A volume with its interval, such as "284 ± 55 cc (95 %: 230 to 339 cc)".

    The half-width is left out if the interval is cut off at zero.

    Args:
        volume_cc: a volume, or a difference of volumes.
        interval_cc: its 95 % interval.
        sign: whether it is a difference, so that positive numbers have a sign.
    """
    cut_off = interval_cc is not None and abs(volume_cc - sum(interval_cc) / 2) > _MIDDLE_CC
    words = rounded_words(volume_cc, half_width(interval_cc), "cc", sign=sign, alone=cut_off)
    return f"{words} ({span_words(interval_cc, sign=sign)})"


def span_words(interval_cc: tuple[float, float] | None, *, sign: bool = False) -> str:
    """The 95 % interval as text, such as "95 %: 300 to 410 cc". Limits of a difference have signs."""
    if interval_cc is None:
        return "its error is not known"
    half = half_width(interval_cc)
    low, high = (rounded_words(bound, half, sign=sign, alone=True) for bound in interval_cc)
    return f"95 %: {low} to {high} cc"


MEANINGS = {
    "flat chest": "what stands out from the chest",
    "measured wall": "in front of the chest wall, which was measured",
    "named wall": "in front of one fixed surface, to compare visits",
    "muscle": "down to the chest muscle, as removed in a mastectomy",
    "closed solid": "of the whole model",
    "any": "",
}
"""Definition of the breast (docs/decisions/0029) → a few plain words to follow a volume."""
MEANINGS_INTRODUCTION = (
    "The back of a breast cannot be seen. Where it ends is a matter of definition, so one breast has several "
    "volumes. Compare only volumes of the same kind."
)
_EXPLAINED = {
    "flat chest": (
        "The part of the breast that stands out from the chest. Behind it, the chest is assumed to be flat, with the "
        "same layer of fat and skin as around the breast."
    ),
    "measured wall": "Everything in front of the chest wall. The chest wall was measured separately.",
    "named wall": (
        "The part of the breast in front of one fixed surface ({wall}), found in the same way at every visit. Use "
        "this volume to compare visits. The real chest wall may be elsewhere."
    ),
    "muscle": (
        "The breast with the layer of fat behind it, down to the chest muscle. It is weighed after a "
        "mastectomy. This layer cannot be seen. Its thickness was entered, or is the mean of other women."
    ),
}


def meaning_title(meaning: str) -> str:
    """Heading for one definition of the breast, in a few plain words."""
    words = MEANINGS.get(meaning, meaning)
    return words[:1].upper() + words[1:]


def meaning_sentences(meaning: str, wall: str) -> str:
    """Explain one definition of the breast to a patient.

    Args:
        meaning: key of `MEANINGS`.
        wall: name of the surface behind the breast.
    """
    return _EXPLAINED[meaning].format(wall=wall)


def definition_words(defined: DefinedVolume) -> str:
    """Volume with one definition, with its interval in cc and %, and weight."""
    grams, half_g = defined.weight_g
    words = measured_words(defined.volume_cc, defined.interval_cc)
    return f"{words}, weight {rounded_words(grams, half_g, 'g')} at {DENSITY_G_PER_CC} g/cc"


Interval = tuple[float, float]

MORE = "more than the measurement error"
WITHIN = "within the measurement error"
UNKNOWN = "no verdict, because the error of the change is not known"


def date_words(date: datetime.date) -> str:
    """A date within a sentence, such as 3 November 2026."""
    return f"{date.day} {date:%B %Y}"


def verdict_words(beyond_error: bool | None) -> str:
    """Verdict on a change against its measurement error, as text.

    Args:
        beyond_error: whether the 95 % interval of the change excludes zero. None: unknown.
    """
    return UNKNOWN if beyond_error is None else MORE if beyond_error else WITHIN


def change_sentence(
    breast: str, change_cc: float, interval_cc: Interval | None, beyond_error: bool | None, before: datetime.date | None
) -> str:
    """One breast's change of volume and its verdict, in one sentence.

    Args:
        breast: "left" or "right".
        change_cc: later volume minus the earlier one, cc.
        interval_cc: its 95 % interval, cc.
        beyond_error: whether that excludes zero.
        before: the earlier date. None: unknown.
    """
    digits = decimals(half_width(interval_cc))
    than = "before" if before is None else f"on {date_words(before)}"
    if not float(f"{change_cc:.{digits}f}"):
        amount = f"as large as {than}"
    else:
        amount = f"{abs(change_cc):.{digits}f} cc {'larger' if change_cc > 0 else 'smaller'} than {than}"
    span = "" if interval_cc is None else f" (95 %: {_span(interval_cc, digits)})"
    return f"{breast.capitalize()} breast: {amount}{span}: {verdict_words(beyond_error)}."


def _span(interval_cc: Interval, digits: int) -> str:
    """Both limits in the order of the change's direction, or each with its own sign if the signs differ."""
    low, high = interval_cc
    if low < 0.0 < high:
        return f"{-low:.{digits}f} cc smaller to {high:.{digits}f} cc larger"
    near, far = sorted((abs(low), abs(high)))
    return f"{near:.{digits}f} to {far:.{digits}f}"
