"""What pages of the clinic say: charts, changes, search, empty places, and names only where they belong."""

import datetime
import errno
import json
import sqlite3
from collections.abc import Callable
from contextlib import closing
from itertools import pairwise
from zipfile import ZipFile

import pytest
from django.db import OperationalError
from django.test import Client
from django.urls import reverse
from django.utils import timezone
from tests.clinic_forms import filled, refused

from mammometry.clinic.config import ClinicConfig
from mammometry.clinic.models import Consent, Drawing, Measurement, Patient, Person, Rig, Visit, Volume
from mammometry.clinic.records.charts import ChartReading, round_levels, time_line
from mammometry.clinic.records.results import age
from mammometry.clinic.roles import Role
from mammometry.clinic.views import results
from mammometry.report.documents.rendering import RenderedReport

NOON = datetime.datetime(2026, 3, 1, 12, tzinfo=datetime.UTC)


def measured(
    patient: Patient, rig: Rig, days: int, volumes: dict[str, tuple[float, float]], **of_visit: object
) -> Visit:
    """A visit with one volume a side, before the named wall: centre and half-width of its interval, cc."""
    visit = Visit.objects.create(
        patient=patient, rig=rig, taken_at=NOON + datetime.timedelta(days=days), state="measured", **of_visit
    )
    measurement = Measurement.objects.create(visit=visit, digest=f"{days:064d}", made_at=NOON, software="1")
    for side, (volume, half) in volumes.items():
        low, high = volume - half, volume + half
        Volume.objects.create(
            measurement=measurement,
            side=side,
            definition="named wall",
            leads=True,
            volume_cc=volume,
            low_cc=low,
            high_cc=high,
        )
    return visit


@pytest.fixture
def rig(clinic: ClinicConfig) -> Rig:
    return Rig.objects.create(name="Room 1", definition={"rig": {"name": "r", "pairs": []}})


@pytest.fixture
def patient(clinic: ClinicConfig) -> Patient:
    patient = Patient.objects.create(
        family_name="Zypernkatze", given_name="Quirina", record_number="KIS-4711", born="1980-02-29"
    )
    Consent.objects.create(patient=patient, purpose="research", given_on=NOON.date())
    return patient


# --- numbers and pictures ---


def test_the_time_line_keeps_order_scale_and_edges() -> None:
    readings = [
        ChartReading(side, NOON + datetime.timedelta(days=days), value, value - 10, value + 15, "words")
        for side, value in (("left", 400.0), ("right", 450.0))
        for days in (0, 30, 90)
    ]
    chart = time_line(readings, width=340, height=250)
    assert chart is not None
    left = [spot for spot in chart.spots if spot.series == "left"]
    assert (left[1].x - left[0].x) * 2 == pytest.approx(left[2].x - left[1].x, abs=0.2)  # 30 days and 60
    px_per_cc = (left[0].low_y - left[0].high_y) / 25
    right = next(spot for spot in chart.spots if spot.series == "right")
    assert (left[0].y - right.y) / 50 == pytest.approx(px_per_cc, rel=0.01)
    assert all(0 <= spot.high_y < spot.y < spot.low_y <= chart.bottom for spot in chart.spots)
    assert all(0 < spot.x < chart.width for spot in chart.spots)
    assert chart.dates[-1].words == "30 May 2026"
    one = time_line(readings[:1], width=340, height=250)
    assert one is not None
    assert one.spots[0].low_y - one.spots[0].high_y < 100  # an interval alone does not fill the chart
    assert time_line([], width=340, height=250) is None


@pytest.mark.parametrize(("low", "high"), [(376.0, 476.0), (0.2, 0.9), (-40.0, 900.0), (399.0, 401.5)])
def test_levels_are_round_and_inside(low: float, high: float) -> None:
    levels = round_levels(low, high)
    assert 2 <= len(levels) <= 6
    assert low <= levels[0] < levels[-1] <= high
    assert len({round(b - a, 9) for a, b in pairwise(levels)}) == 1


def test_full_years_are_counted_to_the_birthday() -> None:
    born = datetime.date(1980, 2, 29)
    assert age(born, datetime.date(2026, 2, 28)) == 45
    assert age(born, datetime.date(2026, 3, 1)) == 46
    assert age(None, datetime.date(2026, 3, 1)) is None


