"""Results on their way to archives: tried again, later each time, by one sender at a time; who may send."""

import datetime
import io
import shutil
import ssl
import subprocess
import threading
import zipfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any, ClassVar

import pydicom
import pytest
from auditlog.models import LogEntry
from django.test import Client
from django.urls import reverse
from django.utils import timezone
from pynetdicom import AE, evt
from pynetdicom.presentation import StoragePresentationContexts
from pynetdicom.sop_class import Verification
from tests import orthanc
from tests.orthanc import free_port
from tests.unit.hospital.exports import NAMES, deidentified, exported

from mammometry.base.errors import SessionError, SettingsError
from mammometry.clinic import deliveries
from mammometry.clinic.config import ClinicConfig, ClinicError, new_clinic, read_config
from mammometry.clinic.jobs import queue
from mammometry.clinic.jobs.lanes import LANES
from mammometry.clinic.jobs.runner import Runner
from mammometry.clinic.models import Confirmation, Consent, Delivery, Destination, Job, Measurement, Person, Visit
from mammometry.clinic.roles import Role
from mammometry.clinic.views import hospital, study
from mammometry.hospital.dicom.stow import answers
from mammometry.hospital.exported import Exported
from mammometry.hospital.tables import FILES as TABLES
from mammometry.hospital.tables import REDCAP_FILES as REDCAP

SECOND = datetime.timedelta(seconds=1)
pytestmark = pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")


@pytest.fixture
def archive(clinic: ClinicConfig) -> Destination:
    """One that is entered and does not run."""
    return Destination.objects.create(name="PACS", address=f"PACS@127.0.0.1:{free_port()}")


