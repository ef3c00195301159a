"""Notices as text, and sentences of version 1.0 as codes."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from types import MappingProxyType
from typing import Any

from mammometry.base.notices.notice import Level, Notice
from mammometry.base.notices.texts import TEXTS, Text

NAMES: Mapping[str, str] = MappingProxyType(
    {"model": "cast", "left": "patient's left breast", "right": "patient's right breast"}
)
"""``model``, ``left`` or ``right`` → its name in a sentence."""


def words_of(notice: Notice) -> str:
    """The notice as text."""
    scan = f"Scan {notice.values['scan']}: " if "scan" in notice.values else ""
    return scan + _filled(_text(notice).words, notice)


def maybe_words(notice: Notice | None) -> str:
    """The notice as text. Empty if there is no notice."""
    return "" if notice is None else words_of(notice)


def concerns(notice: Notice, breast: str) -> bool:
    """Whether a notice concerns a breast: by name, or because it concerns all."""
    return breast in notice.about or not set(notice.about) & NAMES.keys()


def caution_of(notice: Notice) -> str:
    """Text next to the volumes on the first page. Empty if there is none."""
    return _filled(_text(notice).caution, notice)


def _text(notice: Notice) -> Text:
    return TEXTS["sentence"] if "text" in notice.values else TEXTS[notice.code]


def _filled(template: str, notice: Notice) -> str:
    names = [NAMES.get(name, name) for name in notice.about]
    return template.format(
        of=" and of the ".join(names),
        on=" and on the ".join(names),
        about=", ".join(notice.about),
        side=notice.about[0] if notice.about else "",
        **notice.values,
    )


def words_at(level: Level, notices: Iterable[Notice]) -> list[str]:
    """The notices of one level as text."""
    return [words_of(notice) for notice in notices if notice.level == level]


def in_json(notices: Iterable[Notice]) -> dict[str, list[Any]]:
    """Notices for programs, in one order: texts in ``warnings``, codes and values in ``notices``."""
    listed = list(notices)
    return {"warnings": list(map(words_of, listed)), "notices": [notice.as_table() for notice in listed]}


def lines_of(notices: Iterable[Notice]) -> list[str]:
    """Notices as lines for a terminal."""
    return [f"{'Warning' if notice.level == 'warning' else 'note'}: {words_of(notice)}" for notice in notices]


_OF_1_0 = (
    ("Nobody has confirmed the automatic boundary", "boundary-not-confirmed"),
    ("Boundaries are drawn and confirmed with", "boundaries-drawn-with-edit"),
    ("Pose ", "photograph-unfitting"),
    ("Pair ", "pair-moved"),
    ("Something hides part", "subject-hidden"),
    ("The subject was not separated", "subject-not-separated"),
    ("Left and right may be exchanged: the mesh was inside out", "sides-doubtful"),
)
"""Beginnings of sentences that version 1.0 stored → their codes. Such sentences are only read, no longer written."""


def code_of_1_0(sentence: str) -> str:
    """Code of a warning that version 1.0 stored as a sentence."""
    return next((code for begin, code in _OF_1_0 if sentence.startswith(begin)), "sentence")
