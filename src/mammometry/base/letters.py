"""Characters that a name may contain: visible ones and those that scripts need."""

import unicodedata

UNREADABLE = "\ufffd"
"""Shown by programs in place of bytes that they cannot decode."""
JOINERS = "\u200c\u200d"
"""Invisible characters that scripts need: zero-width non-joiner and joiner."""
ISOLATE, END = "\u2068", "\u2069"
"""FIRST STRONG ISOLATE and its end: text between them does not affect the direction of the text around it."""
_FILLERS = "\u115f\u1160\u3164\uffa0"  # invisible Hangul letters
_VIRAMA = 9  # combining class of marks that join consonants
_FOUND = {
    "Cf": "the format character",
    "Co": "a character for private use,",
    "Cn": "an unassigned character",
}


def name_fault(name: str) -> str | None:
    """Describe the first character that is invisible or changes the text's direction. None without one.

    Direction controls can reverse the text, and with invisible letters two names can look the same. Joiners are allowed
    where a script needs them: next to a virama, and after an Arabic letter.

    >>> name_fault("Moser\u202e") is None
    False
    >>> name_fault("نیک\u200cپور") is None
    True
    """
    for place, letter in enumerate(name):
        category = "Cf" if letter in _FILLERS else unicodedata.category(letter)
        if category == "Cs" or letter == UNREADABLE:
            return f"a byte at position {place + 1} that is not valid UTF-8"
        if category in ("Cc", "Zl", "Zp"):
            return f"a control character at position {place + 1}"
        if category in _FOUND and not (letter in JOINERS and _joins(name, place)):
            code = f"U+{ord(letter):04X} {unicodedata.name(letter, '')}".strip()
            return f"{_FOUND[category]} {code} at position {place + 1}"
    return None


def isolated(name: str) -> str:
    """Isolate the direction of a name inside a sentence.

    Otherwise a right-to-left name would reverse a date after it.

    >>> isolated("Dr. B")
    'Dr. B'
    """
    turns = any(unicodedata.bidirectional(letter) in ("R", "AL", "AN") for letter in name)
    return f"{ISOLATE}{name}{END}" if turns else name


def _joins(name: str, place: int) -> bool:
    """Whether a script needs a joiner at this position in a name."""
    if any(unicodedata.combining(letter) == _VIRAMA for letter in name[max(place - 1, 0) : place + 2]):
        return True
    before = [letter for letter in name[:place] if unicodedata.category(letter) != "Mn"]
    return bool(before) and unicodedata.bidirectional(before[-1]) == "AL"