@pytest.fixture
def measured(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Every visit has the same made-up results."""

    def gathered(*_: Any, deidentify: bool = False, **__: Any) -> Exported:
        return deidentified(tmp_path) if deidentify else exported(tmp_path)

    monkeypatch.setattr(deliveries, "gathered", gathered)
    for module in (hospital, study):
        monkeypatch.setattr(module, "report_file", lambda *_: tmp_path)


@contextmanager
def running(destination: Destination) -> Iterator[dict[str, Any]]:
    """The archive runs; what it was sent, by UID."""
    came: dict[str, Any] = {}

    def stored(event: Any) -> int:
        came[event.request.AffectedSOPInstanceUID] = event.dataset
        return 0x0000

    ae = AE(ae_title="PACS")
    ae.add_supported_context(Verification)
    for context in StoragePresentationContexts:
        ae.add_supported_context(context.abstract_syntax, ["1.2.840.10008.1.2.1", "1.2.840.10008.1.2.4.50"])
    for name in ("104.1", "104.3", "104.4", "104.5", "77.1.4", "88.34"):
        ae.add_supported_context(f"1.2.840.10008.5.1.4.1.1.{name}", ["1.2.840.10008.1.2.1", "1.2.840.10008.1.2.4.50"])
    port = int(destination.address.rpartition(":")[2])
    server = ae.start_server(("127.0.0.1", port), block=False, evt_handlers=[(evt.EVT_C_STORE, stored)])
    try:
        yield came
    finally:
        server.shutdown()


SEND = [Job.Kind.SEND]


def due(delivery: Delivery) -> None:
    """Its time to be tried again has come."""
    Job.objects.filter(delivery=delivery, state=Job.State.QUEUED).update(due=timezone.now() - SECOND)


def deliver(clinic: ClinicConfig, delivery: Delivery) -> Job:
    """A runner's lane takes the delivery, and tries it once."""
    runner = Runner(clinic, lanes=LANES)
    (job,) = queue.claim(runner.owner, 2, SEND)
    assert job.delivery == delivery
    runner._do(job, LANES[0])
    for row in (job, delivery):
        row.refresh_from_db()
    return job


def test_what_is_on_its_way_is_not_sent_twice(visit: Visit, archive: Destination) -> None:
    assert deliveries.enqueue(visit, archive, None) == deliveries.enqueue(visit, archive, None)
    assert len(queue.claim("one", 2, SEND)) == 1
    assert queue.claim("other", 2, SEND) == []
    assert deliveries.enqueue(visit, archive, None) == Delivery.objects.get()


@pytest.mark.slow
def test_results_arrive_under_the_patients_name(
    clinic: ClinicConfig, visit: Visit, archive: Destination, measured: None
) -> None:
    delivery = deliveries.enqueue(visit, archive, None)
    with running(archive) as came:
        assert deliver(clinic, delivery).state == Job.State.DONE
    assert (delivery.state, delivery.sent, delivery.message) == ("sent", 12, "")
    assert {str(each.PatientName) for each in came.values()} == {"Zypernkatze^Quirina"}
    assert {each.PatientID for each in came.values()} == {"KIS-4711"}


@pytest.mark.slow
def test_an_archive_that_is_down_is_tried_again_later_each_time(
    clinic: ClinicConfig, visit: Visit, archive: Destination, measured: None, person_of: Callable[..., Person]
) -> None:
    delivery = deliveries.enqueue(visit, archive, None)
    waits = []
    for number in range(1, 9):
        before = timezone.now()
        job = deliver(clinic, delivery)
        assert job.attempt == number
        assert "no answer" in job.message
        assert "Zypernkatze" not in job.message
        if job.state == Job.State.QUEUED:
            assert queue.claim("early", 1, SEND) == []
            waits.append(round((job.due - before).total_seconds() / 60))
        due(delivery)
    assert waits == [1, 2, 4, 8, 16, 32, 60]
    assert (job.state, delivery.state, delivery.message) == (Job.State.FAILED, Delivery.State.FAILED, job.message)
    assert queue.claim("late", 1, SEND) == []
    assert queue.gave_up() == [job]
    queue.enqueue(delivery, None)
    assert queue.gave_up() == []
    with running(archive):
        assert deliver(clinic, delivery).attempt == 1
    assert delivery.state == Delivery.State.SENT


def test_a_delivery_of_a_runner_that_died_is_taken_over(
    clinic: ClinicConfig, visit: Visit, archive: Destination, measured: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    delivery = deliveries.enqueue(visit, archive, None)
    (first,) = queue.claim("elsewhere:1:dead", 1, SEND)
    assert queue.requeue_abandoned() == 0
    Job.objects.update(lease_until=timezone.now() - SECOND)
    assert queue.requeue_abandoned() == 1
    assert queue.claim("other", 1, SEND) == []  # a minute later
    due(delivery)
    (second,) = queue.claim("other", 1, SEND)
    assert second.attempt == 2
    assert not queue.done(first.pk, "elsewhere:1:dead", {"sent": 3, "kept": None, "message": ""})  # it was not dead
    delivery.refresh_from_db()
    assert (delivery.state, delivery.sent) == (Delivery.State.QUEUED, 0)
    assert queue.done(second.pk, "other", {"sent": 3, "kept": True, "message": ""})
    delivery.refresh_from_db()
    assert (delivery.state, delivery.sent, delivery.kept) == (Delivery.State.SENT, 3, True)


def test_a_visit_that_is_not_measured_says_so(clinic: ClinicConfig, visit: Visit, archive: Destination) -> None:
    job = deliver(clinic, deliveries.enqueue(visit, archive, None))
    assert job.message
    assert str(clinic.folder) not in job.message


def test_an_unknown_reason_is_tried_as_often_as_a_known_one_and_no_more(
    clinic: ClinicConfig,
    visit: Visit,
    archive: Destination,
    client_of: Callable[..., Client],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def fails(*_: object, **__: object) -> None:
        raise ZeroDivisionError("of Zypernkatze")

    monkeypatch.setattr(deliveries, "gathered", fails)
    delivery = deliveries.enqueue(visit, archive, None)
    administrator = client_of(Role.ADMINISTRATOR)
    for _ in range(8):
        assert "Delivery to PACS" not in administrator.get(reverse("administration")).content.decode()
        job = deliver(clinic, delivery)
        due(delivery)
    assert (job.state, delivery.state) == (Job.State.FAILED, Delivery.State.FAILED)
    assert "ZeroDivisionError" in delivery.message
    assert "Zypernkatze" not in delivery.message
    assert queue.claim("late", 1, SEND) == []
    page = administrator.get(reverse("administration")).content.decode()
    assert "Delivery to PACS" in page
    assert "tried 8 times" in page
    assert "Zypernkatze" not in page


def test_a_delivery_that_ends_the_server_each_time_is_given_up(visit: Visit, archive: Destination) -> None:
    delivery = deliveries.enqueue(visit, archive, None)
    for _ in range(8):
        assert len(queue.claim("elsewhere:1:dead", 1, SEND)) == 1
        Job.objects.update(lease_until=timezone.now() - SECOND)
        assert queue.requeue_abandoned() == 1
        due(delivery)
    assert queue.claim("late", 1, SEND) == []
    delivery.refresh_from_db()
    assert delivery.state == Delivery.State.FAILED


class _Heard(BaseHTTPRequestHandler):
    """A DICOMweb service that keeps the logins of its requests."""

    logins: ClassVar[list[str | None]] = []

    def do_GET(self) -> None:
        self.logins.append(self.headers["Authorization"])
        self.send_response(204)
        self.end_headers()

    def log_message(self, *_: object) -> None:
        """Say nothing."""


@pytest.mark.slow
@pytest.mark.requirement("R-SEC-7")
def test_each_archive_gets_its_own_login_and_nobody_else_does(
    clinic: ClinicConfig, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("MAMMOMETRY_STOW_AUTHORIZATION", "Bearer of all")
    _Heard.logins = []
    with ThreadingHTTPServer(("127.0.0.1", 0), _Heard) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        base = f"http://127.0.0.1:{server.server_port}"
        (clinic.folder / "one.secret").write_text("Bearer one\n")
        (clinic.folder / "two.secret").write_text("Bearer two\n")
        secrets = {f"{base}/one": "one.secret", f"{base}/two/": "two.secret"}
        changed = clinic.model_copy(update={"stow_secrets": secrets})
        monkeypatch.setattr(deliveries, "the_clinic", lambda: changed)
        for place in ("one", "two", "somebody"):
            deliveries.test(Destination(name=place, kind=Destination.Kind.STOW, address=f"{base}/{place}"))
        server.shutdown()
    assert _Heard.logins == ["Bearer one", "Bearer two", None]


@pytest.mark.requirement("R-SEC-7")
@pytest.mark.parametrize(
    ("address", "good"),
    [
        ("http://pacs.example.org/dicom-web", False),
        ("http://10.0.0.5:8042/dicom-web", False),
        ("https://pacs.example.org/dicom-web", True),
        ("http://localhost:8042/dicom-web", True),
        ("http://[::1]:8042/dicom-web", True),
    ],
)
def test_a_login_goes_over_https_alone(tmp_path: Path, address: str, good: bool) -> None:
    folder = tmp_path / "clinic"
    new_clinic(folder, name="Clinic")
    with (folder / "clinic.toml").open("a") as file:
        file.write(f'\n[stow_secrets]\n"{address}" = "pacs.secret"\n')
    if good:
        assert read_config(folder).stow_secrets == {address: "pacs.secret"}
        with pytest.raises(ClinicError, match=r"pacs\.secret"):  # it is not there
            read_config(folder).stow_secret(address)
    else:
        with pytest.raises(SettingsError, match="https"):
            read_config(folder)
        with pytest.raises(SettingsError, match="https"):
            answers(address, authorization="Bearer one")


# --- pages ---


def test_a_clinician_sends_and_the_audit_says_so(
    client_of: Callable[..., Client], visit: Visit, archive: Destination, measured: None
) -> None:
    client = client_of(Role.CLINICIAN)
    address = reverse("visit-send", args=[visit.pk])
    assert f'name="destination" value="{archive.pk}"' in client.get(address).content.decode()
    answer = client.post(address, {"destination": str(archive.pk)}, follow=True)
    assert 'name="anyway"' in answer.content.decode()
    assert not Delivery.objects.exists()  # one press alone sends nothing that nobody confirmed
    answer = client.post(address, {"destination": str(archive.pk), "anyway": "1"}, follow=True)
    assert 'name="anyway"' not in answer.content.decode()
    (delivery,) = Delivery.objects.all()
    assert str(delivery.created_by) == "clinician"
    entry = LogEntry.objects.get(object_pk=str(delivery.pk), action=LogEntry.Action.CREATE)
    assert str(entry.actor) == "clinician"
    assert "Zypernkatze" not in entry.changes_str + entry.object_repr


def test_a_confirmed_visit_is_sent_without_a_question(
    client_of: Callable[..., Client],
    person_of: Callable[..., Person],
    visit: Visit,
    archive: Destination,
    measured: None,
) -> None:
    made = Measurement.objects.create(
        visit=visit, digest="d", made_at=timezone.now(), software="1", curves={"left": "c"}
    )
    Confirmation.objects.create(measurement=made, curves={"left": "c"}, by=person_of(Role.CLINICIAN))
    Visit.objects.filter(pk=visit.pk).update(state=Visit.State.CONFIRMED)
    address = reverse("visit-send", args=[visit.pk])
    answer = client_of(Role.CLINICIAN).post(address, {"destination": str(archive.pk)}, follow=True)
    assert 'name="anyway"' not in answer.content.decode()


def test_a_failed_one_is_tried_again_by_a_button(
    client_of: Callable[..., Client], visit: Visit, archive: Destination, measured: None
) -> None:
    delivery = deliveries.enqueue(visit, archive, None)
    Delivery.objects.update(state=Delivery.State.FAILED)
    Job.objects.update(state=Job.State.FAILED)
    client = client_of(Role.CLINICIAN)
    assert "again" in client.get(reverse("visit-send", args=[visit.pk])).content.decode()
    client.post(reverse("delivery-retry", args=[delivery.pk]))
    delivery.refresh_from_db()
    assert delivery.state == Delivery.State.QUEUED
    assert [job.state for job in Job.objects.order_by("created")] == ["failed", "queued"]


@pytest.mark.slow
def test_the_test_button_asks_the_archive(client_of: Callable[..., Client], archive: Destination) -> None:
    client = client_of(Role.ADMINISTRATOR)
    address = reverse("destination-test", args=[archive.pk])
    assert [one.level_tag for one in client.post(address, follow=True).context["messages"]] == ["error"]
    with running(archive):
        assert "PACS answers." in client.post(address, follow=True).content.decode()


@pytest.mark.parametrize(
    ("kind", "address", "good"),
    [
        ("dicom", "PACS@host:104", True),
        ("dicom", "https://pacs/dicom-web", False),
        ("stow", "https://pacs/dicom-web", True),
        ("stow", "https://me:secret@pacs/dicom-web", False),
    ],
)
def test_an_archives_address_is_checked(client_of: Callable[..., Client], kind: str, address: str, good: bool) -> None:
    told = {"name": "New", "kind": kind, "address": address, "own_title": "MAMMOMETRY", "active": "on"}
    client_of(Role.ADMINISTRATOR).post(reverse("destination-new"), told)
    assert Destination.objects.filter(name="New").exists() == good


@pytest.mark.parametrize("release", ["r4", "r5"])
def test_a_bundle_is_taken_along(client_of: Callable[..., Client], visit: Visit, measured: None, release: str) -> None:
    answer = client_of(Role.CLINICIAN).get(reverse("visit-fhir", args=[visit.pk, release]))
    assert answer["Content-Type"] == "application/fhir+json"
    assert answer.json()["entry"][0]["resource"]["identifier"] == [{"value": "KIS-4711"}]
    assert client_of(Role.CLINICIAN).get(reverse("visit-fhir", args=[visit.pk, "r3"])).status_code == 404


def unzipped(answer: Any) -> dict[str, bytes]:
    with zipfile.ZipFile(io.BytesIO(answer.content)) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


@pytest.mark.slow
def test_a_study_of_objects_is_taken_along_and_for_others_tells_nobody(
    client_of: Callable[..., Client], visit: Visit, measured: None
) -> None:
    client, address = client_of(Role.CLINICIAN), reverse("visit-dicom", args=[visit.pk])
    whole = client.get(address)
    assert visit.patient.pseudonym in whole["Content-Disposition"]
    assert len(unzipped(whole)) == 12
    assert {str(pydicom.dcmread(io.BytesIO(each)).PatientName) for each in unzipped(whole).values()} == {
        "Zypernkatze^Quirina"
    }
    first, second = (client.get(f"{address}?deidentify") for _ in range(2))
    assert first.content == second.content
    assert visit.patient.pseudonym not in first["Content-Disposition"]
    told = b"".join([*unzipped(first).values(), first.content])
    assert not [name for name in (*NAMES, visit.patient.pseudonym) if name.encode() in told]
    audited = LogEntry.objects.filter(object_pk=str(visit.pk), actor__username="clinician", action=3)
    assert audited.count() >= 3


@pytest.mark.parametrize(("name", "files"), [("study-redcap", REDCAP), ("study-table", TABLES)])
def test_a_researcher_takes_the_study_along_by_pseudonym(
    client_of: Callable[..., Client],
    visit: Visit,
    measured: None,
    monkeypatch: pytest.MonkeyPatch,
    name: str,
    files: tuple[str, ...],
) -> None:
    Consent.objects.create(patient=visit.patient, purpose="research", given_on="2026-01-01")
    visit.measurements.create(digest="d", made_at=timezone.now(), software="0.1.0")
    stale = Visit.objects.create(patient=visit.patient, rig=visit.rig, taken_at=timezone.now())
    stale.measurements.create(digest="e", made_at=timezone.now(), software="0.1.0")
    whole = deliveries.gathered

    def gathered(config: Any, one: Visit, **how: Any) -> Any:
        if one == stale:
            raise SessionError("x", found="a visit whose report is not current", expected="y", remedy="z")
        assert how == {"whole": False}
        return whole(config, one, **how)

    monkeypatch.setattr(deliveries, "gathered", gathered)
    answer = client_of(Role.RESEARCHER).get(reverse(name))
    made = unzipped(answer)
    assert set(made) - {"measurements.parquet"} == {*files, "left-out.csv"} - {"measurements.parquet"}
    assert b"a visit whose report is not current" in made["left-out.csv"]
    assert b"354.25" in b"".join(made.values())
    assert not [
        told for told in ("Zypernkatze", "Quirina", "KIS-4711", "1980-02-29") if told.encode() in answer.content
    ]


def certified(folder: Path, name: str) -> tuple[Path, Path]:
    """A certificate that signs itself, and its key."""
    if shutil.which("openssl") is None:
        pytest.skip("openssl is not installed, which makes the certificate")
    made, key = folder / f"{name}.pem", folder / f"{name}.key"
    command = ["openssl", "req", "-x509", "-newkey", "rsa:2048", "-nodes", "-days", "2", "-subj", f"/CN={name}"]
    command += ["-addext", "subjectAltName=IP:127.0.0.1", "-keyout", str(key), "-out", str(made)]
    subprocess.run(command, check=True, capture_output=True)
    return made, key


@pytest.mark.slow
def test_an_archive_may_ask_for_our_certificate(client_of: Callable[..., Client], tmp_path: Path) -> None:
    (theirs, their_key), (ours, our_key) = certified(tmp_path, "archive"), certified(tmp_path, "clinic")
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.load_cert_chain(theirs, their_key)
    context.load_verify_locations(ours)
    context.verify_mode = ssl.CERT_REQUIRED
    ae = AE(ae_title="PACS")
    ae.add_supported_context(Verification)
    server = ae.start_server(("127.0.0.1", port := free_port()), block=False, ssl_context=context)
    told = {"kind": "dicom", "address": f"PACS@127.0.0.1:{port}", "own_title": "MAMMOMETRY", "encrypted": "on"}
    told |= {"authorities": str(theirs), "active": "on"}
    client = client_of(Role.ADMINISTRATOR)
    try:
        for name, ours_told in (("without", {}), ("with", {"certificate": str(ours), "key": str(our_key)})):
            client.post(reverse("destination-new"), {"name": name, **told, **ours_told})
            asked = reverse("destination-test", args=[Destination.objects.get(name=name).pk])
            page = client.post(asked, follow=True).content.decode()
            assert (f"{name} answers." in page) == (name == "with")
        wrong = {"name": "wrong", **told, "certificate": str(tmp_path / "none.pem")}
        assert "no certificate that can be read" in client.post(reverse("destination-new"), wrong).content.decode()
    finally:
        server.shutdown()


@pytest.mark.slow
@pytest.mark.skipif(orthanc.program() is None, reason=orthanc.ABSENT)
def test_a_promise_to_keep_the_objects_is_awaited(
    clinic: ClinicConfig, visit: Visit, measured: None, tmp_path: Path
) -> None:
    port = free_port()
    modalities = {"us": ["MAMMOMETRY", "127.0.0.1", port]}
    with orthanc.server(tmp_path / "orthanc", DicomModalities=modalities) as archive:
        keeper = Destination.objects.create(name="K", address=archive.peer, commitment=True, promise_port=port)
        for destination, kept in ((keeper, True), (Destination.objects.create(name="N", address=archive.peer), None)):
            delivery = deliveries.enqueue(visit, destination, None)
            deliver(clinic, delivery)
            assert (delivery.state, delivery.kept, delivery.message) == ("sent", kept, "")


@pytest.mark.slow
def test_no_promise_is_said(clinic: ClinicConfig, visit: Visit, archive: Destination, measured: None) -> None:
    Destination.objects.filter(pk=archive.pk).update(commitment=True)
    delivery = deliveries.enqueue(visit, archive, None)
    with running(archive):
        deliver(clinic, delivery)
    assert (delivery.state, delivery.kept) == ("sent", None)
    assert delivery.message == "It sent no storage commitment."
