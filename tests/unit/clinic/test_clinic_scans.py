"""Scans of other devices as visits: what comes in, what is refused, and that they are measured and sent."""

import io
import json
import re
import struct
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from django.core.files.uploadedfile import SimpleUploadedFile
from django.http import HttpResponse
from django.test import Client
from django.urls import reverse
from django.utils import timezone
from pytest_django import Settings
from tests.clinic_forms import refused
from tests.unit.io.scan_files import scanned, texture
from tests.unit.measure.two_scans import part

from mammometry.api.results import show_refusal
from mammometry.base.errors import MeasureError
from mammometry.base.identity import Identity
from mammometry.clinic.config import ClinicConfig
from mammometry.clinic.jobs import queue, work
from mammometry.clinic.models import Consent, Job, Patient, Scan, Visit
from mammometry.clinic.roles import Role
from mammometry.clinic.templatetags.pages import on_pages
from mammometry.geometry import TriangleMesh
from mammometry.geometry.mesh_files.ply import write_ply
from mammometry.io.meshes.scans import read_scan
from mammometry.report.figures.canvas import Caption, encode


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    """A scanner's files by name."""
    mesh = scanned(tmp_path_factory.mktemp("scan") / "in", step_mm=12.0)
    return {path.name: path.read_bytes() for path in mesh.parent.iterdir()}


@pytest.fixture
def patient(clinic: ClinicConfig) -> Patient:
    return Patient.objects.create(
        family_name="Zypernkatze", given_name="Quirina", record_number="KIS-4711", born="1980-02-29"
    )


def packed(files: dict[str, bytes], above: str = "") -> dict[str, bytes]:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in files.items():
            archive.writestr(above + name, content)
    return {"scan.zip": buffer.getvalue()}


def send(client: Client, patient: Patient, files: dict[str, bytes], **changed: str) -> HttpResponse:
    told: dict[str, Any] = {
        "patient": str(patient.pk), "taken_at": f"{timezone.localtime():%Y-%m-%dT%H:%M}", "scanner": "Vectra M5",
        "units": "cm", "head": "y", "ahead": "", **changed,
    }  # fmt: skip
    told["sent"] = [SimpleUploadedFile(name, content) for name, content in files.items()]
    return client.post(reverse("scan-new"), told, follow=True)  # type: ignore[return-value]


def nothing_is_left(clinic: ClinicConfig) -> bool:
    return not Visit.objects.exists() and not any(
        path for name in ("uploads", "sessions") for path in (clinic.folder / name).iterdir()
    )


@pytest.mark.parametrize("way", ["files", "zip", "zip in a folder"])
def test_a_scan_is_a_visit_and_its_job_is_queued(
    client_of: Callable[..., Client], patient: Patient, files: dict[str, bytes], way: str
) -> None:
    given = {"files": files, "zip": packed(files), "zip in a folder": packed(files, "C:\\Scans\\")}[way]
    page = send(client_of(Role.TECHNICIAN), patient, given).content.decode()
    (visit,) = Visit.objects.all()
    assert visit.is_scan
    assert (visit.device, visit.scan.units, visit.scan.textured) == ("Vectra M5", "cm, as stated", True)
    assert {path.name for path in visit.folder.iterdir() if path.name[0] != "."} == {
        "scan.toml", "scan.ply", "scan.obj", "scan.mtl", "texture-1.jpg",
    }  # fmt: skip
    assert Job.objects.get().visit == visit
    assert "Vectra M5" in page
    assert not list((visit.folder.parents[1] / "uploads").iterdir())


def test_no_name_of_a_file_is_kept(client_of: Callable[..., Client], patient: Patient, files: dict[str, bytes]) -> None:
    send(client_of(Role.TECHNICIAN), patient, files)
    folder = Visit.objects.get().folder
    assert [path for path in folder.rglob("*") if path.is_file() and b"Muster" in path.read_bytes()] == []
    assert patient.pseudonym in (folder / "scan.toml").read_text()


