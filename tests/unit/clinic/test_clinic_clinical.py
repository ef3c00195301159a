"""What the clinic knows of a visit beside its numbers: operations, postures, consents, conclusions."""

import datetime
import json
import re
from collections.abc import Callable

import pytest
from auditlog.models import LogEntry
from django.test import Client
from django.urls import reverse
from django.utils import timezone
from tests.clinic_forms import filled, refused

from mammometry.clinic.models import (
    Comparison,
    Conclusion,
    Confirmation,
    Consent,
    Measurement,
    Operation,
    Person,
    Upload,
    Visit,
    Volume,
)
from mammometry.clinic.records.clinical import clinical_of, operation_words
from mammometry.clinic.records.operations import Retention, phase_of, retentions
from mammometry.clinic.records.results import latest
from mammometry.clinic.roles import Role
from mammometry.report.words.anthropometry import length_table

TODAY = timezone.localdate


@pytest.fixture
def surgeon(clinic: object) -> Person:
    return Person.objects.create(username="sergio", full_name="Dr. Sergio Surgeon", roles=["clinician"])


def operated(visit: Visit, days: int, **of_operation: object) -> Operation:
    """An operation some days before a visit; after it where the number is negative."""
    day = timezone.localtime(visit.taken_at).date() - datetime.timedelta(days=days)
    values = {"patient": visit.patient, "kind": "graft", "side": "left", "day": day, **of_operation}
    return Operation.objects.create(**values)  # type: ignore[arg-type]


def measured(visit: Visit, days: int, left: tuple[float, float] | None, **of_visit: object) -> Visit:
    """Another visit of the same patient some days later, and its volume: centre and half-width, cc."""
    values = {"patient": visit.patient, "rig": visit.rig, "state": "measured", **of_visit}
    later = Visit.objects.create(taken_at=visit.taken_at + datetime.timedelta(days=days), **values)
    measurement = Measurement.objects.create(visit=later, digest=f"d{days}", made_at=timezone.now(), software="1")
    if left is not None:
        Volume.objects.create(
            measurement=measurement, side="left", definition="named wall", leads=True, volume_cc=left[0],
            low_cc=left[0] - left[1], high_cc=left[0] + left[1],
        )  # fmt: skip
    return later


# --- what reports and exports are given


def test_a_report_is_given_what_the_database_knows(visit: Visit, surgeon: Person) -> None:
    visit.occasion, visit.posture = Visit.Occasion.WEEKS_6, Visit.Posture.STANDING
    visit.save()
    old = Measurement.objects.create(visit=visit, digest="1", made_at=timezone.now(), software="1")
    Confirmation.objects.create(measurement=old, by=surgeon)
    clinical = clinical_of(Visit.objects.get(pk=visit.pk))
    assert (clinical.patient, clinical.record) == ("Zypernkatze, Quirina", "KIS-4711")
    assert clinical.born == datetime.date(1980, 2, 29)
    assert (clinical.occasion, clinical.posture) == ("6 weeks after", "standing")
    assert clinical.confirmed is not None
    assert clinical.confirmed.by == "Dr. Sergio Surgeon"
    new = Measurement.objects.create(visit=visit, digest="2", made_at=timezone.now(), software="1")
    assert clinical_of(visit).confirmed is None  # the confirmation was of the earlier result
    for text, result in (("Symmetrical.", old), ("Not quite symmetrical.", new)):
        Conclusion.objects.create(visit=visit, measurement=result, text=text, by=surgeon)
    told = [conclusion.text for conclusion in clinical_of(visit).conclusions]
    assert told[0] == "Not quite symmetrical."
    assert re.fullmatch(r"Symmetrical\.\n\(.+\)", told[1])  # it was of an earlier result