# --- pages ---


def test_study_pages_hold_pseudonyms_and_no_names(client_of: Callable[..., Client], patient: Patient, rig: Rig) -> None:
    measured(patient, rig, 0, {"left": (400, 5)}, note="Quirina called")
    client = client_of(Role.RESEARCHER)
    for path in ("/study/", "/study/cohort.csv"):
        text = client.get(path).content.decode()
        assert patient.pseudonym in text
        for secret in ("Zypern", "Quirina", "4711", "1980", str(patient.pk)):
            assert secret not in text, (path, secret)
    assert client.get("/").headers["Location"] == "/study/"


def test_a_name_with_markup_is_shown_as_text(client_of: Callable[..., Client], clinic: ClinicConfig) -> None:
    client = client_of(Role.TECHNICIAN)
    entered = {"family_name": "<script>alert(1)</script>", "given_name": "\"'><b>", "record_number": "1", "note": "<i>"}
    answer = client.post("/patients/new/", entered, follow=True)
    text = answer.content.decode()
    assert "&lt;script&gt;alert(1)&lt;/script&gt;" in text
    for raw in ("<script>alert", "<b>", "<i>"):
        assert raw not in text


def test_every_page_has_no_inline_script_or_style(client_of: Callable[..., Client], patient: Patient, rig: Rig) -> None:
    visit = measured(patient, rig, 0, {"left": (400, 5), "right": (450, 6)})
    empty = Visit.objects.create(patient=patient, rig=rig, taken_at=timezone.now())
    Drawing.objects.create(visit=visit, item="boundary left", action="confirmed")
    client = client_of(*Role)
    pages = [
        *(
            "/",
            "/help/",
            "/patients/",
            "/patients/?q=nobody",
            "/patients/new/",
            "/visits/new/",
            "/jobs/page/",
            "/rigs/",
        ),
        *(
            "/rigs/new/",
            "/study/",
            *("/administration/", "/people/", "/people/new/", "/audit/", "/backups/", "/disk/"),
            "/erase/",
            "/settings/",
            f"/rigs/{rig.pk}/",
        ),
        *(f"/patients/{patient.pk}/", f"/patients/{patient.pk}/edit/", f"/patients/{patient.pk}/compare/"),
        *(
            f"/visits/{visit.pk}/",
            f"/visits/{empty.pk}/",
            f"/visits/{visit.pk}/?photographs=1",
            f"/visits/{visit.pk}/draw/",
        ),
    ]
    for path in pages:
        answer = client.get(path)
        text = answer.content.decode()
        assert answer.status_code == 200, path
        assert "<style" not in text, path
        assert " style=" not in text, path
        assert " on" not in "".join(part.split(">")[0] for part in text.split("<button")[1:]), path
        assert "<script>" not in text, path
        assert "Help" in text, path
        assert text.count("<h1") == 1, path


def test_a_rig_needs_a_description_that_is_one(client_of: Callable[..., Client], clinic: ClinicConfig) -> None:
    from django.core.files.uploadedfile import SimpleUploadedFile

    client = client_of(Role.ADMINISTRATOR)
    good = """
format = 1
units = "mm"
[rig]
name = "pair"
pairs = [{ name = "front", left = "front_left", right = "front_right" }]
[target]
kind = "charuco"
squares = [14, 10]
square_mm = 25.0
marker_mm = 18.0
dictionary = "DICT_5X5_250"
[subject]
kind = "torso"
"""
    for text, said in (
        (good.replace("pairs =", "pears ="), "pairs"),
        (good.replace("25.0", "0.025").replace("18.0", "0.018"), "25 mm would fit"),
        ("[", "cannot be read as TOML"),
        ("format = 1", "no table [rig]"),
        (None, "needs its description"),
    ):
        sent: dict[str, object] = {"name": "Room 2", "active": "on"}
        if text is not None:
            sent["described_by"] = SimpleUploadedFile("session.toml", text.encode())
        answer = client.post("/rigs/new/", sent)
        assert said in answer.content.decode()
        assert not Rig.objects.exists()
    sent = {"name": "Room 2", "active": "on", "described_by": SimpleUploadedFile("session.toml", good.encode())}
    client.post("/rigs/new/", sent)
    assert Rig.objects.get().definition["rig"]["pairs"][0]["left"] == "front_left"


