"""Verify that all files in a results folder are as written. Changes nothing."""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from mammometry.base.errors import SessionError, StorageError
from mammometry.io.meshes.measured import can_be_opened, results_of
from mammometry.io.outputs import RECORD, written_in
from mammometry.io.results.lock import LOCK
from mammometry.io.results.records import (
    RECORDS,
    FileRecord,
    file_of,
    is_link,
    is_plain,
    read_ready,
    read_records,
    status,
)
from mammometry.io.results.store import ASIDE, READY, WRITING
from mammometry.io.sealed import unsealed
from mammometry.io.write import file_digest
from mammometry.job.products import STAGES

BATCH = "batch.json"
"""Record of a batch in the results folder."""
_NOT_RESULTS = (LOCK, WRITING, READY, ASIDE)  # locks, and remains of an interrupted run, which are listed separately


@dataclass(frozen=True, slots=True, kw_only=True)
class Damage:
    """A file that is not as written."""

    stage: str | None
    """Stage. None if it is not in a stage, such as a page for other people."""
    product: str | None
    """Product. None if it is not part of a product, such as a stage's record."""
    file: str
    """Path below the results folder, or below the session if it is not a result."""
    found: str
    """What was found, as text."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Findings:
    """Result of a verification."""

    products: int
    files: int
    """Number of files of products, and of commands that record what they write."""
    outputs: tuple[str, ...]
    """Files written by commands: paths below the session or the results."""
    bytes: int
    """Number of bytes of these files as written."""
    damaged: tuple[Damage, ...]
    unrecorded: tuple[str, ...]
    """Files in the results folder that are in no record."""
    leftovers: tuple[str, ...]
    """Remains of an interrupted run, and files that were set aside."""
    without_digest: tuple[str, ...]
    """Records without their own digest, from versions up to 1.0.0. Their times are not checked."""


def results_in(folder: Path) -> Path:
    """Results folder of a session or a scan. Any other folder that a command wrote is returned itself.

    Raises:
        SessionError: it contains neither.
    """
    if can_be_opened(folder):
        return results_of(folder)
    if (folder / RECORD).is_file() or any((folder / stage).is_dir() for stage in STAGES):
        return folder
    remedy = "Name the folder that `mammometry run` or another command wrote to"
    expected = "a session, a scan, or the output folder of a command"
    raise SessionError(str(folder), found="no results", expected=expected, remedy=remedy)


def verify(results: Path, session: Path | None = None) -> Findings:
    """Compare all recorded files with their records.

    Args:
        results: results folder, which contains the folders of the stages.
        session: its session or scan. Its other folders are checked, too, if a command has left a record there.
    """
    read = {stage: read_records(results / stage) for stage in STAGES}
    files = [
        (stage, product, name, written)
        for stage, about in read.items()
        for product, record in about.records.items()
        for name, written in record.files.items()
    ]
    hidden = sorted(path.name for path in results.iterdir()) if results.is_dir() else []
    moving = _half_in_place(results, hidden)
    damaged, whole = list[Damage](), 0
    known = {f"{stage}/{name}" for stage, _, name, _ in files}
    for stage, about in read.items():
        present = set(_files(results / stage))
        known.add(f"{stage}/{RECORDS}")
        damaged += [
            _no_record(stage, name)
            for name in about.invalid or ([RECORDS] if present - moving[stage] and not about.records else [])
        ]
    for stage, product, name, written in files:
        damage = _damage(results, stage, name, written)
        if damage is None:
            whole += written.bytes
        else:
            damaged.append(Damage(stage=stage, product=product, file=f"{stage}/{name}", found=damage))
    others = _others(results, session)
    outputs = [*others.whole, *(damage.file for damage in others.damaged)]
    known.update(outputs)
    return Findings(
        products=sum(len(about.records) for about in read.values()),
        files=len(files) + len(outputs),
        outputs=tuple(outputs),
        bytes=whole + sum(others.whole.values()),
        damaged=(*damaged, *others.damaged),
        unrecorded=tuple(shown(name) for name in sorted(_files(results)) if name not in known),
        leftovers=tuple(shown(name) for name in hidden if name.startswith((WRITING, READY, ASIDE))),
        without_digest=tuple(
            [f"{stage}/{RECORDS}" for stage, about in read.items() if about.records and not about.has_digest]
            + list(others.without_digest)
        ),
    )


class _Others(NamedTuple):
    """Files that no stage has written, checked by their own records."""

    whole: Mapping[str, int]
    """File → its size in bytes."""
    damaged: tuple[Damage, ...]
    without_digest: tuple[str, ...]


def _others(results: Path, session: Path | None) -> _Others:
    """Check the files of other commands, and the record of a batch."""
    whole, damaged, without_digest = dict[str, int](), list[Damage](), list[str]()
    root = results if session is None else session
    records = [path for path in (root.rglob(RECORD) if root.is_dir() else ()) if not _is_below_link(path, root)]
    for record in sorted(records):
        folder = record.parent
        try:
            written = written_in(folder)
            _, has_digest = unsealed(record.read_bytes())
        except (StorageError, OSError) as error:
            found = error.found if isinstance(error, StorageError) else str(error.strerror)
            damaged.append(Damage(stage=None, product=None, file=_named(record, results, root), found=found))
            continue
        whole[_named(record, results, root)] = record.stat().st_size
        without_digest += [] if has_digest else [_named(record, results, root)]
        for name, about in written.items():
            path = folder / name
            if status(path) is None:
                continue  # removed, possibly by the command itself
            if file_digest(path) in about.sha256:
                whole[_named(path, results, root)] = path.stat().st_size
            else:
                found = f"a file that was changed since `mammometry {about.command}` wrote it"
                damaged.append(Damage(stage=None, product=None, file=_named(path, results, root), found=found))
    batch = results / BATCH
    if is_plain(batch):
        try:
            _, has_digest = unsealed(batch.read_bytes())
            whole[BATCH] = batch.stat().st_size
            without_digest += [] if has_digest else [BATCH]
        except (ValueError, RecursionError) as error:
            damaged.append(Damage(stage=None, product=None, file=BATCH, found=str(error)))
    return _Others(whole, tuple(damaged), tuple(without_digest))


def _is_below_link(path: Path, root: Path) -> bool:
    below = path.relative_to(root)
    return any(is_link(root / above) for above in (below, *below.parents[:-1]))


def _named(path: Path, results: Path, root: Path) -> str:
    """Path below the results, or else below the session."""
    return shown(path.relative_to(results if path.is_relative_to(results) else root).as_posix())


def _half_in_place(results: Path, names: Iterable[str]) -> Mapping[str, set[str]]:
    """Stage → files that an interrupted run was moving into place. The next run continues with them."""
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
        return f"{path.st_size} bytes instead of {written.bytes}"
    try:
        digest = file_digest(results / stage / name)
    except OSError as error:
        return f"a file that cannot be read ({error.strerror})"
    return None if digest == written.sha256 else "a file that was changed since it was written"


def _files(folder: Path) -> Iterator[str]:
    """Files below a folder, without locks and without hidden working folders at its top level."""
    for path in folder.rglob("*") if folder.is_dir() and not is_link(folder) else ():
        below = path.relative_to(folder)
        if (is_link(path) or not path.is_dir()) and not below.parts[0].startswith(_NOT_RESULTS):
            yield below.as_posix()


def shown(name: str) -> str:
    """A file name as printable text: control characters and lone surrogates are replaced."""
    return "".join(letter if letter.isprintable() else "?" for letter in name)
