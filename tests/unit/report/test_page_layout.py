"""The page as a reader sees it, in a real browser: no words lie on others, nothing runs off to the side."""

import shutil
from collections.abc import Iterator
from dataclasses import replace

import pytest
import synthetic
from playwright.sync_api import Browser, Page, sync_playwright
from tests.patience import patient

from mammometry.base.identity import Identity
from mammometry.calibration.judge.quality import assess
from mammometry.report import content
from mammometry.report.documents import html
from mammometry.report.figures import stage_results
from mammometry.report.figures.shading import front_frame
from mammometry.report.figures.thinning import thinned_ranges
from mammometry.report.first_page import first_page
from mammometry.report.models import viewer_scene
from mammometry.report.pictures import all_encoded
from mammometry.report.scene import to_json
from mammometry.report.warnings import RunResults, warnings
from mammometry.report.words import describe
from mammometry.report.words.anthropometry import comparison
from mammometry.settings import Settings

CHROMIUM = shutil.which("chromium")
FLAGS = [
    "--no-sandbox",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--no-first-run",
]
pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="no chromium on this machine: apt-get install chromium")

OVERLAPS = """() => {
  const shown = [];
  const walker = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  for (let node; (node = walker.nextNode()); ) {
    const owner = node.parentElement, words = node.textContent.trim();
    if (!words || owner.closest("script, style, noscript, select") || !owner.checkVisibility()) continue;
    const range = document.createRange();
    range.selectNodeContents(node);
    for (const line of range.getClientRects()) {
      let [left, top, right, bottom] = [line.left, line.top, line.right, line.bottom];
      for (let around = owner; around !== document.body; around = around.parentElement)
        if (getComputedStyle(around).overflowX !== "visible") {
          const box = around.getBoundingClientRect();
          left = Math.max(left, box.left); top = Math.max(top, box.top);
          right = Math.min(right, box.right); bottom = Math.min(bottom, box.bottom);
        }
      if (right > left && bottom > top) shown.push({ node, words, left, top, right, bottom });
    }
  }
  const found = [];
  shown.forEach((one, i) => shown.slice(i + 1).forEach((other) => {
    const across = Math.min(one.right, other.right) - Math.max(one.left, other.left);
    const down = Math.min(one.bottom, other.bottom) - Math.max(one.top, other.top);
    const least = Math.min(one.bottom - one.top, other.bottom - other.top);
    if (one.node !== other.node && across > 2 && down > 0.3 * least)
      found.push(`${one.words.slice(0, 60)} | ${other.words.slice(0, 60)}`);
  }));
  if (!shown.length) throw new Error("no words on the page");
  return found;
}"""
"""Pairs of texts whose lines lie on one another; boxes of lines are a little higher than what is drawn in them."""

BEYOND = """() => [...document.querySelectorAll("body *")]
  .filter((one) => one.checkVisibility() && one.getBoundingClientRect().right > innerWidth + 1)
  .filter((one) => !one.parentElement.closest(".scroll, .pan, .mm-canvas"))
  .map((one) => `${one.tagName} ${one.className} ${one.textContent.trim().slice(0, 60)}`)"""
"""What reaches beyond the window's right edge, but in boxes that scroll by themselves."""


@pytest.fixture(scope="module")
def address(tmp_path_factory: pytest.TempPathFactory) -> str:
    """A torso's report with everything in it, and with names and numbers as long as they get."""
    rig, ball = synthetic.rig(), synthetic.ball(3)
    calibration = synthetic.calibration(rig)
    quality = assess(calibration)
    measured = [
        replace(
            synthetic.measurement(name, interval_cc=(521.0, 793.0)),
            interval_terms_cc={"chest wall": 133.2, "boundary": 12.9, "calibration": 0.44, "surface": 1.2},
            alternatives_cc={"tangent-continuous": 612.1, "thin-plate": 650.0, "cylinder-membrane": 655.5},
        )
        for name in ("left", "right")
    ]
    changed, everything = describe.settings_facts(Settings().overridden(["surface.repair.rho=3.0"]))
    repaired = synthetic.repaired(ball)
    ranges = synthetic.ranges(rig)
    page_content = content.ReportContent(
        identity=Identity(name="a_session_whose_name_is_long_and_has_no_place_to_break_2026-11-22_second_visit"),
        created="2024-01-01 00:00 UTC",
        subject=describe.SUBJECTS["torso"],
        world="The board in pose 00.",
        warnings=tuple(
            warnings(
                RunResults(
                    quality=quality,
                    calibration=None,
                    shares={"one": 0.4, "two": 0.9},
                    matching=synthetic.matching(rig, d_v_px=0.5),
                    foregrounds=synthetic.foregrounds(rig, everything=True),
                    measurements=measured,
                    repaired=repaired,
                )
            )
        ),
        breasts=tuple(describe.breast_report(each, repaired) for each in measured),
        comparison=comparison(measured),
        stages=(
            describe.calibration_report(rig, calibration, quality),
            describe.matching_report(
                synthetic.foregrounds(rig), synthetic.matching(rig, d_v_px=0.5), {"one": 0.4, "two": 0.9}
            ),
            describe.surface_report(thinned_ranges(ranges, synthetic.valid(ranges)), repaired),
            describe.measure_report(measured),
        ),
        timings=describe.timings({"calibrate": 1.25, "match": 2.0}),
        changed_settings=changed,
        all_settings=everything,
        versions=describe.versions(),
        pictures=all_encoded({"measure": stage_results.draw(synthetic.measured(rig, measured[:1], ball))}),
        scene=to_json(viewer_scene(front_frame(rig), repaired, synthetic.textured(ball), measured)),
    )
    page = tmp_path_factory.mktemp("report") / "report.html"
    page.write_text(html.render(page_content, first_page(page_content, {}, None, named=True)), encoding="utf-8")
    return page.as_uri()


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=FLAGS)
        yield browser
        browser.close()


def opened(browser: Browser, address: str, width: int, scheme: str) -> Page:
    page = patient(browser.new_page(viewport={"width": width, "height": 800}, color_scheme=scheme))
    page.goto(address)
    page.wait_for_function("document.getElementById('mm-viewer').dataset.ready !== undefined")
    return page


@pytest.mark.slow
@pytest.mark.parametrize(
    ("width", "scheme"), [(1280, "light"), pytest.param(768, "light", marks=pytest.mark.slow), (360, "dark")]
)
def test_no_words_lie_on_others_and_nothing_runs_off(browser: Browser, address: str, width: int, scheme: str) -> None:
    page = opened(browser, address, width, scheme)
    closed = page.locator("details:not([open]) > summary")
    while closed.count():
        closed.first.click()
    assert page.evaluate(OVERLAPS) == []
    assert page.evaluate(BEYOND) == []
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    page.close()


@pytest.mark.slow
def test_the_check_sees_words_on_words_and_what_runs_off(browser: Browser, address: str) -> None:
    page = opened(browser, address, 360, "light")
    page.evaluate("document.querySelector('h1').style.marginBottom = '-1.5rem'")
    assert any("a_session" in pair for pair in page.evaluate(OVERLAPS))
    page.evaluate("document.querySelector('h2').style.marginLeft = '400px'")
    assert page.evaluate(BEYOND)
    page.close()
