"""The page of a refusal names what it is about as one would."""

import pytest

from mammometry.base.errors import MatchingError
from mammometry.base.identity import Identity
from mammometry.report.refusal_page import refusal_page


@pytest.mark.parametrize(
    ("subject", "heading"),
    [("capture/front_left.jpg", "capture/front_left.jpg"), ("session.toml", "session.toml"), ("torso", "Torso")],
)
def test_a_files_name_stays_as_it_is(subject: str, heading: str) -> None:
    error = MatchingError(subject, found="nothing", expected="a subject", remedy="Look at it")
    assert f"<h2>{heading}</h2>" in refusal_page(Identity(name="session"), error, {})


def test_single_cases_come_after_cause_and_remedy() -> None:
    error = MatchingError("torso", found="nothing", expected="a subject", remedy="Look at it")
    error.details = ("pose 03, front_left: blurred", "pose 04, front_left: blurred")
    page = refusal_page(Identity(name="session"), error, {})
    assert page.index("Look at it") < page.index("Pose 03, front_left: blurred.") < page.index("Pose 04")


def test_a_long_sentence_is_not_cut_within_a_word() -> None:
    error = MatchingError("torso", found="onetwothree " * 200, expected="a subject", remedy="Look at it")
    assert set(error.found.split()) == {"onetwothree", "…"}
    assert len(error.found) <= 503
