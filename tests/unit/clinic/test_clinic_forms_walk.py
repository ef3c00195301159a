"""Forms by clicks, as each role, on both databases: a stale one, an ended session, a draft, a double click."""

import base64
import hmac
import json
import os
import shutil
import struct
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass

import pytest
from playwright.sync_api import Browser, Page, Route, expect, sync_playwright
from tests.clinic_browser import AXE, CHROMIUM_FLAGS, cookies, opened, require_accessible, require_fitting
from tests.clinic_seed import PASSWORD
from tests.clinic_server import served
from tests.postgresql import ABSENT, binaries, server

CHROMIUM = shutil.which("chromium")
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(CHROMIUM is None, reason="no chromium on this machine: apt-get install chromium"),
    pytest.mark.skipif(not AXE.exists(), reason="no axe-core: the bundles are not built (hatch_build.py)"),
]
SECRET = "JBSWY3DPEHPK3PXP"
"""Of the account with a second factor."""
# A clinic with one of each record. Prints keys, and the session of a clinician with a second factor, as JSON.
_FILL = """
import datetime, json, sys
from pathlib import Path
from mammometry.clinic.config import new_clinic
from mammometry.clinic.web.server import migrate
migrate(new_clinic(Path(sys.argv[1]), name="Clinic", second_factor="offered", database=sys.argv[2]))
from allauth.mfa.totp.internal.auth import TOTP
from django.test import Client
from mammometry.clinic.models import *
from mammometry.clinic.records.results import add_volumes
from tests.clinic_seed import DEFINITION, PASSWORD
keys = {}
noon = datetime.datetime(2026, 3, 1, 12, tzinfo=datetime.UTC)
rig = Rig.objects.create(name="Room 1", definition=DEFINITION)
for name in sys.argv[4:]:
    patient = Patient.objects.create(family_name="Zypernkatze", given_name=name, record_number=name)
    visit = Visit.objects.create(patient=patient, rig=rig, taken_at=noon, state="measured")
    made = Measurement.objects.create(visit=visit, digest=name, made_at=noon, software="1")
    add_volumes(made, [Volume(side=side, definition="named wall", volume_cc=400, low_cc=380, high_cc=430)
                       for side in ("left", "right")])
    operation = Operation.objects.create(patient=patient, kind="implant", side="left", day="2026-01-02", words="round")
    consent = Consent.objects.create(patient=patient, purpose="pictures", given_on="2026-01-01")
    archive = Destination.objects.create(name=f"PACS {name}", address="PACS@127.0.0.1:104")
    room = Rig.objects.create(name=f"Room {name}", definition=DEFINITION, active=False)
    person = Person.objects.create(username=name, full_name="Eva Efeu", roles=["technician"])
    rows = {"patient": patient, "visit": visit, "operation": operation, "consent": consent, "rig": room,
            "person": person, "archive": archive}
    keys[name] = {what: str(row.pk) for what, row in rows.items()}
careful = Person.objects.create(username="careful", full_name="Cara Careful", roles=["clinician"])
careful.set_password(PASSWORD)
careful.save()
TOTP.activate(careful, sys.argv[3])
client = Client()
client.force_login(careful, backend="allauth.account.auth_backends.AuthenticationBackend")
print(json.dumps({"keys": keys, "careful": client.cookies["clinic-session"].value}))
"""
NAMES = ("stale", "notes", "ended", "draft", "double", "other")
"""A patient with all records for each test, so that none sees what another did."""


@dataclass(frozen=True)
class Served:
    """A clinic that runs, and a browser."""

    browser: Browser
    address: str
    logins: dict[str, str]
    keys: dict[str, dict[str, str]]

    def page(self, role: str, width: int = 1280) -> Page:
        """A window of its own of somebody of this role."""
        return opened(self.browser, self.address, self.logins[role], width=width)