def test_the_shape_alone_is_enough(client_of: Callable[..., Client], patient: Patient, files: dict[str, bytes]) -> None:
    mesh = {name: content for name, content in files.items() if name.endswith(".obj")}
    send(client_of(Role.TECHNICIAN), patient, mesh, shape_alone="on")
    assert not Scan.objects.get().textured


@pytest.mark.requirement("R-MERGE-4")
@pytest.mark.slow
def test_a_second_scan_of_the_visit_is_merged_and_another_body_is_refused(
    client_of: Callable[..., Client], patient: Patient, tmp_path: Path, clinic: ClinicConfig
) -> None:
    def ply(name: str, mesh: TriangleMesh) -> SimpleUploadedFile:
        write_ply(tmp_path / name, mesh, comments=("units: mm",))
        return SimpleUploadedFile(name, (tmp_path / name).read_bytes())

    first, below = part(-150.0, 90.0, seed=1), part(-90.0, 150.0, seed=2)
    client = client_of(Role.TECHNICIAN)
    told = {
        "patient": str(patient.pk), "taken_at": f"{timezone.localtime():%Y-%m-%dT%H:%M}", "scanner": "Vectra M5",
        "units": "mm", "head": "y", "ahead": "z",
    }  # fmt: skip
    larger = below.mapped(lambda points: 1.02 * points)
    sent = {"sent": [ply("Muster.ply", first)], "second": [ply("Muster-2.ply", larger)]}
    page = client.post(reverse("scan-new"), told | sent).content.decode()
    assert "2.0 %" in page
    assert nothing_is_left(clinic)
    sent = {"sent": [ply("Muster.ply", first)], "second": [ply("Muster.ply", below)]}
    client.post(reverse("scan-new"), told | sent, follow=True)
    (visit,) = Visit.objects.all()
    (also,) = read_scan(visit.folder).also
    assert also.within_mm < 0.2
    assert not [path for path in visit.folder.rglob("*") if path.is_file() and b"Muster" in path.read_bytes()]


def bomb() -> dict[str, bytes]:
    """A ZIP of 200 kB that says it holds a few bytes, and holds 200 MB."""
    made = packed({"scan.obj": bytes(200 * 10**6)})["scan.zip"]
    lied = made.replace(struct.pack("<I", 200 * 10**6), struct.pack("<I", 40))
    assert len(made) < 10**6
    return {"scan.zip": lied}


def without(files: dict[str, bytes], ending: str) -> dict[str, bytes]:
    return {name: content for name, content in files.items() if not name.endswith(ending)}


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda files: without(files, ".mtl"), "material"),
        (lambda files: without(files, ".jpg"), "picture"),
        (lambda files: without(files, ".obj"), "0 meshes"),
        (lambda files: {**files, "b.stl": b"solid"}, "2 meshes"),
        (lambda files: {**files, "run.exe": b"MZ"}, ".exe"),
        (lambda files: {**files, "x": b"MZ"}, "ending"),
        (lambda files: {**files, "Muster Anna.jpg": b"<html>"}, ".jpg"),
        (lambda files: {**files, "Muster Anna.jpg": files["Muster Anna.jpg"] + b"<script>"}, "web"),
        (lambda files: {**files, "Muster Anna.obj": b"nothing"}, "Expected: "),
        (lambda files: {"scan.zip": b"PK\x03\x04 no archive"}, "ZIP"),
        (lambda files: {"scan.zip": packed(files)["scan.zip"][:-40]}, "ZIP"),
        (lambda files: packed({f"{n}.png": b"" for n in range(50)}), "many"),
        (lambda files: packed({"a/s.obj": b"", "b/s.obj": b""}), "name"),
        (lambda files: packed({"in.zip": packed(files)["scan.zip"]}), "0 meshes"),
    ],
)
def test_what_is_no_scan_is_one_sentence_and_leaves_nothing(
    client_of: Callable[..., Client],
    patient: Patient,
    clinic: ClinicConfig,
    files: dict[str, bytes],
    change: Callable[[dict[str, bytes]], dict[str, bytes]],
    said: str,
) -> None:
    answer = send(client_of(Role.TECHNICIAN), patient, change(files))
    page = answer.content.decode()
    assert said in refused(answer)["sent"]
    assert str(clinic.folder) not in page
    assert nothing_is_left(clinic)


