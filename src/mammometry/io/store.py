"""The memo on disk: SESSION/results, where every product lies beside a record of what it was made from.

A product is written to a hidden folder; renaming that folder to ``.ready-…`` is the moment from which it counts. Its
files are then moved into place and its record into ``provenance.json``. Whatever interrupts this, the next run either
removes a half-written folder or finishes moving a ready one, so earlier results stay whole.
"""

from __future__ import annotations

import fcntl
import json
import logging
import os
import platform
import shutil
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from datetime import UTC, datetime
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import IO, Any, Literal, TypeVar, cast

from mammometry.errors import StorageError
from mammometry.io.stamp import stamp_folder
from mammometry.io.write import disk_errors, file_digest
from mammometry.products import Key
from mammometry.progress import Progress, no_progress

T = TypeVar("T")
State = Literal["current", "stale", "absent"]
Watch = Callable[[Key], AbstractContextManager[Progress]]
"""Told of every product that is made: gives the progress callback to use while it is."""

_FORMAT = 1
_RECORDS = "provenance.json"
_WRITING, _READY = ".writing-", ".ready-"
_LOG = logging.getLogger(__name__)


def unwatched(key: Key) -> AbstractContextManager[Progress]:
    """Watch nothing."""
    return nullcontext(no_progress)