@pytest.fixture(scope="module", params=["sqlite", "postgresql"])
def clinic_served(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Served]:
    """A clinic's server with each database."""
    if request.param == "postgresql" and binaries() is None:
        pytest.skip(ABSENT)
    folder = tmp_path_factory.mktemp("forms") / "clinic"
    with ExitStack() as stack:
        database = stack.enter_context(server()) if request.param == "postgresql" else "sqlite"
        words = [sys.executable, "-c", _FILL, str(folder), database, SECRET, *NAMES]
        done = subprocess.run(words, capture_output=True, text=True, check=False, timeout=120)
        assert done.returncode == 0, done.stderr
        filled = json.loads(done.stdout)
        logins = {**cookies(folder), "careful": filled["careful"]}
        address, _ = stack.enter_context(served(folder, "--no-jobs"))
        playwright = stack.enter_context(sync_playwright())
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=CHROMIUM_FLAGS)
        yield Served(browser, f"http://{address}", logins, filled["keys"])
        browser.close()


def fill(page: Page, values: dict[str, str]) -> None:
    """Fill fields in by their labels."""
    for label, text in values.items():
        field = page.locator("main form").get_by_label(label).first
        if field.evaluate("each => each.tagName") == "SELECT":
            field.select_option(label=text)
        elif field.get_attribute("type") in ("checkbox", "radio"):
            field.set_checked(text == "yes")
        else:
            field.fill(text)


def open_form(page: Page, address: str, summary: str = "") -> None:
    page.goto(address)
    fold = page.get_by_role("main").get_by_text(summary, exact=True) if summary else None
    if fold is not None and not fold.evaluate("each => each.parentElement.open"):
        fold.click()


def require_forgotten(page: Page) -> None:
    """Fail where the tab still keeps something that was typed, a moment after the page's script has run."""
    end = time.monotonic() + 5
    while kept(page) != "{}" and time.monotonic() < end:
        page.wait_for_timeout(50)
    assert kept(page) == "{}", page.url


def kept(page: Page) -> str:
    """All drafts that the tab keeps."""
    found = "Object.entries(sessionStorage).filter(([key]) => key.startsWith('draft '))"
    return str(page.evaluate(f"JSON.stringify(Object.fromEntries({found}))"))


def picture(page: Page, name: str) -> None:
    if "MAMMOMETRY_TEST_PICTURES" in os.environ:  # for somebody who wants to look at the page
        page.screenshot(path=f"{os.environ['MAMMOMETRY_TEST_PICTURES']}/{name}.png", full_page=True)


# --- a stale form

CONCLUDE = "Write the conclusion"
STALE = [
    ("technician", "/patients/{patient}/edit/", "", {"Note": "allergic to latex"}, {"Given name": "Quirina"}),
    ("clinician", "/patients/{patient}/edit/", "", {"Record number": "KIS-9"}, {"Family name": "Zimtkatze"}),
    ("technician", "/operations/{operation}/edit/", "", {"Volume, cc": "315"}, {"Side": "Right"}),
    ("clinician", "/operations/{operation}/edit/", "", {"In words": "anatomical"}, {"Day": "2026-01-03"}),
    ("technician", "/consents/{consent}/edit/", "", {"Remark": "in the file"}, {"Given on": "2026-01-03"}),
    ("clinician", "/consents/{consent}/edit/", "", {"Given on": "2026-01-04"}, {"Remark": "on paper"}),
    ("technician", "/visits/{visit}/", "Occasion, posture and repeat", {"Occasion": "Later"}, {"Posture": "Lying"}),
    ("technician", "/rigs/{rig}/edit/", "", {"Note": "by the window"}, {"In use": "yes"}),
    ("administrator", "/rigs/{rig}/edit/", "", {"Name": "Room 12"}, {"Note": "by the door"}),
    ("administrator", "/people/{person}/", "", {"Clinician": "yes"}, {"Full name": "Dr. Eva Efeu"}),
    ("administrator", "/archives/{archive}/", "", {"Name": "Archive"}, {"Our AE title": "ROOM1"}),
]  # fmt: skip


