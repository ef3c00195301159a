"""A clinic's whole first day in a real browser, on either database: from an empty folder to a signed, confirmed report.

An administrator enters people and the rig, a technician calibrates, checks and photographs, a surgeon draws, confirms
and concludes. Every screen is judged. ``python -m tests.postgresql pytest …`` does the same with PostgreSQL.
"""

import base64
import csv
import io
import itertools
import json
import os
import re
import shutil
from collections.abc import Callable, Iterator
from contextlib import nullcontext
from dataclasses import dataclass, field
from pathlib import Path
from urllib.parse import urlsplit

import numpy as np
import pydicom
import pypdf
import pytest
from PIL import Image
from playwright.sync_api import Browser, Page, expect, sync_playwright
from scipy import ndimage
from tests.clinic_browser import AXE, CHROMIUM_FLAGS, opened, require_accessible, require_fitting
from tests.clinic_seed import PASSWORD
from tests.clinic_server import command, served
from tests.made_once import made_once
from tests.postgresql import VARIABLE, new_database
from tests.unit.clinic.test_clinic_numbers import of_dicom, of_fhir, unzipped, words

from mammometry.clinic.config import FILE, SETTINGS_FILE

CHROMIUM = shutil.which("chromium")
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(CHROMIUM is None, reason="no chromium on this machine: apt-get install chromium"),
    pytest.mark.skipif(not AXE.exists(), reason="no axe-core: the bundles are not built (hatch_build.py)"),
    pytest.mark.xdist_group("clinic-days"),
]
MEASURED_MS = 1_200_000  # one small visit: 40 s alone, more than 5 min beside eight others
WIDTHS = (390, 820, 1440)
HANDLE_RGB = (213, 94, 0)  # of a boundary's points, as `viewer/src/stage.ts` draws them
PEOPLE = {
    "technician": ("tessa", "Tessa Weiß", "Technician:"),
    "clinician": ("luchs", "Dr. Rosa Luchs", "Clinician:"),
    "researcher": ("rita", "Rita Ritter", "Researcher:"),
}
PATIENT = {"Family name": "Müller", "Given name": "Siobhán", "Record number": "KIS-1", "Date of birth": "1979-05-14"}
CONCLUSION = "Symmetrical. Seen again after one year."
Opens = Callable[..., Page]


@dataclass
class Hospital:
    """A clinic that is served, its browser, and who has logged in."""

    address: str
    link: str
    """With which the first administrator sets a password."""
    photographs: Path
    """A session: the board in several poses, and a patient. Beside it lies ``later``, the patient changed."""
    browser: Browser
    cookies: dict[str, str] = field(default_factory=dict)
    """Role → login."""

    def window(self, role: str, width: int = WIDTHS[-1]) -> Page:
        """A window of somebody with a role; without a login where nobody has one yet."""
        return opened(self.browser, self.address, self.cookies.get(role, "nobody"), width=width)


def render(folder: Path) -> None:
    """The demo's photographs: small, of its coarse board, and of its first patient at two dates."""
    from mammometry.base.progress import no_progress
    from mammometry.clinic import demo

    subject = demo.PATIENTS[0].subject
    demo.render(folder / "session", subject, "", demo.POSES, no_progress)
    demo.render(folder / "later", subject, "ratio=1.25", 1, no_progress)


@pytest.fixture(scope="module")
def hospital(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Hospital]:
    """A clinic without people, rigs and patients, as `clinic init` leaves it."""
    from mammometry.clinic import demo

    session = made_once(tmp_path_factory, "clinic-days", render) / "session"
    folder = tmp_path_factory.mktemp("days") / "clinic"
    server = os.environ.get(VARIABLE)
    with new_database(server, "days") if server else nullcontext("sqlite") as database:
        made = command("init", str(folder), "--administrator", "ada", "--database", database)
        settings = folder / FILE  # no test has a telephone
        text = settings.read_text(encoding="utf-8").replace('second_factor = "required"', 'second_factor = "offered"')
        settings.write_text(text, encoding="utf-8")
        (folder / SETTINGS_FILE).write_text(demo.SETTINGS, encoding="utf-8")
        with served(folder) as (address, _), sync_playwright() as playwright:
            browser = playwright.chromium.launch(executable_path=CHROMIUM, args=CHROMIUM_FLAGS)
            link = urlsplit(str(made["link"])).path
            yield Hospital(address=f"http://{address}", link=link, photographs=session, browser=browser)
            browser.close()


