"""Comparisons of visits: made by themselves, made again when their cause is gone, one verdict on every page."""

import datetime
import html
import io
import re
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from django.test import Client
from django.urls import reverse
from PIL import Image
from tests.first_cases import first

import mammometry
from mammometry.clinic.config import ClinicConfig
from mammometry.clinic.jobs import queue
from mammometry.clinic.models import Calibration, Comparison, Job, Measurement, Patient, Rig, Upload, Visit, Volume
from mammometry.clinic.records import comparing
from mammometry.clinic.roles import Role

pytestmark = pytest.mark.django_db

NOON = datetime.datetime(2026, 3, 12, 12, tzinfo=datetime.UTC)
SENTENCE = "Left breast: 28 cc larger than on 12 March 2026 (95 %: 12 to 44): more than the measurement error."


def table(change_cc: float = 28.0, low: float = 12.0, high: float = 44.0, *, doubtful: bool = False) -> dict[str, Any]:
    """What compare.json holds, as far as pages read it."""
    breast = {"change_cc": change_cc, "change_interval_cc": [low, high], "beyond_error": not low <= 0 <= high}
    return {
        "breasts": {"left": {**breast, "before_cc": 400.0, "after_cc": 400.0 + change_cc}},
        "registration": {"doubtful": doubtful},
        "lengths": [],
        "warnings": [],
    }


def answer_of(digest: str) -> dict[str, Any]:
    """What measuring a visit comes to."""
    row = {"side": "left", "definition": "named wall", "volume_cc": 400.0, "low_cc": 390.0, "high_cc": 410.0}
    return {"digest": digest, "made_at": None, "software": "0", "volumes": [{**row, "refused": ""}], "megapixels": 1.0}


def do(kind: str, answer: Callable[[Job], dict[str, Any] | str]) -> Job:
    """Do the next job of a kind: what it comes to, or why it fails."""
    owner = queue.new_owner()
    job = next(job for job in queue.claim(owner, 99) if job.kind == kind)
    queue.release(owner)
    Job.objects.filter(pk=job.pk).update(state="running", lease_owner=owner)
    came_to = answer(job)
    if isinstance(came_to, str):
        assert queue.failed(job.pk, owner, came_to, 8)
    else:
        assert queue.done(job.pk, owner, came_to)
    return job


def measure(visit: Visit, digest: str) -> None:
    """Measure a visit, by the queue."""
    queue.enqueue(visit, None)
    do("measure", lambda job: answer_of(digest))
    visit.refresh_from_db()


def compared(job: Job, **change: Any) -> dict[str, Any]:
    assert job.comparison is not None
    return {"digest": "c", "of": job.comparison.of, "table": table(**change)}


@pytest.fixture
def visits(clinic: ClinicConfig) -> list[Visit]:
    patient = Patient.objects.create(family_name="Zypernkatze", given_name="Quirina", record_number="1")
    rig = Rig.objects.create(name="rig")
    calibration = Calibration.objects.create(rig=rig, taken_at=NOON, folder="rigs/x", state="done", current=True)
    return [
        Visit.objects.create(
            patient=patient,
            rig=rig,
            calibration=calibration,
            taken_at=NOON + datetime.timedelta(days=days),
            posture="leaning",
        )
        for days in (0, 30, 60)
    ]


def open_pairs() -> set[tuple[int, int]]:
    found = Job.objects.filter(kind="compare", state__in=Job.OPEN).select_related("comparison")
    days = {visit.pk: (visit.taken_at - NOON).days for visit in Visit.objects.all()}
    return {(days[job.comparison.before_id], days[job.comparison.after_id]) for job in found if job.comparison}


def test_a_measured_visit_is_compared_with_the_one_before_and_the_one_after(visits: list[Visit]) -> None:
    measure(visits[0], "a")
    assert open_pairs() == set()
    measure(visits[2], "c")
    assert open_pairs() == {(0, 60)}
    (pending,) = comparing.verdicts(visits[2])
    assert "12 March 2026" in pending
    do("compare", compared)
    assert comparing.verdicts(visits[2]) == (SENTENCE,)
    assert comparing.verdicts(visits[0]) == ()
    measure(visits[1], "b")
    assert open_pairs() == {(0, 30), (30, 60)}
    assert "11 April 2026" in comparing.verdicts(visits[2])[0]


