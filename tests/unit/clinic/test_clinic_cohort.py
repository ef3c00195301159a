"""The study's rows and figures: the plain values of the database are what the visits' own results say."""

import csv
import datetime
import io
import random
import re
from collections.abc import Callable, Iterable

import numpy as np
import pytest
from django.test import Client
from django.urls import reverse
from django.utils import timezone
from tests.clinic_forms import filled

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
from mammometry.clinic.records.cohort import CohortRow, left_out, pooled, repeats, study_rows, visits_between
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


def rows_by_objects(**asked: object) -> list[CohortRow]:
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
                CohortRow(
                    pseudonym=visit.patient.pseudonym, day=day, years=results.age(visit.patient.born, day),
                    side=side.side, definition=side.definition, volume_cc=side.volume_cc, low_cc=low, high_cc=high,
                    refused=side.refused, state=CHANGED if visit.is_changed else visit.state,
                    confirmed=confirmation is not None,
                    confirmed_on=None if confirmation is None else timezone.localtime(confirmation.at).date(),
                    rig=visit.device, software=result.measurement.software, posture=visit.posture,
                    settings=side.basis.settings, wall=side.basis.wall, boundary=side.basis.boundary,
                    apart="", repeat_of=None,
                )
            )  # fmt: skip
    return rows


@pytest.mark.slow
@pytest.mark.usefixtures("random_clinic")
def test_rows_and_figures_are_those_of_the_visits_own_results() -> None:
    for confirmed in (False, True):
        _rows_and_figures_are_the_visits(confirmed)


def _rows_and_figures_are_the_visits(confirmed: bool) -> None:
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
    same = [row.settings + row.wall + row.boundary + row.posture + row.definition for row in rows]
    usual = max(set(same), key=[name for name, row in zip(same, rows, strict=True) if row.volume_cc].count)
    pooled_cc = [row.volume_cc for name, row in zip(same, rows, strict=True) if row.volume_cc and name == usual]
    assert sorted(figures.comparable_cc) == sorted(pooled_cc)
    assert len(pooled_cc) < len(figures.volumes_cc)
    assert figures.reference is not None
    apart = [row.apart for row in study_rows(visits, figures.reference)]
    may = [name == usual or row.volume_cc is None for name, row in zip(same, rows, strict=True)]
    assert [not words for words in apart] == may  # where there is no volume, nothing is compared
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


HOW = {
    "settings": {}, "walls": dict.fromkeys(("left", "right"), "rounded-membrane"),
    "boundaries": dict.fromkeys(("left", "right"), "automatic"),
}  # fmt: skip

BOTH = [(400.0, 401.0), (500.0, 501.0)]
"""Volumes of the left and right breast at both visits, cc."""


def repeated(
    number: int, *, declared: bool = True, how: object = HOW, first: str = "leaning", second: str = "leaning"
) -> tuple[Visit, Visit]:
    """A woman who was measured twice on one day, both breasts."""
    patient, rig = consenting(number), Rig.objects.get_or_create(name="Room 1")[0]
    visits = []
    for hours, posture, recorded in ((0, first, HOW), (1, second, how)):
        visit = Visit.objects.create(
            patient=patient, rig=rig, taken_at=NOON + datetime.timedelta(hours=hours), state="measured",
            posture=posture, repeat_of=visits[0] if visits and declared else None,
        )  # fmt: skip
        made = measure(
            visit,
            [
                Volume(side=side, definition="named wall", volume_cc=400.0 + add + number + hours)
                for side, add in (("left", 0.0), ("right", 100.0))
            ],
        )
        made.how = recorded
        made.save()
        visits.append(visit)
    return visits[0], visits[1]


def pairs_of() -> tuple[list[tuple[float, float]], list[str]]:
    found = repeats(visits_between(None, None, confirmed=False))
    return [(pair.first_cc, pair.second_cc) for pair in found.pairs], [why for _, why in found.left_out]


