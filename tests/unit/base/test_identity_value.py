"""Names that can be shown, identifiers that are taken, and subjects that differ."""

import datetime
import os
from pathlib import Path

import pytest

from mammometry.base.errors import SessionError
from mammometry.base.identity import Identity, one_subject, shown_name, subject_id


@pytest.mark.parametrize(
    ("name", "shown"),
    [
        ("Huber B", "Huber B"),
        ("Müller A", "Müller A"),
        (os.fsdecode(b"M\xfcller"), "M\\xfcller"),
        ("two\nlines", "two\\nlines"),
        ("نیک\u200cپور", "نیک\u200cپور"),
        ("a\u202eb", "a\\u202eb"),
    ],
)
def test_any_folder_has_a_name_that_can_be_written(tmp_path: Path, name: str, shown: str) -> None:
    assert shown_name(tmp_path / name) == shown
    shown.encode("utf-8")


@pytest.mark.parametrize("text", ["P-0421", "Fall 12, links", "Ä", "x" * 64, "Mu\u0308", "山田", "نیک\u200cپور"])
def test_a_pseudonym_is_taken_in_its_composed_form(text: str) -> None:
    assert subject_id(text) == text.replace("u\u0308", "ü")


@pytest.mark.parametrize(
    "text", ["", "x" * 65, "a/b", "a\\b", "two\nlines", "\x00", " P1", "P1 ", "\udcfc", "P\u202e1", "P\u200d1"]
)
def test_what_is_no_identifier_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match=r"\b1 .*\b64\b"):
        subject_id(text)


def test_the_subject_is_the_heading_and_the_folder_stands_below() -> None:
    path, day = Path("/somewhere/Huber B"), datetime.date(2026, 1, 31)
    assert (Identity.of(path).title, Identity.of(path).subtitle) == ("Huber B", "")
    with_patient = Identity.of(path, "P-1", day)
    assert (with_patient.title, with_patient.subtitle) == ("P-1", "Huber B · photographed 2026-01-31")
    assert Identity.of(path, "Huber B").subtitle == ""


def test_those_who_tell_nothing_contradict_nobody() -> None:
    assert one_subject([("a", None), ("b", "P-1"), ("c", None), ("d", "P-1")], remedy="none") == "P-1"
    assert one_subject([("a", None)], remedy="none") is None
    with pytest.raises(SessionError, match=r"^d: .*'P-2', .*'P-1'.*\bb\b"):
        one_subject([("a", None), ("b", "P-1"), ("d", "P-2")], remedy="Do")