def test_operations_after_the_visit_are_not_told(visit: Visit) -> None:
    operated(visit, 60, volume_cc=120.0)
    operated(visit, 20, kind="reduction", side="both", resected_g=310.5, words="inferior pedicle")
    operated(visit, -1, kind="implant")
    day = (timezone.localtime(visit.taken_at).date() - datetime.timedelta(days=20)).isoformat()
    told = clinical_of(visit).operations
    assert len(told) == 2
    assert f", {day}, 310.5 g" in told[0]
    assert "120 cc" in told[1]


def test_a_visit_before_the_operation_of_its_own_day_does_not_show_it(visit: Visit) -> None:
    operation = operated(visit, 0, kind="implant", volume_cc=300.0)
    assert clinical_of(visit).operations == (operation_words(operation),)
    visit.occasion = Visit.Occasion.BEFORE
    assert clinical_of(visit).operations == ()


def test_codes_of_operations_are_in_pydicoms_dictionary() -> None:
    from pydicom.sr._concepts_dict import concepts

    from mammometry.hospital.codes import OPERATIONS

    known = {code for codes in concepts["SCT"].values() for code in codes}
    assert set(OPERATIONS) == set(Operation.Kind.values)
    coded = [code for code in OPERATIONS.values() if code is not None]
    assert coded
    assert {code.value for code in coded} <= known


# --- the time line


def test_a_visit_is_told_by_the_operation_before_it(visit: Visit) -> None:
    assert phase_of(visit, []) == ""
    first = operated(visit, 30, kind="filling")
    assert phase_of(visit, [first]) == "after the filling"
    rows = [first, operated(visit, 10, kind="filling"), operated(visit, -10, kind="filling")]
    assert "second filling" in phase_of(visit, rows)
    assert phase_of(visit, [operated(visit, -10, kind="implant")]) == "before the operation"


def kept(visit: Visit) -> list[Retention]:
    visits = visit.patient.visits.prefetch_related("measurements__volumes")
    return retentions(list(visit.patient.operations.all()), latest(visits))


def test_what_stays_of_a_graft_has_the_interval_of_both_volumes(visit: Visit) -> None:
    measured(visit, 0, (400.0, 12.0))
    measured(visit, 60, (460.0, 16.0))
    operated(visit, -10, volume_cc=100.0)
    (retention,) = kept(visit)
    assert retention.percent == pytest.approx(60.0)
    assert retention.interval_percent == pytest.approx((40.0, 80.0))  # 12 and 16 cc, squared and added: 20 cc
    before, after = visit.patient.visits.filter(measurements__isnull=False).order_by("taken_at")
    digests = ":".join(one.measurements.get().digest for one in (before, after))
    row = Comparison.objects.create(
        before=before, after=after, of=digests, state="done", made_at=timezone.now(),
        table={"breasts": {"left": {"change_cc": 57.0, "change_interval_cc": [50.0, 64.0]}}},
    )  # fmt: skip
    (retention,) = kept(visit)
    assert (retention.percent, retention.interval_percent) == (pytest.approx(57.0), pytest.approx((50.0, 64.0)))
    Comparison.objects.filter(pk=row.pk).update(of="an earlier measurement:d60")
    assert kept(visit)[0].percent == pytest.approx(60.0)


@pytest.mark.parametrize(
    ("volume_cc", "before", "after", "posture", "other", "why"),
    [
        (None, 400.0, 460.0, "leaning", None, "injected"),
        (100.0, None, 460.0, "leaning", None, "visit before"),
        (100.0, 400.0, None, "leaning", None, "visit after"),
        (100.0, 400.0, 460.0, "standing", None, "posture"),
        (100.0, 400.0, 460.0, "leaning", -20, "nother operation"),
    ],
)
def test_where_nothing_can_be_said_of_a_graft_the_page_says_why(
    visit: Visit,
    client_of: Callable[..., Client],
    volume_cc: float | None,
    before: float | None,
    after: float | None,
    posture: str,
    other: int | None,
    why: str,
) -> None:
    measured(visit, 0, None if before is None else (before, 12.0))
    measured(visit, 60, None if after is None else (after, 12.0), posture=posture)
    visit.delete()
    operated(visit, -10, volume_cc=volume_cc)
    if other is not None:
        operated(visit, other, kind="implant", side="both")
    (retention,) = kept(visit)
    assert retention.percent is None
    assert why in retention.why
    page = client_of(Role.TECHNICIAN).get(reverse("patient", args=[visit.patient_id])).content.decode()
    assert retention.why in page