def test_a_verdict_of_another_measurement_is_none(visits: list[Visit]) -> None:
    measure(visits[0], "a")
    measure(visits[1], "b")
    do("compare", compared)
    measure(visits[0], "a2")
    assert open_pairs() == {(0, 30)}
    assert "cc" not in comparing.verdicts(visits[1])[0]
    do("compare", lambda job: compared(job, change_cc=-2.0, low=-9.0, high=5.0))
    (within,) = comparing.verdicts(visits[1])
    assert re.search("12 March 2026.*measurement error", within)


def test_what_was_measured_during_a_comparison_is_compared_again(visits: list[Visit]) -> None:
    measure(visits[0], "a")
    measure(visits[1], "b")

    def measured_meanwhile(job: Job) -> dict[str, Any]:
        came_to = compared(job)
        later = Measurement.objects.create(
            visit=visits[0], digest="a2", made_at=NOON + datetime.timedelta(days=900), software="0"
        )
        Volume.objects.create(measurement=later, side="left", definition="muscle", volume_cc=1.0)
        return came_to

    do("compare", measured_meanwhile)
    assert open_pairs() == {(0, 30)}
    assert "cc" not in comparing.verdicts(visits[1])[0]


def test_a_refusal_holds_for_the_same_measurements_and_the_same_software(
    visits: list[Visit], monkeypatch: pytest.MonkeyPatch
) -> None:
    measure(visits[0], "a")
    measure(visits[1], "b")
    do("compare", lambda job: "the breasts of both dates: found left before.")
    (sentence,) = comparing.verdicts(visits[1])
    assert re.search("12 March 2026.*breasts of both", sentence)
    queue.compare(visits[0], visits[1], None)
    assert open_pairs() == set()
    measure(visits[0], "a2")  # its cause is mended
    assert open_pairs() == {(0, 30)}
    do("compare", lambda job: "The trunks are those of two bodies.")
    (refusal,) = comparing.verdicts(visits[1])
    monkeypatch.setattr(mammometry, "__version__", "99")
    assert comparing.verdicts(visits[1]) != (refusal,)
    queue.compare(visits[0], visits[1], None)
    assert open_pairs() == {(0, 30)}


def test_what_was_drawn_and_not_measured_is_not_compared(visits: list[Visit]) -> None:
    measure(visits[0], "a")
    measure(visits[1], "b")
    do("compare", compared)
    measure(visits[0], "a2")
    job = Job.objects.get(kind="compare", state="queued")
    assert queue.cancel(job)
    Visit.objects.filter(pk=visits[1].pk).update(state=Visit.State.CHANGED)
    Comparison.objects.all().delete()
    visits[1].refresh_from_db()
    queue.compare(visits[0], visits[1], None)
    assert open_pairs() == set()
    assert "measured" in comparing.verdicts(visits[1])[0]


def test_visits_in_the_bin_are_not_compared(visits: list[Visit]) -> None:
    for visit, digest in zip(visits, "abc", strict=True):
        measure(visit, digest)
    Visit.objects.filter(pk=visits[1].pk).update(binned_at=NOON)
    assert [pair[0] for pair in comparing.neighbours(visits[2])] == [visits[0]]


@pytest.mark.parametrize(
    ("before", "after", "words"),
    [
        ("standing", "leaning", ("leaning forward", "standing")),
        ("", "leaning", ("leaning forward",)),
        ("standing", "", ("standing",)),
    ],
)
def test_visits_in_other_postures_are_not_compared_and_say_why(
    visits: list[Visit],
    client_of: Callable[..., Client],
    clinic: ClinicConfig,
    before: str,
    after: str,
    words: tuple[str, ...],
) -> None:
    visits[0].posture, visits[1].posture = before, after
    for visit, digest in zip(visits[:2], "ab", strict=True):
        visit.save()
        measure(visit, digest)
    assert open_pairs() == set()
    (sentence,) = comparing.verdicts(visits[1])
    assert all(word in sentence for word in ("posture", *words))
    chosen = {"before": str(visits[0].pk), "after": str(visits[1].pk)}
    page = client_of(Role.CLINICIAN).get(reverse("compare", args=[visits[0].patient_id]), chosen).content.decode()
    assert sentence.partition(": ")[2].strip(".") in page