@pytest.fixture(scope="module")
def people(hospital: Hospital) -> Hospital:
    """After the administrator's first hour: everybody can log in."""
    page = hospital.window("administrator")
    page.goto(hospital.link)
    log_in_first(hospital, page, "ada", "administrator")
    links = {}
    for role, (name, full_name, label) in PEOPLE.items():
        page.goto("/people/")
        page.get_by_role("link", name="Add a person").click()
        page.get_by_label("Name for the login").fill(name)
        page.get_by_label("Full name").fill(full_name)
        page.get_by_label(label).check()
        page.get_by_role("button", name="Enter, and show the link").click()
        links[role] = urlsplit(page.get_by_label("Link").input_value()).path
    judge(page, "person")
    page.goto("/people/")
    judge(page, "people")
    for role, link in links.items():
        other = hospital.window(role)
        other.goto(link)
        log_in_first(hospital, other, PEOPLE[role][0], role)
        close(other)
    close(page)
    return hospital


@pytest.fixture(scope="module")
def visit(people: Hospital, tmp_path_factory: pytest.TempPathFactory) -> str:
    """After the technician's day: address of the visit that was measured."""
    page = people.window("technician")
    enter_rig(page, people.photographs)
    calibrate(page, people.photographs, tmp_path_factory.mktemp("poses"))
    check_rig(page, people.photographs)
    enter_patient(page)
    address = photograph(page, people.photographs)
    close(page)
    return address


@pytest.fixture
def opens(people: Hospital) -> Iterator[Opens]:
    """Opens a window for somebody with a role."""
    pages: list[Page] = []

    def open_one(role: str, width: int = WIDTHS[-1]) -> Page:
        pages.append(people.window(role, width))
        return pages[-1]

    yield open_one
    for page in pages:
        close(page)


def close(page: Page) -> None:
    page.context.close()
    assert page.wrong == []  # type: ignore[attr-defined]


def judge(page: Page, name: str) -> None:
    """Fail where a screen is wider than its window, or not accessible."""
    for width in WIDTHS:
        page.set_viewport_size({"width": width, "height": 900})
        require_fitting(page)
        if "MAMMOMETRY_TEST_PICTURES" in os.environ:  # for somebody who wants to look at the page
            page.screenshot(path=f"{os.environ['MAMMOMETRY_TEST_PICTURES']}/{name}-{width}.png", full_page=True)
    require_accessible(page)


def log_in_first(hospital: Hospital, page: Page, name: str, role: str) -> None:
    """Set a password by the link that was handed over, and log in."""
    for label in ("New password", "The same again"):
        page.get_by_label(label).fill(PASSWORD)
    page.get_by_role("button", name="Set the password").click()
    page.get_by_role("main").get_by_role("link", name="Log in").click()
    page.get_by_label("Name").fill(name)
    page.get_by_label("Password").fill(PASSWORD)
    page.get_by_role("button", name="Log in").click()
    expect(page.locator(".me-name")).to_be_visible()
    hospital.cookies[role] = login_of(page)


def login_of(page: Page) -> str:
    """The session's cookie of who is logged in."""
    return next(one["value"] for one in page.context.cookies() if one["name"] == "clinic-session")  # type: ignore[typeddict-item]


def require_step(page: Page, title: str) -> None:
    """The first page leads through the first day."""
    page.goto("/")
    expect(page.locator("[aria-current=step] strong")).to_have_text(title)