# --- numbers that surgeons plan with


def quantity(code: str, side: str, value: float, **more: object) -> dict[str, object]:
    return {"code": code, "title": code, "side": side, "value": value, "unit": "mm", "method": "straight", **more}


def test_lengths_stand_in_clinical_order_with_their_differences() -> None:
    table = length_table(
        [
            quantity("projection", "left", 60.0, sigma=1.0),
            quantity("projection", "right", 50.0, interval_95=[46.0, 54.0]),
            quantity("n_midline_straight", "left", 110.0, sigma=2.0),
            quantity("sn_n_straight", "left", 230.0, sigma=2.0),
            quantity("n_n_straight", "", 205.0, sigma=2.0),
        ]
    )
    assert table is not None
    rows = {row.title: row for row in table.rows}
    to_notch, to_fold, to_midline = list(rows.values())[:3]
    difference = rows["Projection"].difference
    assert difference is not None
    assert difference.value_mm == pytest.approx(10.0)
    assert difference.half_mm == pytest.approx((1.96**2 + 4.0**2) ** 0.5)
    assert to_notch.missing[0] == ""
    assert re.search("nipple.*notch", to_notch.missing[1])
    assert "fold" in to_fold.missing[0]
    assert to_midline.difference is None
    assert table.nipples is not None
    assert table.has_gaps
    assert length_table([]) is None


def test_a_side_without_a_breast_has_no_landmarks_to_mark() -> None:
    table = length_table([quantity("projection", "left", 60.0)])
    assert table is not None
    assert {row.missing[1] for row in table.rows} == {"no breast"}


def test_the_visit_page_shows_lengths_and_sends_a_clinician_to_the_landmarks(
    visit: Visit, client_of: Callable[..., Client]
) -> None:
    quantities = [quantity("projection", side, 60.25, sigma=1.0) for side in ("left", "right")]
    Measurement.objects.create(visit=visit, digest="1", made_at=timezone.now(), software="1", quantities=quantities)
    address = reverse("visit", args=[visit.pk])
    page = client_of(Role.CLINICIAN).get(address).content.decode()
    assert "60.2 ±\u00a02.0" in page
    assert f'href="{reverse("draw", args=[visit.pk])}"' in page
    page = client_of(Role.TECHNICIAN).get(address).content.decode()
    assert reverse("draw", args=[visit.pk]) not in page
    assert "landmarks" in page


# --- who a page is about


@pytest.mark.parametrize("name", ["visit", "visit-capture", "draw", "visit-send"])
def test_every_page_of_a_visit_says_whose_it_is(visit: Visit, client_of: Callable[..., Client], name: str) -> None:
    operated(visit, 3)
    Visit.objects.filter(pk=visit.pk).update(posture="leaning")
    upload = Upload.objects.create(visit=visit, camera="front_left", size_bytes=1, state="placed")
    upload.path.with_suffix(".webp").write_bytes(b"a picture")
    if name == "draw":  # only a measured visit is drawn on
        Measurement.objects.create(visit=visit, digest="1", made_at=timezone.now(), software="1")
    page = client_of(Role.CLINICIAN, Role.TECHNICIAN).get(reverse(name, args=[visit.pk])).content.decode()
    banner = page[page.index('class="banner"') : page.index("<h1")]
    years = (TODAY() - datetime.date(1980, 3, 1)).days // 365.25
    for words in ("Zypernkatze, Quirina", "29 Feb 1980", f"({years:.0f} years)", "KIS-4711", visit.patient.pseudonym):
        assert words in banner
    assert "<dt>Surgery</dt><dd>left</dd>" in banner
    assert Visit.Posture.LEANING.label.lower() in banner
    assert reverse("upload-thumbnail", args=[upload.pk]) in banner
    assert "Front left" in banner


