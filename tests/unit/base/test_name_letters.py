"""Letters that a name may hold."""

import unicodedata

import pytest

from mammometry.base.letters import name_fault

ALLOWED = [
    "Moser-O'Neil", "Größe", "山田 花子", "山田\u3000花子", "渡邉\U000e0100", "محمد", "فاطمه نیک\u200cپور", "क्\u200dष",
    "क्\u200cष", "শ্রী", "র\u200d্যাব", "ශ්\u200dරී", "Zoe\u0308", "김민지", "١٢", "Їжакевич", "שָׁלוֹם",
]  # fmt: skip
REFUSED = {
    letter: category
    for category, letters in {
        "Cf": "\u202e\u202a\u2066\u200b\u200e\ufeff\u00ad\u2060\u200c\u200d\U000e0041",
        "Cc": "\x00\x1b\x85\n",
        "Zl": "\u2028",
        "Co": "\ue000\U000f0000",
        "Cn": "\u0378\U0010ffff",
        "Cs": "\udcfc",
        "Lo": "\u3164",
    }.items()
    for letter in letters
}


@pytest.mark.requirement("R-NAME-2")
@pytest.mark.parametrize("name", ALLOWED)
def test_names_of_every_script_are_taken(name: str) -> None:
    assert name_fault(name) is None


@pytest.mark.requirement("R-NAME-2")
@pytest.mark.parametrize("letter", REFUSED, ids=ascii)
@pytest.mark.parametrize("name", ["Mo{}ser", "{}Moser", "Moser{}", "山{}田"])
def test_what_is_not_seen_or_turns_a_name_round_is_refused(letter: str, name: str) -> None:
    assert unicodedata.category(letter) == REFUSED[letter]
    fault = name_fault(name.format(letter))
    assert fault is not None
    assert f" {name.index('{') + 1}" in fault


def test_the_character_is_named() -> None:
    assert name_fault("ab\u202ec") == "the format character U+202E RIGHT-TO-LEFT OVERRIDE at position 3"


def test_every_control_and_format_character_is_refused_between_latin_letters() -> None:
    unseen = [chr(code) for code in range(0x110000) if unicodedata.category(chr(code)) in ("Cc", "Cf", "Zl", "Zp")]
    assert len(unseen) > 200
    assert all(name_fault(f"a{letter}b") is not None for letter in unseen)