@pytest.mark.parametrize("wrong", [{"units": "m"}, {"units": "inch"}, {"scanner": ""}, {"head": "up"}])
def test_what_is_said_of_it_is_checked(
    client_of: Callable[..., Client],
    patient: Patient,
    clinic: ClinicConfig,
    files: dict[str, bytes],
    wrong: dict[str, str],
) -> None:
    assert 'class="wrong"' in send(client_of(Role.TECHNICIAN), patient, files, **wrong).content.decode()
    assert nothing_is_left(clinic)


def test_the_unit_is_not_needed(client_of: Callable[..., Client], patient: Patient, files: dict[str, bytes]) -> None:
    send(client_of(Role.TECHNICIAN), patient, files, units="")
    assert Visit.objects.get().scan.units.startswith("cm, ")


def test_a_refusal_names_the_forms_fields_and_the_sent_file(
    client_of: Callable[..., Client], patient: Patient, files: dict[str, bytes]
) -> None:
    page = send(client_of(Role.TECHNICIAN), patient, files, units="m").content.decode()
    assert re.search("unit of the mesh: .*cm", page)
    assert "--" not in page.partition("<main")[2]
    assert "uploads/" not in page


@pytest.mark.parametrize(
    "sentence",
    [
        "Draw its boundary with `mammometry edit`",
        "Say which axis points ahead: --ahead z, for example",
        "Correct --head or --ahead",
        "Check both; compare.refuse_mm sets the limit.",
        "Add --units mm, cm, m, in or ft",
    ],
)
def test_pages_name_fields_and_not_options(sentence: str) -> None:
    shown = on_pages(sentence)
    assert shown.split()[0] == sentence.split()[0]
    assert not re.search("--|mammometry|[a-z]_[a-z]", shown)


def test_a_visit_without_files_is_refused(client_of: Callable[..., Client], patient: Patient) -> None:
    page = send(client_of(Role.TECHNICIAN), patient, {}).content.decode()
    assert page.count('class="wrong"') == 1
    assert not Visit.objects.exists()


@pytest.mark.slow
def test_a_bomb_is_stopped_at_the_clinics_limit(
    client_of: Callable[..., Client], patient: Patient, clinic: ClinicConfig, settings: Settings
) -> None:
    limits = clinic.limits.model_copy(update={"scan_mb": 20})
    settings.CLINIC = clinic.model_copy(update={"limits": limits})
    page = send(client_of(Role.TECHNICIAN), patient, bomb()).content.decode()
    assert "20 MB" in page or "20 MB" in page
    honest = packed({"scan.obj": bytes(30 * 10**6)})
    assert "20 MB" in send(client_of(Role.TECHNICIAN), patient, honest).content.decode()
    assert nothing_is_left(clinic)


def test_a_names_folders_lead_nowhere(
    client_of: Callable[..., Client], patient: Patient, clinic: ClinicConfig, files: dict[str, bytes]
) -> None:
    send(client_of(Role.TECHNICIAN), patient, packed(files, "../../../"))
    assert Visit.objects.count() == 1
    assert sorted(path.name for path in clinic.folder.parent.glob("Muster*")) == []


def test_a_large_picture_is_refused_by_its_header(
    client_of: Callable[..., Client],
    patient: Patient,
    clinic: ClinicConfig,
    files: dict[str, bytes],
    settings: Settings,
    tmp_path: Path,
) -> None:
    limits = clinic.limits.model_copy(update={"photograph_megapixels": 1})
    settings.CLINIC = clinic.model_copy(update={"limits": limits})
    large = texture(tmp_path / "large.jpg", (1200, 1000)).read_bytes()
    page = send(client_of(Role.TECHNICIAN), patient, {**files, "Muster Anna.jpg": large}).content.decode()
    assert "megapixels" in page
    assert nothing_is_left(clinic)


