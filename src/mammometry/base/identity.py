"""Subject, folder and date of a session: the only source of names on pages."""

from __future__ import annotations

import datetime
import unicodedata
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from mammometry.base.errors import SessionError
from mammometry.base.letters import JOINERS, name_fault

LONGEST_ID = 64
"""Most characters of a subject's identifier."""
_WITHOUT_JOINERS = dict.fromkeys(map(ord, JOINERS))


@dataclass(frozen=True, slots=True, kw_only=True)
class Identity:
    """Subject, name and date that a page shows."""

    name: str
    """Printable name of the session folder or of the mesh file."""
    subject: str | None = None
    """Identifier of the subject, a pseudonym. None if not given."""
    date: str = ""
    """Date of the photographs, ISO 8601. Empty if not given."""

    @classmethod
    def of(cls, path: Path, subject: str | None = None, taken: datetime.date | None = None) -> Identity:
        """Identity of a session folder or a mesh file."""
        return cls(name=shown_name(path), subject=subject, date="" if taken is None else taken.isoformat())

    @property
    def title(self) -> str:
        """Heading of a page: the subject if known, otherwise the folder."""
        return self.subject or self.name

    @property
    def subtitle(self) -> str:
        """Line below the heading: folder and date. The folder is left out if it is the heading."""
        folder = "" if self.subject in (None, self.name) else self.name
        return " · ".join(filter(None, (folder, self.date and f"photographed {self.date}")))


NAMELESS = Identity(name="De-identified case")
"""Identity on a de-identified page."""


def shown_name(path: Path) -> str:
    r"""Name of a file or folder as printable text. Bytes that are not UTF-8 appear as ``\xfc``."""
    return "".join(
        character
        if character.isprintable() or character in JOINERS
        else character.encode("unicode_escape").decode("ascii")
        for character in as_utf_8(path.resolve().name)
    )


def as_utf_8(name: str) -> str:
    r"""Name of a file or folder that can be written as UTF-8. Bytes that are not UTF-8 become ``\xfc``."""
    return name.encode("utf-8", "surrogateescape").decode("utf-8", "backslashreplace")


def folded(name: str) -> str:
    """Normalise a name for comparison: without case, spaces and the encoding of accented letters.

    >>> folded("Ju\u0308rg ") == folded("jürg")
    True
    """
    return " ".join(unicodedata.normalize("NFC", unicodedata.normalize("NFC", name).casefold()).split())


def subject_id(text: str) -> str:
    """Check a subject's identifier and return it in Unicode's composed form (NFC).

    Raises:
        ValueError: names what is allowed.
    """
    composed = unicodedata.normalize("NFC", text)
    if (
        not 0 < len(composed) <= LONGEST_ID
        or name_fault(composed) is not None
        or not composed.translate(_WITHOUT_JOINERS).isprintable()
        or composed != composed.strip()
        or set(composed) & set("/\\")
    ):
        raise ValueError(
            f"1 to {LONGEST_ID} printable characters without / and \\, no space at either end; preferably a pseudonym"
        )
    return composed


def one_subject(named: Iterable[tuple[str, str | None]], *, remedy: str) -> str | None:
    """Return the identifier that all sources agree on. None if no source gives one.

    Args:
        named: file or option, and the identifier that it gives, or None.
        remedy: what to do if two differ.

    Raises:
        SessionError: two of them differ.
    """
    first: tuple[str, str] | None = None
    for source, subject in named:
        if subject is None:
            continue
        first = first or (source, subject)
        if subject != first[1]:
            raise SessionError(
                source,
                found=f"subject {subject!r}",
                expected=f"{first[1]!r}, as in {first[0]}: one subject only",
                remedy=remedy,
            )
    return None if first is None else first[1]
