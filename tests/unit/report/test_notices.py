"""The catalogue has words for every notice, and the page of the documentation lists them."""

import ast
import json
import re
from pathlib import Path

import pytest
from tools.codes import PAGE, page

from mammometry.base.notices import Notice, from_table
from mammometry.base.notices.texts import TEXTS
from mammometry.base.notices.words import caution_of, code_of_1_0, words_of

SOURCE = Path(__file__).resolve().parents[3] / "src" / "mammometry"


def made() -> list[tuple[str, set[str]]]:
    """Codes that the program makes, with the names of their values."""
    found = []
    for path in SOURCE.rglob("*.py"):
        if "Notice(" not in (text := path.read_text(encoding="utf-8")):
            continue
        for node in ast.walk(ast.parse(text)):
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "Notice":
                given = {word.arg: word.value for word in node.keywords}
                if isinstance(given["code"], ast.Constant):
                    found.append(given)
    return [
        (each["code"].value, {key.value for key in each["values"].keys})
        for each in found
        if isinstance(each.get("values"), ast.Dict)
    ] + [(each["code"].value, set()) for each in found if "values" not in each]


def test_every_notice_that_is_made_has_words_that_say_its_values() -> None:
    codes = made()
    assert len(codes) > 15
    for code, values in codes:
        fields = set(re.findall(r"\{(\w+)", TEXTS[code].words + TEXTS[code].caution)) - {"of", "on", "about", "side"}
        assert fields == values, code


def test_no_notice_holds_a_sentence_but_those_that_were_stored_so() -> None:
    assert [code for code, text in TEXTS.items() if "{text}" in text.words] == ["sentence"]


@pytest.mark.parametrize("code", ["body-size-rare", "mesh-repaired", "calibration-doubtful"])
def test_a_notice_that_was_stored_with_a_sentence_is_read(code: str) -> None:
    stored = from_table({**Notice(code="sentence").as_table(), "code": code, "values": {"text": "A sentence."}})
    assert (words_of(stored), caution_of(stored)) == ("A sentence.", "")


def test_a_notice_about_one_of_several_scans_names_it() -> None:
    joined = Notice(code="mesh-seams-joined", values={"pieces": 2})
    of_second = Notice(code=joined.code, values={**joined.values, "scan": 2})
    assert words_of(of_second) == f"Scan 2: {words_of(joined)}"


def test_codes_are_in_one_form() -> None:
    assert all(re.fullmatch(r"[a-z]+(-[a-z]+)*", code) for code in TEXTS)


def test_words_name_the_breasts_and_round_the_values() -> None:
    both = Notice(code="boundary-not-confirmed", about=("left", "right"))
    assert "of the patient's left breast and of the patient's right breast" in words_of(both)
    little = Notice(code="pair-little-matched", about=("front",), values={"percent": 41.6})
    assert words_of(little) == "Pair front matched only 42 % of the subject's silhouette."
    assert json.loads(json.dumps(little.as_table()))["values"] == {"percent": 41.6}
    assert TEXTS[little.code].concern == "photographs"


@pytest.mark.parametrize(
    ("sentence", "code"),
    [
        ("Nobody has confirmed the automatic boundary of the patient's left breast.", "boundary-not-confirmed"),
        ("Boundaries are drawn and confirmed with `mammometry edit`.", "boundaries-drawn-with-edit"),
        ("Left and right may be exchanged: the mesh was inside out, as a mirror image is.", "sides-doubtful"),
    ],
)
def test_sentences_that_version_1_0_stored_have_their_code(sentence: str, code: str) -> None:
    assert code_of_1_0(sentence) == code
    assert code_of_1_0("Cameras or body moved.") == "sentence"


def test_the_page_lists_all_codes() -> None:
    assert PAGE.read_text(encoding="utf-8") == page(), "run python -m tools.codes"