def enter_rig(page: Page, photographs: Path) -> None:
    require_step(page, "Rig")
    judge(page, "first-day")
    page.get_by_role("link", name="Enter the rig").click()
    page.get_by_label("Name", exact=True).fill("Room 1")
    page.get_by_label("Or a session.toml of this rig").set_input_files(photographs / "session.toml")
    page.get_by_role("button", name="Save").click()
    expect(page.get_by_text("The rig is saved.")).to_be_visible()
    require_step(page, "Board to print")
    board = page.get_by_role("link", name="Open the board as PDF").get_attribute("href")
    assert page.request.get(str(board)).body().startswith(b"%PDF")


def calibrate(page: Page, photographs: Path, folder: Path) -> None:
    """The first pose, which all cameras see, is kept for the daily check."""
    require_step(page, "Calibration")
    page.get_by_role("link", name="To the rig").click()
    page.get_by_role("button", name="New calibration").click()
    poses = [pose for pose in sorted((photographs / "calibration").iterdir()) if pose.name != "00"]
    for pose in poses:
        shutil.copytree(pose, folder / "calibration" / pose.name)
    page.get_by_label("Choose a folder of photographs").set_input_files(folder / "calibration")
    calibrates = page.get_by_role("button", name="Calibrate", exact=True)
    count = sum(1 for pose in poses for _ in pose.glob("*.jpg"))
    expect(page.get_by_text(f"{count} photographs have arrived.")).to_be_visible(timeout=MEASURED_MS)
    judge(page, "calibration")
    calibrates.click()
    expect(page.get_by_text("✓ in use")).to_be_visible(timeout=MEASURED_MS)
    judge(page, "calibrated")


def check_rig(page: Page, photographs: Path) -> None:
    page.goto("/rigs/")
    page.get_by_role("link", name="Room 1").first.click()
    page.get_by_role("button", name="Daily check").click()
    drop(page, sorted((photographs / "calibration" / "00").glob("*.jpg")))
    page.get_by_role("button", name="Check", exact=True).click()
    expect(page.get_by_text("✓ Passed")).to_be_visible(timeout=MEASURED_MS)
    judge(page, "check")
    page.goto("/rigs/")
    page.get_by_role("link", name="Room 1").first.click()
    judge(page, "rig")


def drop(page: Page, photographs: list[Path]) -> None:
    """Let go of photographs over the page, as from a folder's window."""
    expect(page.locator("[data-missing]")).not_to_be_empty()  # the page has heard what is there, and takes more
    sent = [(path.name, base64.b64encode(path.read_bytes()).decode()) for path in photographs]
    transfer = page.evaluate_handle(
        """sent => {
          const transfer = new DataTransfer();
          for (const [name, text] of sent)
            transfer.items.add(new File([Uint8Array.from(atob(text), (c) => c.charCodeAt(0))], name));
          return transfer;
        }""",
        sent,
    )
    page.locator("[data-drop]").dispatch_event("drop", {"dataTransfer": transfer})


def enter_patient(page: Page) -> None:
    """She is not there yet, which the search says; then consents and her operation."""
    require_step(page, "First patient")
    page.get_by_role("main").get_by_role("link", name="New visit", exact=True).click()
    page.get_by_label("Who is photographed?").press_sequentially("müller")
    expect(page.get_by_text("No patient matches “müller”.")).to_be_visible()
    judge(page, "search")
    page.get_by_role("link", name="Enter a new patient").click()
    entries = {
        "Family name": "Müller",
        "Given name": "Siobhán",
        "Record number": "KIS-1",
        "Date of birth": "1979-05-14",
    }
    for label, text in entries.items():
        page.get_by_label(label).fill(text)
    judge(page, "new-patient")
    page.get_by_role("button", name="Save").click()
    expect(page.get_by_role("heading", name="Müller, Siobhán")).to_be_visible()
    expect(page.get_by_role("link", name="Enter consent")).to_have_count(2)
    for _ in range(2):
        page.get_by_role("link", name="Enter consent").first.click()
        page.get_by_label("Given on").fill("2026-01-10")
        page.get_by_role("button", name="Save").click()
    expect(page.get_by_text("✓ holds")).to_have_count(2)
    page.get_by_role("link", name="Enter an operation").click()
    page.get_by_label("Operation", exact=True).select_option("Reduction or lift")
    page.get_by_label("Side").select_option("Both")
    page.get_by_label("Day").fill("2026-01-12")
    page.get_by_label("Tissue removed, g").fill("210")
    judge(page, "operation")
    page.get_by_role("button", name="Save").click()
    expect(page.get_by_text("Reduction or lift").first).to_be_visible()
    judge(page, "patient")


