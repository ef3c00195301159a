"""Normalise names, numbers and days for the search."""

import datetime
import re
import unicodedata
from collections.abc import Iterable
from dataclasses import dataclass

_PLAIN = str.maketrans({"ø": "o", "ł": "l", "đ": "d", "ð": "d", "þ": "th", "æ": "ae", "œ": "oe", "ı": "i", "ħ": "h"})
"""Letters that Unicode does not decompose into a letter and its accent."""
_SPELT_OUT = str.maketrans({"ä": "ae", "ö": "oe", "ü": "ue", "å": "aa", "ø": "oe"})
_MONTHS = {
    name: number
    for number, names in enumerate(
        (
            *("jan january januar", "feb february februar", "mar march marz maerz", "apr april", "may mai"),
            *("jun june juni", "jul july juli", "aug august", "sep sept september", "oct october okt oktober"),
            *("nov november", "dec december dez dezember"),
        ),
        start=1,
    )
    for name in names.split()
}
_DATES = tuple(
    re.compile(rf"(?<![\w-])(?:{form})(?![\w-])")
    for form in (
        r"(?P<year>\d{4})[-./](?P<month>\d{1,2})[-./](?P<day>\d{1,2})",
        r"(?P<day>\d{1,2})[-./] ?(?P<month>\d{1,2})[-./] ?(?P<year>\d{4}|\d{2})",
        r"(?P<day>\d{1,2})(?:st|nd|rd|th)?\.?\s*(?P<month>[^\W\d]{3,9})\.?,?\s+(?P<year>\d{4}|\d{2})",
        r"(?P<month>[^\W\d]{3,9})\.?\s+(?P<day>\d{1,2})(?:st|nd|rd|th)?,?\s+(?P<year>\d{4})",
        r"(?P<year>(?:19|20)\d{2})(?P<month>\d{2})(?P<day>\d{2})",
        r"(?P<day>\d{2})(?P<month>\d{2})(?P<year>(?:19|20)\d{2})",
    )
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Query:
    """A search, separated into words and days."""

    days: tuple[tuple[frozenset[datetime.date], str], ...]
    """Days with all their meanings (a year of two digits has two), and their digits as they may occur in a number."""
    words: tuple[str, ...]


def plain(text: str) -> str:
    """Only the letters and digits, without case and accents."""
    return "".join(filter(str.isalnum, _without_accents(text)))


def plain_name(name: str) -> str:
    """A name in which umlauts and their spellings are the same: Müller, Mueller."""
    return re.sub("(?<=[aou])e", "", plain(name.casefold().translate(_SPELT_OUT)))


def words_of(texts: Iterable[str]) -> str:
    """All search words of a record, separated by spaces.

    Args:
        texts: names and numbers.
    """
    words: dict[str, None] = {}
    for text in texts:
        for spelling in (text, unicodedata.normalize("NFC", text).casefold().translate(_SPELT_OUT)):
            parts = re.split(r"[^\w]+", spelling)
            words |= dict.fromkeys(filter(None, (plain(spelling), *map(plain, parts))))
    return " ".join(words)


def read_query(text: str) -> Query:
    """Separate the days and words of a search."""
    days: list[tuple[frozenset[datetime.date], str]] = []
    for form in _DATES:
        for match in form.finditer(text):
            if meanings := _meanings(match["day"], match["month"], match["year"]):
                days.append((meanings, plain(match[0])))
                text = text.replace(match[0], " ")
    words = (plain(word) for word in re.split(r"[\s,;]+", text))
    return Query(days=tuple(days), words=tuple(filter(None, words)))


def _meanings(day: str, month: str, year: str) -> frozenset[datetime.date]:
    number = int(month) if month.isdecimal() else _MONTHS.get(plain(month), 0)
    years = [int(year)] if len(year) == 4 else [1900 + int(year), 2000 + int(year)]
    days = set()
    for full_year in years:
        for month_number, other in ((number, int(day)), (int(day), number)):  # in 05/14/1979 the month comes first
            try:
                days.add(datetime.date(full_year, month_number, other))
                break
            except ValueError:
                continue
    return frozenset(days)


def _without_accents(text: str) -> str:
    folded = unicodedata.normalize("NFKD", text).casefold().translate(_PLAIN)
    return "".join(letter for letter in unicodedata.normalize("NFKD", folded) if not unicodedata.combining(letter))
