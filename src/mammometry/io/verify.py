"""Whether every byte of a results folder is as it was written; reads only."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

from mammometry.errors import SessionError
from mammometry.io.manifest import MANIFEST
from mammometry.io.records import RECORDS, FileRecord, file_of, is_link, read_records
from mammometry.io.store import ASIDE, READY, WRITING
from mammometry.io.write import file_digest
from mammometry.products import STAGES


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


@dataclass(slots=True, kw_only=True)
class Findings:
    """What a check of all files came to."""

    products: int = 0
    files: int = 0
    """Files that were read."""
    bytes: int = 0
    damaged: list[Damage] = field(default_factory=list)
    unrecorded: list[str] = field(default_factory=list)
    """Files in the stages' folders that no record names."""
    leftovers: list[str] = field(default_factory=list)
    """What an interrupted run has left, and what was set aside."""


def results_in(folder: Path) -> Path:
    """The results of a session; of a measured mesh, or of results themselves, the folder as it is.

    Raises:
        SessionError: it holds neither.
    """
    if (folder / MANIFEST).is_file():
        return folder / "results"
    if any((folder / stage).is_dir() for stage in STAGES):
        return folder
    raise SessionError(
        str(folder),
        found="no results",
        expected="a session, or the folder of a measured mesh",
        remedy="Name the folder that `mammometry run` or `mammometry measure` has written to",
    )


def verify(results: Path) -> Findings:
    """Read all recorded files from the disk and compare them with their records."""
    findings = Findings()
    for stage in STAGES:
        _verify_stage(results, stage, findings)
    for path in sorted(results.iterdir()) if results.is_dir() else ():
        if path.name.startswith((WRITING, READY, ASIDE)):
            findings.leftovers.append(shown(path.name))
    return findings


def _verify_stage(results: Path, stage: str, findings: Findings) -> None:
    records, invalid = read_records(results / stage)
    told = {name for record in records.values() for name in record.files} | {RECORDS}
    there = sorted(_files(results / stage))
    findings.unrecorded += [shown(f"{stage}/{name}") for name in there if name not in told]
    if there and not records and not invalid:
        invalid = [RECORDS]
    for name in invalid:
        product = None if name == RECORDS else shown(name)
        said = "no valid records" if product is None else f"no valid record of {product}"
        findings.damaged.append(Damage(stage=stage, product=product, file=f"{stage}/{RECORDS}", found=said))
    for product, record in records.items():
        findings.products += 1
        for name, file in record.files.items():
            findings.files += 1
            found = _damage(results, stage, name, file)
            if found is None:
                findings.bytes += file.bytes
            else:
                findings.damaged.append(Damage(stage=stage, product=product, file=f"{stage}/{name}", found=found))


def _damage(results: Path, stage: str, name: str, told: FileRecord) -> str | None:
    found = file_of(results, stage, name)
    if found is None:
        return "no such file"
    if found.st_size != told.bytes:
        return f"{found.st_size} bytes where {told.bytes} were written"
    try:
        digest = file_digest(results / stage / name)
    except OSError as error:
        return f"a file that cannot be read ({error.strerror})"
    return None if digest == told.sha256 else "other bytes than were written"


def _files(folder: Path) -> Iterator[str]:
    for path in folder.rglob("*") if folder.is_dir() and not is_link(folder) else ():
        if is_link(path) or not path.is_dir():
            yield path.relative_to(folder).as_posix()


def shown(name: str) -> str:
    """A name from the disk that may be printed: without control characters and halves of letters."""
    return "".join(letter if letter.isprintable() else "?" for letter in name)
