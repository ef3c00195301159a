"""Small things on the clinic's pages: what each says, to whom."""

from collections.abc import Callable
from types import SimpleNamespace
from uuid import uuid4

import pytest
from django.test import Client
from django.urls import reverse
from django.utils import timezone

from mammometry.base.errors import SessionError
from mammometry.clinic.models import Calibration, Job, Rig, Visit
from mammometry.clinic.records.search import search
from mammometry.clinic.roles import Role
from mammometry.clinic.templatetags.pages import on_pages, rounding_note


def test_a_year_finds_who_was_born_or_photographed_in_it(visit: Visit) -> None:
    for text in ("1980", str(timezone.localdate().year), "zypern 1980"):
        assert list(search(text)) == [visit.patient], text
    for text in ("1979", "2001", "meier 1980"):
        assert not search(text), text


@pytest.mark.parametrize(
    ("left", "right", "apart", "noted"),
    [(393.4, 335.6, 57.8, True), (393.0, 336.0, 57.0, False), (None, 336.0, None, False)],
)
def test_a_difference_that_rounding_moved_says_so(
    left: float | None, right: float, apart: float | None, noted: bool
) -> None:
    sides = tuple(SimpleNamespace(volume_cc=value) for value in (left, right))
    result = SimpleNamespace(sides=sides, difference=SimpleNamespace(volume_cc=apart))
    assert bool(rounding_note(result)) == noted  # type: ignore[arg-type]


@pytest.mark.parametrize("kind", ["visit", "patient"])
def test_the_address_of_what_is_in_the_bin_says_so(visit: Visit, client_of: Callable[..., Client], kind: str) -> None:
    row = visit if kind == "visit" else visit.patient
    Visit.objects.filter(pk=visit.pk).update(binned_at=timezone.now())
    row.__class__.everything.filter(pk=row.pk).update(binned_at=timezone.now())
    answer = client_of(Role.CLINICIAN).get(reverse(kind, args=[row.pk]))
    assert answer.status_code == 404
    assert "bin" in answer.content.decode()
    nowhere = client_of(Role.CLINICIAN).get(reverse(kind, args=[uuid4()]))
    assert nowhere.status_code == 404
    assert "erased" in nowhere.content.decode()
    assert "erased" not in answer.content.decode()


def test_who_may_see_names_sees_them_among_the_jobs(visit: Visit, client_of: Callable[..., Client]) -> None:
    Job.objects.create(visit=visit, kind=Job.Kind.MEASURE, state=Job.State.DONE, ended=timezone.now())
    for role in (Role.CLINICIAN, Role.TECHNICIAN):
        page = client_of(role).get(reverse("jobs-page")).content.decode()
        assert "Zypernkatze, Quirina" in page
        assert visit.patient.pseudonym not in page


@pytest.mark.requirement("R-SEC-1")
@pytest.mark.parametrize(("role", "status"), [(Role.CLINICIAN, 403), (Role.TECHNICIAN, 201)])
def test_only_who_keeps_rigs_adds_to_a_calibration(
    clinic: object, client_of: Callable[..., Client], role: Role, status: int
) -> None:
    definition = {"rig": {"name": "pair", "pairs": [{"name": "front", "left": "a", "right": "b"}]}}
    rig = Rig.objects.create(name="Room 1", definition=definition)
    calibration = Calibration.objects.create(rig=rig, taken_at=timezone.now(), folder="rigs/x/y")
    body = {"for": "calibration", "id": str(calibration.pk), "name": "a.jpg", "camera": "a", "pose": "01"}
    body |= {"size_bytes": 10, "sha256": "0" * 64}
    answer = client_of(role).post(reverse("upload-new"), body, content_type="application/json")
    assert answer.status_code == status, answer.content
    assert calibration.uploads.exists() == (status == 201)


def test_a_calibration_that_is_begun_does_not_miss_photographs_that_are_here(
    clinic: object, client_of: Callable[..., Client]
) -> None:
    rig = Rig.objects.create(name="Room 1")
    calibration = Calibration.objects.create(rig=rig, taken_at=timezone.now(), folder="rigs/x/y")
    for name, key in (("calibration", calibration.pk), ("rig", rig.pk)):
        page = client_of(Role.TECHNICIAN).get(reverse(name, args=[key])).content.decode()
        assert "photographs missing" not in page
        assert "not calibrated yet" in page


def test_refusals_on_pages_are_said_as_people_speak() -> None:
    error = SessionError("capture", found="no photograph", expected="one of each camera", remedy="Add it")
    shown = on_pages(str(error))
    assert all(part in shown for part in (error.subject, error.found, error.expected, error.remedy))
    assert "found" not in shown
    plain = "The visit was found. It is expected today."
    assert on_pages(plain) == plain