@pytest.mark.requirement("R-KEEP-6")
def test_a_stale_form_shows_both_versions(clinic_served: Served) -> None:
    keys = clinic_served.keys["stale"]
    for role, where, summary, theirs, mine in STALE:
        address = where.format(**keys)
        first, second = clinic_served.page(role), clinic_served.page(role)
        for page in (first, second):
            open_form(page, address, summary)
        fill(first, theirs)
        first.get_by_role("main").get_by_role("button", name="Save", exact=True).click()
        expect(first.get_by_role("status").first).to_be_visible()  # saved
        fill(second, mine)
        second.get_by_role("main").get_by_role("button", name="Save", exact=True).click()
        expect(second.get_by_role("heading", name="Somebody else changed this meanwhile")).to_be_visible()
        expect(second.locator("fieldset")).to_have_count(2)
        require_accessible(second)
        for width in (390, 1280):
            second.set_viewport_size({"width": width, "height": 900})
            require_fitting(second)
        picture(second, f"stale-{address.split('/')[1]}-{role}")
        second.get_by_role("button", name="Save").click()
        expect(second.get_by_role("heading", name="Somebody else changed this meanwhile")).to_be_hidden()
        open_form(second, address, summary)
        for label, text in {**theirs, **mine}.items():
            field = second.get_by_role("main").get_by_label(label).first
            if field.evaluate("each => each.tagName") == "SELECT":
                expect(field.locator("option:checked")).to_have_text(text)
            elif text == "yes":
                expect(field).to_be_checked()
            else:
                expect(field).to_have_value("315.0" if text == "315" else text)
        for page in (first, second):
            assert page.wrong == []  # type: ignore[attr-defined]
            page.context.close()


@pytest.mark.requirement("R-KEEP-8")
@pytest.mark.parametrize("role", ["technician", "clinician", "researcher", "administrator"])
def test_earlier_notes_are_for_those_who_care_for_patients(clinic_served: Served, role: str) -> None:
    address = f"/patients/{clinic_served.keys['notes']['patient']}/"
    writer = clinic_served.page("technician")
    for text in ("allergic to latex", "allergic to iodine"):
        writer.goto(f"{address}edit/")
        writer.get_by_label("Note").fill(f"{text}, for the {role}")
        writer.get_by_role("button", name="Save").click()
        expect(writer.get_by_text("The patient's entry is changed.")).to_be_visible()
    page = clinic_served.page(role, width=390)
    if role in ("technician", "clinician"):
        page.goto(address)
        page.get_by_text("Correct …").click()
        page.get_by_role("link", name="Earlier notes").click()
        expect(page.get_by_text(f"allergic to latex, for the {role}").first).to_be_visible()
        expect(page.get_by_text("Technician One").first).to_be_visible()
        require_accessible(page)
        require_fitting(page)
        picture(page, "earlier-notes")
    else:
        page.goto(f"{address}notes/")
        expect(page.get_by_role("heading", name="Not for your role")).to_be_visible()
    if role == "administrator":
        page.goto("/audit/?kind=changed")
        page.get_by_role("cell").get_by_text("Patient changed").first.click(trial=True)
        page.locator("tbody tr").first.get_by_role("link").click()
        expect(page.get_by_role("cell", name="•••").first).to_be_visible()
        expect(page.get_by_text("allergic")).to_have_count(0)
        require_accessible(page)
    assert page.wrong == []  # type: ignore[attr-defined]


@pytest.mark.requirement("R-KEEP-6")
def test_two_conclusions_of_one_visit_are_both_kept(clinic_served: Served) -> None:
    address = f"/visits/{clinic_served.keys['stale']['visit']}/"
    first, second = clinic_served.page("clinician"), clinic_served.page("clinician")
    for page in (first, second):
        open_form(page, address, CONCLUDE)
    first.get_by_label("Conclusion").last.fill("Seroma on the left.")
    first.get_by_role("button", name="Sign").click()
    expect(first.get_by_text("The conclusion is signed.")).to_be_visible()
    second.get_by_label("Conclusion").last.fill("The left is fuller.")
    second.get_by_role("button", name="Sign").click()
    expect(second.get_by_text("Clinician One saved it")).to_be_visible()
    second.get_by_role("button", name="Save").click()  # nothing is proposed: the browser asks for a choice
    expect(second.get_by_role("heading", name="Somebody else changed this meanwhile")).to_be_visible()
    picture(second, "stale-conclusion")
    second.get_by_label("Keep both").check()
    second.get_by_role("button", name="Save").click()
    expect(second.locator("blockquote").first).to_contain_text("Seroma on the left.")
    expect(second.locator("blockquote").first).to_contain_text("The left is fuller.")