def test_thumbnails_do_not_flood_the_audit(visit: Visit, client_of: Callable[..., Client]) -> None:
    upload = Upload.objects.create(visit=visit, camera="front_left", size_bytes=1, state="placed")
    upload.path.with_suffix(".webp").write_bytes(b"a picture")
    client = client_of(Role.TECHNICIAN)
    seen = LogEntry.objects.count()
    assert client.get(reverse("upload-thumbnail", args=[upload.pk])).status_code == 200
    assert LogEntry.objects.count() == seen
    client.get(reverse("visit", args=[visit.pk]))
    assert LogEntry.objects.count() == seen + 1


# --- operations and consents are entered


def test_an_operation_is_entered_changed_and_removed(visit: Visit, client_of: Callable[..., Client]) -> None:
    client, patient = client_of(Role.TECHNICIAN), visit.patient
    entered = {"kind": "implant", "side": "left", "day": "2026-03-02", "volume_cc": "300", "words": "round"}
    page = client.post(reverse("operation-new", args=[patient.pk]), entered, follow=True).content.decode()
    operation = Operation.objects.get()
    assert (operation.patient, operation.entered_by) == (patient, Person.objects.get(username="technician"))
    assert re.search("300 cc.*round", page)
    address = reverse("operation-edit", args=[operation.pk])
    assert client.post(address, filled(client, address, volume_cc="315")).status_code == 302
    assert Operation.objects.get().volume_cc == 315.0
    remove = reverse("operation-remove", args=[operation.pk])
    client.post(remove, filled(client, address, remove))
    assert not Operation.objects.exists()
    changes = LogEntry.objects.filter(object_pk=str(operation.pk)).exclude(action=LogEntry.Action.ACCESS)
    assert {entry.action for entry in changes} == {0, 1, 2}
    assert all("round" not in str(entry.changes) for entry in changes)


@pytest.mark.parametrize(
    ("field", "value", "wrong"),
    [
        ("day", "2999-01-01", "day"),
        ("day", "1979-01-01", "day"),
        ("volume_cc", "-5", "volume_cc"),
        ("volume_cc", "1e9", "volume_cc"),
        ("kind", "other", "words"),
        ("kind", "tattoo", "kind"),
    ],
)
def test_an_operation_that_cannot_be_is_refused(
    visit: Visit, client_of: Callable[..., Client], field: str, value: str, wrong: str
) -> None:
    entered = {"kind": "implant", "side": "left", "day": "2026-03-02", field: value}
    answer = client_of(Role.TECHNICIAN).post(reverse("operation-new", args=[visit.patient_id]), entered)
    assert set(refused(answer)) == {wrong}
    assert not Operation.objects.exists()


def test_a_visit_says_where_the_consent_to_photographs_lacks_or_is_withdrawn(
    visit: Visit, client_of: Callable[..., Client]
) -> None:
    client, patient, page = client_of(Role.TECHNICIAN), visit.patient, reverse("visit", args=[visit.pk])
    missing = client.get(page).content.decode()
    client.post(reverse("consent-new", args=[patient.pk]), {"purpose": "pictures", "given_on": "2026-01-05"})
    consent = Consent.objects.get()
    assert consent.entered_by is not None
    entered = client.get(page).content.decode()
    address = reverse("consent-edit", args=[consent.pk])
    client.post(address, filled(client, address, withdrawn_on="2026-02-01"))
    withdrawn = client.get(page).content.decode()
    assert "withdrawn" in withdrawn
    assert "withdrawn" not in entered
    assert missing.count("onsent") > entered.count("onsent")
    early = client.post(address, filled(client, address, withdrawn_on="2026-01-01"))
    assert "withdrawn_on" in refused(early)


