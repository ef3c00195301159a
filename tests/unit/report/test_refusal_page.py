"""The page of a refusal names what it is about as one would."""

import io

import numpy as np
import pytest
from PIL import Image

from mammometry.base.errors import MatchingError
from mammometry.base.identity import Identity
from mammometry.base.photograph import Photograph
from mammometry.report.documents.pages import refusal_page
from mammometry.report.figures.refused import photographs_seen


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


def test_the_outlines_that_were_found_are_drawn_on_the_photographs() -> None:
    shot = Photograph(name="capture/a.jpg", pixels=np.full((120, 160, 3), 90, dtype=np.uint8))
    v, u = np.mgrid[:60, :80]
    disc = np.hypot(u - 40, v - 30) < 20

    def orange(png: bytes) -> int:
        pixels = np.asarray(Image.open(io.BytesIO(png)).convert("RGB")).astype(int)
        return int(np.count_nonzero(pixels[..., 0] - pixels[..., 2] > 80))

    shots = {"a": shot, "b": shot}
    assert orange(photographs_seen(shots)) == 0
    assert orange(photographs_seen(shots, {})) == 0
    assert (
        orange(photographs_seen(shots, {"a": disc, "b": disc})) > 1.5 * orange(photographs_seen(shots, {"a": disc})) > 0
    )
