"""What text DICOM allows in a field: its value representation (PS3.5, 6.2).

Messages say what is wrong without quoting the text, which may be a patient's name.
"""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Mapping
from typing import Literal, TypeAlias

from mammometry.base.errors import MammometryError, SettingsError

Representation: TypeAlias = Literal["AE", "LO", "PN", "SH", "UI", "UT"]
"""Application's title, long string, person's name, short string, unique identifier, unlimited text."""
_LONGEST: Mapping[Representation, int] = {"AE": 16, "LO": 64, "PN": 64, "SH": 16, "UI": 64}
"""Characters; of a name, in each of its groups."""
_MOST_GROUPS, _MOST_PARTS = 3, 5  # of a name: groups are separated by =, their parts by ^
_UID = re.compile(r"(0|[1-9][0-9]*)(\.(0|[1-9][0-9]*))*", re.ASCII)
_LINES = "\t\n\f\r"  # control characters of a text of several lines
_UNREADABLE = "\ufffd"  # what a reader puts where it cannot read a byte
_ALLOWED: Mapping[Representation, str] = {
    "AE": "1 to 16 letters of ASCII without backslash",
    "LO": "at most 64 letters, no backslash and no control character",
    "PN": "at most 64 letters in each of at most 3 groups (=) of at most 5 parts (^), no backslash and no control "
    "character",
    "SH": "at most 16 letters, no backslash and no control character",
    "UI": "numbers with points between them, at most 64 letters, such as 1.2.840.113619",
    "UT": "text without control characters",
}


def text_fault(text: str, representation: Representation) -> tuple[str, str] | None:
    """Say what is wrong with a text, and what is allowed. None where it is allowed.

    Args:
        text: of one field. Empty text is allowed, but for an application's title.
        representation: of that field.
    """
    found = _fault(text, representation)
    return None if found is None else (found, _ALLOWED[representation])


def require_text(
    text: str,
    representation: Representation,
    field: str,
    *,
    remedy: str = "Correct it",
    refusal: type[MammometryError] = SettingsError,
) -> str:
    """Return a text that DICOM allows in this field.

    Raises:
        MammometryError: `refusal`; DICOM does not allow it.
    """
    if (fault := text_fault(text, representation)) is not None:
        found, allowed = fault
        raise refusal(field, found=found, expected=allowed, remedy=remedy)
    return text


def _fault(text: str, representation: Representation) -> str | None:
    for place, letter in enumerate(text, 1):
        category = unicodedata.category(letter)
        if category == "Cs" or letter == _UNREADABLE:
            return f"a byte at place {place} that is no letter in UTF-8"
        if category in ("Cc", "Zl", "Zp") and not (representation == "UT" and letter in _LINES):
            return f"a control character at place {place}"
        if letter == "\\" and representation != "UT":
            return f"a backslash at place {place}"
    if representation == "AE" and not (text.strip() and text.isascii()):
        return "letters beyond ASCII" if text.strip() else "no title"
    if representation == "UI" and text and not _UID.fullmatch(text):
        return "no unique identifier"
    groups = text.split("=") if representation == "PN" else [text]
    if len(groups) > _MOST_GROUPS:
        return f"{len(groups)} groups"
    if (parts := max(group.count("^") + 1 for group in groups)) > _MOST_PARTS and representation == "PN":
        return f"{parts} parts in a group"
    longest = max(map(len, groups))
    return f"{longest} letters" if longest > _LONGEST.get(representation, longest) else None