class Store:
    """Remembers products in a results folder; one process at a time may write there."""

    def __init__(self, folder: Path, watch: Watch = unwatched, subject: str | None = None) -> None:
        self.folder = folder
        self.watch = watch
        self.subject = subject
        """Identifier that every product carries; one that carries another, or none, is not current."""
        self.made: list[str] = []
        """``stage/product`` of everything made, not recalled, since this store was opened."""
        self._lock: IO[str]
        self._depth = 0
        self._mutex = threading.RLock()
        self._records: dict[str, dict[str, Any]] = {}

    @contextmanager
    def taken(self) -> Iterator[None]:
        """Take the folder for writing, and tidy up after an interrupted run; may be nested.

        Raises:
            StorageError: it cannot be written to, or another run is working there.
        """
        with self._mutex:
            if self._depth == 0:
                self._take()
            self._depth += 1
        try:
            yield
        finally:
            with self._mutex:
                self._depth -= 1
                if self._depth == 0:
                    self._lock.close()

    def _take(self) -> None:
        with disk_errors(self.folder):
            self.folder.mkdir(exist_ok=True)
            lock = (self.folder / ".lock").open("a+", encoding="ascii")
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            lock.close()
            raise StorageError(
                str(self.folder),
                found="another run at work there",
                expected="one run at a time in a session",
                remedy="Wait for it to end, or stop it",
            ) from None
        self._lock = lock
        self._records.clear()  # another run may have written since
        try:
            with disk_errors(self.folder):
                for left in sorted(self.folder.glob(f"{_READY}*")):
                    _LOG.info("finishing what an interrupted run had ready: %s", left.name)
                    self._put_in_place(left)
                for left in self.folder.glob(f"{_WRITING}*"):
                    _LOG.info("removing what an interrupted run left half-written: %s", left.name)
                    shutil.rmtree(left, ignore_errors=True)
        except BaseException:
            lock.close()
            raise

    def state(self, key: Key) -> State:
        """Whether the product is there and made from just these inputs and settings; reads no more than the record."""
        record = self.record(key)
        if record is None:
            return "absent"
        folder = self.folder / key.stage
        there = all(_size(folder / name) == told["bytes"] for name, told in record["files"].items())
        same = record["key"] == key.digest and record.get("subject") == self.subject
        return "current" if there and same else "stale"

    def has(self, key: Key) -> bool:
        """Whether the product is current."""
        return self.state(key) == "current"

    def record(self, key: Key) -> dict[str, Any] | None:
        """What provenance.json says of a product; None where it says nothing."""
        return cast("dict[str, Any] | None", self._stage_records(key.stage).get(key.product))

    def made_at(self, keys: Iterable[Key]) -> str | None:
        """When the newest of these products was made, ISO 8601, UTC; None where none is there."""
        records = map(self.record, keys)
        return max((record["made"] for record in records if record is not None), default=None)

    def recall(self, key: Key, prepare: Callable[[], Callable[[Progress], T]]) -> T:
        """Return the product from disk if it is current and whole; else make it and put it there.

        Raises:
            StorageError: the disk is full or refuses.
        """
        from mammometry.io.codecs import decode, encode

        if self.state(key) == "current" and self._is_whole(key):
            try:
                return cast("T", decode(self.folder / key.stage, key.product))
            except StorageError as error:
                _LOG.warning("%s/%s cannot be read back (%s); it is made anew", key.stage, key.product, error.subject)
        make = prepare()
        with self.taken():
            _LOG.info("making %s/%s", key.stage, key.product)
            begun = time.monotonic()
            with self.watch(key) as progress:
                value = make(progress)
            seconds = time.monotonic() - begun
            with self._writing(key, seconds) as folder:
                encode(value, folder, key.product)
        return value

    def write_folder(self, key: Key, prepare: Callable[[], Callable[[Path, Progress], None]]) -> bool:
        """Have a product written as a whole folder of files of its stage, unless it is current; say whether it was."""
        if self.state(key) == "current" and self._is_whole(key):
            return False
        write = prepare()
        with self.taken(), self._writing(key, None) as folder, self.watch(key) as progress:
            write(folder, progress)
        return True

    def _is_whole(self, key: Key) -> bool:
        record = self.record(key)
        assert record is not None
        for name, told in record["files"].items():
            path = self.folder / key.stage / name
            with disk_errors(path):
                if file_digest(path) != told["sha256"]:
                    _LOG.warning("%s/%s was changed since it was written; it is made anew", key.stage, name)
                    return False
        return True

    @contextmanager
    def _writing(self, key: Key, seconds: float | None) -> Iterator[Path]:
        begun = time.monotonic()
        name = f"{key.stage}-{key.product.replace('/', '-')}-{os.getpid()}"
        writing, ready = self.folder / f"{_WRITING}{name}", self.folder / f"{_READY}{name}"
        try:
            with disk_errors(self.folder):
                shutil.rmtree(writing, ignore_errors=True)
                stage = writing / key.stage
                stage.mkdir(parents=True)
                yield stage
                stamp_folder(stage, self.subject)
                files = {
                    str(path.relative_to(stage)): {"bytes": path.stat().st_size, "sha256": file_digest(path)}
                    for path in sorted(stage.rglob("*"))
                    if path.is_file()
                }
                record = {
                    "key": key.digest,
                    "subject": self.subject,
                    "version": key.version,
                    "settings": dict(key.settings),
                    "inputs": dict(key.inputs),
                    "files": files,
                    "made": datetime.now(UTC).isoformat(timespec="seconds"),
                    "seconds": round(time.monotonic() - begun if seconds is None else seconds, 3),
                    "software": dict(_software()),
                }
                about = {"stage": key.stage, "product": key.product, "record": record}
                (writing / "record.json").write_text(json.dumps(about), encoding="utf-8")
                writing.rename(ready)
                with self._mutex:
                    self._put_in_place(ready)
        except BaseException:
            shutil.rmtree(writing, ignore_errors=True)
            raise
        self.made.append(f"{key.stage}/{key.product}")

    def _put_in_place(self, ready: Path) -> None:
        about = json.loads((ready / "record.json").read_text(encoding="utf-8"))
        stage, product, record = about["stage"], about["product"], about["record"]
        folder = self.folder / stage
        folder.mkdir(exist_ok=True)
        for name in record["files"]:
            source = ready / stage / name
            if source.exists():  # else an interrupted run had moved it already
                (folder / name).parent.mkdir(parents=True, exist_ok=True)
                source.replace(folder / name)
        records = self._stage_records(stage)
        for name in set(records.get(product, {}).get("files", {})) - set(record["files"]):
            (folder / name).unlink(missing_ok=True)
        records[product] = record
        table = {"format": _FORMAT, "stage": stage, "products": records}
        fresh = ready / _RECORDS
        fresh.write_text(json.dumps(table, indent=1), encoding="utf-8")
        fresh.replace(folder / _RECORDS)
        shutil.rmtree(ready, ignore_errors=True)

    def _stage_records(self, stage: str) -> dict[str, Any]:
        with self._mutex:
            if stage not in self._records:
                try:
                    table = json.loads((self.folder / stage / _RECORDS).read_text(encoding="utf-8"))
                    self._records[stage] = dict(table["products"]) if table.get("format") == _FORMAT else {}
                except (OSError, ValueError, KeyError, TypeError, AttributeError):
                    self._records[stage] = {}  # nothing there, or nothing that can be trusted: made anew
            return self._records[stage]


def _size(path: Path) -> int:
    try:
        return path.stat().st_size
    except OSError:
        return -1


@cache
def _software() -> tuple[tuple[str, str], ...]:
    packages = ("mammometry", "numpy", "scipy", "numba", "opencv-python-headless", "scikit-image")
    return (("python", platform.python_version()), *((package, version(package)) for package in packages))
