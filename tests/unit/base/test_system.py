"""What systems do differently: the branch that runs on Windows, tried here with what Windows lacks taken away."""

import os
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import psutil
import pytest

from mammometry.base.child_process import ChildProcess
from mammometry.base.machine import system
from mammometry.io.drawn_changes import ItemChange, change_drawn
from mammometry.io.results.lock import RunLock
from mammometry.io.write import sync_tree


@pytest.fixture
def windows(monkeypatch: pytest.MonkeyPatch) -> list[tuple[str, object]]:
    """Windows: no module `resource`, no affinity, no opened folders. Lists what is asked of it instead."""
    asked: list[tuple[str, object]] = []
    open_file = os.open

    def opened(path: Any, *rest: Any, **more: Any) -> int:
        if os.path.isdir(path):
            raise PermissionError(13, "Permission denied", str(path))
        return open_file(path, *rest, **more)

    process = SimpleNamespace(
        nice=lambda kind: asked.append(("priority", kind)), memory_info=lambda: SimpleNamespace(peak_wset=300 << 20)
    )
    monkeypatch.setattr(system, "WINDOWS", True)
    monkeypatch.setitem(sys.modules, "resource", None)
    monkeypatch.delattr(os, "sched_getaffinity", raising=False)
    monkeypatch.setattr(os, "open", opened)
    monkeypatch.setattr(psutil, "Process", lambda: process)
    monkeypatch.setattr(psutil, "BELOW_NORMAL_PRIORITY_CLASS", 0x4000, raising=False)
    monkeypatch.setattr(subprocess, "CREATE_NEW_PROCESS_GROUP", 0x200, raising=False)
    return asked


def test_the_process_is_looked_at_by_windows_own_words(windows: list[tuple[str, object]]) -> None:
    assert system.peak_memory_mb() == 300.0
    assert system.allowed_cores() == os.cpu_count()
    assert system.own_group() == {"creationflags": 0x200}
    system.lower_priority()
    assert windows == [("priority", 0x4000)]
    system.limit_memory(1 << 30)  # nothing, and no error


def test_files_are_written_and_locked_where_no_folder_can_be_opened(windows: object, tmp_path: Path) -> None:
    entry = {"points": [[0.0, 0.0, 60.0]], "author": "A"}
    (changed,) = change_drawn(tmp_path, "cast", {("landmarks", "nipple_model"): ItemChange(entry=entry, base=None)})
    assert changed == tmp_path / "landmarks.json"
    lock = RunLock(tmp_path)
    lock.take()
    lock.release()
    sync_tree(tmp_path)


def test_a_child_and_its_parent_are_in_two_groups() -> None:
    """Else Ctrl-C at the terminal would end both."""
    with ChildProcess() as child:
        assert child.call(os.getpgrp) == child.process.pid != os.getpgrp()