def photograph(page: Page, photographs: Path) -> str:
    page.goto("/")
    expect(page.get_by_text("The first day of this clinic")).to_be_hidden()
    page.get_by_role("main").get_by_role("link", name="New visit", exact=True).click()
    page.get_by_label("Who is photographed?").press_sequentially("siobhan mul")
    page.get_by_role("main").get_by_role("link", name="Müller, Siobhán").click()
    page.get_by_label("Occasion").select_option(index=1)
    judge(page, "new-visit")
    page.get_by_role("button", name="Go on to the photographs").click()
    expect(page.get_by_role("button", name="Measure")).to_be_disabled()
    drop(page, sorted((photographs / "capture").glob("*.jpg")))
    expect(page.get_by_text("Everything is here.")).to_be_visible()
    judge(page, "photographs")
    page.get_by_role("button", name="Measure").click()
    expect(page.get_by_role("heading", name="Being measured")).to_be_visible()
    expect(page.get_by_role("heading", name="Left breast")).to_be_visible(timeout=MEASURED_MS)
    return urlsplit(page.url).path


def open_editor(page: Page, visit: str) -> None:
    page.goto(f"{visit}draw/")
    page.locator("#mm-editor[data-ready]").wait_for(timeout=MEASURED_MS)


def drag_highest_point(page: Page) -> None:
    """Take hold of the highest point that is seen, and pull it down."""
    canvas = page.locator("#mm-editor canvas")
    canvas.evaluate("canvas => canvas.scrollIntoView({block: 'center'})")
    page.wait_for_timeout(500)  # it is drawn anew
    picture = np.asarray(Image.open(io.BytesIO(canvas.screenshot())).convert("RGB")).astype(int)
    spots, count = ndimage.label(np.abs(picture - HANDLE_RGB).max(axis=2) < 40)
    areas = ndimage.sum_labels(spots > 0, spots, np.arange(1, count + 1))
    centres = ndimage.center_of_mass(spots > 0, spots, 1 + np.flatnonzero(areas > 30))
    y, x = min(centres)
    box = canvas.bounding_box()
    assert box is not None
    page.mouse.move(box["x"] + x, box["y"] + y)
    page.mouse.down()
    page.mouse.move(box["x"] + x, box["y"] + y + 40, steps=4)
    page.mouse.up()


def look_at(page: Page, title: str, volume: str) -> None:
    """The editor shows exactly the visit's number."""
    expect(page.locator(".mm-about h2")).to_have_text(title)
    expect(page.locator(".mm-volume b")).to_have_text(volume)
    expect(page.locator(".mm-note")).to_have_text("measured")
    page.locator("#mm-editor .mm-canvas").evaluate("picture => picture.scrollIntoView({block: 'center'})")
    page.get_by_role("button", name="Looks right").click()  # only what is in view does


def volumes_of(page: Page) -> list[str]:
    """Left and right, as the visit's page says them."""
    return page.locator("p.volume").all_inner_texts()[:2]


