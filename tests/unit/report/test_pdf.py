"""The document: two to four pages that say what the page in the browser says."""

import datetime
import io
from dataclasses import fields, replace
from functools import cache

import numpy as np
import pypdf
import pytest
import synthetic
from synthetic import sentence_notice

from mammometry.base.identity import Identity
from mammometry.base.notices import Notice
from mammometry.base.notices.words import words_of
from mammometry.report import content
from mammometry.report.content import Clinical, ReportContent, Signed
from mammometry.report.documents import pdf
from mammometry.report.figures import stage_results
from mammometry.report.figures.canvas import PanelSheet
from mammometry.report.figures.catalogue import PREVIEWS
from mammometry.report.figures.matching import disparity
from mammometry.report.figures.stage_results import MatchingResult
from mammometry.report.first_page import first_page
from mammometry.report.pictures import all_encoded
from mammometry.report.words import describe
from mammometry.report.words.anthropometry import comparison, difference_number
from mammometry.settings import Settings
from mammometry.study.tables import TextTable

LENGTHS = TextTable(
    title="Lengths",
    columns=("Lengths in mm, ± 95 %", "Left", "Right", "Left minus right"),
    rows=(("Sternal notch to nipple", "212.3 ± 4.1", "208.0 ± 4.0", "+4 ± 6"),),
)
TAKEN = datetime.datetime(2026, 11, 24, 10, 12, tzinfo=datetime.UTC)
CLINICAL = Clinical(
    patient="Moser, Anna",
    born=datetime.date(1971, 12, 2),
    record="MR-4711",
    taken=TAKEN,
    occasion="6 weeks after",
    posture="standing",
    operations=("Implant inserted, left, 2026-10-12, 300 cc", "Mastectomy, left, 2026-04-03"),
    change=("Left breast: 28 cc larger than on 3 November 2026 (95 %: 12 to 44): more than the measurement error.",),
    confirmed=Signed(by="Dr. C. Eye", at=TAKEN.replace(minute=40)),
    conclusions=(
        Signed(by="Dr. B", at=TAKEN.replace(hour=11), text="The volumes are balanced."),
        Signed(by="Dr. A", at=TAKEN.replace(minute=50), text="An earlier conclusion."),
    ),
)


@cache
def page_content(*names: str) -> ReportContent:
    rig = synthetic.rig()
    measured = [synthetic.measurement(name, interval_cc=(400.0, 500.0)) for name in names]
    changed, everything = describe.settings_facts(Settings())
    disparities = synthetic.disparities(rig)
    shares = {"one": 0.9, "two": 0.8}
    matched = MatchingResult.thinned(rig, synthetic.photographs(rig), synthetic.foregrounds(rig), disparities)
    pictures = {
        "measure": stage_results.draw(synthetic.measured(rig, measured, synthetic.ball(3))),
        "match": {"disparity": disparity(matched)},
    }
    return ReportContent(
        identity=Identity(name="Case <7> & co"),
        created="2024-01-01 00:00 UTC",
        subject=describe.SUBJECTS["torso"],
        world="The board in pose 00.",
        warnings=(sentence_notice("Pair one: only 12 % of the subject's silhouette could be matched."),),
        concerns=(Notice(code="cameras-imported"),),
        breasts=tuple(describe.breast_report(each) for each in measured),
        comparison=comparison(measured),
        difference=difference_number(measured),
        meanings=describe.meanings(measured),
        lengths=LENGTHS if len(names) == 2 else None,
        stages=(describe.matching_report({}, synthetic.matching(rig), shares),),
        timings=describe.timings({"calibrate": 1.25, "match": 2.0}),
        changed_settings=changed,
        all_settings=everything,
        versions=describe.versions(),
        pictures=all_encoded(pictures),
    )


def rendered_with(content: ReportContent, clinical: Clinical | None = None) -> bytes:
    return pdf.render(content, first_page(content, {}, clinical, named=True))


@cache
def rendered(*names: str) -> bytes:
    return rendered_with(page_content(*names))


def pages_of(document: bytes) -> list[str]:
    return [" ".join(page.extract_text().split()) for page in pypdf.PdfReader(io.BytesIO(document)).pages]


@pytest.mark.parametrize("names", [(), pytest.param(("model",), marks=pytest.mark.slow), ("left", "right")])
def test_it_says_what_it_must(names: tuple[str, ...]) -> None:
    content_of = page_content(*names)
    reader = pypdf.PdfReader(io.BytesIO(rendered(*names)))
    pages = pages_of(rendered(*names))
    assert 3 <= len(pages) <= 5
    for page in pages:
        assert content.DISCLAIMER in page
    assert "Case <7> & co" in pages[0]
    for breast in content_of.breasts:
        assert breast.number.title in pages[0]
        assert breast.number.value in pages[0]
        assert "95 %: 400 to 500 cc" in pages[0]
    assert pages[0].count("cameras' errors") == bool(names)  # once, though it concerns both
    assert "signature" in pages[0]
    assert ("Boundaries: " in pages[0]) == ("left" in names)  # a cast needs nobody's eye
    rest = " ".join(pages[1:])
    assert words_of(content_of.warnings[0]) not in pages[0]
    assert words_of(content_of.warnings[0]) in rest
    assert all(f"{breast.title}: " in rest for breast in content_of.breasts)
    assert "σ (median), px" in rest
    assert reader.metadata is not None
    assert reader.metadata.title == "Case <7> & co: mammometry"


