"""Products of a session on disk with their records, in SESSION/results.

A record states the inputs of its product. A product is written into a hidden folder, which is then renamed to
``.ready-…``. From then on the product is valid. Its files are then moved into place, and its record into
``provenance.json``. Each step is on the disk before the next one starts. After an interruption, even by a power
failure, the next run removes an incomplete folder or finishes moving a complete one, so earlier results stay intact. A
results folder may be from another computer: its records are checked (`records`), links are not followed, and foreign
files in the way are renamed and never removed.
"""

import logging
import os
import platform
import shutil
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import AbstractContextManager, contextmanager, nullcontext
from datetime import UTC, datetime
from functools import cache
from hashlib import sha256
from importlib.metadata import version
from pathlib import Path
from typing import Literal, TypeVar, cast

from mammometry.base.errors import StorageError
from mammometry.base.machine.cores import available_cores
from mammometry.base.progress import Progress, no_progress
from mammometry.io.results.lock import RunLock
from mammometry.io.results.records import (
    READY_RECORD,
    RECORDS,
    FileRecord,
    ProductRecord,
    Ready,
    file_of,
    is_link,
    is_own_folder,
    read_ready,
    read_records,
    write_ready,
    write_records,
)
from mammometry.io.results.stamp import stamp_folder
from mammometry.io.write import disk_errors, file_digest, sync_folder, sync_tree, write_new
from mammometry.job.products import Key

T = TypeVar("T")
State = Literal["current", "damaged", "stale", "absent"]
"""``current``: computed from these inputs, and as written. ``damaged``: computed from these inputs, but changed since.
``stale``: computed from other inputs. ``absent``: missing."""
Watch = Callable[[Key], AbstractContextManager[Progress]]
"""Called for each product that is computed. Its context gives the progress callback."""

WRITING, READY, ASIDE = ".writing-", ".ready-", ".set-aside-"
_Identity = tuple[int, int, int, int]
_LOG = logging.getLogger(__name__)


def unwatched(key: Key) -> AbstractContextManager[Progress]:
    """A `Watch` that does nothing."""
    return nullcontext(no_progress)