def test_a_surgeons_day(visit: str, opens: Opens, people: Hospital) -> None:
    page = opens("clinician")
    page.goto("/")
    waiting = page.locator("section", has=page.get_by_role("heading", name="To be confirmed"))
    expect(waiting.get_by_role("listitem")).to_contain_text("Müller, Siobhán")
    judge(page, "waiting")
    waiting.get_by_role("link").first.click()
    page.locator("#mm-viewer[data-ready]:not([data-ready='0'])").wait_for(timeout=MEASURED_MS)
    judge(page, "measured")
    before = volumes_of(page)
    page.get_by_role("link", name="Confirm boundaries").click()
    page.locator("#mm-editor[data-ready]").wait_for(timeout=MEASURED_MS)
    judge(page, "editor")
    look_at(page, "Left breast", before[0])

    # The right one is drawn better. The session ends meanwhile: the password is asked for here, and nothing is lost.
    page.get_by_role("button", name="Change the line").click()
    drag_highest_point(page)
    expect(page.locator(".mm-origin")).to_contain_text("Changed, not saved.")
    page.context.clear_cookies(name="clinic-session")
    page.get_by_role("button", name="Save").click()
    dialog = page.get_by_role("dialog", name="Log in again, luchs")
    dialog.get_by_label("Password").fill(PASSWORD)
    dialog.get_by_role("button", name="Log in").click()
    expect(page.locator(".mm-readout")).to_contain_text("Measured.", timeout=MEASURED_MS)
    people.cookies["clinician"] = login_of(page)
    after = page.locator(".mm-volume b").inner_text()
    assert after != before[1]
    page.locator(".mm-steps").get_by_role("button", name="Left breast").click()
    look_at(page, "Left breast", before[0])
    look_at(page, "Right breast", after)
    expect(page.locator(".mm-about h2")).to_have_text("Landmarks")
    judge(page, "landmarks")
    page.get_by_role("button", name="Confirm and finish").click()
    page.wait_for_url(visit)
    expect(page.get_by_text("No other visit to confirm.")).to_be_visible()
    assert volumes_of(page) == [before[0], after]
    expect(page.get_by_text("✓ confirmed").first).to_be_visible()
    page.get_by_role("status").get_by_role("link", name="Write the conclusion").click()
    page.get_by_role("textbox", name="Conclusion").fill(CONCLUSION)
    page.get_by_role("button", name="Sign").click()
    expect(page.get_by_text("Signed by Dr. Rosa Luchs")).to_be_visible()
    expect(page.get_by_text("Confirmed and concluded.")).to_be_visible()
    judge(page, "concluded")
    page.get_by_text("History of drawing").click()
    expect(page.get_by_text("Boundary right: drawn")).to_be_visible()
    expect(page.get_by_text("Boundary left: confirmed")).to_be_visible()

    researcher = opens("researcher")
    researcher.goto("/study/")
    judge(researcher, "study")
    require_same_numbers(page, researcher, visit, [before[0], after])


def require_same_numbers(page: Page, researcher: Page, visit: str, shown: list[str]) -> None:
    """What leaves the clinic says what its page says, and who confirmed it."""

    def content(who: Page, path: str) -> bytes:
        answer = who.request.get(path)
        assert answer.status == 200, answer.text()
        return answer.body()

    fhir = content(page, f"{visit}fhir-r4.json")
    numbers = of_fhir(fhir)
    volumes = [numbers[f"volume_flat_chest_{side}"] for side in ("left", "right")]
    assert [f"{value:.0f} cc" for value, *_ in volumes] == shown
    (report,) = [
        one["resource"] for one in json.loads(fhir)["entry"] if one["resource"]["resourceType"] == "DiagnosticReport"
    ]
    assert (report["status"], report["performer"]) == ("final", [{"display": "Dr. Rosa Luchs"}])
    assert report["conclusion"].startswith(CONCLUSION)

    structured = pydicom.dcmread(io.BytesIO(unzipped(content(page, f"{visit}dicom.zip"))["02-SR-001.dcm"]))
    assert (structured.VerificationFlag, structured.PreliminaryFlag) == ("VERIFIED", "FINAL")
    assert str(structured.VerifyingObserverSequence[0].VerifyingObserverName).rstrip("^") == "Dr. Rosa Luchs"
    found = of_dicom(structured)
    assert found.keys() == numbers.keys()
    assert all(found[name] == pytest.approx(figures, abs=1e-4) for name, figures in numbers.items())

    paper = pypdf.PdfReader(io.BytesIO(content(page, f"{visit}report.pdf")))
    text = words(" ".join(leaf.extract_text() for leaf in paper.pages))
    for part in ("Müller", "Siobhán", "KIS-1", "confirmed by Dr. Rosa Luchs", CONCLUSION):
        assert part in text
    rows = list(csv.DictReader(io.StringIO(content(researcher, "/study/cohort.csv").decode())))
    assert [row["side"] for row in rows] == ["left", "right"]
    for row, (value, low, high) in zip(rows, volumes, strict=True):
        assert low is not None
        assert high is not None
        assert f"{low:.0f} to {high:.0f}" in text
        assert f"{value:.0f}" in re.findall(r"\d+", text)
        of_study = [float(row[name]) for name in ("volume_cc", "low_cc", "high_cc")]
        assert of_study == pytest.approx((value, low, high), abs=0.6)  # exports are rounded by their intervals
        assert (row["confirmed"], row["state"]) == ("True", "confirmed")
    assert not {"Müller", "Luchs", "KIS-1"} & set(re.findall(r"[\w-]+", str(rows)))


