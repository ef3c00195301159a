"""Input files of a session or scan, compared with those of its stored results."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from mammometry.api.changes import Changes, changes, source_of
from mammometry.api.job import Job, open_session
from mammometry.io.drawn import BOUNDARIES, LANDMARK_FILE
from mammometry.io.manifest import MANIFEST
from mammometry.io.meshes.measured import is_measured
from mammometry.io.meshes.scans import ABOUT, MESH, RESULTS
from mammometry.io.results.verify import shown
from mammometry.job.products import STAGES, Key
from mammometry.settings import Settings

_WHOLE = {"cameras": "cameras.json", "prior": "prior.json", "wall": "wall.ply"}  # input → its file
_BY_VALUE = (MANIFEST, ABOUT, MESH, BOUNDARIES, LANDMARK_FILE)
"""Files that are always compared: keys of results contain all their content except comments."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Sources:
    """Comparison of photographs, drawings and settings with those of the results."""

    wanted: frozenset[str]
    """``stage/product`` of all results that belong to the session now."""
    changed: Changes
    """Differences from the sources of the stored results."""
    not_compared: tuple[str, ...]
    """Files that no result depends on. A folder is listed with a final ``/`` and the number of such files in it."""


def sources(folder: Path, settings: Settings, recorded: frozenset[str]) -> Sources:
    """Comparison of a session or an imported scan with the records of its results. Nothing is written.

    Args:
        folder: folder of the session or scan.
        settings: settings of the results.
        recorded: files that other records contain, as paths relative to the folder.

    Raises:
        MammometryError: it cannot be opened.
    """
    job = open_session(folder, settings)
    keys = [key for stage in STAGES[:-1] if job.plan.products(stage) for key in job.keys(stage)]
    keys += [job.content_key, job.report_key]
    used = _used_files(job, keys)
    names = (shown(name) for name in _files(folder) if name not in {*used, *_BY_VALUE, *recorded})
    return Sources(
        wanted=frozenset(f"{key.stage}/{key.product}" for key in keys),
        changed=changes(job.store, job.plan, keys),
        not_compared=tuple(_by_folder(names)),
    )


def _used_files(job: Job, keys: list[Key]) -> set[str]:
    """Files whose digests are in the keys of results."""
    if "calibrate" not in job.stages:
        return set()
    named = {source_of(key, name) for key in keys for name in key.inputs}
    found = job.session.files()
    files = {name: path.relative_to(job.session.path).as_posix() for name, path in found.items()} | _WHOLE
    return {path for name, path in files.items() if name in named}


def _files(folder: Path) -> Iterator[str]:
    """Files of a folder except its results and hidden files. None in a measured mesh's folder."""
    if is_measured(folder):
        return
    for path in sorted(folder.rglob("*")):
        below = path.relative_to(folder)
        if path.is_file() and below.parts[0] != RESULTS and not any(part.startswith(".") for part in below.parts):
            yield below.as_posix()


def _by_folder(names: Iterator[str]) -> Iterator[str]:
    counts = Counter(name.partition("/")[0] + "/" * ("/" in name) for name in names)
    for name, count in sorted(counts.items()):
        yield f"{name} ({count} file{'s' * (count > 1)})" if name.endswith("/") else name