def test_postures_that_differ_are_compared_where_the_clinics_settings_say_so(
    visits: list[Visit], clinic: ClinicConfig
) -> None:
    file = clinic.folder / "settings.toml"
    file.write_text("[compare]\nother_posture = true\n")
    try:
        visits[0].posture, visits[1].posture = "standing", "leaning"
        for visit, digest in zip(visits[:2], "ab", strict=True):
            visit.save()
            measure(visit, digest)
        do("compare", lambda job: compared(job, doubtful=True))
        first, posture, fit = comparing.verdicts(visits[1])
    finally:
        file.unlink()
    assert first == SENTENCE
    assert re.search("leaning forward .*standing", posture)
    assert "trunks" in fit


def test_two_visits_without_a_posture_are_compared_with_a_caution(visits: list[Visit]) -> None:
    Visit.objects.update(posture="")
    for visit, digest in zip(visits[:2], "ab", strict=True):
        visit.refresh_from_db()
        measure(visit, digest)
    do("compare", compared)
    first, caution = comparing.verdicts(visits[1])
    assert first == SENTENCE
    assert "posture" in caution


def test_all_pages_say_one_verdict(visits: list[Visit], client_of: Callable[..., Client]) -> None:
    measure(visits[0], "a")
    measure(visits[1], "b")
    client = client_of(Role.CLINICIAN)
    patient = visits[0].patient
    pages = (
        reverse("patient", args=[patient.pk]),
        reverse("patient-changes", args=[patient.pk]),
        reverse("visit-verdict", args=[visits[1].pk]),
        reverse("compare", args=[patient.pk]),
    )
    for page in pages[:3]:
        said = html.unescape(client.get(page).content.decode())
        assert "12 March 2026" in said, page
        assert "measurement error." not in said.partition('id="h-changes"')[2], page
    do("compare", compared)
    for page in pages:
        assert SENTENCE in html.unescape(client.get(page).content.decode()), page


def test_who_looks_has_what_is_due_compared(visits: list[Visit], client_of: Callable[..., Client]) -> None:
    for visit, digest in zip(visits, "abc", strict=True):
        measure(visit, digest)
    Job.objects.filter(kind="compare").delete()  # as in a clinic of an earlier version
    Comparison.objects.all().delete()
    client = client_of(Role.CLINICIAN)
    client.get(reverse("visit-verdict", args=[visits[1].pk]))
    assert open_pairs() == {(0, 30)}
    client.get(reverse("patient", args=[visits[0].patient_id]))
    assert open_pairs() == {(0, 30), (30, 60)}
    client.get(reverse("compare", args=[visits[0].patient_id]), {"before": visits[0].pk, "after": visits[2].pk})
    assert open_pairs() == {(0, 30), (30, 60), (0, 60)}


def test_only_who_cares_for_patients_sees_and_repeats_comparisons(
    visits: list[Visit], client_of: Callable[..., Client]
) -> None:
    measure(visits[0], "a")
    measure(visits[1], "b")
    job = do("compare", lambda job: "No.")
    page = reverse("job-retry", args=[job.pk])
    assert client_of(Role.ADMINISTRATOR).post(page, "{}", "application/json").status_code == 403
    assert client_of(Role.CLINICIAN).post(page, "{}", "application/json").status_code == 202
    assert open_pairs() == {(0, 30)}


