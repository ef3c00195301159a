"""Mappings whose values are computed on look-up, and digests of files."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager, nullcontext
from functools import lru_cache
from pathlib import Path
from threading import Lock
from typing import Any, Generic, TypeVar

from mammometry.base.errors import ImageError

K = TypeVar("K")
V = TypeVar("V")
# room for fourteen photographs of 12 megapixels; surfaces of such rigs take several times as much
_ROOM_BYTES = 512 << 20


class LazyMapping(Mapping[K, V], Generic[K, V]):
    """A mapping that computes its values at every look-up, because photographs are too large to keep."""

    def __init__(self, sources: Mapping[K, object], make: Callable[..., V]) -> None:
        self._sources = dict(sources)
        self._make = make

    def __getitem__(self, key: K) -> V:
        return self._make(key, self._sources[key])

    def __iter__(self) -> Iterator[K]:
        return iter(self._sources)

    def __len__(self) -> int:
        return len(self._sources)

    def __contains__(self, key: object) -> bool:
        return key in self._sources


class SharedMapping(LazyMapping[K, V]):
    """A mapping that computes values at every look-up, but only once within `shared`."""

    def __init__(self, sources: Mapping[K, object], make: Callable[..., V], *, bytes_of: Callable[[V], int]) -> None:
        super().__init__(sources, make)
        self._bytes_of = bytes_of
        self._locks = {key: Lock() for key in self._sources}
        self._values: dict[K, V] = {}
        self._left = 0

    def __getitem__(self, key: K) -> V:
        with self._locks[key]:  # if two threads need a value at the same time, one waits for the other's
            if key in self._values:
                return self._values[key]
            value = super().__getitem__(key)
            size = self._bytes_of(value)
            if size <= self._left:
                self._left -= size
                self._values[key] = value
            return value

    @contextmanager
    def kept(self) -> Iterator[None]:
        """Keep values that are computed within the block, as far as memory allows."""
        self._left = _ROOM_BYTES
        try:
            yield
        finally:
            self._left = 0
            self._values.clear()


def shared(values: Mapping[Any, Any]) -> AbstractContextManager[None]:
    """Keep values that are computed by look-ups within a block, if the mapping supports it."""
    return values.kept() if isinstance(values, SharedMapping) else nullcontext()


class KeptMapping(LazyMapping[K, V]):
    """A mapping that computes each value at its first look-up and keeps it."""

    def __init__(self, sources: Mapping[K, object], make: Callable[..., V]) -> None:
        super().__init__(sources, make)
        self._values: dict[K, V] = {}

    def __getitem__(self, key: K) -> V:
        if key not in self._values:
            self._values[key] = super().__getitem__(key)
        return self._values[key]


def digest_of(value: object) -> str:
    """SHA-256 of a value that can be written as JSON."""
    return hashlib.sha256(json.dumps(value, sort_keys=True, default=str).encode()).hexdigest()


def file_digest(path: Path) -> str:
    """SHA-256 of a file's content. Cached as long as its times, size and inode are unchanged.

    Raises:
        ImageError: the file cannot be read.
    """
    try:
        status = path.stat()
        return _hashed(path, (status.st_size, status.st_mtime_ns, status.st_ctime_ns, status.st_ino))
    except OSError as error:
        remedy = "Check it and its permissions"
        raise ImageError(
            str(path), found=f"a file that cannot be read ({error.strerror})", expected="a readable file", remedy=remedy
        ) from None


@lru_cache(maxsize=4096)
def _hashed(path: Path, about: tuple[int, ...]) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
