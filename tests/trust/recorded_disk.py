"""What a program does to a folder, step by step; and what a power cut after any step may leave of it.

The model is that of POSIX at its harshest, but for one kindness: a rename is one step, as on every journalling file
system. A file's bytes survive once it was synced, else any first part of them does; a name that was made, moved or
removed survives once its folder was synced, else it may be undone, each such step by itself.
"""

import builtins
import errno
import io
import os
import random
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest

Name = tuple[int, str]
"""Number of a folder, and a name in it."""


@dataclass(frozen=True)
class Step:
    kind: str
    """``link`` (a new name), ``move``, ``unlink``, ``open`` (bytes no longer known), ``sync``."""
    thing: int = -1
    name: Name = (-1, "")
    target: Name = (-1, "")
    data: bytes | None = None
    """Of ``sync``: a file's bytes; None for a folder."""


@dataclass
class Recording:
    root: Path
    steps: list[Step] = field(default_factory=list)
    numbers: dict[Path, int] = field(default_factory=dict)
    first_names: dict[Name, int] = field(default_factory=dict)
    first_data: dict[int, bytes | None] = field(default_factory=dict)
    folders: set[int] = field(default_factory=set)
    count: int = 0

    def __post_init__(self) -> None:
        self.number(self.root, folder=True)
        for path in sorted(self.root.rglob("*")):
            thing = self.number(path, folder=path.is_dir())
            self.first_names[self.name(path)] = thing
            self.first_data[thing] = None if path.is_dir() else path.read_bytes()

    def number(self, path: Path, *, folder: bool = False) -> int:
        self.numbers[path] = self.count
        if folder:
            self.folders.add(self.count)
        self.count += 1
        return self.count - 1

    def name(self, path: Path) -> Name:
        return self.numbers[path.parent], path.name

    def mine(self, path: Path) -> bool:
        return path.is_relative_to(self.root) and not path.name.startswith(".lock")

    def linked(self, path: Path, *, folder: bool) -> None:
        self.steps.append(Step("link", self.number(path, folder=folder), self.name(path)))

    def moved(self, source: Path, target: Path) -> None:
        self.steps.append(Step("move", self.numbers[source], self.name(source), self.name(target)))
        below = [path for path in self.numbers if path.is_relative_to(source)]
        fresh = {target / path.relative_to(source): self.numbers.pop(path) for path in below}
        self.numbers |= fresh

    def unlinked(self, path: Path) -> None:
        self.steps.append(Step("unlink", self.numbers.pop(path), self.name(path)))

    def after_power_cut(self, moment: int, folder: Path, chance: random.Random, lost: float) -> None:
        """Write to `folder` what may be left after so many steps; each that may be undone is, with such a chance."""
        done = self.steps[:moment]
        synced = [(at, step.thing) for at, step in enumerate(done) if step.kind == "sync"]
        names, data = dict(self.first_names), dict(self.first_data)
        for at, step in enumerate(done):
            if step.kind == "sync":
                data[step.thing] = step.data
            elif step.kind == "open":
                coming = next((s.data for s in self.steps[at:] if s.kind == "sync" and s.thing == step.thing), b"")
                whole = coming or b""
                data[step.thing] = whole[: chance.randint(0, len(whole))] if lost else whole
            else:
                parent = (step.target if step.kind == "move" else step.name)[0]
                safe = any(when > at and thing == parent for when, thing in synced)
                if not safe and chance.random() < lost:
                    continue
                if step.kind == "link":
                    names[step.name] = step.thing
                elif step.kind == "unlink":
                    names.pop(step.name, None)
                else:  # wherever it was
                    names = {name: thing for name, thing in names.items() if thing != step.thing}
                    names[step.target] = step.thing
        self._write(folder, self.numbers[self.root], names, data)

    def _write(self, folder: Path, number: int, names: dict[Name, int], data: dict[int, bytes | None]) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        for (parent, name), thing in names.items():
            if parent != number:
                continue
            if thing in self.folders:
                self._write(folder / name, thing, names, data)
            else:
                (folder / name).write_bytes(data.get(thing) or b"")


