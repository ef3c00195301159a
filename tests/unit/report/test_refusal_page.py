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
