"""A demo clinic.

Three virtual patients at several dates, photographed by a virtual rig and measured by the queue.

Everything works as in a real clinic: photographs are uploaded and checked, jobs calibrate and check the rig and measure
the visits. Only the photographs are rendered, and small. The clinic opens as soon as the rig is calibrated and the
first visit is queued, after about half a minute on two cores. By then, all visits are entered. A second process uploads
their photographs one after another, and the queue measures them.
"""

from __future__ import annotations

import datetime
import secrets
import shutil
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from mammometry.base.errors import BatchError
from mammometry.base.machine.system import lower_priority
from mammometry.base.progress import Progress
from mammometry.clinic.config import (
    FILE,
    SETTINGS_FILE,
    ClinicConfig,
    machine_time_zone,
    new_clinic,
    quoted,
    read_config,
    write_private,
)

if TYPE_CHECKING:
    from mammometry.clinic.models import Calibration, Rig, Visit

_SCALE, POSES = (
    0.12,
    7,
)  # pictures of 540 × 360 and few poses, for speed; all cameras see the first pose, which is used for the check
_RIG = "reference:front,left,right"
_RIG_NAME = "Room 1"
_RIG_FILE = "cameras/rig.toml"  # in the clinic's folder
_SEED = 11  # seed of the rig, the same for all visits
_TARGET = {"squares": (9, 7), "square_mm": 42.0, "marker_mm": 32.0, "dictionary": "DICT_4X4_100"}
"""A coarser board than usual, for small pictures."""
SETTINGS = """\
# The demo's photographs are small, and its cubes large, so that a visit takes seconds.
[surface.extract]
cube_mm = 3.0
"""
_CALIBRATED_DAYS = 80  # days before today
_PEOPLE = (
    ("technician", "Tessa Technician"),
    ("clinician", "Clara Clinician"),
    ("researcher", "Rita Researcher"),
    ("administrator", "Ada Administrator"),
)
_WAIT_S = 900.0  # time for all jobs: slow machines must not fail
_LOOK_S = 0.3  # time between two checks of the jobs: short enough for a smooth progress bar


@dataclass(frozen=True, slots=True, kw_only=True)
class VirtualPatient:
    """One patient of the demo."""

    family_name: str
    given_name: str
    born: str
    subject: str
    """Name of the simulation's subject."""
    dates: tuple[tuple[int, str], ...]
    """Days before today, and the simulation's disturbances on that date."""
    operations: tuple[tuple[int, str, str], ...] = ()
    """Days before today, kind and side."""