def test_agreement_takes_declared_repeats_alone(clinic: ClinicConfig) -> None:
    repeated(0)
    repeated(1, declared=False)  # two visits on one day are no repeat until somebody says so
    assert pairs_of() == (BOTH, [])


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"how": {**HOW, "settings": {"measure.wall": "plane"}}}, "(measure.wall)"),
        ({"how": {**HOW, "walls": {"left": "plane", "right": "plane"}}}, "wall"),
        ({"how": {**HOW, "boundaries": {"left": "drawn", "right": "drawn"}}}, "hand"),
        ({"how": {}}, "recorded"),
        ({"second": "standing"}, "posture"),
    ],
)
def test_a_repeat_that_is_not_comparable_is_left_out_with_the_reason(
    clinic: ClinicConfig, change: dict[str, object], words: str
) -> None:
    repeated(0)
    repeated(1, **change)  # type: ignore[arg-type]
    pairs, left_out = pairs_of()
    assert pairs == BOTH
    assert words in left_out[0]


@pytest.mark.parametrize(("side", "pairs"), [("left", [(500.0, 501.0)]), ("both", [])])
def test_an_operation_in_between_leaves_its_breast_out(
    clinic: ClinicConfig, side: str, pairs: list[tuple[float, float]]
) -> None:
    first, second = repeated(0)
    Visit.objects.filter(pk=second.pk).update(taken_at=NOON + 3 * DAY)
    first.patient.operations.create(kind="graft", side=side, day=(NOON + DAY).date())
    assert pairs_of()[0] == pairs


def test_a_repeat_of_another_patient_is_none(clinic: ClinicConfig) -> None:
    _, second = repeated(0)
    Visit.objects.filter(pk=second.pk).update(patient=consenting(7))
    assert pairs_of()[0] == []
    second.refresh_from_db()
    assert second.repeated is None


@pytest.mark.slow
def test_a_repeat_is_declared_on_the_visits_page(clinic: ClinicConfig, client_of: Callable[..., Client]) -> None:
    first, second = repeated(0, declared=False)
    client, address = client_of(Role.TECHNICIAN), reverse("circumstances", args=[second.pk])
    shown = reverse("visit", args=[second.pk])

    def declared(repeat_of: Visit) -> str:
        sent = filled(client, shown, address, repeat_of=str(repeat_of.pk))
        return str(client.post(address, sent, follow=True).content.decode())

    page = declared(first)
    assert f'<a href="{reverse("visit", args=[first.pk])}">' in page
    assert pairs_of()[0] == BOTH
    stranger, _ = repeated(1)
    page = declared(stranger)
    second.refresh_from_db()
    assert second.repeat_of == first
    own = reverse("circumstances", args=[first.pk])
    client.post(own, filled(client, reverse("visit", args=[first.pk]), own, repeat_of=str(second.pk)))  # the later one
    first.refresh_from_db()
    assert first.repeat_of is None
    Visit.objects.filter(pk=second.pk).update(taken_at=NOON + 3 * DAY, repeat_of=None)
    first.patient.operations.create(kind="graft", side="left", day=(NOON + DAY).date())
    declared(first)
    second.refresh_from_db()
    assert second.repeat_of is None


def test_the_time_line_and_the_table_show_another_wall_apart(
    clinic: ClinicConfig, client_of: Callable[..., Client]
) -> None:
    """The same mesh with another wall is no growth: no line joins both, and the reason stands below."""
    first, _ = repeated(0, how={**HOW, "walls": {"left": "plane", "right": "plane"}})
    page = client_of(Role.CLINICIAN).get(reverse("patient", args=[first.patient_id])).content.decode()
    assert "(rounded-membrane instead" in page
    assert page.count("<polyline") == 2 * 4  # a line a basis and side, narrow and broad: none of two points
    assert not [points for points in re.findall(r'<polyline[^>]* points="([^"]*)"', page) if " " in points]
    table = client_of(Role.RESEARCHER).get(reverse("study-csv")).content.decode()
    rows = list(csv.DictReader(io.StringIO(table)))
    assert sorted(bool(row["apart"]) for row in rows) == [False, False, True, True]
    assert {row["repeat_of"] for row in rows} == {"", "2026-03-01"}


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