# --- the session has ended

TEXTS = [
    ("technician", "/patients/new/", "", "Save",
     {"Family name": "Ahorn", "Given name": "Anna", "Record number": "E-{role}", "Note": "comes by train"}),
    ("clinician", "/patients/{patient}/edit/", "", "Save", {"Note": "comes by train"}),
    ("technician", "/patients/{patient}/edit/", "", "Save", {"Note": "comes by bus"}),
    ("technician", "/patients/{patient}/operations/new/", "", "Save",
     {"Operation": "Implant inserted", "Side": "Left", "Day": "2026-02-03", "In words": "round"}),
    ("clinician", "/operations/{operation}/edit/", "", "Save", {"In words": "anatomical"}),
    ("clinician", "/patients/{patient}/consents/new/", "", "Save",
     {"Consent to": "Research, by pseudonym", "Remark": "in the file"}),
    ("technician", "/consents/{consent}/edit/", "", "Save", {"Remark": "on paper"}),
    ("technician", "/visits/new/?patient={patient}", "", "Go on to the photographs",
     {"Rig": "Room 1", "Note": "tired"}),
    ("clinician", "/visits/{visit}/date/", "", "Save", {"Note": "cold room", "Reason": "forgotten"}),
    ("clinician", "/visits/{visit}/", CONCLUDE, "Sign", {"Conclusion": "Symmetrical."}),
    ("careful", "/visits/{visit}/", "Amend the conclusion", "Sign", {"Conclusion": "Nearly symmetrical."}),
    ("careful", "/patients/{patient}/edit/", "", "Save", {"Note": "comes by tram"}),
    ("technician", "/rigs/{rig}/edit/", "", "Save", {"Note": "by the window"}),
    ("administrator", "/rigs/{rig}/edit/", "", "Save", {"Note": "by the door"}),
    ("administrator", "/people/new/", "", "Enter, and show the link",
     {"Name for the login": "greta", "Full name": "Greta Gras", "Clinician": "yes"}),
    ("administrator", "/people/{person}/", "", "Save", {"Full name": "Dr. Eva Efeu"}),
    ("administrator", "/archives/new/", "", "Save", {"Name": "Archive E", "Address": "PACS@10.0.0.5:104"}),
    ("administrator", "/archives/{archive}/", "", "Save", {"Name": "Archive of E"}),
    ("technician", "/visits/{visit}/bin/", "", "Put into the bin", {"Reason": "Taken twice"}),
    ("clinician", "/visits/{other_visit}/move/?patient={patient}", "", "Move the visit", {"Reason": "Wrong patient"}),
    ("technician", "/patients/{patient}/merge/?patient={other_patient}", "", "Merge the records", {"Reason": "Same"}),
]  # fmt: skip
"""Role, page, the fold to open, the button, and what is typed: every form with text."""


def end_session(page: Page) -> None:
    """As `security.Expiry` does: the session's cookie counts no more."""
    page.context.clear_cookies(name="clinic-session")