@pytest.mark.slow
def test_photographs_have_no_place_in_a_scans_visit(
    client_of: Callable[..., Client], patient: Patient, files: dict[str, bytes]
) -> None:
    client = client_of(Role.TECHNICIAN)
    send(client, patient, files)
    visit = Visit.objects.get()
    Job.objects.update(state=Job.State.FAILED, message="Too little of the trunk is seen.")
    about = {"for": "visit", "id": str(visit.pk), "name": "a.jpg", "size_bytes": 10}
    answer = client.post(reverse("upload-new"), json.dumps(about), content_type="application/json")
    assert answer.status_code == 409
    assert "device" in answer.json()["error"]
    assert client.get(reverse("visit-uploads", args=[visit.pk])).status_code == 409
    assert client.get(reverse("visit-capture", args=[visit.pk])).status_code == 404
    for name in ("visit-state", "visit-look", "visit-fire"):
        method = client.get if name == "visit-state" else client.post
        assert method(reverse(name, args=[visit.pk])).status_code == 409
    for page in (reverse("home"), reverse("patient", args=[patient.pk]), reverse("visit", args=[visit.pk])):
        assert client.get(page).status_code == 200
    assert reverse("scan-new") in client.get(reverse("visit", args=[visit.pk])).content.decode()
    again = client.post(reverse("visit-measure", args=[visit.pk]), "{}", content_type="application/json")
    assert again.status_code == 202


def test_only_care_sends_scans(client_of: Callable[..., Client], patient: Patient, files: dict[str, bytes]) -> None:
    for role in (Role.RESEARCHER, Role.ADMINISTRATOR):
        assert send(client_of(role), patient, files).status_code == 403
    assert not Visit.objects.exists()


@pytest.mark.slow
def test_a_refused_scans_page_shows_what_was_seen(
    client_of: Callable[..., Client], patient: Patient, files: dict[str, bytes]
) -> None:
    client = client_of(Role.TECHNICIAN)
    send(client, patient, files)
    (visit,) = Visit.objects.all()
    (job,) = queue.claim("me", 1)
    picture = encode(np.zeros((4, 4, 3), dtype=np.uint8), Caption(title="The surface", text="Standard views."))
    show_refusal(
        visit.folder / "results",
        Identity(name="scan"),
        MeasureError("torso", found="no breast", expected="one", remedy="Draw it"),
        lambda: {"surface": picture},
    )
    assert queue.failed(job.pk, "me", "torso: found no breast, expected one. Draw it.", 8)
    page = client.get(reverse("visit", args=[visit.pk])).content.decode()
    address = reverse("refused-picture", args=[visit.pk, "surface"])
    assert f'src="{address}"' in page
    assert "Standard views." in page
    assert client.get(address).content == picture
    assert client.get(reverse("refused-picture", args=[visit.pk, "other"])).status_code == 404


