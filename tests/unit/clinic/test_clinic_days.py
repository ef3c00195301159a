"""Whole days in a real browser, on the demo clinic: a technician, a surgeon, two on one visit; every page judged."""

import itertools
import json
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from playwright.sync_api import Browser, Page, expect, sync_playwright
from tests.clinic_browser import AXE, CHROMIUM_FLAGS, cookies, opened, require_accessible, require_fitting
from tests.clinic_seed import PASSWORD
from tests.clinic_server import served
from tests.made_once import made_once

CHROMIUM = shutil.which("chromium")
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(CHROMIUM is None, reason="no chromium on this machine: apt-get install chromium"),
    pytest.mark.skipif(not AXE.exists(), reason="no axe-core: the bundles are not built (hatch_build.py)"),
    pytest.mark.xdist_group("demo-clinic"),
]
MEASURED_MS = 300_000  # one visit of the demo, on a busy machine
WIDTHS = (360, 820, 1440)
Opens = Callable[..., Page]


def make_demo(folder: Path) -> None:
    words = [sys.executable, "-m", "mammometry", "clinic", "demo", str(folder / "clinic"), "--no-serve", "--json"]
    done = subprocess.run(words, capture_output=True, text=True, check=False, timeout=1200)
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["failed"] == {}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A demo clinic that these tests may change."""
    made = made_once(tmp_path_factory, "demo-clinic", make_demo)
    return Path(shutil.copytree(made / "clinic", tmp_path_factory.mktemp("days") / "clinic"))


@pytest.fixture(scope="module")
def clinic(folder: Path) -> Iterator[tuple[str, dict[str, str], Browser]]:
    logins = cookies(folder)
    with served(folder) as (address, _), sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=CHROMIUM_FLAGS)
        yield f"http://{address}", logins, browser
        browser.close()


@pytest.fixture
def opens(clinic: tuple[str, dict[str, str], Browser]) -> Iterator[Opens]:
    """Opens a window for somebody with a role."""
    address, logins, browser = clinic
    pages: list[Page] = []

    def open_one(role: str, width: int = 1100) -> Page:
        pages.append(opened(browser, address, logins[role], width=width))
        return pages[-1]

    yield open_one
    for page in pages:
        page.context.close()
        assert page.wrong == []  # type: ignore[attr-defined]


def test_a_technicians_day(opens: Opens, folder: Path) -> None:
    page = opens("technician")
    page.goto("/")
    page.get_by_role("link", name="Room 1").first.click()
    (check,) = (folder / "rigs").glob("*/checks/*")
    board = sorted(check.glob("*.jpg"))  # all cameras see it
    page.get_by_role("button", name="Daily check").click()
    page.get_by_label("Choose photographs").set_input_files(board)
    page.get_by_role("button", name="Check", exact=True).click(timeout=60_000)
    expect(page.get_by_text("Passed")).to_be_visible(timeout=MEASURED_MS)

    page.goto("/patients/new/")
    for label, text in (("Family name", "Meier"), ("Given name", "Eva"), ("Record number", "KIS-1")):
        page.get_by_label(label).fill(text)
    page.get_by_role("button", name="Save").click()
    page.get_by_role("main").get_by_role("link", name="New visit", exact=True).click()
    page.get_by_label("Rig").select_option(label="Room 1")
    page.get_by_role("button", name="Go on to the photographs").click()
    capture = sorted(next((folder / "sessions").glob("*/capture")).glob("*.jpg"))
    page.get_by_label("Choose photographs").set_input_files(capture)
    expect(page.get_by_text("Everything is here.")).to_be_visible(timeout=60_000)
    page.get_by_role("button", name="Measure").click()
    expect(page.get_by_role("heading", name="Being measured")).to_be_visible()
    expect(page.get_by_role("heading", name="Left breast")).to_be_visible(timeout=MEASURED_MS)
    page.goto("/")
    row = page.get_by_role("listitem").filter(has_text="Meier, Eva").first
    expect(row).to_contain_text("to be confirmed")
    assert page.goto("/settings/").status == 403  # type: ignore[union-attr]


def click_surface(page: Page, share: float) -> None:
    """Click half-way down the picture, at a share of its width."""
    canvas = page.locator("#mm-editor canvas")
    canvas.evaluate("each => each.scrollIntoView({block: 'center'})")
    page.wait_for_timeout(500)  # it is drawn anew
    box = canvas.bounding_box()
    assert box is not None
    page.mouse.click(box["x"] + share * box["width"], box["y"] + box["height"] / 2)


def test_a_surgeons_day(opens: Opens) -> None:
    page = opens("clinician")
    page.goto("/patients/")
    page.get_by_label("Search").press_sequentially("demo-ahrens")
    expect(page.locator("#rows li")).to_have_count(1)
    page.get_by_role("link", name="Demo-Ahrens, Anna").click()
    address = page.url
    page.get_by_role("main").locator("tbody a").first.click()
    page.locator("#mm-viewer[data-ready]:not([data-ready='0'])").wait_for(timeout=120_000)
    visit = page.url
    volumes = page.locator("p.volume").all_inner_texts()[:2]
    page.get_by_role("link", name="Confirm boundaries").click()
    page.locator("#mm-editor[data-ready]").wait_for(timeout=MEASURED_MS)
    assert page.get_by_label("Your name").is_hidden()
    for title, volume in zip(("Left breast", "Right breast"), volumes, strict=True):
        expect(page.locator(".mm-about h2")).to_have_text(title)
        expect(page.locator(".mm-volume b")).to_have_text(volume)  # exactly the visit's number
        page.get_by_role("button", name="Looks right").click()

    # The session ends while a landmark is drawn: the password is asked for here, and the drawing is saved.
    page.get_by_role("button", name="Left nipple").click()
    click_surface(page, 0.6)
    page.context.clear_cookies(name="clinic-session")
    page.get_by_role("button", name="Save").click()
    dialog = page.get_by_role("dialog", name="Log in again, clinician-1")
    dialog.get_by_label("Password").fill(PASSWORD)
    dialog.get_by_role("button", name="Log in").click()
    expect(page.locator(".mm-readout")).to_contain_text("It is measured.", timeout=MEASURED_MS)
    require_accessible(page)
    page.get_by_role("button", name="Confirm and finish").click()
    page.wait_for_url(lambda url: visit not in url, timeout=60_000)
    page.goto(visit)
    expect(page.get_by_text("✓ confirmed").first).to_be_visible()
    page.get_by_text("History of drawing").click()
    expect(page.get_by_text("Boundary left: confirmed")).to_be_visible()
    expect(page.get_by_role("main").get_by_text("Clinician One, ").first).to_be_visible()

    page.goto(address)
    page.get_by_role("button", name="Compare").click()
    expect(page.get_by_role("heading", name="Change", exact=True)).to_be_visible(timeout=MEASURED_MS)
    expect(page.locator("#comparison tbody .chip").first).to_contain_text("measurement error")
    require_accessible(page)


def test_two_people_at_once_on_one_visit(opens: Opens) -> None:
    first, second = opens("clinician"), opens("clinician")
    first.goto("/patients/?q=celik")
    first.locator("#rows a").first.click()
    first.get_by_role("main").locator("tbody a").first.click()
    visit = first.url
    for page, share in ((first, 0.6), (second, 0.62)):  # of the width: two opinions of one place
        page.goto(f"{visit}draw/")
        page.locator("#mm-editor[data-ready]").wait_for(timeout=MEASURED_MS)
        page.locator(".mm-steps").get_by_role("button", name="Landmarks").click()
        page.get_by_role("button", name="Left nipple").click()
        click_surface(page, share)
        expect(page.get_by_role("button", name="Save")).to_be_visible()
    first.get_by_role("button", name="Save").click()
    expect(first.locator(".mm-readout")).to_contain_text("Saved", timeout=60_000)
    second.get_by_role("button", name="Save").click()
    expect(second.locator(".mm-readout")).to_contain_text("a change by somebody else meanwhile", timeout=60_000)
    second.get_by_role("button", name="Replace it by mine").click()
    expect(second.locator(".mm-readout")).to_contain_text("Saved", timeout=60_000)
    second.goto(visit)
    expect(second.get_by_text("Landmark nipple_left: drawn")).to_have_count(2)


@pytest.mark.parametrize("role", ["technician", "clinician", "researcher", "administrator"])
def test_every_page_is_accessible_and_fits_every_width(opens: Opens, role: str) -> None:
    """Every page that can be reached by links from the first one, each kind once or twice."""
    page = opens(role)
    seen: set[str] = set()
    waiting = ["/"]
    kinds: dict[str, int] = {}
    while waiting:
        path = waiting.pop()
        answer = page.goto(path)
        assert answer is not None
        assert answer.status == 200, path
        for width in WIDTHS:
            page.set_viewport_size({"width": width, "height": 900})
            require_fitting(page)
        require_accessible(page)
        links = page.locator("a[href^='/']").evaluate_all("all => all.map(each => each.getAttribute('href'))")
        for link in links:
            kind = "/".join("*" if len(part) == 36 else part for part in link.partition("?")[0].split("/"))
            skipped = ("/administration/auditlog", "/static", "/report/", "/compare/*")
            download = "." in kind  # a file's ending
            if download or link in seen or any(each in kind for each in skipped) or kinds.get(kind, 0) >= 2:
                continue
            seen.add(link)
            kinds[kind] = kinds.get(kind, 0) + 1
            waiting.append(link)
    least = {"technician": 12, "clinician": 12, "researcher": 3, "administrator": 6}
    assert len(kinds) >= least[role], sorted(kinds)


def test_the_keyboard_alone_reaches_what_a_page_offers(opens: Opens) -> None:
    page = opens("technician", 1440)
    page.goto("/")
    page.keyboard.press("Tab")
    assert page.evaluate("document.activeElement.textContent") == "Go to the content"
    page.keyboard.press("Enter")
    assert page.evaluate("document.activeElement.id") == "main"
    reached = []
    for _ in itertools.repeat(None, 40):
        page.keyboard.press("Tab")
        reached.append(page.evaluate("document.activeElement.textContent.trim()"))
    assert "New visit" in reached
    assert "Help with this page" in reached