@contextmanager
def recorded(root: Path) -> Iterator[Recording]:
    """Record what is done below `root`."""
    recording = Recording(root)
    real_open, real_fsync = builtins.open, os.fsync

    def path_of(name: Any, dir_fd: int | None = None) -> Path:
        path = Path(os.fspath(name))
        return path if dir_fd is None else Path(os.readlink(f"/proc/self/fd/{dir_fd}")) / path

    def opened(file: Any, mode: str = "r", *args: Any, **kwargs: Any) -> Any:
        wanted = isinstance(file, (str, os.PathLike)) and recording.mine(path_of(file)) and set(mode) & set("wxa")
        new = wanted and not os.path.lexists(file)
        handle = real_open(file, mode, *args, **kwargs)
        if wanted:
            if new:
                recording.linked(path_of(file), folder=False)
            recording.steps.append(Step("open", recording.numbers[path_of(file)]))
        return handle

    def synced(descriptor: int) -> None:
        path = Path(os.readlink(f"/proc/self/fd/{descriptor}"))
        real_fsync(descriptor)
        if path in recording.numbers:
            data = None if path.is_dir() else path.read_bytes()
            recording.steps.append(Step("sync", recording.numbers[path], data=data))

    def noted(real: Callable[..., Any], note: Callable[[Path], None]) -> Callable[..., Any]:
        def call(name: Any, *args: Any, dir_fd: int | None = None, **kwargs: Any) -> None:
            path = path_of(name, dir_fd)
            real(name, *args, dir_fd=dir_fd, **kwargs)
            if recording.mine(path):
                note(path)

        return call

    def moving(real: Callable[..., Any]) -> Callable[..., Any]:
        def call(source: Any, target: Any) -> None:
            real(source, target)
            recording.moved(path_of(source), path_of(target))

        return call

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(builtins, "open", opened)
        patch.setattr(io, "open", opened)
        patch.setattr(os, "fsync", synced)
        patch.setattr(os, "mkdir", noted(os.mkdir, lambda path: recording.linked(path, folder=True)))
        patch.setattr(os, "unlink", noted(os.unlink, recording.unlinked))
        patch.setattr(os, "rmdir", noted(os.rmdir, recording.unlinked))
        patch.setattr(os, "rename", moving(os.rename))
        patch.setattr(os, "replace", moving(os.replace))
        yield recording


class FullDisk:
    """Lets so many steps succeed, then answers all that need room with ENOSPC, until room is made."""

    def __init__(self, steps: int) -> None:
        self.left = steps
        self.refused = 0

    @contextmanager
    def below(self, root: Path) -> Iterator["FullDisk"]:
        """Be full for whatever is done below `root`."""
        real_open = builtins.open

        def step(path: Any) -> None:
            if isinstance(path, (str, os.PathLike)) and Path(path).is_relative_to(root):
                if self.left <= 0:
                    self.refused += 1
                    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(path))
                self.left -= 1

        def opened(file: Any, mode: str = "r", *args: Any, **kwargs: Any) -> Any:
            if set(mode) & set("wxa"):
                step(file)
            return real_open(file, mode, *args, **kwargs)

        def guarded(real: Callable[..., Any]) -> Callable[..., Any]:
            def call(*args: Any, **kwargs: Any) -> Any:
                path = args[0] if not isinstance(args[0], int) else os.readlink(f"/proc/self/fd/{args[0]}")
                step(path)
                return real(*args, **kwargs)

            return call

        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(builtins, "open", opened)
            patch.setattr(io, "open", opened)
            for name in ("mkdir", "rename", "replace", "fsync"):
                patch.setattr(os, name, guarded(getattr(os, name)))
            yield self