def test_two_dates_are_compared(visit: str, opens: Opens, people: Hospital) -> None:
    """The comparison is made by itself; patient's page and comparison say the same verdict."""
    technician = opens("technician")
    later = photograph(technician, people.photographs.parent / "later")
    page = opens("clinician")
    page.goto(later)
    page.locator(".banner-name a").click()
    verdict = page.locator("section", has=page.get_by_role("heading", name="Changes")).locator(".verdict")
    expect(verdict).to_contain_text("measurement error", timeout=MEASURED_MS)
    text = verdict.inner_text()
    judge(page, "two-visits")
    page.get_by_role("link", name="Compare").click()
    page.locator("#mm-viewer[data-ready]:not([data-ready='0'])").wait_for(timeout=MEASURED_MS)
    assert page.locator(".verdict").first.inner_text() == text
    judge(page, "compared")


def test_two_people_at_once_on_one_visit(visit: str, opens: Opens) -> None:
    first, second = opens("clinician"), opens("clinician")
    for page, share in ((first, 0.6), (second, 0.62)):  # of the width: two opinions of one place
        open_editor(page, visit)
        page.locator(".mm-steps").get_by_role("button", name="Landmarks").click()
        page.get_by_role("button", name="Left nipple").click()
        canvas = page.locator("#mm-editor canvas")
        canvas.evaluate("canvas => canvas.scrollIntoView({block: 'center'})")
        page.wait_for_timeout(500)  # it is drawn anew
        box = canvas.bounding_box()
        assert box is not None
        page.mouse.click(box["x"] + share * box["width"], box["y"] + box["height"] / 2)
        expect(page.get_by_role("button", name="Save")).to_be_visible()
    first.get_by_role("button", name="Save").click()
    expect(first.locator(".mm-readout")).to_contain_text("Saved")
    second.get_by_role("button", name="Save").click()
    expect(second.locator(".mm-readout")).to_contain_text("a change by somebody else meanwhile")
    second.get_by_role("button", name="Replace it by mine").click()
    expect(second.locator(".mm-readout")).to_contain_text("Saved")
    second.goto(visit)  # which is measured again
    expect(second.get_by_role("heading", name="Left breast")).to_be_visible(timeout=MEASURED_MS)
    second.get_by_text("History of drawing").click()
    expect(second.get_by_text("Landmark nipple_left: drawn")).to_have_count(2)


@pytest.mark.parametrize("role", ["technician", "clinician", "researcher", "administrator"])
def test_every_page_is_accessible_and_fits_every_width(visit: str, opens: Opens, role: str) -> None:
    """Every page that can be reached by links from the first one, one of each kind."""
    page = opens(role)
    waiting = ["/"]
    kinds: set[str] = set()
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
            kind = "/".join(
                "*" if len(part) == 36 or part.isdigit() else part for part in link.partition("?")[0].split("/")
            )
            skipped = ("/static", "/report/", "/screen/")  # the last two: a page by itself, and a photograph
            download = "." in kind  # a file's ending
            if download or any(each in kind for each in skipped) or kind in kinds:
                continue
            kinds.add(kind)
            waiting.append(link)
    least = {"technician": 12, "clinician": 12, "researcher": 3, "administrator": 6}
    assert len(kinds) >= least[role], sorted(kinds)


def test_the_keyboard_alone_reaches_what_a_page_offers(visit: str, opens: Opens) -> None:
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
