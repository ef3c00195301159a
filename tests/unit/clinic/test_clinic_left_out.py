"""A poor photograph of the board is shown beside its warning, and left out by a click, which can be undone."""

import datetime

import pytest
from auditlog.models import LogEntry
from django.contrib.contenttypes.models import ContentType
from django.utils import timezone
from tests.clinic_forms import filled
from tests.first_cases import first
from tests.unit.clinic.test_clinic_uploads import DEFINITION, photograph

from mammometry.clinic import rig_history
from mammometry.clinic.jobs.results import enter
from mammometry.clinic.models import Calibration, Job, Rig, Upload
from mammometry.clinic.roles import Role

CAMERAS = ("front_left", "front_right")
POOR = "pose 02: 9 of 88 points of front_left were left out as outliers"
DOUBTS = [{"sentence": POOR, "photographs": ["02/front_left"]}]
FIGURES = {"verdict": "warn", "reasons": [POOR, "the residuals are good"], "doubts": DOUBTS, "cameras": {}}


@pytest.fixture
def calibration(clinic):
    """In use, of four poses by two cameras; the photographs lie there, as a version without uploads made them."""
    rig = Rig.objects.create(name="Room 1", definition=DEFINITION)
    made = rig_history.new_calibration(rig, None)
    made.taken_at = timezone.now() - datetime.timedelta(days=3)
    made.state, made.current, made.figures = Calibration.State.DONE, True, FIGURES
    made.save()
    for pose in range(1, 5):
        folder = clinic.folder / made.folder / "calibration" / f"{pose:02d}"
        folder.mkdir(parents=True)
        for place, camera in enumerate(CAMERAS):
            (folder / f"{camera}.jpg").write_bytes(photograph(10 * pose + place))
    return made


def leave_out(client, calibration, *keys):
    form = filled(client, f"/calibrations/{calibration.pk}/", f"/calibrations/{calibration.pk}/leave-out/")
    form["photograph"] = list(keys)
    return client.post(f"/calibrations/{calibration.pk}/leave-out/", form)


def test_the_rig_leads_to_the_photograph(client_of, calibration):
    client = client_of(Role.TECHNICIAN)
    rig = client.get(f"/rigs/{calibration.rig_id}/").content.decode()
    assert f'href="/calibrations/{calibration.pk}/#doubts"' in rig
    page = client.get(f"/calibrations/{calibration.pk}/").content.decode()
    assert "Pose 02: 9 of 88" in page
    address = f"/calibrations/{calibration.pk}/photographs/02/front_left.webp"
    assert address in page
    assert "03/front_left" not in page
    assert client.get(address).content[8:12] == b"WEBP"
    for wrong in ("02/front_middle", "9/front_left", "..%2f..%2fx/front_left"):
        assert client.get(f"/calibrations/{calibration.pk}/photographs/{wrong}.webp").status_code == 404


@pytest.mark.requirement("R-RIG-2")
@pytest.mark.parametrize("role", first(1, [Role.TECHNICIAN, Role.ADMINISTRATOR]))
def test_it_is_left_out_and_the_calibration_in_use_stays_until_the_new_one_is_done(
    client_of, clinic, calibration, role
):
    client = client_of(role)
    before = {path: path.read_bytes() for path in (clinic.folder / calibration.folder).rglob("*.jpg")}
    answer = leave_out(client, calibration, "02/front_left")
    made = Calibration.objects.exclude(pk=calibration.pk).get()
    assert answer.url == f"/calibrations/{made.pk}/"
    calibration.refresh_from_db()
    assert calibration.current
    assert not made.current
    assert made.taken_at == calibration.taken_at  # its photographs are no newer
    assert {path: path.read_bytes() for path in (clinic.folder / calibration.folder).rglob("*.jpg")} == before
    folder = clinic.folder / made.folder
    assert sorted(str(path.relative_to(folder)) for path in (folder / "calibration").rglob("*.jpg")) == [
        f"calibration/{pose:02d}/{camera}.jpg" for pose in range(1, 5) for camera in CAMERAS
        if (pose, camera) != (2, "front_left")
    ]  # fmt: skip
    (aside,) = Upload.objects.filter(calibration=made, state="set aside")
    assert (folder / aside.name).read_bytes() == photograph(20)
    entries = LogEntry.objects.filter(content_type=ContentType.objects.get_for_model(Upload), object_pk=str(aside.pk))
    assert entries.filter(actor__username=str(role), changes__state=["placed", "set aside"]).exists()

    job = Job.objects.get(calibration=made)
    enter(job, {"figures": {"verdict": "pass", "reasons": ["the residuals are good"], "doubts": [], "cameras": {}}})
    calibration.refresh_from_db()
    made.refresh_from_db()
    assert (calibration.current, made.current) == (False, True)
    page = client.get(f"/calibrations/{made.pk}/").content.decode()
    assert "pose 02, front" in page
    assert f'href="/calibrations/{calibration.pk}/"' in page

    form = filled(client, f"/calibrations/{calibration.pk}/", f"/calibrations/{calibration.pk}/use/")
    client.post(f"/calibrations/{calibration.pk}/use/", form)
    calibration.refresh_from_db()
    made.refresh_from_db()
    assert (calibration.current, made.current) == (True, False)


def test_leaving_out_twice_makes_one_calibration(client_of, calibration):
    client = client_of(Role.TECHNICIAN)
    form = filled(client, f"/calibrations/{calibration.pk}/", f"/calibrations/{calibration.pk}/leave-out/")
    form["photograph"] = ["02/front_left"]
    first, second = (client.post(f"/calibrations/{calibration.pk}/leave-out/", form) for _ in range(2))
    assert first.url == second.url
    assert Calibration.objects.count() == 2


@pytest.mark.parametrize("keys", [(), ("02/front_middle",), ("02/front_left", "03/front_left")])
def test_nothing_is_left_out_where_that_cannot_be(client_of, calibration, keys):
    """Nothing ticked, no such photograph, and fewer views than a flat board needs."""
    leave_out(client_of(Role.TECHNICIAN), calibration, *keys)
    assert Calibration.objects.get() == calibration


def test_others_look_and_change_nothing(client_of, calibration):
    clinician, researcher = client_of(Role.CLINICIAN), client_of(Role.RESEARCHER)
    page = clinician.get(f"/calibrations/{calibration.pk}/").content.decode()
    assert "Pose 02:" in page
    assert "leave-out" not in page
    for what in ("leave-out", "use"):
        assert clinician.post(f"/calibrations/{calibration.pk}/{what}/").status_code == 403
        assert researcher.post(f"/calibrations/{calibration.pk}/{what}/").status_code == 403
    assert researcher.get(f"/calibrations/{calibration.pk}/photographs/02/front_left.webp").status_code == 403


@pytest.mark.parametrize("doubts", [{}, {"doubts": [POOR]}])
def test_a_calibration_of_an_earlier_version_has_sentences(client_of, calibration, doubts):
    calibration.figures = {name: value for name, value in FIGURES.items() if name != "doubts"} | doubts
    calibration.save()
    assert "02/front_left" in client_of(Role.TECHNICIAN).get(f"/calibrations/{calibration.pk}/").content.decode()


def test_a_calibration_without_result_is_not_used(client_of, calibration):
    other = rig_history.new_calibration(calibration.rig, None)
    client_of(Role.TECHNICIAN).post(f"/calibrations/{other.pk}/use/")
    calibration.refresh_from_db()
    assert calibration.current