def test_an_administrator_stays_one(client_of: Callable[..., Client], person_of: Callable[..., Person]) -> None:
    client = client_of(Role.ADMINISTRATOR)
    own = person_of(Role.ADMINISTRATOR)
    for data in ({"roles": ["clinician"], "is_active": "on"}, {"roles": ["administrator"]}):
        path = reverse("person", args=[own.pk])
        answer = client.post(path, filled(client, path, **{"is_active": None, **data}))
        assert refused(answer)
        own.refresh_from_db()
        assert (own.roles, own.is_active) == (["administrator"], True)
    path = reverse("person-new")
    made = client.post(
        path, {"username": "new", "full_name": "N", "roles": ["technician"], "is_active": "on"}, follow=True
    )
    assert "/account/invitation/" in made.content.decode()
    assert Person.objects.get(username="new").roles == ["technician"]


def test_a_report_is_sealed_off_and_its_scene_is_given(
    client_of: Callable[..., Client], patient: Patient, rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    visit = measured(patient, rig, 0, {"left": (400, 5)})
    client = client_of(Role.CLINICIAN)
    assert client.get(f"/visits/{visit.pk}/report/").status_code == 404
    assert client.get(f"/visits/{visit.pk}/scene/").status_code == 404
    folder = visit.folder / "results" / "report"
    folder.mkdir(parents=True)
    page = "<html><script>let x = 1;</script></html>"
    (folder / "report.html").write_text(page)
    assert client.get(f"/visits/{visit.pk}/scene/").status_code == 404
    (folder / "content.zip").write_bytes(b"damaged")
    assert client.get(f"/visits/{visit.pk}/scene/").status_code == 404
    with ZipFile(folder / "content.zip", "w") as content:
        content.writestr("scene.json", json.dumps({"models": []}))
    rendered = RenderedReport(html=page.encode(), pdf=b"", warnings=())
    monkeypatch.setattr(results, "rendered_report", lambda _: rendered)
    answer = client.get(f"/visits/{visit.pk}/report/")
    policy = answer.headers["Content-Security-Policy"]
    assert "sandbox allow-scripts" in policy
    assert "allow-same-origin" not in policy
    assert "'unsafe-inline'" not in policy.split("script-src")[1].split(";")[0]
    assert client.get(f"/visits/{visit.pk}/scene/").json() == {"models": []}


def full_sqlite() -> OperationalError:
    """Django's error of a database that may not grow."""
    with closing(sqlite3.connect(":memory:")) as database:
        database.execute("PRAGMA max_page_count = 2")
        database.execute("CREATE TABLE a (b)")
        try:
            database.execute("INSERT INTO a VALUES (zeroblob(100000))")
        except sqlite3.OperationalError as error:
            full = OperationalError(*error.args)
            full.__cause__ = error
            return full
    raise AssertionError("it had room")


def full_postgresql() -> OperationalError:
    """Django's error of a German server."""
    full = OperationalError("konnte Datei »base/5/1259« nicht erweitern: Auf dem Gerät ist kein Speicherplatz mehr")
    full.__cause__ = pytest.importorskip("psycopg").errors.DiskFull()
    return full


@pytest.mark.parametrize(
    "make", [lambda: OSError(errno.ENOSPC, "No space left on device"), full_sqlite, full_postgresql]
)
def test_a_full_disk_is_said_and_is_no_defect(
    client_of: Callable[..., Client], monkeypatch: pytest.MonkeyPatch, make: Callable[[], Exception]
) -> None:
    client, error = client_of(Role.TECHNICIAN), make()
    client.raise_request_exception = False

    def fails(self: Patient, *_: object, **__: object) -> None:
        raise error

    monkeypatch.setattr(Patient, "save", fails)
    sent = {"family_name": "Müller", "given_name": "Anna", "record_number": "KIS-1"}
    answer = client.post(reverse("patient-new"), sent)
    assert answer.status_code == 507
    assert "disk" in answer.content.decode()
    monkeypatch.setattr(Patient, "save", lambda *_, **__: 1 / 0)
    assert client.post(reverse("patient-new"), sent).status_code == 500
