"""First page of a report, on the web page and in the PDF: what a surgeon reads in thirty seconds."""

import datetime
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from mammometry.base.letters import isolated
from mammometry.base.notices import Notice
from mammometry.base.notices.words import caution_of, concerns
from mammometry.measure.volume.attribution import Attribution
from mammometry.report.content import BreastReport, Clinical, LargeNumber, ReportContent, ReportPicture, Signed
from mammometry.report.figures.canvas import CYCLE
from mammometry.report.words.volumes import date_words

NOT_CONFIRMED = "not confirmed"
FIRST_PICTURES = ("front", "from_right", "from_left")
_WITHOUT_A_BREAST = "views"  # name of the picture if nothing was measured: views of the surface


@dataclass(frozen=True, slots=True, kw_only=True)
class FirstPage:
    """The first page before layout."""

    title: str
    """The patient's name, or the session's title."""
    who: str
    """Birth date and record number, or the session's other facts."""
    when: str
    """Date, occasion and posture."""
    operations: tuple[str, ...]
    numbers: tuple[LargeNumber, ...]
    """Both volumes and their difference."""
    cautions: tuple[str, ...]
    """Cautions about these numbers, one line each."""
    pictures: tuple[ReportPicture, ...]
    """The front view, then the two oblique ones."""
    change: tuple[str, ...]
    """Change since the previous visit."""
    confirmation: str
    """Confirmation of the boundaries, with name and time. Empty if nothing was measured."""
    is_confirmed: bool
    conclusion: Signed | None
    amended: str
    """Earlier conclusion that the newest one amends. Empty if there is none."""


def first_page(
    content: ReportContent, attributions: Mapping[str, Attribution], clinical: Clinical | None, *, named: bool
) -> FirstPage:
    """Make the first page.

    Args:
        content: content of the report.
        attributions: breast → confirmation of its boundary.
        clinical: a clinic's data; its confirmation then applies to all boundaries.
        named: whether names and dates are included.
    """
    known = clinical or Clinical()
    measured = [breast for breast in content.breasts if breast.absence is None]
    confirmation, is_confirmed = _confirmation(measured, attributions, clinical, named=named)
    conclusions = known.conclusions
    born = None if known.born is None else _birth_words(known.born, known.taken)
    taken = None if known.taken is None else moment_words(known.taken)
    made = content.created and f"measured {content.created}"
    return FirstPage(
        title=known.patient or content.identity.title,
        who=_joined(born, known.record and f"record {known.record}") or content.identity.subtitle,
        when=_joined(taken, known.occasion, known.posture) or made,
        operations=known.operations,
        numbers=(*_volumes(content.breasts), *([content.difference] if content.difference else [])),
        cautions=_cautions(measured, (*content.warnings, *content.concerns)),
        pictures=_pictures(content),
        change=known.change,
        confirmation=confirmation,
        is_confirmed=is_confirmed,
        conclusion=conclusions[0] if conclusions else None,
        amended=f"It replaces that of {signature(conclusions[1])}." if len(conclusions) > 1 else "",
    )


def signature(signed: Signed) -> str:
    """Name and time, such as "Dr. B, 22 November 2026, 10:30"."""
    return _joined(isolated(signed.by), moment_words(signed.at), between=", ")


def moment_words(moment: datetime.datetime) -> str:
    """A time as text, to the minute, such as "22 November 2026, 10:30"."""
    return f"{date_words(moment)}, {moment:%H:%M}"


def _birth_words(born: datetime.date, taken: datetime.datetime | None) -> str:
    if taken is None:
        return f"born {date_words(born)}"
    years = taken.year - born.year - ((taken.month, taken.day) < (born.month, born.day))
    return f"born {date_words(born)}, {years} years old"


def _confirmation(
    measured: Sequence[BreastReport], attributions: Mapping[str, Attribution], clinical: Clinical | None, *, named: bool
) -> tuple[str, bool]:
    """Confirmation of the boundaries, as text, and whether all are confirmed."""
    signed = None if clinical is None else clinical.confirmed
    if signed is not None and measured:
        return f"confirmed by {signature(signed)}", True
    if all(breast.name == "model" for breast in measured):  # a cast's base needs no confirmation
        return "", True
    if clinical is not None:
        return NOT_CONFIRMED, False
    words, is_confirmed = {}, True
    for breast in measured:
        seen = attributions.get(breast.name, Attribution()).confirmation
        holds = seen is not None and seen.curve == breast.curve
        is_confirmed = is_confirmed and holds
        words[breast.number.title] = (
            (f"confirmed by {isolated(seen.by)}, {seen.at[:10]}" if named else "confirmed")
            if seen and holds
            else NOT_CONFIRMED
        )
    if len(set(words.values())) == 1:
        return next(iter(words.values())), is_confirmed
    return "; ".join(f"{title[0].lower()}{title[1:]} {how}" for title, how in words.items()), is_confirmed


def _volumes(breasts: Sequence[BreastReport]) -> list[LargeNumber]:
    """Volumes, in the colours of their boundaries in `figures.measure`."""
    colours = iter(CYCLE)
    return [breast.number if breast.absence else replace(breast.number, colour=next(colours)) for breast in breasts]


def _cautions(measured: Sequence[BreastReport], notices: Sequence[Notice]) -> tuple[str, ...]:
    """Cautions about the volumes. Those that do not concern all breasts name the breast."""
    lines = []
    for notice in notices:
        of = [breast.number.title for breast in measured if concerns(notice, breast.name)]
        if (caution := caution_of(notice)) and of:
            lines.append(caution if len(of) == len(measured) else f"{of[0]}: {caution[0].lower()}{caution[1:]}")
    return tuple(dict.fromkeys(lines))


def _pictures(content: ReportContent) -> tuple[ReportPicture, ...]:
    drawn = content.pictures.get("measure", {})
    pictures = tuple(drawn[name] for name in FIRST_PICTURES if name in drawn)
    surface = content.pictures.get("surface", {})
    return pictures or tuple(surface[name] for name in (_WITHOUT_A_BREAST,) if name in surface)


def _joined(*words: str | None, between: str = " · ") -> str:
    return between.join(filter(None, words))