class Store:
    """Products in a results folder. Only one process at a time can write there."""

    def __init__(self, folder: Path, watch: Watch = unwatched, subject: str | None = None) -> None:
        self.folder = folder
        self.watch = watch
        self.subject = subject
        """Identifier in each product. A product with another identifier, or without one, is not current."""
        self.made: list[str] = []
        """``stage/product`` of all products that were computed, not read, since this store was opened."""
        self._lock = RunLock(folder)
        self._depth = 0
        self._mutex = threading.RLock()
        self._records: dict[str, dict[str, ProductRecord]] = {}
        self._digests: dict[Path, tuple[_Identity, str]] = {}

    @property
    def at_work(self) -> str:
        """Process, computer and start time of a run that is using the folder. Empty if there is none."""
        return self._lock.holder()

    @contextmanager
    def taken(self) -> Iterator[None]:
        """Lock the folder for writing, and clean up after an interrupted run. Calls may be nested.

        Raises:
            StorageError: the folder is not writable, or another run is using it.
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
                    self._lock.release()

    def _take(self) -> None:
        with disk_errors(self.folder):
            if is_link(self.folder):
                remedy = "Replace the link by a folder"
                expected = "a folder, so that nothing is written elsewhere"
                raise StorageError(str(self.folder), found="a link to another folder", expected=expected, remedy=remedy)
            if not self.folder.exists():
                self.folder.mkdir()
                sync_folder(self.folder.parent)
        self._lock.take()
        self._records.clear()  # another run may have written in the meantime
        try:
            with disk_errors(self.folder):
                self._tidy()
        except BaseException:
            self._lock.release()
            raise

    def _tidy(self) -> None:
        """Finish or remove what an interrupted run has left."""
        for left in sorted(self.folder.glob(f"{READY}*")):
            if (ready := self._finishable(left)) is not None:
                _LOG.info("finishing what an interrupted run had ready: %s", left.name)
                self._put_in_place(left, ready)
            else:
                self._discard(left)
        for left in sorted(self.folder.glob(f"{WRITING}*")):
            self._discard(left)

    def _finishable(self, left: Path) -> Ready | None:
        """Record of a completely written product, unless a newer one is in place."""
        ready = read_ready(left) if is_own_folder(left) else None
        if ready is None:
            return None
        stored = self._stage_records(ready.stage).get(ready.product)
        if stored is not None and stored.made > ready.record.made:
            return None
        whole = all(
            self._is_as_written(left, ready.stage, name, written)
            or self._is_as_written(self.folder, ready.stage, name, written)
            for name, written in ready.record.files.items()
        )
        return ready if whole else None

    def _discard(self, left: Path) -> None:
        if is_own_folder(left):
            _LOG.info("removing what an interrupted run left half-written: %s", left.name)
            shutil.rmtree(left, ignore_errors=True)
        else:
            self._set_aside(left)

    def _set_aside(self, path: Path) -> None:
        """Rename a foreign file or folder. For a link, the link itself is renamed."""
        name = f"{ASIDE}{path.name.lstrip('.')}"
        number = 1
        while os.path.lexists(self.folder / f"{name}-{number}"):
            number += 1
        _LOG.warning("%s is not ours and in the way: it is now %s-%d", path.name, name, number)
        path.rename(self.folder / f"{name}-{number}")

    def state(self, key: Key) -> State:
        """State of a product. A file is read once per process, and again if it seems to have changed."""
        record = self.record(key)
        if record is None:
            return "absent"
        if record.key != key.digest or record.subject != self.subject:
            return "stale"
        files = record.files.items()
        whole = all(self._is_as_written(self.folder, key.stage, name, written) for name, written in files)
        return "current" if whole else "damaged"

    def states(self, keys: Iterable[Key]) -> list[State]:
        """States of many products, whose files are read in parallel: about 0.5 GB per second and core."""
        with ThreadPoolExecutor(available_cores()) as pool:
            return list(pool.map(self.state, keys))

    def has(self, key: Key) -> bool:
        """Whether the product is current."""
        return self.state(key) == "current"

    def all_current(self, keys: Iterable[Key]) -> bool:
        """Whether all products are current, so that nothing has to be written."""
        return all(state == "current" for state in self.states(keys))

    def record(self, key: Key) -> ProductRecord | None:
        """A product's record in provenance.json. None if there is no valid record."""
        return self._stage_records(key.stage).get(key.product)

    def files(self, key: Key) -> dict[str, bytes]:
        """Contents of a product's files by name. Empty without a record.

        Raises:
            StorageError: a file was changed or is missing.
        """
        record = self.record(key)
        content = {}
        for name, written in {} if record is None else record.files.items():
            path = self.folder / key.stage / name
            with disk_errors(path):
                stored = file_of(self.folder, key.stage, name) is not None
                data = path.read_bytes() if stored else b""
            if sha256(data).hexdigest() != written.sha256:
                raise StorageError(
                    f"{key.stage}/{name}",
                    found="a file that was changed since it was written" if stored else "no file",
                    expected="the file as it was written",
                    remedy="Run the session again, which computes it again",
                )
            content[name] = data
        return content

    def made_at(self, keys: Iterable[Key]) -> str | None:
        """Time at which the newest of these products was computed, ISO 8601, UTC. None if none was."""
        records = map(self.record, keys)
        return max((record.made for record in records if record is not None), default=None)

    def recall(self, key: Key, prepare: Callable[[], Callable[[Progress], T]]) -> T:
        """Read the current product, or else compute and store it.

        Raises:
            StorageError: the disk is full or reports an error.
        """
        from mammometry.io.results.codecs import decode, encode

        if self._is_current(key):
            try:
                return cast("T", decode(self.folder / key.stage, key.product))
            except StorageError as error:
                _LOG.warning("%s/%s cannot be read back (%s); it is made again", key.stage, key.product, error.subject)
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
        """Write a product that is a folder of its stage, unless it is current. Return whether it was written."""
        if self._is_current(key):
            return False
        write = prepare()
        with self.taken(), self._writing(key, None) as folder, self.watch(key) as progress:
            write(folder, progress)
        return True

    def _is_current(self, key: Key) -> bool:
        state = self.state(key)
        if state == "damaged":
            _LOG.warning("%s/%s was changed since it was written; it is made again", key.stage, key.product)
        return state == "current"

    def _is_as_written(self, results: Path, stage: str, name: str, written: FileRecord) -> bool:
        file = file_of(results, stage, name)
        if file is None or file.st_size != written.bytes:
            return False
        path, identity = results / stage / name, _identity(file)
        if self._digests.get(path, (None, ""))[0] != identity:
            with disk_errors(path):
                self._digests[path] = identity, file_digest(path)
        return self._digests[path][1] == written.sha256

    @contextmanager
    def _writing(self, key: Key, seconds: float | None) -> Iterator[Path]:
        begun = time.monotonic()
        name = f"{key.stage}-{key.product.replace('/', '-')}-{os.getpid()}"
        writing, ready = self.folder / f"{WRITING}{name}", self.folder / f"{READY}{name}"
        try:
            with disk_errors(self.folder):
                stage = writing / key.stage
                stage.mkdir(parents=True)
                yield stage
                stamp_folder(stage, self.subject)
                files = {
                    path.relative_to(stage).as_posix(): FileRecord(bytes=path.stat().st_size, sha256=file_digest(path))
                    for path in sorted(stage.rglob("*"))
                    if path.is_file()
                }
                record = ProductRecord(
                    key=key.digest,
                    subject=self.subject,
                    version=key.version,
                    settings=dict(key.settings),
                    inputs=dict(key.inputs),
                    files=files,
                    made=datetime.now(UTC).isoformat(timespec="seconds"),
                    seconds=round(time.monotonic() - begun if seconds is None else seconds, 3),
                    software=dict(_software()),
                )
                about = Ready(stage=key.stage, product=key.product, record=record)
                (writing / READY_RECORD).write_bytes(write_ready(about))
                sync_tree(writing)
                writing.rename(ready)
                sync_folder(self.folder)
                with self._mutex:
                    self._put_in_place(ready, about)
        except BaseException:
            shutil.rmtree(writing, ignore_errors=True)
            raise
        self.made.append(f"{key.stage}/{key.product}")

    def _put_in_place(self, ready: Path, about: Ready) -> None:
        """Move the files of a completely written product, then its record. Can be repeated if interrupted."""
        stage, files = about.stage, about.record.files
        folder = self._folder_in_place(self.folder / stage)
        parents = {folder}
        for name, written in files.items():
            target = folder / name
            for above in reversed(Path(name).parents[:-1]):
                parents.add(self._folder_in_place(folder / above))
            if file_of(ready, stage, name) is None:
                continue  # already moved by an interrupted run
            if target.is_dir() and not is_link(target):
                self._set_aside(target)
            (ready / stage / name).replace(target)
            self._digests[target] = _identity(target.stat()), written.sha256
        records = dict(self._stage_records(stage))
        self._remove_superseded(stage, records.pop(about.product, None), {*files, *_names(records)})
        for parent in parents:
            sync_folder(parent)
        records[about.product] = about.record
        write_new(ready / RECORDS, write_records(stage, records))
        if (folder / RECORDS).is_dir():
            self._set_aside(folder / RECORDS)
        (ready / RECORDS).replace(folder / RECORDS)
        sync_folder(folder)
        self._records[stage] = records
        shutil.rmtree(ready, ignore_errors=True)  # a power failure may restore it, but without its files

    def _folder_in_place(self, folder: Path) -> Path:
        if is_link(folder) or (folder.exists() and not folder.is_dir()):
            self._set_aside(folder)
        if not folder.exists():
            folder.mkdir()
            sync_folder(folder.parent)
        return folder

    def _remove_superseded(self, stage: str, old: ProductRecord | None, kept: set[str]) -> None:
        """Remove files of the product's earlier version that were not replaced, if they are unchanged."""
        for name, written in {} if old is None else old.files.items():
            if name not in kept and self._is_as_written(self.folder, stage, name, written):
                (self.folder / stage / name).unlink()

    def _stage_records(self, stage: str) -> dict[str, ProductRecord]:
        with self._mutex:
            if stage not in self._records:
                self._records[stage], invalid, _ = read_records(self.folder / stage)
                for name in invalid:
                    _LOG.warning("%s: no valid record of %s; it counts as absent", stage, name)
            return self._records[stage]


class Reader:
    """Reads a store's products, and computes nothing."""

    def __init__(self, store: Store) -> None:
        self._store = store

    def has(self, key: Key) -> bool:
        """Whether the product is current."""
        return self._store.has(key)

    def recall(self, key: Key, prepare: Callable[[], Callable[[Progress], T]]) -> T:
        """Read the current product.

        Raises:
            StorageError: there is no current product.
        """

        def refuse() -> Callable[[Progress], T]:
            remedy = "Run the session, which computes it"
            raise StorageError(
                f"{key.stage}/{key.product}", found="no current result", expected="a current result", remedy=remedy
            )

        return self._store.recall(key, refuse)


def _identity(status: os.stat_result) -> _Identity:
    return status.st_size, status.st_mtime_ns, status.st_ino, status.st_ctime_ns


def _names(records: dict[str, ProductRecord]) -> set[str]:
    return {name for record in records.values() for name in record.files}


@cache
def _software() -> tuple[tuple[str, str], ...]:
    packages = ("mammometry", "numpy", "scipy", "numba", "opencv-python-headless", "scikit-image")
    return (("python", platform.python_version()), *((package, version(package)) for package in packages))
