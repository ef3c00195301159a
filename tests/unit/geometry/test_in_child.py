"""Readers in a child process: their results and errors come back; a crash, a hang or a full memory is an error."""

import os
import time
from pathlib import Path

import numpy as np
import pytest
from tests.first_cases import first

from mammometry.base.errors import SessionError
from mammometry.geometry.mesh_files import in_child
from mammometry.geometry.mesh_files.in_child import read_in_child

pytestmark = pytest.mark.usefixtures("readers_in_a_child")


def size_of(path: Path, *, times: int) -> int:
    return times * path.stat().st_size


def refuses(path: Path) -> int:
    raise SessionError(path.name, found="a", expected="b", remedy="c")


def crashes(path: Path) -> int:
    os.abort()


def fills_memory(path: Path) -> int:
    return int(np.ones(1 << 32).sum())  # 32 GiB


def hangs(path: Path) -> int:
    time.sleep(60)
    return 0


@pytest.fixture
def file(tmp_path: Path) -> Path:
    (tmp_path / "a.obj").write_bytes(b"abc")
    return tmp_path / "a.obj"


def test_result_and_error_are_those_of_the_reader(file: Path) -> None:
    assert read_in_child(size_of, file, times=2) == 6
    with pytest.raises(SessionError) as caught:
        read_in_child(refuses, file)
    assert (caught.value.subject, caught.value.found, caught.value.remedy) == ("a.obj", "a", "c")


@pytest.mark.requirement("R-IN-10")
@pytest.mark.parametrize("reader", first(1, [crashes, fills_memory, hangs]))
def test_a_file_that_ends_its_reader_is_refused(file: Path, monkeypatch: pytest.MonkeyPatch, reader: object) -> None:
    monkeypatch.setattr(in_child, "_LONGEST_S", 1.5)
    with pytest.raises(SessionError) as caught:
        read_in_child(reader, file)  # type: ignore[arg-type]
    assert caught.value.subject == str(file)