def test_the_first_page_shows_all_that_a_clinic_knows() -> None:
    first = pages_of(rendered_with(page_content("left", "right"), CLINICAL))[0]
    for words in (
        "Moser, Anna",
        "born 2 December 1971, 54 years old · record MR-4711",
        "24 November 2026, 10:12 · 6 weeks after · standing",
        *CLINICAL.operations,
        *CLINICAL.change,
        *LENGTHS.columns,
        *LENGTHS.rows[0],
        "Boundaries: confirmed by Dr. C. Eye, 24 November 2026, 10:40.",
        "The volumes are balanced. Signed: Dr. B, 24 November 2026, 11:12.",
        "It replaces that of Dr. A, 24 November 2026, 10:50.",
    ):
        assert words in first, words
    assert "An earlier conclusion" not in first
    assert "signature" not in first
    for field in fields(Clinical):  # a new one needs a line above
        assert field.name in {
            "patient", "born", "record", "taken", "occasion", "posture", "operations", "change", "confirmed",
            "conclusions",
        }  # fmt: skip


def test_a_long_conclusion_follows_whole_on_the_second_page() -> None:
    long = replace(CLINICAL, conclusions=(replace(CLINICAL.conclusions[0], text="All is well. " * 150),))
    pages = pages_of(rendered_with(page_content("left", "right"), long))
    assert "Signed: Dr. B" in pages[0]
    assert pages[1].count("All is well.") == 150


def test_a_page_full_of_words_is_still_one_page() -> None:
    many = replace(
        CLINICAL,
        operations=4 * CLINICAL.operations,
        change=2 * CLINICAL.change,
        conclusions=(replace(CLINICAL.conclusions[0], text="All is well. " * 60),),
    )
    pages = pages_of(rendered_with(page_content("left", "right"), many))
    assert "Signed: Dr. B" in pages[0]
    assert "measured values" in pages[1]


@pytest.mark.slow
def test_pictures_shrink_until_the_document_is_short(monkeypatch: pytest.MonkeyPatch) -> None:
    made = page_content("left", "right")
    picture = made.pictures["match"]["disparity"]
    crowded = replace(
        made,
        pictures={
            **made.pictures,
            "match": dict.fromkeys((name for name in PREVIEWS if PREVIEWS[name].on_paper), picture),
        },
        stages=9 * made.stages,
    )
    monkeypatch.setattr(pdf, "_MOST_PAGES", 1)
    short = len(pages_of(rendered_with(crowded)))
    monkeypatch.setattr(pdf, "_PICTURE_HEIGHTS", pdf._PICTURE_HEIGHTS[:1])
    assert len(pages_of(rendered_with(crowded))) >= short


def test_pictures_lie_inside_the_page_and_the_text_is_text() -> None:
    reader = pypdf.PdfReader(io.BytesIO(rendered("left", "right")))
    images = [image for page in reader.pages for image in page.images]
    assert len(reader.pages[0].images) == 3
    # three of the first page, the overview, two of both breasts, which are alike, disparity
    assert len({image.data for image in images}) == 7
    for image in images:
        assert image.image is not None
        assert max(image.image.size) <= 1400
        assert np.ptp(np.asarray(image.image)) > 50
    fonts = {str(font) for page in reader.pages for font in page["/Resources"]["/Font"]}
    assert fonts


@pytest.mark.slow
@pytest.mark.requirement("R-NAME-1")
def test_names_of_every_script_are_read_on_the_first_page() -> None:
    """Patient, who confirmed, who concluded, and what: all that people enter."""
    at = TAKEN.replace(hour=12)
    known = replace(
        CLINICAL,
        patient="山田, 花子",
        confirmed=Signed(by="Д-р Ґанна Їжакевич", at=at),
        conclusions=(Signed(by="د. محمد عبد الله", at=at, text="क्षितिज\nالثديان متماثلان."),),
    )
    first, *rest = pages_of(rendered_with(page_content("left", "right"), known))
    for name in (known.patient, known.confirmed.by, "محمد عبد الله", "الثديان متماثلان", "क्षितिज"):  # type: ignore[union-attr]
        assert name in first
    assert all("山田, 花子" in page for page in rest)  # at the foot of each


def test_the_same_content_gives_the_same_bytes() -> None:
    assert rendered_with(page_content("left", "right")) == rendered("left", "right")


def test_the_views_of_an_open_surface_are_on_paper() -> None:
    """Where a breast was measured, its own pictures are."""
    png = PanelSheet(1, 1, (60, 40)).png("Views", "From the front.")
    assert all_encoded({"surface": {"views": png}})["surface"]["views"].jpeg
    assert not all_encoded({"surface": {"views": png}, "measure": {"sections": png}})["surface"]["views"].jpeg