def test_the_study_leaves_out_who_has_not_consented_to_research(visit: Visit, client_of: Callable[..., Client]) -> None:
    measured(visit, -1, (400.0, 12.0))
    client = client_of(Role.RESEARCHER)

    def shown(path: str) -> str:
        text: str = client.get(path).content.decode()
        return text

    assert visit.patient.pseudonym not in shown("/study/") + shown("/study/cohort.csv")
    assert re.search("1 visit .*1 patient", shown("/study/"))
    consent = Consent.objects.create(patient=visit.patient, purpose="research", given_on="2026-01-01")
    assert visit.patient.pseudonym in shown("/study/")
    assert visit.patient.pseudonym in shown("/study/cohort.csv")
    assert re.search("0 visits .*0 patients", shown("/study/"))
    Consent.objects.filter(pk=consent.pk).update(withdrawn_on="2026-02-01")
    assert visit.patient.pseudonym not in shown("/study/") + shown("/study/cohort.csv")


# --- the conclusion


def test_a_conclusion_is_signed_amended_and_never_overwritten(
    visit: Visit, surgeon: Person, client_of: Callable[..., Client]
) -> None:
    measurement = Measurement.objects.create(visit=visit, digest="1", made_at=timezone.now(), software="1")
    client, address = client_of(name="sergio"), reverse("conclude", args=[visit.pk])

    def sign(text: str, result: Measurement) -> str:
        entered = filled(client, reverse("visit", args=[visit.pk]), address, text=text, measurement=str(result.pk))
        answer = client.post(address, entered, follow=True)
        page: str = answer.content.decode()
        return page

    assert "Dr. Sergio Surgeon" in sign("Symmetrical.", measurement)
    sign("Symmetrical.", measurement)
    assert Conclusion.objects.count() == 1
    assert "(1)" in sign("Nearly symmetrical.", measurement)
    assert Conclusion.objects.count() == 2
    again = Measurement.objects.create(visit=visit, digest="2", made_at=timezone.now(), software="1")
    page = sign("Of the old numbers.", measurement)
    assert "Of the old numbers." in page  # what was written is not lost
    assert Conclusion.objects.count() == 2
    page = client.get(reverse("visit", args=[visit.pk])).content.decode()
    old = page
    assert old.count("again") > sign("Of the new numbers.", again).count("again")
    Person.objects.filter(pk=surgeon.pk).update(full_name="د. محمد")
    page = client.get(reverse("visit", args=[visit.pk])).content.decode()
    assert "\u2068د. محمد\u2069, " in page  # the date stays behind it


def test_technicians_read_a_conclusion_and_write_none(visit: Visit, client_of: Callable[..., Client]) -> None:
    measurement = Measurement.objects.create(visit=visit, digest="1", made_at=timezone.now(), software="1")
    Conclusion.objects.create(visit=visit, measurement=measurement, text="Symmetrical.")
    client = client_of(Role.TECHNICIAN)
    page = client.get(reverse("visit", args=[visit.pk])).content.decode()
    assert "Symmetrical." in page
    assert "<textarea" not in page
    assert client.post(reverse("conclude", args=[visit.pk]), {"text": "x"}).status_code == 403


# --- what comes next