@pytest.mark.parametrize("role", first(1, [Role.TECHNICIAN, Role.CLINICIAN]))
def test_the_list_of_jobs_leads_only_to_pages_that_one_may_open(
    visits: list[Visit], client_of: Callable[..., Client], role: Role
) -> None:
    measure(visits[0], "a")
    measure(visits[1], "b")
    client = client_of(role)
    page = client.get(reverse("jobs-page")).content.decode().partition("<main")[2]
    links = [html.unescape(link) for link in re.findall(r'href="(/[^"]*)"', page)]
    assert any(str(visits[1].patient_id) in link for link in links)
    assert {link: client.get(link).status_code for link in links} == dict.fromkeys(links, 200)


def with_photograph(visit: Visit, camera: str) -> Upload:
    """A photograph of a visit, as it lies in the folder."""
    name = f"capture/{camera}.png"
    (visit.folder / "capture").mkdir(parents=True, exist_ok=True)
    Image.fromarray(np.full((40, 3300, 3), 128, dtype=np.uint8)).save(visit.folder / name)
    return Upload.objects.create(visit=visit, camera=camera, name=name, size_bytes=1, state=Upload.State.PLACED)


def test_the_page_names_lengths_and_shows_the_photographs_of_both_dates(
    visits: list[Visit], client_of: Callable[..., Client]
) -> None:
    for visit, digest in zip(visits[:2], "ab", strict=True):
        measure(visit, digest)
    shots = [with_photograph(visits[0], "front_left"), with_photograph(visits[1], "front_left")]
    with_photograph(visits[1], "left_left")
    length = {"name": "SN-N left", "title": "sternal notch to left nipple", "along_the_skin": False}
    length |= {"before_mm": 210.0, "after_mm": 214.04, "change_mm": 4.04, "sigma_mm": 1.5, "beyond_error": True}
    do("compare", lambda job: {**compared(job), "table": {**table(), "lengths": [length]}})
    client = client_of(Role.CLINICIAN)
    page = html.unescape(client.get(reverse("compare", args=[visits[0].patient_id])).content.decode())
    assert length["title"][1:] in page
    assert "SN-N" not in page
    assert "<strong>+4.0 ± 2.9</strong>" in page
    assert all(reverse("upload-screen", args=[shot.pk]) in page for shot in shots)
    larger = client.get(reverse("upload-screen", args=[shots[0].pk]))
    assert Image.open(io.BytesIO(larger.content)).size == (1600, 19)
    assert client_of(Role.RESEARCHER).get(reverse("upload-screen", args=[shots[0].pk])).status_code == 403


def test_pictures_of_a_comparison_of_the_past_are_not_shown(
    visits: list[Visit], client_of: Callable[..., Client]
) -> None:
    for visit, digest in zip(visits[:2], "ab", strict=True):
        measure(visit, digest)
    do("compare", compared)
    folder = comparing.comparison_folder(visits[0], visits[1])
    folder.mkdir(parents=True)
    (folder / "compare.html").write_text('<script type="application/json" id="mm-scene">{"models": []}</script>')
    client = client_of(Role.CLINICIAN)
    addresses = [
        reverse(name, args=[visits[0].patient_id, visits[0].pk, visits[1].pk])
        for name in ("compare-scene", "compare-page")
    ]
    assert client.get(addresses[0]).json() == {"models": []}, "as version 1.0 wrote it"
    (folder / "scene.json").write_text('{"models": [1]}')
    assert client.get(addresses[0]).json() == {"models": [1]}
    assert [client.get(address).status_code for address in addresses] == [200, 200]
    measure(visits[0], "a2")
    assert [client.get(address).status_code for address in addresses] == [404, 404]


def test_a_refused_comparison_says_why_and_can_be_tried_again(
    visits: list[Visit], client_of: Callable[..., Client]
) -> None:
    for visit, digest in zip(visits[:2], "ab", strict=True):
        measure(visit, digest)
    job = do("compare", lambda job: "The breasts of both dates: found none before. Draw it with `mammometry edit`.")
    page = client_of(Role.CLINICIAN).get(reverse("compare", args=[visits[0].patient_id])).content.decode()
    assert "found none before" in page
    assert "mammometry edit" not in page
    assert reverse("job-retry", args=[job.pk]) in page
