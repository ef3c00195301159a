"""Records in provenance.json, checked strictly because the folder may be from another computer."""

import os
import re
import stat as modes
from pathlib import Path
from typing import Annotated, Any, NamedTuple, Self

from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
    StringConstraints,
    ValidationError,
    model_validator,
)

from mammometry.io.sealed import sealed, unsealed
from mammometry.job.products import STAGES, Key, Stage

RECORDS = "provenance.json"
READY_RECORD = "record.json"
_FORMAT = 1  # version of a stage's record; others are not read
_STRICT = ConfigDict(extra="forbid", strict=True, frozen=True)
_PART = re.compile(r'[^.<>:"/\\|?*\x00-\x1f\x7f][^<>:"/\\|?*\x00-\x1f\x7f]*')
_UNREADABLE = (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError)


def _is_file_name(name: str) -> str:
    """Whether a name is that of a visible file, is valid on every system, and is not that of a record."""
    parts = name.split("/")
    if not all(_PART.fullmatch(part) and part[-1] not in ". " for part in parts) or name.casefold() == RECORDS:
        raise ValueError("the name of a file inside the stage's folder")
    return name


FileName = Annotated[str, AfterValidator(_is_file_name)]
Digest = Annotated[str, StringConstraints(pattern="^[0-9a-f]{64}$")]
ProductName = Annotated[str, StringConstraints(pattern=r"^[^\x00-\x1f\x7f]+$")]
Moment = Annotated[str, StringConstraints(pattern=r"^\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d\+00:00$")]


class FileRecord(BaseModel):
    """One file of a product, as written."""

    model_config = _STRICT

    bytes: Annotated[int, Field(ge=0)]
    sha256: Digest


class ProductRecord(BaseModel):
    """Inputs of a product, and its files."""

    model_config = _STRICT

    key: Digest
    subject: str | None = None
    """Identifier of the subject. None if the session does not name one."""
    version: int
    settings: dict[str, Any]
    inputs: dict[str, str]
    files: dict[FileName, FileRecord]
    """Path below the stage's folder, with ``/`` → file."""
    made: Moment
    """Time in UTC. Sorting as text sorts by time."""
    seconds: Annotated[float, Field(ge=0)]
    """Elapsed time of the computation, s."""
    software: dict[str, str]


class Ready(BaseModel):
    """A product that has been written completely but not yet moved into place."""

    model_config = _STRICT

    stage: Stage
    product: ProductName
    record: ProductRecord

    @model_validator(mode="after")
    def _key_fits(self) -> Self:
        """Refuse a version, settings or inputs that do not belong to the key.

        The records of versions up to 1.0.0 have no other protection.
        """
        about = self.record
        key = Key(
            stage=self.stage,
            product=self.product,
            version=about.version,
            settings=about.settings,
            inputs=about.inputs,
        )
        if key.digest != about.key:
            raise ValueError("a key that is not that of its settings and inputs")
        return self


class StageRecords(NamedTuple):
    """Content of a stage's provenance.json."""

    records: dict[str, ProductRecord]
    """Product → record, for all valid records."""
    invalid: list[str]
    """Names of invalid records. ``provenance.json`` itself if it cannot be read or was changed."""
    has_digest: bool
    """Whether its own digest confirms it. Versions up to 1.0.0 did not write one."""


def read_records(folder: Path) -> StageRecords:
    """Read the records in a stage's folder. Empty if there is no file."""
    try:
        if is_link(folder) or not is_plain(folder / RECORDS):
            return StageRecords({}, [RECORDS] if os.path.lexists(folder / RECORDS) else [], has_digest=False)
        table, has_digest = unsealed((folder / RECORDS).read_bytes())
        if table["format"] != _FORMAT or table["stage"] != folder.name:
            return StageRecords({}, [RECORDS], has_digest=False)
        products = dict(table["products"])
    except _UNREADABLE:
        return StageRecords({}, [RECORDS], has_digest=False)
    records: dict[str, ProductRecord] = {}
    invalid: list[str] = []
    for name, entry in products.items():
        try:
            about = Ready.model_validate({"stage": folder.name, "product": name, "record": entry})
        except (ValidationError, RecursionError):
            invalid.append(name)
        else:
            records[name] = about.record
    return StageRecords(records, invalid, has_digest)


def write_records(stage: str, records: dict[str, ProductRecord]) -> bytes:
    """Content of a stage's provenance.json."""
    products = {name: record.model_dump() for name, record in sorted(records.items())}
    return sealed({"format": _FORMAT, "stage": stage, "products": products})


def write_ready(about: Ready) -> bytes:
    """Content of the record of a product that has been written completely."""
    return sealed(about.model_dump())


def read_ready(folder: Path) -> Ready | None:
    """Read the record of a product that has been written completely. None if there is no valid record."""
    try:
        if not is_plain(folder / READY_RECORD):
            return None
        return Ready.model_validate(unsealed((folder / READY_RECORD).read_bytes())[0])
    except _UNREADABLE:
        return None


def is_own_folder(folder: Path) -> bool:
    """Whether a hidden folder contains only our own files at its top level."""
    if is_link(folder) or not folder.is_dir():
        return False
    return all(
        is_plain(path) if path.name in (RECORDS, READY_RECORD) else path.name in STAGES and not is_link(path)
        for path in folder.iterdir()
    )


def is_link(path: Path) -> bool:
    """Whether a path is a symbolic link, or a junction on Windows."""
    return path.is_symlink() or bool(getattr(os.path, "isjunction", lambda _: False)(path))


def is_plain(path: Path) -> bool:
    """Whether a path is an ordinary file, and not a folder, link, pipe or device."""
    return status(path) is not None


def status(path: Path) -> os.stat_result | None:
    """Size and times of an ordinary file. None if there is none."""
    try:
        about = path.lstat()
    except (OSError, ValueError):
        return None
    return about if modes.S_ISREG(about.st_mode) else None


def file_of(results: Path, stage: str, name: str) -> os.stat_result | None:
    """Size and times of a product's file. None if it is missing, a link or below a link."""
    path = results / stage / name
    folders = [results / stage, *(results / stage / above for above in Path(name).parents)]
    return None if any(is_link(folder) for folder in folders) else status(path)