PATIENTS = (
    VirtualPatient(
        family_name="Demo-Ahrens",
        given_name="Anna",
        born="1979-05-14",
        subject="torso_1",
        dates=((75, ""), (1, "ratio=1.25")),
    ),
    VirtualPatient(
        family_name="Demo-Brandt",
        given_name="Berta",
        born="1966-10-02",
        subject="torso_2",
        dates=((60, ""), (2, "removed=right")),
        operations=((44, "mastectomy", "right"),),
    ),
    VirtualPatient(
        family_name="Demo-Celik",
        given_name="Ceren",
        born="1991-01-23",
        subject="torso_3",
        dates=((40, "ratio=0.8"), (0, "")),
    ),
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Demo:
    """A finished demo clinic."""

    config: ClinicConfig
    passwords: dict[str, str]
    """Login → random password; empty for an existing demo."""
    visits: int
    measured: int
    failed: dict[str, str]
    """Pseudonym and date of a visit → reason why it was not measured."""
    seconds: float


def make_demo(folder: Path, say: Callable[[str], Progress], *, address: str | None = None, whole: bool = True) -> Demo:
    """Make a demo clinic in a new folder.

    Args:
        folder: new or empty.
        say: called with the text of the current step; returns its progress callback.
        address: HOST:PORT of the server, if any.
        whole: measure all visits. Otherwise they are entered, the first one is queued, and `finish` does the rest while
            a server runs.

    Raises:
        ClinicError: the folder is not empty.
        BatchError: the jobs do not finish in time.
    """
    from mammometry.clinic.web.server import migrate
    from mammometry.io.write import write_text

    begun = time.monotonic()
    config = _with_cameras(
        new_clinic(folder, name="Demo clinic", second_factor="offered", time_zone=machine_time_zone())
    )
    if address is not None:
        config = config.model_copy(update={"address": address})
    migrate(config)
    write_text(folder / SETTINGS_FILE, SETTINGS)
    from mammometry.clinic.jobs.queue import enqueue
    from mammometry.clinic.models import Job, Visit

    passwords = _people()
    with tempfile.TemporaryDirectory(prefix="mammometry-demo-") as scratch, ExitStack() as working:
        # One rendering provides the photographs of the rig and of the first visit.
        first = PATIENTS[0]
        made = render(Path(scratch) / "rig", first.subject, first.dates[0][1], POSES, say("photographs"))
        working.enter_context(_runner(config))
        calibration = _calibrated(made)
        if not whole:
            working.close()  # from here on, the server's runner does the queued jobs
        _check(calibration.rig, made)
        visit = _enter_visits(calibration)[0]
        _bring(visit, made)
        enqueue(visit, None)
        if whole:
            finish(say)
            _wait_for_jobs(folder, say("measurements"))
    failed = {
        f"{job.visit.patient.pseudonym} {job.visit.taken_at:%Y-%m-%d}" if job.visit else job.kind: job.message
        for job in Job.objects.filter(state=Job.State.FAILED).select_related("visit__patient")
    }
    return Demo(
        config=config,
        passwords=passwords,
        visits=Visit.objects.count(),
        measured=Visit.objects.filter(state=Visit.State.MEASURED).count(),
        failed=failed,
        seconds=time.monotonic() - begun,
    )


def finish(say: Callable[[str], Progress]) -> None:
    """Upload photographs for the demo's visits that have none yet, and queue the visits.

    It may be interrupted and called again.
    """
    from mammometry.clinic.jobs.queue import enqueue
    from mammometry.clinic.models import Visit

    waiting = (Visit.State.NEW, Visit.State.UPLOADING, Visit.State.READY)
    with tempfile.TemporaryDirectory(prefix="mammometry-demo-") as scratch:
        for place, patient in enumerate(PATIENTS):
            for number, (_, other) in enumerate(patient.dates):
                visit = Visit.objects.filter(
                    patient__record_number=_record_number(place), note=_note(number), state__in=waiting
                ).first()
                if visit is None:
                    continue
                made = render(Path(scratch) / str(visit.pk), patient.subject, other, 1, say(patient.given_name))
                _bring(visit, made)
                enqueue(visit, None)
                shutil.rmtree(made)


def finish_beside(folder: Path) -> None:
    """Finish a demo while its server is running."""
    from mammometry.base.progress import no_progress
    from mammometry.clinic.site import configure

    lower_priority()  # pages and measurements come first
    configure(read_config(folder))
    finish(lambda _: no_progress)


def _people() -> dict[str, str]:
    """One person per role, with a random password."""
    from mammometry.clinic.models import Person

    passwords = {}
    for name, full_name in _PEOPLE:
        roles = [name] if name != "clinician" else ["clinician", "technician"]
        person = Person(username=name, full_name=full_name, roles=roles)
        passwords[name] = secrets.token_urlsafe(12)
        person.set_password(passwords[name])
        person.save()
    return passwords


@contextmanager
def _runner(config: ClinicConfig) -> Iterator[None]:
    """Run the queue in this process while photographs are rendered."""
    from mammometry.clinic.jobs.runner import Runner

    runner = Runner(config)
    thread = threading.Thread(target=runner.run, daemon=True)
    thread.start()
    try:
        yield
    finally:
        runner.stop()
        thread.join()


def _calibrated(made: Path) -> Calibration:
    """Calibrate the rig, dated some days before the first visit."""
    from django.utils import timezone

    from mammometry.capture.sessions import definition_of
    from mammometry.clinic.jobs.queue import enqueue
    from mammometry.clinic.models import Rig
    from mammometry.clinic.rig_history import new_calibration
    from mammometry.io.manifest import read_manifest

    rig = Rig.objects.create(name=_RIG_NAME, definition=definition_of(read_manifest(made / "session.toml")))
    calibration = new_calibration(rig, None)
    calibration.taken_at = timezone.now() - datetime.timedelta(days=_CALIBRATED_DAYS)
    calibration.save()
    for path in _shots(made)[1:]:
        for photograph in sorted(path.glob("*.jpg")):
            _send(calibration, photograph, pose=path.name)
    enqueue(calibration, None)
    _write_cameras(made, rig)
    _wait_for_calibration(rig)
    calibration.refresh_from_db()
    return calibration


def _with_cameras(config: ClinicConfig) -> ClinicConfig:
    """Name the rig's cameras in the clinic's settings, before a process is configured with them."""
    path = config.folder / FILE
    write_private(path, f"{path.read_text(encoding='utf-8')}\n[cameras]\n{quoted(_RIG_NAME)} = {quoted(_RIG_FILE)}\n")
    return read_config(config.folder)


def _write_cameras(made: Path, rig: Rig) -> None:
    """Use the rendered pictures as the rig's cameras, so that capturing can be tried on the page."""
    from mammometry.capture.sessions import manifest_text
    from mammometry.clinic.site import the_clinic
    from mammometry.io.write import write_text

    path = the_clinic().folder / _RIG_FILE
    pictures = path.parent / "pictures"
    shutil.copytree(made / "capture", pictures / "capture")
    text = manifest_text(rig.definition, "torso")
    capture = f'\n[capture]\nbackend = "virtual"\noptions = {{ session = {quoted(str(pictures))} }}\n'
    write_text(path, text + capture)


def _shots(made: Path) -> list[Path]:
    """Folders of the board's poses."""
    return sorted((made / "calibration").iterdir())


def _check(rig: Rig, made: Path) -> None:
    """Make today's check with a new photograph of the board."""
    from mammometry.clinic.jobs.queue import enqueue
    from mammometry.clinic.rig_history import new_check

    check = new_check(rig, None)
    assert check is not None
    for path in sorted(_shots(made)[0].glob("*.jpg")):
        _send(check, path)
    enqueue(check, None)


def _enter_visits(calibration: Calibration) -> list[Visit]:
    """Enter all patients and their visits, without photographs."""
    from django.utils import timezone

    from mammometry.clinic.models import Consent, Operation, Patient, Visit

    made = []
    for place, drawn in enumerate(PATIENTS):
        patient = Patient.objects.create(
            family_name=drawn.family_name,
            given_name=drawn.given_name,
            born=drawn.born,
            record_number=_record_number(place),
        )
        first = timezone.localdate() - datetime.timedelta(days=drawn.dates[0][0])
        for purpose in Consent.Purpose:
            Consent.objects.create(patient=patient, purpose=purpose, given_on=first)
        for days, kind, side in drawn.operations:
            day = timezone.localdate() - datetime.timedelta(days=days)
            Operation.objects.create(patient=patient, kind=kind, side=side, day=day)
        for number, (days, _) in enumerate(drawn.dates):
            made.append(
                Visit.objects.create(
                    patient=patient,
                    rig=calibration.rig,
                    calibration=calibration,
                    taken_at=timezone.now() - datetime.timedelta(days=days),
                    note=_note(number),
                )
            )
    return made


def _record_number(place: int) -> str:
    return f"DEMO-{place + 1:03d}"


def _note(number: int) -> str:
    return f"Demo: visit {number + 1}. A virtual patient; the photographs are rendered."


def _bring(visit: Visit, made: Path) -> None:
    """Upload a visit's missing photographs."""
    placed = set(visit.uploads.filter(state="placed").values_list("camera", flat=True))
    for path in sorted((made / "capture").glob("*.jpg")):
        if path.stem not in placed:
            _send(visit, path)
    visit.refresh_from_db()


def _wait_for_jobs(folder: Path, progress: Progress) -> None:
    from mammometry.clinic.models import Job

    until = time.monotonic() + _WAIT_S
    while left := Job.objects.filter(state__in=(Job.State.QUEUED, Job.State.RUNNING)).count():
        if time.monotonic() > until:
            remedy = f"Look at {folder / 'logs'}"
            raise BatchError("the demo's jobs", found=f"{left} that have not ended", expected="none", remedy=remedy)
        progress(1.0 - left / Job.objects.count())
        time.sleep(_LOOK_S)


def _wait_for_calibration(rig: Rig) -> None:
    from mammometry.clinic.models import Calibration, Job

    until = time.monotonic() + _WAIT_S
    while not Calibration.objects.filter(rig=rig, current=True).exists():
        failed = Job.objects.filter(calibration__rig=rig, state=Job.State.FAILED).first()
        if failed is not None or time.monotonic() > until:
            raise BatchError(
                "the demo's rig", found=failed.message if failed else "no calibration yet", expected="a calibration",
                remedy="Report this to the authors",
            )  # fmt: skip
        time.sleep(_LOOK_S)


def render(folder: Path, subject: str, other: str, poses: int, progress: Progress) -> Path:
    """Render photographs of the target or of a subject with one rig."""
    from mammometry.calibration.targets.kinds.charuco import CharucoTarget
    from mammometry.simulate.recipe import SessionRecipe, parse_situation
    from mammometry.simulate.session import write_session
    from mammometry.simulate.studio import Studio

    recipe = SessionRecipe(
        rig=_RIG, subject=subject, scale=_SCALE, seed=_SEED, poses=poses, situation=parse_situation(other)
    )
    target = CharucoTarget(**_TARGET)  # type: ignore[arg-type]
    write_session(folder, recipe, Studio(target=target), truth=False, progress=progress)
    return folder


def _send(target: object, path: Path, pose: str = "") -> None:
    """Upload one photograph in the same way as the page."""
    from mammometry.clinic.intake import uploads
    from mammometry.clinic.intake.announced import Announced
    from mammometry.clinic.models import Calibration, DailyCheck, Visit
    from mammometry.io.write import file_digest

    assert isinstance(target, (Visit, Calibration, DailyCheck))
    data = path.read_bytes()
    file = Announced(name=path.name, camera=path.stem, pose=pose, size_bytes=len(data), sha256=file_digest(path))
    upload = uploads.begin(target, None, file)
    uploads.append(upload, 0, data)