def code_of_now() -> str:
    """The code that an authenticator shows (RFC 6238, six digits of SHA-1, 30 s)."""
    key = base64.b32decode(SECRET)
    digest = hmac.new(key, struct.pack(">Q", int(time.time()) // 30), "sha1").digest()
    at = digest[-1] & 15
    return f"{(struct.unpack('>I', digest[at : at + 4])[0] & 0x7FFFFFFF) % 1_000_000:06d}"


def log_in_again(page: Page, role: str) -> None:
    """Answer the dialog."""
    dialog = page.get_by_role("dialog", name="Log in again")
    dialog.get_by_label("Password").fill(PASSWORD)
    dialog.get_by_role("button", name="Log in").click()
    if role == "careful":
        code = dialog.get_by_label("Code of your authenticator")
        expect(code).to_be_visible()
        code.fill(code_of_now())
        dialog.get_by_role("button", name="Log in").click()
    expect(dialog).to_be_hidden()


@pytest.mark.requirement("R-KEEP-9")
def test_no_text_is_lost_when_the_session_has_ended(clinic_served: Served) -> None:
    others = {f"other_{what}": key for what, key in clinic_served.keys["other"].items()}
    keys = {**clinic_served.keys["ended"], **others}
    seen_code = 0.0
    for role, where, summary, save, texts in TEXTS:
        if role == "careful":  # a code is accepted once
            time.sleep(max(0.0, 31 - (time.time() - seen_code)))
            seen_code = time.time()
        page = clinic_served.page(role)
        open_form(page, where.format(**keys), summary)
        values = {label: text.format(role=role) for label, text in texts.items()}
        fill(page, values)
        end_session(page)
        main = page.get_by_role("main")
        main.get_by_role("button", name=save, exact=True).click()
        dialog = page.get_by_role("dialog", name="Log in again")
        expect(dialog).to_be_visible()
        for label, text in values.items():
            field = page.locator("main form").get_by_label(label).first  # the dialog makes the page behind it inert
            if text not in ("yes", "Implant inserted", "Left", "Room 1", "Research, by pseudonym"):
                expect(field).to_have_value(text)
        log_in_again(page, role)
        expect(main.get_by_role("button", name=save, exact=True)).to_be_hidden()  # the next page
        expect(page.get_by_text("This form is out of date")).to_be_hidden()
        require_forgotten(page)
        assert page.wrong == []  # type: ignore[attr-defined]
        page.context.close()
    page = clinic_served.page("administrator")
    page.goto(f"/people/{keys['person']}/")
    expect(page.get_by_label("Full name")).to_have_value("Dr. Eva Efeu")


@pytest.mark.requirement("R-KEEP-9")
def test_who_does_not_log_in_keeps_the_text_on_the_page(clinic_served: Served) -> None:
    page = clinic_served.page("technician", width=390)
    page.goto(f"/patients/{clinic_served.keys['draft']['patient']}/edit/")
    page.get_by_label("Note").fill("comes by train")
    end_session(page)
    page.get_by_role("button", name="Save").click()
    picture(page, "ended-form")
    page.get_by_role("button", name="Not now").click()
    expect(page.get_by_label("Note")).to_have_value("comes by train")
    expect(page.get_by_role("button", name="Save")).to_be_enabled()
    page.context.set_offline(True)
    page.get_by_role("button", name="Save").click()
    expect(page.get_by_text("The clinic cannot be reached. Your entries are kept.")).to_be_visible()
    expect(page.get_by_role("button", name="Save")).to_be_enabled()


@pytest.mark.requirement("R-KEEP-9")
@pytest.mark.parametrize("role", ["technician", "clinician"])
def test_a_draft_is_offered_after_a_reload_and_a_login(clinic_served: Served, role: str) -> None:
    page = clinic_served.page(role, width=390)
    address = f"/patients/{clinic_served.keys['draft']['patient']}/edit/"
    page.goto(address)
    page.get_by_label("Note").fill(f"typed by the {role}")
    end_session(page)
    page.reload()  # leads to the login, and back
    page.get_by_label("Name").fill(f"{role}-1")
    page.get_by_label("Password").fill(PASSWORD)
    page.get_by_role("button", name="Log in").click()
    expect(page.get_by_text("Your entries here were not saved.")).to_be_visible()
    expect(page.get_by_label("Note")).not_to_have_value(f"typed by the {role}")
    require_accessible(page)
    require_fitting(page)
    picture(page, "draft")
    page.get_by_role("button", name="Put it back").click()
    expect(page.get_by_label("Note")).to_have_value(f"typed by the {role}")
    page.get_by_role("button", name="Save").click()
    expect(page.get_by_text("The patient's entry is changed.")).to_be_visible()
    page.goto(address)
    expect(page.get_by_label("Note")).to_have_value(f"typed by the {role}")
    expect(page.get_by_text("Your entries here were not saved.")).to_be_hidden()
    # Discarded, it is not offered again.
    page.get_by_label("Note").fill("a slip")
    page.reload()
    page.get_by_role("button", name="Discard it").click()
    page.reload()
    expect(page.get_by_label("Note")).to_have_value(f"typed by the {role}")
    expect(page.get_by_text("Your entries here were not saved.")).to_be_hidden()


@pytest.mark.requirement("R-KEEP-9")
def test_a_conclusion_that_was_not_signed_is_offered(clinic_served: Served) -> None:
    page = clinic_served.page("clinician")
    address = f"/visits/{clinic_served.keys['draft']['visit']}/"
    open_form(page, address, CONCLUDE)
    page.get_by_label("Conclusion").last.fill("Symmetrical.")
    page.goto("/patients/")
    page.goto(address)
    page.get_by_role("button", name="Put it back").click()
    expect(page.get_by_label("Conclusion").last).to_have_value("Symmetrical.")
    page.get_by_role("button", name="Sign").click()
    expect(page.get_by_text("The conclusion is signed.")).to_be_visible()
    require_forgotten(page)


@pytest.mark.requirement("R-KEEP-9")
def test_a_draft_is_compared_with_what_a_colleague_saved_meanwhile(clinic_served: Served) -> None:
    page, other = clinic_served.page("technician"), clinic_served.page("clinician")
    address = f"/operations/{clinic_served.keys['draft']['operation']}/edit/"
    page.goto(address)
    page.get_by_label("In words").fill("round, textured")
    other.goto(address)
    other.get_by_label("In words").fill("anatomical")
    other.get_by_role("button", name="Save").click()
    expect(other.get_by_text("The operation is changed.")).to_be_visible()
    page.reload()
    page.get_by_role("button", name="Put it back").click()
    page.get_by_role("button", name="Save").click()
    expect(page.get_by_role("heading", name="Somebody else changed this meanwhile")).to_be_visible()
    expect(page.get_by_text("anatomical")).to_be_visible()


@pytest.mark.requirement("R-KEEP-9")
def test_a_draft_is_nobody_elses(clinic_served: Served) -> None:
    """Neither after a log-out, in this tab or another, nor after another person's login."""
    address = f"/patients/{clinic_served.keys['draft']['patient']}/edit/"

    def typed(page: Page) -> None:
        page.goto(address)
        page.get_by_label("Note").fill("a secret of mine")
        assert "a secret of mine" in kept(page)

    def log_in(page: Page, name: str) -> None:
        page.get_by_label("Name").fill(name)
        page.get_by_label("Password").fill(PASSWORD)
        page.get_by_role("button", name="Log in").click()

    page = clinic_served.page("technician")
    typed(page)
    end_session(page)
    page.reload()
    log_in(page, "clinician-1")
    expect(page.get_by_label("Note")).to_be_visible()
    assert "a secret" not in kept(page)
    expect(page.get_by_text("Your entries here were not saved.")).to_be_hidden()

    typed(page)
    tab = page.context.new_page()
    tab.goto("/")
    tab.locator(".me summary").click()
    tab.get_by_role("button", name="Log out").click()
    expect(tab.get_by_role("heading", name="Log in")).to_be_visible()
    require_forgotten(page)

    tab.goto(address)
    log_in(tab, "clinician-1")
    typed(tab)
    tab.locator(".me summary").click()
    tab.get_by_role("button", name="Log out").click()
    expect(tab.get_by_role("heading", name="Log in")).to_be_visible()
    require_forgotten(tab)
    tab.goto(address)
    log_in(tab, "clinician-1")
    expect(tab.get_by_label("Note")).to_be_visible()
    expect(tab.get_by_text("Your entries here were not saved.")).to_be_hidden()


# --- a double click

TWICE = [
    ("technician", "/patients/new/", "Save", {"Family name": "Dorn", "Given name": "Dora", "Record number": "D-1"},
     "/patients/?q=D-1", "#rows li"),
    ("technician", "/visits/new/?patient={patient}", "Go on to the photographs", {"Rig": "Room 1"},
     "/patients/{patient}/", "table.visits tbody tr"),
    ("clinician", "/visits/new/?patient={patient}", "Go on to the photographs", {"Rig": "Room 1"},
     "/patients/{patient}/", "table.visits tbody tr"),
    ("technician", "/patients/{patient}/operations/new/", "Save",
     {"Operation": "Implant inserted", "Side": "Left", "Day": "2026-02-03"}, "/patients/{patient}/", "#operations li"),
    ("clinician", "/patients/{patient}/operations/new/", "Save",
     {"Operation": "Implant inserted", "Side": "Left", "Day": "2026-02-04"}, "/patients/{patient}/", "#operations li"),
    ("technician", "/patients/{patient}/consents/new/", "Save", {"Consent to": "Photographs and measurement"},
     "/patients/{patient}/", "#consents li"),
    ("clinician", "/patients/{patient}/consents/new/", "Save", {"Consent to": "Photographs and measurement"},
     "/patients/{patient}/", "#consents li"),
    ("administrator", "/people/new/", "Enter, and show the link", {"Name for the login": "doris", "Technician": "yes"},
     "/people/", "tbody tr"),
    ("administrator", "/archives/new/", "Save", {"Name": "Archive D", "Address": "PACS@10.0.0.5:104"},
     "/archives/", "main li"),
    ("technician", "/rigs/{rig}/", "New calibration", {}, "/rigs/{rig}/", "section[aria-labelledby=h-cals] li"),
]  # fmt: skip


@pytest.mark.requirement("R-KEEP-7")
def test_a_double_click_makes_one_by_clicks(clinic_served: Served) -> None:
    keys = clinic_served.keys["double"]
    for role, where, save, values, counted, rows in TWICE:
        page = clinic_served.page(role)
        page.goto(counted.format(**keys))
        before = page.locator(rows).count()
        page.goto(where.format(**keys))
        fill(page, values)
        page.get_by_role("main").get_by_role("button", name=save, exact=True).dblclick()
        page.wait_for_url(lambda url, where=where: not url.endswith(where.format(**keys)))
        page.goto(counted.format(**keys))
        expect(page.locator(rows)).to_have_count(before + 1)
        assert page.wrong == []  # type: ignore[attr-defined]
        page.context.close()


@pytest.mark.requirement("R-KEEP-7")
def test_buttons_wait_while_a_form_is_sent_and_can_be_used_again(clinic_served: Served) -> None:
    page = clinic_served.page("technician")
    address = f"/patients/{clinic_served.keys['double']['patient']}/edit/"
    page.goto(address)
    sent = []

    def slow(route: Route) -> None:
        if route.request.method == "POST":
            sent.append(route.request.post_data)
            time.sleep(0.5)
        route.continue_()

    page.route(f"**{address}", slow)
    page.get_by_label("Note").fill("comes by train")
    button = page.get_by_role("button", name="Save")
    three = "button => { button.click(); button.click(); button.form.requestSubmit(); return button.disabled; }"
    assert button.evaluate(three) is True
    expect(page.get_by_text("The patient's entry is changed.")).to_be_visible()
    assert len(sent) == 1
    page.go_back()
    expect(page.get_by_role("button", name="Save")).to_be_enabled()
    # As a browser does that keeps the page as it was left.
    page.evaluate("document.querySelector('main form').addEventListener('submit', e => 0)")
    button = page.get_by_role("button", name="Save")
    page.route("**/account/token/", lambda route: None)  # never answered
    button.click()
    expect(button).to_be_disabled()
    page.evaluate("window.dispatchEvent(new PageTransitionEvent('pageshow', {persisted: true}))")
    expect(button).to_be_enabled()
