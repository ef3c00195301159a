"""The page: whole, self-contained, escaped, small, and replaced atomically."""

import base64
import io
import re
from dataclasses import replace
from html.parser import HTMLParser

import numpy as np
import pytest
import synthetic
from PIL import Image
from synthetic import sentence_notice

from mammometry.base.identity import Identity
from mammometry.base.notices import Notice
from mammometry.report import content
from mammometry.report.content import ReportContent
from mammometry.report.documents import html, pages
from mammometry.report.figures import stage_results
from mammometry.report.figures.canvas import Caption, encode
from mammometry.report.first_page import FirstPage, first_page
from mammometry.report.pictures import all_encoded
from mammometry.report.words import describe
from mammometry.report.words.anthropometry import comparison
from mammometry.settings import Settings

VOID = {"meta", "img", "link", "br", "hr", "input"}


class Page(HTMLParser):
    """Checks nesting and gathers addresses."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.addresses: list[str] = []
        self.images: list[dict[str, str]] = []
        self.words: list[str] = []
        self.tags: set[str] = set()
        self.feed(text)
        assert self.open == []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.add(tag)
        if tag not in VOID:
            self.open.append(tag)
        self.addresses += [value for name, value in attrs if name in ("src", "href", "action", "srcset") and value]
        if tag == "img":
            self.images.append({name: value or "" for name, value in attrs})

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.words.append(data)


@pytest.fixture(scope="module")
def page_content() -> ReportContent:
    rig = synthetic.rig()
    measured = [synthetic.measurement("left"), synthetic.measurement("right", interval_cc=(400.0, 500.0))]
    changed, everything = describe.settings_facts(Settings())
    pictures = {"measure": stage_results.draw(synthetic.measured(rig, measured[:1], synthetic.ball(3)))}
    return ReportContent(
        identity=Identity(name="<b>Case</b> & co"),
        created="2024-01-01 00:00 UTC",
        subject=describe.SUBJECTS["torso"],
        world="The board in pose 00.",
        warnings=(sentence_notice("Pair one: <script>alert(1)</script>"),),
        concerns=(Notice(code="cameras-imported"),),
        breasts=tuple(describe.breast_report(each) for each in measured),
        comparison=comparison(measured),
        stages=(describe.matching_report({}, synthetic.matching(rig), {"one": 0.9, "two": 0.8}),),
        timings=describe.timings({"calibrate": 1.25, "match": 2.0}),
        changed_settings=changed,
        all_settings=everything,
        versions=describe.versions(),
        pictures=all_encoded(pictures),
    )


def first(content: ReportContent) -> FirstPage:
    return first_page(content, {}, None, named=True)


def test_the_page_says_what_it_must(page_content: ReportContent) -> None:
    page = Page(html.render(page_content, first(page_content)))
    words = " ".join(" ".join(page.words).split())
    assert content.DISCLAIMER in words
    for wanted in ("<b>Case</b> & co", "Left breast", "its error is not known", "95 %: 400 to 500 cc"):
        assert wanted in words
    order = (
        "<b>Case</b> & co",
        "95 %: 400 to 500 cc",
        "The interval does not cover the cameras' errors.",
        "Boundaries: not confirmed.",
        "Pair one: <script>",
        "Left breast: measured values",
        "For the technician",
    )
    places = [words.index(part) for part in order]
    assert places == sorted(places)
    assert "The board in pose 00." in words
    assert "3.2 s" in words or "3.3 s" in words
    assert "mammometry" in words


@pytest.mark.parametrize(
    ("said", "shown"),
    [
        ("657 ± 136 cc (95 %: 521 to 793 cc)", "657_±_136_cc (95_%: 521 to 793_cc)"),
        ("3.2 ± 0.1 mm wide", "3.2_±_0.1_mm wide"),
        ("6 897 used, < 0.1 mmm", "6_897 used, <_0.1 mmm"),
        ("pose 03 seen by 8 cameras", "pose 03 seen by 8 cameras"),
    ],
)
def test_no_line_ends_within_a_quantity(said: str, shown: str) -> None:
    assert pages.tied(said) == shown.replace("_", "\u00a0")


def test_a_command_is_set_as_code_and_nothing_else_is_markup(page_content: ReportContent) -> None:
    page = html.render(
        replace(
            page_content,
            warnings=(sentence_notice("Left < right: save it with `mammometry edit`, then measure."),),
        ),
        first(page_content),
    )
    assert "Left &lt; right: save it with <code>mammometry edit</code>, then measure." in page


@pytest.mark.requirement("R-SENT-6")
def test_nothing_is_loaded_from_elsewhere_and_nothing_runs(page_content: ReportContent) -> None:
    text = html.render(page_content, first(page_content))
    page = Page(text)
    assert all(address.startswith("data:image/") for address in page.addresses)
    assert "script" not in page.tags
    assert "http" not in text.split("</style>")[0]
    assert "@import" not in text
    assert "url(" not in text


def test_pictures_have_sizes_and_words_for_those_who_do_not_see_them(page_content: ReportContent) -> None:
    images = Page(html.render(page_content, first(page_content))).images
    assert len(images) == 6  # three of the first page, the overview, two of the left breast
    for image in images:
        assert int(image["width"]) > 100
        assert len(image["alt"]) > 20


def pixels_of(shown: pages.EmbeddedPicture) -> np.ndarray:
    kind, data = shown.source.split(";base64,")
    assert kind == "data:image/webp"
    return np.asarray(Image.open(io.BytesIO(base64.b64decode(data))).convert("RGB")).astype(int)


def test_a_drawing_loses_nothing_and_a_photograph_little() -> None:
    drawing = np.full((300, 400, 3), 255, dtype=np.uint8)
    drawing[100:110, 50:350] = (0, 114, 178)
    shown = pages.embed(encode(drawing, Caption(title="a", text="b")))
    assert (shown.width, shown.height, shown.title, shown.text) == (400, 300, "a", "b")
    np.testing.assert_array_equal(pixels_of(shown), drawing)
    rough = np.random.default_rng(0).integers(0, 255, (30, 40, 3), dtype=np.uint8)
    photograph = np.asarray(Image.fromarray(rough).resize((400, 300), Image.Resampling.BICUBIC))
    png = encode(photograph, Caption(title="a", text="b"))
    shown = pages.embed(png)
    assert len(shown.source) < 0.5 * len(png)
    assert np.abs(pixels_of(shown) - photograph).mean() < 4


def test_the_page_is_small(page_content: ReportContent) -> None:
    assert len(html.render(page_content, first(page_content))) < 8e6


@pytest.mark.parametrize("named", [("calibration/03/front_left",), ("capture/front", "capture/front_left"), ()])
def test_a_warning_links_its_photographs(page_content: ReportContent, named: tuple[str, ...]) -> None:
    places = ("capture", "calibration/03", "calibration/3", "calibration/03b")
    photographs = {
        f"{place}/{camera}": f"../../{place}/{camera}.jpg" for place in places for camera in ("front", "front_left")
    }
    notice = Notice(code="subject-hidden", about=("side",), photographs=(*named, "capture/side"), values={"shares": ""})
    shown = replace(page_content, warnings=(notice,))
    links = re.findall(r'<a href="\.\./\.\./([^"]+)\.jpg">([^<]+)</a>', html.render(shown, first(shown), photographs))
    assert sorted(links) == sorted((name, name) for name in named)
    assert "../../" not in html.render(shown, first(shown))
