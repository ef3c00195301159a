"""By clicks, as each role, on both databases: repeats, what is not comparable, sending unconfirmed, and erasing."""

import shutil
import subprocess
import sys
from contextlib import nullcontext
from pathlib import Path

import pytest
from playwright.sync_api import expect, sync_playwright
from tests.clinic_browser import AXE, CHROMIUM_FLAGS, cookies, opened, require_accessible, require_fitting
from tests.clinic_server import command, served
from tests.postgresql import ABSENT, binaries, server

CHROMIUM = shutil.which("chromium")
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(CHROMIUM is None, reason="no chromium on this machine: apt-get install chromium"),
    pytest.mark.skipif(not AXE.exists(), reason="no axe-core: the bundles are not built (hatch_build.py)"),
]
# A clinic with a patient of three visits: one with another wall, then two of one day. Prints their keys and pseudonym.
_FILL = """
import datetime, sys
from pathlib import Path
from mammometry.clinic.config import new_clinic
from mammometry.clinic.web.server import migrate
migrate(new_clinic(Path(sys.argv[1]), name="Clinic", second_factor="offered", database=sys.argv[2]))
from mammometry.clinic.models import Consent, Destination, Measurement, Patient, Rig, Visit, Volume
from mammometry.clinic.records.results import add_volumes
patient = Patient.objects.create(family_name="Zypernkatze", given_name="Quirina", record_number="KIS-4711")
Consent.objects.create(patient=patient, purpose="research", given_on="2026-01-01")
Consent.objects.create(patient=patient, purpose="pictures", given_on="2026-01-01")
Destination.objects.create(name="PACS", address="PACS@127.0.0.1:104")
rig = Rig.objects.create(name="Room 1", definition={"rig": {"pairs": []}})
noon = datetime.datetime(2026, 3, 1, 12, tzinfo=datetime.UTC)
for days, wall in ((0, "plane"), (40, "rounded-membrane"), (40.1, "rounded-membrane")):
    visit = Visit.objects.create(
        patient=patient, rig=rig, taken_at=noon + datetime.timedelta(days=days), state="measured", posture="leaning"
    )
    how = {"settings": {}, "walls": {"left": wall, "right": wall}, "boundaries": {"left": "drawn", "right": "drawn"}}
    made = Measurement.objects.create(visit=visit, digest=str(days), made_at=noon, software="1", how=how)
    add_volumes(made, [
        Volume(side=side, definition="named wall", volume_cc=400 + days + add, low_cc=380 + days + add,
               high_cc=430 + days + add) for side, add in (("left", 0), ("right", 60))
    ])
    report = visit.folder / "results" / "report"
    report.mkdir(parents=True)
    (report / "report.pdf").write_bytes(b"%PDF-1.4")
    print(visit.pk)
print(patient.pseudonym, patient.pk)
"""


@pytest.mark.parametrize("database", ["sqlite", "postgresql"])
def test_records_are_kept_right_by_clicks(tmp_path: Path, database: str) -> None:
    if database == "postgresql" and binaries() is None:
        pytest.skip(ABSENT)
    folder = tmp_path / "clinic"
    with server() if database == "postgresql" else nullcontext(database) as address:
        words = [sys.executable, "-c", _FILL, str(folder), address]
        done = subprocess.run(words, capture_output=True, text=True, check=False, timeout=120)
        assert done.returncode == 0, done.stderr
        first, second, third, pseudonym, patient = done.stdout.split()
        logins = cookies(folder)
        command("backup", str(folder), "--to", str(tmp_path / "elsewhere.tar"))
        with served(folder, "--no-jobs") as (place, _), sync_playwright() as playwright:
            browser = playwright.chromium.launch(executable_path=CHROMIUM, args=CHROMIUM_FLAGS)
            pages = {role: opened(browser, f"http://{place}", login, width=1280) for role, login in logins.items()}

            page = pages["technician"]
            page.goto(f"/visits/{third}/")
            page.get_by_text("Occasion, posture and repeat").click()
            page.get_by_label("Repeat of").select_option(value=second)
            require_accessible(page)
            page.get_by_role("button", name="Save").click()
            expect(page.get_by_text("Occasion, posture and repeat are changed.")).to_be_visible()
            expect(page.get_by_role("link", name="10 Apr 2026", exact=True).first).to_be_visible()

            page = pages["clinician"]
            page.goto(f"/patients/{patient}/")
            expect(page.locator("ul.apart li").last).to_contain_text("another wall (plane instead of rounded-membrane)")
            expect(page.locator("ul.apart").last).to_be_visible()
            assert page.locator("svg.broad polyline.way").count() == 4  # two sides, each with two lines
            assert page.locator("svg.broad g.apart").count() == 2
            require_accessible(page)
            for width in (390, 1280):
                page.set_viewport_size({"width": width, "height": 900})
                require_fitting(page)
            page.goto(f"/visits/{first}/send/")
            page.get_by_role("button", name="Send to PACS").click()
            expect(page.get_by_text("The boundaries of this visit are not confirmed.")).to_be_visible()
            require_accessible(page)
            page.get_by_role("button", name="Send unconfirmed").click()
            expect(page.get_by_text("The results are being sent to PACS.")).to_be_visible()

            page = pages["researcher"]
            page.goto("/study/")
            expect(page.get_by_text("Listed separately, not in the median")).to_be_visible()
            expect(page.get_by_text("apart: another wall").first).to_be_visible()
            expect(page.get_by_text("3 patients with a visit that was entered as a repeat")).to_be_visible()
            require_accessible(page)

            page = pages["administrator"]
            page.goto("/erase/")
            page.get_by_label("Pseudonym", exact=True).fill(pseudonym)
            page.get_by_role("button", name="Show what would be deleted").click()
            expect(page.get_by_text(f"The backup {tmp_path / 'elsewhere.tar'}")).to_be_visible()
            require_accessible(page)
            page.get_by_label("Type the pseudonym again").fill(pseudonym)
            page.get_by_role("button", name="Erase for ever").click()
            expect(page.get_by_text(f"{pseudonym} is erased")).to_be_visible()
            expect(page.get_by_text(f"The backup {tmp_path / 'elsewhere.tar'}")).to_be_visible()
            assert all(page.wrong == [] for page in pages.values())  # type: ignore[attr-defined]
            browser.close()
        made = command("backup", str(folder))
        assert made["backup"]
        command("test-restore", str(folder), timeout_s=300)