@pytest.mark.slow
def test_a_scan_is_measured_shown_and_exported(
    client_of: Callable[..., Client], patient: Patient, clinic: ClinicConfig, tmp_path: Path
) -> None:
    mesh = scanned(tmp_path / "in", step_mm=2.0)
    client = client_of(Role.CLINICIAN)
    send(client, patient, {path.name: path.read_bytes() for path in mesh.parent.iterdir()})
    (visit,) = Visit.objects.all()
    (job,) = queue.claim("me", 1)
    said: list[str] = []
    answer = work.measure_scan(lambda stage, fraction: said.append(stage), str(visit.folder), "")
    assert "measure" in said
    assert queue.done(job.pk, "me", answer)
    page = client.get(reverse("visit", args=[visit.pk])).content.decode()
    for words in ("Left breast", "Right breast", "Vectra M5", "cm, as stated", "Read this first", "to be confirmed"):
        assert words in page
    assert client.get(reverse("scene", args=[visit.pk])).json()
    assert "Vectra M5" in client.get(reverse("report", args=[visit.pk])).content.decode()
    assert client.get(reverse("draw", args=[visit.pk])).status_code == 200
    drawing = client.get(reverse("draw-drawing", args=[visit.pk])).json()
    bases = {"boundaries": {name: each["base"] for name, each in drawing["boundaries"].items()}, "landmarks": {}}
    curves = {name: each["of"] for name, each in drawing["boundaries"].items()}
    for name, boundary in drawing["boundaries"].items():
        assert f"{boundary['measured']['volumeCc']:.0f} cc" in page, name
    confirmed = client.post(
        reverse("draw-finish", args=[visit.pk]), {"curves": curves, "base": bases}, content_type="application/json"
    )
    assert confirmed.json() == {"next": reverse("visit", args=[visit.pk])}
    visit.refresh_from_db()
    assert visit.shown_state == Visit.State.CONFIRMED
    for name, arguments in (("visit-dicom", {}), ("visit-dicom", {"deidentify": "1"})):
        made = client.get(reverse(name, args=[visit.pk]), arguments)
        assert made.status_code == 200
        with zipfile.ZipFile(io.BytesIO(made.content)) as archive:
            assert {"02-SR-001.dcm", "03-M3D-003.dcm"} <= set(archive.namelist())
            held = b"".join(archive.read(each) for each in archive.namelist())
            assert (b"KIS-4711" in held) is not bool(arguments)
    for release in ("r4", "r5"):
        assert client.get(reverse("visit-fhir", args=[visit.pk, release])).status_code == 200
    Consent.objects.create(patient=patient, purpose="research", given_on="2026-01-01")
    table = client_of(Role.RESEARCHER).get(reverse("study-table"))
    with zipfile.ZipFile(io.BytesIO(table.content)) as archive:
        assert patient.pseudonym.encode() in archive.read("measurements.csv")
        assert "left-out.csv" not in archive.namelist()


@pytest.mark.slow
@pytest.mark.requirement("R-SIDE-4")
def test_a_mirrored_scan_is_confirmed_on_its_page_before_its_boundaries_are(
    client_of: Callable[..., Client], patient: Patient, clinic: ClinicConfig, tmp_path: Path
) -> None:
    mesh = scanned(tmp_path / "in", step_mm=2.0)
    lines = [line.split() for line in mesh.read_text().splitlines()]
    mirrored = [["v", str(-float(line[1])), *line[2:]] if line[:1] == ["v"] else line for line in lines]
    mesh.write_text("\n".join(map(" ".join, mirrored)))
    client = client_of(Role.CLINICIAN)
    send(client, patient, {path.name: path.read_bytes() for path in mesh.parent.iterdir()})
    (visit,) = Visit.objects.all()

    def measured() -> None:
        (job,) = queue.claim("me", 1)
        assert queue.done(job.pk, "me", work.measure_scan(lambda stage, fraction: None, str(visit.folder), ""))
        visit.refresh_from_db()

    def finished() -> HttpResponse:
        drawing = client.get(reverse("draw-drawing", args=[visit.pk])).json()
        bases = {"boundaries": {name: each["base"] for name, each in drawing["boundaries"].items()}, "landmarks": {}}
        curves = {name: each["of"] for name, each in drawing["boundaries"].items()}
        address = reverse("draw-finish", args=[visit.pk])
        return client.post(address, {"curves": curves, "base": bases}, content_type="application/json")  # type: ignore[return-value]

    measured()
    address, said = reverse("scan-sides", args=[visit.pk]), "Left and right may be exchanged"
    page = client.get(reverse("visit", args=[visit.pk])).content.decode()
    assert address in page
    assert said in page
    assert "--" + "sides" not in page
    assert said in client.get(reverse("report", args=[visit.pk])).content.decode()
    assert finished().status_code == 409
    assert client_of(Role.TECHNICIAN).post(address).status_code == 403
    client.post(address)
    measured()
    assert visit.measurements.count() == 1  # the numbers are the same
    page = client.get(reverse("visit", args=[visit.pk])).content.decode()
    assert address not in page
    assert said not in page
    assert "right: confirmed" in page
    assert said not in client.get(reverse("report", args=[visit.pk])).content.decode()
    assert finished().status_code == 200
    client.post(address)
    assert Job.objects.filter(state=Job.State.QUEUED).count() == 0  # once is enough
