"""Letters that a name may hold: those that a reader sees, and what shapes them."""

import unicodedata

UNREADABLE = "\ufffd"
"""What a reader puts where it cannot read a byte."""
JOINERS = "\u200c\u200d"
"""Invisible letters that scripts need: zero-width non-joiner and joiner."""
ISOLATE, END = "\u2068", "\u2069"
"""Around letters whose direction concerns no others (FIRST STRONG ISOLATE and its end)."""
_FILLERS = "\u115f\u1160\u3164\uffa0"  # letters of Hangul that show nothing
_VIRAMA = 9  # combining class of marks that join consonants
_FOUND = {
    "Cf": "the format character",
    "Co": "a character for private use,",
    "Cn": "a character that Unicode does not have,",
}


def name_fault(name: str) -> str | None:
    """Say what in a name cannot be seen, or changes how other letters are read. None: nothing.

    Controls of direction turn a name round, and an invisible letter makes two of what looks like one. A joiner is
    allowed where a script needs it: beside a virama, and after an Arabic letter.

    >>> name_fault("Moser\u202e") is None
    False
    >>> name_fault("نیک\u200cپور") is None
    True
    """
    for place, letter in enumerate(name):
        category = "Cf" if letter in _FILLERS else unicodedata.category(letter)
        if category == "Cs" or letter == UNREADABLE:
            return f"a byte at place {place + 1} that is no letter in UTF-8"
        if category in ("Cc", "Zl", "Zp"):
            return f"a control character at place {place + 1}"
        if category in _FOUND and not (letter in JOINERS and _joins(name, place)):
            code = f"U+{ord(letter):04X} {unicodedata.name(letter, '')}".strip()
            return f"{_FOUND[category]} {code} at place {place + 1}"
    return None


def isolated(name: str) -> str:
    """Isolate a name's direction for the middle of a sentence.

    One written from right to left would else turn a date after it.

    >>> isolated("Dr. B")
    'Dr. B'
    """
    turns = any(unicodedata.bidirectional(letter) in ("R", "AL", "AN") for letter in name)
    return f"{ISOLATE}{name}{END}" if turns else name


def _joins(name: str, place: int) -> bool:
    """Whether a script has a joiner at this place of a name."""
    if any(unicodedata.combining(letter) == _VIRAMA for letter in name[max(place - 1, 0) : place + 2]):
        return True
    before = [letter for letter in name[:place] if unicodedata.category(letter) != "Mn"]
    return bool(before) and unicodedata.bidirectional(before[-1]) == "AL"