@pytest.mark.parametrize(
    ("state", "role", "words", "button"),
    [
        ("measured", Role.CLINICIAN, "boundaries", "Confirm"),
        ("measured", Role.TECHNICIAN, "boundaries", None),
        ("changed", Role.TECHNICIAN, "changed", "Measure"),
        ("confirmed", Role.CLINICIAN, "confirmed", "Write"),
        ("confirmed", Role.TECHNICIAN, "conclusion", None),
    ],
)
def test_a_visit_names_the_one_thing_to_do_next(
    visit: Visit, client_of: Callable[..., Client], state: str, role: Role, words: str, button: str | None
) -> None:
    Measurement.objects.create(visit=visit, digest="1", made_at=timezone.now(), software="1")
    Visit.objects.filter(pk=visit.pk).update(state=state)
    page = client_of(role).get(reverse("visit", args=[visit.pk])).content.decode()
    step = page[page.index('aria-label="Next step"') :]
    step = step[: step.index("</section>")]
    assert words in step
    assert ("button" in step) is (button is not None)
    assert button is None or f">{button}" in step
    assert "mammometry edit" not in page


def test_occasion_and_posture_are_entered_and_shown(visit: Visit, client_of: Callable[..., Client]) -> None:
    client = client_of(Role.TECHNICIAN)
    page = client.get(reverse("visit", args=[visit.pk])).content.decode()
    assert "<dt>Posture</dt><dd>standing</dd>" not in page
    shown, address = reverse("visit", args=[visit.pk]), reverse("circumstances", args=[visit.pk])
    client.post(address, filled(client, shown, address, occasion="1 year", posture="standing"))
    page = client.get(reverse("visit", args=[visit.pk])).content.decode()
    assert Visit.Occasion.YEAR_1.label in page
    assert "<dt>Posture</dt><dd>standing</dd>" in page
    client.post(address, filled(client, shown, address, posture="floating"))
    assert Visit.objects.get(pk=visit.pk).posture == Visit.Posture.STANDING
    assert Visit.objects.create(patient=visit.patient, taken_at=timezone.now()).posture == ""


def test_a_new_visit_says_why_the_patient_came_and_a_model_has_no_posture(
    visit: Visit, client_of: Callable[..., Client]
) -> None:
    entered = {
        "patient": str(visit.patient_id), "rig": str(visit.rig_id), "taken_at": "2026-03-02T10:00",
        "subject_kind": "torso", "occasion": "before", "posture": "standing", "anyway": "1",
    }  # fmt: skip
    client, address = client_of(Role.TECHNICIAN), reverse("visit-new")
    client.post(address, entered)
    client.post(address, {**entered, "subject_kind": "model"})
    patient, model = Visit.objects.exclude(pk=visit.pk).order_by("created")
    assert (patient.occasion, patient.posture) == ("before", "standing")
    assert (model.occasion, model.posture) == ("", "")


def test_no_page_of_a_visit_names_a_command(visit: Visit, client_of: Callable[..., Client]) -> None:
    sentences = [
        "Nobody has confirmed the automatic boundary of the left breast..",
        "Boundaries are drawn and confirmed with `mammometry edit`.",
        "Pair front matched only 40 % of the subject's silhouette.",
        "Left and right rest on how the cameras are mounted.",
    ]
    folder = visit.folder / "results" / "report"
    folder.mkdir(parents=True)
    (folder / "warnings.json").write_text(json.dumps({"warnings": sentences}))
    measurement = Measurement.objects.create(visit=visit, digest="1", made_at=timezone.now(), software="1")
    why = "Draw its boundary with `mammometry edit`."
    Volume.objects.create(measurement=measurement, side="left", definition="any", refused=why)
    page = client_of(Role.TECHNICIAN).get(reverse("visit", args=[visit.pk])).content.decode()
    assert "mammometry edit" not in page
    assert "Draw its boundary" in page
    assert sentences[0].rstrip(".") not in page  # the state says it
    first = page[page.index("Read this first") : page.index("More about this result")]
    assert sentences[3] in first
    assert "Pair front" not in first
    assert "Pair front" in page


def test_a_new_consent_proposes_today(visit: Visit, client_of: Callable[..., Client]) -> None:
    page = client_of(Role.TECHNICIAN).get(reverse("consent-new", args=[visit.patient.pk])).content.decode()
    assert f'value="{timezone.localdate():%Y-%m-%d}"' in page
