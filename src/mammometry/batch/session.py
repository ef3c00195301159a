"""A batch's work on one session: fetch, measure, record the result."""

import base64
import io
import json
import os
import shutil
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeVar

import psutil
from PIL import Image

from mammometry.api.job import Job, open_session
from mammometry.api.stored_report import WARNINGS
from mammometry.base.errors import BusyError
from mammometry.base.machine.system import peak_memory_mb
from mammometry.base.notices import from_table
from mammometry.base.progress import Progress, StageProgress
from mammometry.batch import storage
from mammometry.batch.record import (
    RECORD,
    BatchEntry,
    BatchRow,
    Measured,
    SessionRecord,
    key_of,
    read_record,
    stats_of,
    write_record,
)
from mammometry.io.meshes.measured import is_result, results_of
from mammometry.io.photographs.images import megapixels_of
from mammometry.io.write import disk_errors
from mammometry.job.products import Key
from mammometry.settings import Settings

_R = TypeVar("_R")
_PICTURES = ("measure/overview.png", "surface/views.png")
_THUMBNAIL_PX, _THUMBNAIL_QUALITY = 160, 70  # about 3 kB each
_SCRATCH = "mammometry-batch-"
_WAIT_S, _STEP_S = 30.0, 1.0
"""Wait for the previous run of a restarted task, which may still be ending in the session."""


def measure_entry(progress: StageProgress, entry: BatchEntry, settings: str) -> dict[str, Any]:
    """Measure one session in place, or in a scratch folder if remote.

    Args:
        progress: called with stage and fraction.
        entry: the session.
        settings: all settings of the batch, TOML; the entry's own take precedence.

    Returns:
        The record's digest, and the size of the photographs in megapixels.

    Raises:
        MammometryError: the session cannot be measured.
    """
    chosen = Settings.from_toml(settings).overridden(entry.assignments)
    if not entry.remote:
        with disk_errors(Path(entry.address)):
            record = _measured(Path(entry.address), chosen, progress)
    else:
        with _scratch() as scratch, disk_errors(scratch):
            folder = scratch / entry.name
            progress("fetch", 0.0)
            files = storage.fetch(entry, folder)
            record = _measured(folder, chosen, progress).model_copy(update={"files": files})
            write_record(folder, record)
            progress("put", 0.0)
            storage.put(entry, folder / "results", record.digest)
    return {"digest": record.digest, "megapixels": record.row.megapixels}


@contextmanager
def _scratch() -> Iterator[Path]:
    """A folder for this task only. Folders of killed tasks are removed."""
    base = Path(tempfile.gettempdir())
    for left in base.glob(f"{_SCRATCH}*"):
        pid = left.name.removeprefix(_SCRATCH).partition("-")[0]
        if pid.isdecimal() and not psutil.pid_exists(int(pid)):
            shutil.rmtree(left, ignore_errors=True)
    with tempfile.TemporaryDirectory(prefix=f"{_SCRATCH}{os.getpid()}-", ignore_cleanup_errors=True) as folder:
        yield Path(folder)


def _measured(session: Path, settings: Settings, progress: StageProgress) -> SessionRecord:
    """Measure a session and write its record.

    The record has the state of the user's files before the run, so that changes during the run are noticed next time.
    """
    before = stats_of(session)
    job = open_session(session, settings, watch=lambda key: watched(key, progress))
    made = _when_free(lambda: job.run().made)
    earlier = None if made else _earlier(session)
    row = _row_of(job, peak_memory_mb() if earlier is None else earlier.peak_memory_mb)
    brought = {name: stat for name, stat in before.items() if not is_result(session, name)}
    made_now = {name: stat for name, stat in stats_of(session).items() if is_result(session, name)}
    record = SessionRecord(key=key_of(settings), files={**brought, **made_now}, row=row)
    write_record(session, record)
    return record


def _earlier(session: Path) -> BatchRow | None:
    """Result of an earlier record, for a run that made nothing.

    The peak memory of such a run is too low to be useful.
    """
    try:
        record = read_record((results_of(session) / RECORD).read_bytes())
    except OSError:
        return None
    return None if record is None else record.row


def _when_free(run: Callable[[], _R]) -> _R:
    """Run as soon as no other run is active in the session."""
    until = time.monotonic() + _WAIT_S
    while True:
        try:
            return run()
        except BusyError:
            if time.monotonic() > until:
                raise
            time.sleep(_STEP_S)


def _row_of(job: Job, peak_mb: float | None) -> BatchRow:
    warnings = json.loads((job.store.folder / "report" / WARNINGS).read_text(encoding="utf-8"))
    made = [job.store.record(key) for stage in job.stages for key in job.keys(stage)]
    return BatchRow(
        session=job.identity.name,
        subject=job.identity.subject,
        date=job.identity.date or None,
        measured=tuple(
            Measured(name=name, volume_cc=measured.volume_cc, interval_cc=measured.interval_cc)  # type: ignore[arg-type]
            for name, measured in job.measure().items()
        ),
        no_breast=job.no_breast(),
        notices=tuple(map(from_table, warnings["notices"])),
        made_at=job.made_at("report"),
        seconds=round(sum(record.seconds for record in made if record is not None), 3),
        peak_memory_mb=peak_mb,
        megapixels=megapixels_of(job.folder / "capture") if job.inputs.photographs else 0.0,
        page="report/report.html",
        thumbnail=_thumbnail(job.store.folder),
    )


def _thumbnail(results: Path) -> str | None:
    """A small picture of the subject, WebP in base64. None if there is none."""
    for name in _PICTURES:
        if not (results / name).is_file():
            continue
        with Image.open(results / name, formats=("PNG",)) as image:
            small = image.convert("RGB")
        small.thumbnail((_THUMBNAIL_PX, _THUMBNAIL_PX))
        buffer = io.BytesIO()
        small.save(buffer, format="WEBP", quality=_THUMBNAIL_QUALITY)
        return base64.b64encode(buffer.getvalue()).decode("ascii")
    return None


@contextmanager
def watched(key: Key, progress: StageProgress) -> Iterator[Progress]:
    """Report progress of a product as progress of its stage."""
    progress(key.stage, 0.0)
    yield lambda fraction: progress(key.stage, fraction)
