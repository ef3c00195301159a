"""What a report for others gives away: no face, no name, no date, no photograph."""

import base64
import io
import re

import numpy as np
import pytest
import synthetic
from PIL import Image

from mammometry.base.identity import NAMELESS
from mammometry.report import content
from mammometry.report.documents import html, pages, pdf
from mammometry.report.figures.catalogue import PREVIEWS
from mammometry.report.first_page import first_page
from mammometry.report.privacy import Privacy, guard, without_photographs
from mammometry.report.words import describe
from mammometry.settings import Settings

UP = np.array([0.0, -1.0, 0.0])
NOTCH = {"sternal_notch": np.array([[0.0, -30.0, 0.0]])}
GREY = 176


def colourful() -> synthetic.TexturedMesh:
    return synthetic.textured(synthetic.ball(4))


@pytest.mark.parametrize("kind", ["torso", "model"])
def test_nothing_is_left_out_unless_asked_for(kind: str) -> None:
    textured = colourful()
    guarded = guard(textured, Privacy(), subject_kind=kind, up_world=UP, landmarks={})
    assert guarded.textured is textured
    assert "photographs of the subject" in guarded.contains


def test_colours_end_at_the_sternal_notch() -> None:
    textured = colourful()
    guarded = guard(textured, Privacy(deidentify=True), subject_kind="torso", up_world=UP, landmarks=NOTCH)
    grey = (guarded.textured.colours == GREY).all(axis=1)
    assert np.array_equal(grey, textured.mesh.vertices[:, 1] < -30.0)  # the world's y runs down
    assert 0 < grey.mean() < 0.5
    assert np.array_equal(guarded.textured.colours[~grey], textured.colours[~grey])


@pytest.mark.parametrize(
    ("privacy", "kind", "marks"),
    [
        (Privacy(deidentify=True), "torso", {}),  # nobody said where the face begins
        (Privacy(geometry_only=True), "model", {}),
        (Privacy(deidentify=True, geometry_only=True), "torso", NOTCH),
    ],
)
def test_no_colour_is_left(privacy: Privacy, kind: str, marks: dict[str, np.ndarray]) -> None:
    guarded = guard(colourful(), privacy, subject_kind=kind, up_world=UP, landmarks=marks)
    assert (guarded.textured.colours == GREY).all()
    assert "no photograph" in guarded.contains


def test_a_cast_keeps_its_colours() -> None:
    guarded = guard(colourful(), Privacy(deidentify=True), subject_kind="model", up_world=UP, landmarks={})
    assert not (guarded.textured.colours == GREY).any()


def test_pictures_that_show_photographs_are_left_out_and_unknown_ones_with_them() -> None:
    assert {name for name, each in PREVIEWS.items() if each.photographs} == {"detections", "foreground", "rectified"}
    made = {
        "match": {"foreground": b"", "rectified": b"", "disparity": b"", "renamed": b""},
        "calibrate": {"detections": b""},
    }
    assert without_photographs(made) == {"match": {"disparity": b""}, "calibrate": {}}
    assert without_photographs({"measure": {"closed-left": b""}}) == {"measure": {"closed-left": b""}}


def test_embedded_pictures_carry_no_exif() -> None:
    exif = Image.Exif()
    exif[0x010E] = "Jane Doe"
    noise = np.random.default_rng(1).integers(0, 255, (300, 400, 3), dtype=np.uint8)
    buffer = io.BytesIO()
    Image.fromarray(noise).save(buffer, format="PNG", exif=exif)
    assert b"Jane Doe" in buffer.getvalue()
    source = pages.embed(buffer.getvalue()).source
    assert b"Jane Doe" not in base64.b64decode(source.partition(",")[2])


def test_neither_page_nor_paper_tells_name_or_date() -> None:
    measured = [synthetic.measurement("model")]
    changed, everything = describe.settings_facts(Settings())
    said = content.ReportContent(
        identity=NAMELESS,
        created="",
        subject=describe.SUBJECTS["model"],
        world="The board in pose 00.",
        warnings=(),
        breasts=tuple(describe.breast_report(each) for each in measured),
        comparison=(),
        stages=(),
        timings=(),
        changed_settings=changed,
        all_settings=everything,
        versions=describe.versions(),
        contains="no name",
    )
    first = first_page(said, {}, None, named=False)
    page = html.render(said, first)
    assert "This page contains no name." in page
    dates = r"\b(19|20)\d\d-\d\d-\d\d\b"
    assert not re.search(dates, page)
    document = pdf.render(said, first)
    year = re.findall(rb"/CreationDate \(D:(\d{4})", document)
    assert year == [b"2000"]  # a constant, not the moment
