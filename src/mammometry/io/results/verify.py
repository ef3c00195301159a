"""Verify that every byte of a results folder is as it was written. Changes nothing."""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from mammometry.base.errors import SessionError
from mammometry.io.manifest import MANIFEST
from mammometry.io.meshes.scans import RESULTS, is_scan
from mammometry.io.results.records import RECORDS, FileRecord, file_of, is_link, read_ready, read_records
from mammometry.io.results.store import ASIDE, READY, WRITING
from mammometry.io.write import file_digest
from mammometry.job.products import STAGES


@dataclass(frozen=True, slots=True, kw_only=True)
class Damage:
    """One file that is not as it was written."""

    stage: str
    product: str | None
    """None: it is the stage's record of all its products."""
    file: str
    """Path below the results folder."""
    found: str
    """What was found, in words."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Findings:
    """Result of a check of all files."""

    products: int
    files: int
    """Files that should be there."""
    bytes: int
    """Bytes that are as they were written."""
    damaged: tuple[Damage, ...]
    unrecorded: tuple[str, ...]
    """Files in the stages' folders that no record names."""
    leftovers: tuple[str, ...]
    """What an interrupted run has left, and what was set aside."""


def results_in(folder: Path) -> Path:
    """Results folder of a session or a scan. A measured mesh's folder is one itself.

    Raises:
        SessionError: it holds neither.
    """
    if (folder / MANIFEST).is_file() or is_scan(folder):
        return folder / RESULTS
    if any((folder / stage).is_dir() for stage in STAGES):
        return folder
    remedy = "Name the folder that `mammometry run` or `mammometry measure` has written to"
    expected = "a session, a scan, or the folder of a measured mesh"
    raise SessionError(str(folder), found="no results", expected=expected, remedy=remedy)


def verify(results: Path) -> Findings:
    """Compare all recorded files on the disk with their records."""
    read = {stage: read_records(results / stage) for stage in STAGES}
    files = [
        (stage, product, name, written)
        for stage, (records, _) in read.items()
        for product, record in records.items()
        for name, written in record.files.items()
    ]
    hidden = sorted(path.name for path in results.iterdir()) if results.is_dir() else []
    moving = _half_in_place(results, hidden)
    damaged, unrecorded, whole = list[Damage](), list[str](), 0
    for stage, (records, invalid) in read.items():
        present = sorted(_files(results / stage))
        recorded = {name for record in records.values() for name in record.files} | {RECORDS}
        unrecorded += [shown(f"{stage}/{name}") for name in present if name not in recorded]
        damaged += [
            _no_record(stage, name)
            for name in invalid or ([RECORDS] if set(present) - moving[stage] and not records else [])
        ]
    for stage, product, name, written in files:
        damage = _damage(results, stage, name, written)
        if damage is None:
            whole += written.bytes
        else:
            damaged.append(Damage(stage=stage, product=product, file=f"{stage}/{name}", found=damage))
    return Findings(
        products=sum(len(records) for records, _ in read.values()),
        files=len(files),
        bytes=whole,
        damaged=tuple(damaged),
        unrecorded=tuple(unrecorded),
        leftovers=tuple(shown(name) for name in hidden if name.startswith((WRITING, READY, ASIDE))),
    )


def _half_in_place(results: Path, names: Iterable[str]) -> Mapping[str, set[str]]:
    """Files by stage that an interrupted run was moving into place. The next run goes on with them."""
    moving: dict[str, set[str]] = {stage: set() for stage in STAGES}
    for name in names:
        about = read_ready(results / name) if name.startswith(READY) else None
        if about is not None:
            moving[about.stage].update(about.record.files)
    return moving


def _no_record(stage: str, name: str) -> Damage:
    product = None if name == RECORDS else shown(name)
    found = "no valid records" if product is None else f"no valid record of {product}"
    return Damage(stage=stage, product=product, file=f"{stage}/{RECORDS}", found=found)


def _damage(results: Path, stage: str, name: str, written: FileRecord) -> str | None:
    path = file_of(results, stage, name)
    if path is None:
        return "no such file"
    if path.st_size != written.bytes:
        return f"{path.st_size} bytes where {written.bytes} were written"
    try:
        digest = file_digest(results / stage / name)
    except OSError as error:
        return f"a file that cannot be read ({error.strerror})"
    return None if digest == written.sha256 else "other bytes than were written"


def _files(folder: Path) -> Iterator[str]:
    for path in folder.rglob("*") if folder.is_dir() and not is_link(folder) else ():
        if is_link(path) or not path.is_dir():
            yield path.relative_to(folder).as_posix()


def shown(name: str) -> str:
    """A name from the disk as printable text. Control characters and lone surrogates are replaced."""
    return "".join(letter if letter.isprintable() else "?" for letter in name)
