"""The study's rows and figures: the plain values of the database are what the visits' own results say."""

import csv
import datetime
import io
import random
from collections.abc import Callable, Iterable

import numpy as np
import pytest
from django.test import Client
from django.urls import reverse
from django.utils import timezone

from mammometry.clinic.config import ClinicConfig
from mammometry.clinic.models import (
    Confirmation,
    Consent,
    Drawing,
    Measurement,
    Patient,
    Rig,
    Scan,
    Visit,
    Volume,
)  # fmt: skip
from mammometry.clinic.records import results
from mammometry.clinic.records.cohort import Row, left_out, pooled, study_rows, visits_between
from mammometry.clinic.records.confirmations import CHANGED, confirmation_of
from mammometry.clinic.roles import Role

NOON = datetime.datetime(2026, 3, 1, 12, tzinfo=datetime.UTC)
DAY = datetime.timedelta(days=1)
STATES = ("measured", "confirmed", "changed", "queued", "refused")


def consenting(number: int, **details: object) -> Patient:
    patient = Patient.objects.create(
        family_name="Zypernkatze", given_name=f"Quirina{number}", record_number=f"KIS-{number}", **details
    )
    Consent.objects.create(patient=patient, purpose="research", given_on=NOON.date())
    return patient


def measure(visit: Visit, volumes: Iterable[Volume], made_at: datetime.datetime = NOON) -> Measurement:
    measurement = Measurement.objects.create(
        visit=visit, digest="d", made_at=made_at, software="1", curves={"left": "curve"}
    )
    results.add_volumes(measurement, volumes)
    return measurement


def random_volumes(draw: random.Random) -> list[Volume]:
    """Some meanings of each side, some refused, some without an interval."""
    volumes = []
    for side in draw.sample(("left", "right", "model", "difference"), draw.randint(1, 4)):
        usual = {"flat chest"} if draw.random() < 0.8 else set()
        others = draw.sample((*results.LEADING[2:], "another", "a further one"), draw.randint(0, 4))
        for definition in sorted({*usual, *others} or {"measured wall"}, key=lambda _: draw.random()):
            value = None if draw.random() < 0.2 else draw.uniform(100, 900)
            low = None if value is None or draw.random() < 0.2 else value - 10
            volumes.append(
                Volume(
                    side=side, definition=definition, volume_cc=value, low_cc=low,
                    high_cc=None if low is None else low + 20, refused="A hole." if value is None else "",
                )
            )  # fmt: skip
    return volumes


@pytest.fixture
def random_clinic(clinic: ClinicConfig) -> None:
    """60 visits of all kinds: measured again, scanned, drawn on since, without a consent."""
    draw = random.Random(3)
    rig = Rig.objects.create(name="Room 1", definition={})
    for number in range(20):
        patient = consenting(number, born=draw.choice((None, datetime.date(1980, 2, 29))))
        if number < 2:
            patient.consents.all().delete()
        elif number == 2:
            patient.consents.update(withdrawn_on=NOON.date())
        for _ in range(3):
            scan = draw.random() < 0.2
            # Near midnight, where the day of the clinic's time zone is not that of UTC.
            taken_at = NOON + draw.randint(0, 40) * DAY + draw.choice((0, 11, 12)) * datetime.timedelta(hours=1)
            visit = Visit.objects.create(
                patient=patient, rig=None if scan else rig, taken_at=taken_at, state=draw.choice(STATES),
                subject_kind=draw.choice(("torso", "torso", "torso", "model")),
            )  # fmt: skip
            if scan:
                Scan.objects.create(visit=visit, scanner="Arm", units="mm", sha256="s")
            for age in range(draw.choice((0, 1, 1, 2, 3))):
                measurement = measure(visit, random_volumes(draw), NOON - age * DAY)
                for curves in draw.sample(({"left": "curve"}, {"left": "other"}), draw.randint(0, 2)):
                    Confirmation.objects.create(measurement=measurement, curves=curves)
            if draw.random() < 0.3:
                Drawing.objects.create(visit=visit, item="left", action="drawn")


def rows_by_objects(**asked: object) -> list[Row]:
    """The rows from the results that pages of single visits show."""
    rows = []
    visits = [
        visit
        for visit in Visit.objects.filter(subject_kind="torso").order_by("patient__pseudonym", "taken_at", "pk")
        if visit.patient.consents.filter(purpose="research", withdrawn_on=None)
        and (not asked.get("confirmed") or visit.state == "confirmed")
    ]
    for result in results.latest(visits):
        visit, day = result.visit, timezone.localtime(result.visit.taken_at).date()
        confirmation = confirmation_of(result.measurement) if visit.state == "confirmed" else None
        for side in result.sides:
            low, high = side.interval_cc or (None, None)
            rows.append(
                Row(
                    pseudonym=visit.patient.pseudonym, day=day, years=results.age(visit.patient.born, day),
                    side=side.side, definition=side.definition, volume_cc=side.volume_cc, low_cc=low, high_cc=high,
                    refused=side.refused, state=CHANGED if visit.is_changed else visit.state,
                    confirmed=confirmation is not None,
                    confirmed_on=None if confirmation is None else timezone.localtime(confirmation.at).date(),
                    rig=visit.device, software=result.measurement.software,
                )
            )  # fmt: skip
    return rows


