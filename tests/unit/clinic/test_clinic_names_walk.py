"""Names in Kanji, Arabic, Cyrillic, Devanagari by clicks, as each role, on both databases, read back from the PDF."""

import io
import json
import shutil
import subprocess
import sys
import unicodedata
from contextlib import nullcontext
from pathlib import Path

import pydicom
import pypdf
import pytest
from playwright.sync_api import Page, expect, sync_playwright
from tests.clinic_browser import AXE, CHROMIUM_FLAGS, cookies, opened, require_accessible, require_fitting
from tests.clinic_server import served
from tests.postgresql import ABSENT, binaries, server
from tests.unit.clinic.test_clinic_numbers import unzipped

CHROMIUM = shutil.which("chromium")
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(CHROMIUM is None, reason="no chromium on this machine: apt-get install chromium"),
    pytest.mark.skipif(not AXE.exists(), reason="no axe-core: the bundles are not built (hatch_build.py)"),
]
# A clinic with a patient whose scan is measured. Prints the keys of visit and patient as JSON.
_FILL = """
import json, sys
from pathlib import Path
from mammometry.clinic.config import new_clinic
from mammometry.clinic.web.server import migrate
migrate(new_clinic(Path(sys.argv[1]), name="Clinic", second_factor="offered", database=sys.argv[2]))
from django.test import Client
from django.test.utils import setup_test_environment
setup_test_environment()  # its name of this machine is allowed
from mammometry.clinic.models import Patient, Person
from tests.unit.clinic.test_clinic_numbers import measured
client = Client()
person = Person.objects.create(username="filler", roles=["technician"])
client.force_login(person, backend="allauth.account.auth_backends.AuthenticationBackend")
patient = Patient.objects.create(family_name="Müller", given_name="Siobhán", record_number="KIS-1", born="1979-05-14")
visit = measured(client, patient, Path(sys.argv[3]))
print(json.dumps({"visit": str(visit.pk), "patient": str(patient.pk)}))
"""
NAMES = (("山田", "花子"), ("عبد الله", "فاطمة"), ("Їжакевич", "Ґанна"), ("शर्मा", "क्षितिज"))
SURGEON = "د. محمد علي"


def text_of(document: bytes) -> str:
    """What a reader of PDF finds on the first page."""
    return " ".join(unicodedata.normalize("NFC", pypdf.PdfReader(io.BytesIO(document)).pages[0].extract_text()).split())


def enter_names(page: Page, patient: str, family: str, given: str) -> None:
    page.goto(f"/patients/{patient}/")
    page.get_by_text("Correct …", exact=True).click()
    page.get_by_role("link", name="Change the entry").click()
    page.get_by_label("Family name").fill(family)
    page.get_by_label("Given name").fill(given)
    page.get_by_role("button", name="Save").click()


def document_of(page: Page, visit: str) -> bytes:
    page.goto(f"/visits/{visit}/")
    with page.expect_download() as loading:
        page.get_by_role("link", name="PDF", exact=True).click()
    return Path(loading.value.path()).read_bytes()


def walk(folder: Path, visit: str, patient: str) -> None:
    """Each role's clicks in a clinic that runs."""
    logins = cookies(folder)
    with served(folder, "--no-jobs") as (place, _), sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=CHROMIUM_FLAGS)
        pages = {role: opened(browser, f"http://{place}", login, width=1280) for role, login in logins.items()}

        page = pages["administrator"]
        page.goto("/people/")
        page.get_by_role("link", name="Clinician One").click()
        page.get_by_label("Full name").fill(f"{SURGEON}\u202e")
        page.get_by_role("button", name="Save").click()
        expect(page.get_by_text("the format character U+202E RIGHT-TO-LEFT OVERRIDE at position")).to_be_visible()
        page.get_by_label("Full name").fill(SURGEON)
        page.get_by_role("button", name="Save").click()

        page = pages["technician"]
        enter_names(page, patient, "Moser\u202e", "Anna")
        expect(page.get_by_text("the format character U+202E RIGHT-TO-LEFT OVERRIDE at position 6")).to_be_visible()

        surgeon = pages["clinician"]
        surgeon.goto(f"/visits/{visit}/")
        surgeon.get_by_role("textbox", name="Conclusion").fill("الثديان متماثلان.")
        surgeon.get_by_role("button", name="Sign").click()
        expect(surgeon.get_by_text(f"Signed by \u2068{SURGEON}\u2069")).to_be_visible()
        for family, given in NAMES:
            enter_names(page, patient, family, given)
            expect(page.get_by_role("heading", name=f"{family}, {given}")).to_be_visible()
            for width in (390, 1280):
                page.set_viewport_size({"width": width, "height": 900})
                require_fitting(page)
            require_accessible(page)
            first = text_of(document_of(surgeon, visit))
            for part in (family, given, SURGEON, "الثديان متماثلان"):
                assert part in first
        sent = surgeon.request.get(f"/visits/{visit}/dicom.zip")
        assert sent.status == 200, sent.text()
        objects = [pydicom.dcmread(io.BytesIO(each)) for each in unzipped(sent.body()).values()]
        (encapsulated,) = [each for each in objects if each.get("MIMETypeOfEncapsulatedDocument") == "application/pdf"]
        assert str(encapsulated.PatientName) == "शर्मा^क्षितिज"
        assert "शर्मा" in text_of(encapsulated.EncapsulatedDocument)

        page = pages["researcher"]
        page.goto("/study/")
        assert not any(name in page.content() for names in NAMES for name in names)
        assert all(page.wrong == [] for page in pages.values())  # type: ignore[attr-defined]
        browser.close()


@pytest.mark.requirement("R-NAME-1")
@pytest.mark.requirement("R-NAME-2")
@pytest.mark.parametrize("database", ["sqlite", "postgresql"])
def test_names_of_other_scripts_are_read_back_from_the_document(tmp_path: Path, database: str) -> None:
    if database == "postgresql" and binaries() is None:
        pytest.skip(ABSENT)
    folder = tmp_path / "clinic"
    (tmp_path / "scan").mkdir()
    with server() if database == "postgresql" else nullcontext(database) as address:
        filling = [sys.executable, "-c", _FILL, str(folder), address, str(tmp_path / "scan")]
        done = subprocess.run(filling, capture_output=True, text=True, check=False, timeout=900)
        assert done.returncode == 0, done.stderr
        keys = json.loads(done.stdout.splitlines()[-1])
        walk(folder, keys["visit"], keys["patient"])
