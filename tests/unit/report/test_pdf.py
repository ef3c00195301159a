"""The document: two to four pages that say what the page in the browser says."""

import io
from dataclasses import replace
from functools import cache

import numpy as np
import pypdf
import pytest
import synthetic

from mammometry.base.identity import Identity
from mammometry.report import content, describe, pdf
from mammometry.report.anthropometry import comparison
from mammometry.report.content import ReportContent
from mammometry.report.figures import previews
from mammometry.report.figures.catalogue import PREVIEWS
from mammometry.report.figures.matching import disparity
from mammometry.report.figures.stage_results import MatchingResult
from mammometry.report.pictures import all_encoded
from mammometry.settings import Settings


@cache
def page_content(*names: str) -> ReportContent:
    rig = synthetic.rig()
    measured = [synthetic.measurement(name, interval_cc=(400.0, 500.0)) for name in names]
    changed, everything = describe.settings_facts(Settings())
    disparities = synthetic.disparities(rig)
    shares = {"one": 0.9, "two": 0.8}
    matched = MatchingResult.thinned(rig, synthetic.photographs(rig), synthetic.foregrounds(rig), disparities)
    pictures = {
        "measure": previews.draw(synthetic.measured(rig, measured, synthetic.ball(3))),
        "match": {"disparity": disparity(matched)},
    }
    return ReportContent(
        identity=Identity(name="Case <7> & co"),
        created="2024-01-01 00:00 UTC",
        subject=describe.SUBJECTS["torso"],
        world="The board in pose 00.",
        warnings=("Pair one: only 12 % of the subject's silhouette could be matched.",),
        breasts=tuple(describe.breast_report(each, cautions=("Cameras moved.",)) for each in measured),
        comparison=comparison(measured),
        stages=(describe.matching_report({}, synthetic.matching(rig), shares),),
        timings=describe.timings({"calibrate": 1.25, "match": 2.0}),
        changed_settings=changed,
        all_settings=everything,
        versions=describe.versions(),
        pictures=all_encoded(pictures),
    )


@cache
def rendered(*names: str) -> bytes:
    return pdf.render(page_content(*names))


@pytest.mark.parametrize("names", [(), pytest.param(("model",), marks=pytest.mark.slow), ("left", "right")])
def test_it_says_what_it_must_on_two_to_four_pages(names: tuple[str, ...]) -> None:
    said = page_content(*names)
    reader = pypdf.PdfReader(io.BytesIO(rendered(*names)))
    assert 2 <= len(reader.pages) <= 4
    pages = [" ".join(page.extract_text().split()) for page in reader.pages]
    for page in pages:
        assert content.DISCLAIMER in page
    assert "Case <7> & co" in pages[0]
    assert said.warnings[0] in pages[0]
    for breast in said.breasts:
        assert breast.title in pages[0]
        assert breast.volume in pages[0]
        assert breast.interval in pages[0]
    assert pages[0].count("Cameras moved.") == len(names)
    assert all(breast.wall_label in pages[0] + pages[1] for breast in said.breasts)
    assert "For the technician" in " ".join(pages[1:])
    assert "σ (median), px" in " ".join(pages[1:])
    assert reader.metadata is not None
    assert reader.metadata.title == "Case <7> & co: mammometry"


@pytest.mark.slow
def test_pictures_shrink_until_four_pages_hold_all(monkeypatch: pytest.MonkeyPatch) -> None:
    said = page_content("left", "right")
    pictures = {
        **said.pictures,
        "match": dict.fromkeys(
            (name for name in PREVIEWS if PREVIEWS[name].on_paper), said.pictures["match"]["disparity"]
        ),
    }
    crowded = replace(said, pictures=pictures, stages=9 * said.stages)
    assert len(pypdf.PdfReader(io.BytesIO(pdf.render(crowded))).pages) == 4
    monkeypatch.setattr(pdf, "_PICTURE_HEIGHTS", pdf._PICTURE_HEIGHTS[:1])
    assert len(pypdf.PdfReader(io.BytesIO(pdf.render(crowded))).pages) == 5


def test_pictures_lie_inside_the_page_and_the_text_is_text() -> None:
    reader = pypdf.PdfReader(io.BytesIO(rendered("left", "right")))
    images = [image for page in reader.pages for image in page.images]
    assert len({image.data for image in images}) == 4  # overview, two of both breasts, which are alike, disparity
    for image in images:
        assert image.image is not None
        assert max(image.image.size) <= 1400
        assert np.ptp(np.asarray(image.image)) > 50
    fonts = {str(font) for page in reader.pages for font in page["/Resources"]["/Font"]}
    assert fonts


@pytest.mark.slow
def test_the_same_content_gives_the_same_bytes() -> None:
    assert pdf.render(page_content("model")) == rendered("model")