def pairs_by_rows(rows: list[Row], within_days: int) -> list[tuple[str, float, float]]:
    first: dict[tuple[str, str, str], Row] = {}
    pairs: dict[tuple[str, str, str], tuple[str, float, float]] = {}
    for row in rows:
        if row.volume_cc is None:
            continue
        key = row.pseudonym, row.side, row.definition
        before = first.get(key)
        if before is not None and key not in pairs and (row.day - before.day).days <= within_days:
            assert before.volume_cc is not None
            pairs[key] = f"{row.pseudonym} {row.side}", before.volume_cc, row.volume_cc
        first[key] = row
    return list(pairs.values())


@pytest.mark.parametrize("confirmed", [False, True])
@pytest.mark.usefixtures("random_clinic")
def test_rows_and_figures_are_those_of_the_visits_own_results(confirmed: bool) -> None:
    expected = rows_by_objects(confirmed=confirmed)
    assert len(expected) > (3 if confirmed else 30)
    assert {row.state for row in expected} >= ({"confirmed"} if confirmed else {CHANGED, "measured", "queued"})
    visits = visits_between(None, None, confirmed=confirmed)
    rows = list(study_rows(visits))
    assert rows == expected
    figures = pooled(visits)
    volumes = [np.nan if row.volume_cc is None else row.volume_cc for row in rows]
    np.testing.assert_array_equal(figures.volume_cc, volumes)
    assert len(figures.volumes_cc) == sum(row.volume_cc is not None for row in rows) < len(rows)
    assert figures.patients == len({row.pseudonym for row in rows})
    assert figures.visits == len({(row.pseudonym, row.day) for row in rows})
    assert list(study_rows(visits.filter(pk__in=figures.visit_keys))) == rows
    for days in (1, 40):
        assert figures.repeated(days) == pairs_by_rows(rows, days)
    assert confirmed or pairs_by_rows(rows, 40)
    without = Visit.objects.filter(subject_kind="torso", measurements__isnull=False).distinct()
    without = without.exclude(patient__consents__in=Consent.objects.filter(purpose="research", withdrawn_on=None))
    without = without.filter(state="confirmed") if confirmed else without
    assert left_out(visits) == (without.count(), len({visit.patient_id for visit in without}))


def test_rows_go_on_where_many_visits_are_read_in_parts(clinic: ClinicConfig, monkeypatch: pytest.MonkeyPatch) -> None:
    rig = Rig.objects.create(name="Room 1", definition={})
    for number in range(5):
        visit = Visit.objects.create(patient=consenting(number), rig=rig, taken_at=NOON, state="measured")
        measure(visit, [Volume(side="left", definition="flat chest", volume_cc=400.0 + number)])
    visits = visits_between(None, None, confirmed=False)
    whole = list(study_rows(visits))
    monkeypatch.setattr("mammometry.clinic.records.cohort._VISITS_AT_ONCE", 2)
    assert list(study_rows(visits)) == whole
    assert sorted(row.volume_cc or 0 for row in whole) == [400, 401, 402, 403, 404]


def test_agreement_takes_one_pair_a_breast_within_the_days(clinic: ClinicConfig) -> None:
    patient, rig = consenting(0), Rig.objects.create(name="Room 1", definition={})
    for days, left in ((0, 400.0), (1, 410.0), (2, 420.0), (90, 500.0)):
        visit = Visit.objects.create(patient=patient, rig=rig, taken_at=NOON + days * DAY, state="measured")
        measure(visit, [Volume(side="left", definition="named wall", volume_cc=left)])
    rows = list(study_rows(visits_between(None, None, confirmed=False)))
    assert len(rows) == 4
    assert pooled(visits_between(None, None, confirmed=False)).repeated(1) == [
        (f"{patient.pseudonym} left", 400.0, 410.0)
    ]
    some = visits_between(datetime.date(2026, 3, 2), datetime.date(2026, 3, 3), confirmed=False)
    assert list(study_rows(some)) == rows[1:3]
    assert list(study_rows(visits_between(None, None, confirmed=True))) == []


def test_the_page_makes_the_same_few_queries_however_many_visits_there_are(
    client_of: Callable[..., Client], clinic: ClinicConfig, django_assert_max_num_queries: Callable[..., object]
) -> None:
    patient, rig = consenting(0), Rig.objects.create(name="Room 1", definition={})
    for days in range(30):
        visit = Visit.objects.create(patient=patient, rig=rig, taken_at=NOON + days * DAY, state="measured")
        measure(visit, [Volume(side="left", definition="flat chest", volume_cc=400.0 + days)])
    researcher = client_of(Role.RESEARCHER)
    with django_assert_max_num_queries(20):  # type: ignore[attr-defined]
        page = researcher.get(reverse("study")).content.decode()
    assert "415 cc" in page or "414 cc" in page
    with django_assert_max_num_queries(20):  # type: ignore[attr-defined]
        table = researcher.get(reverse("study-csv")).content.decode()
    assert [float(row["volume_cc"]) for row in csv.DictReader(io.StringIO(table))] == [400.0 + k for k in range(30)]
