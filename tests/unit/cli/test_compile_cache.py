"""Compiling ahead: the list names what the job calls, and the process ends with the job."""

import inspect
import os
import subprocess
import sys

import pytest

from mammometry.cli import compile_cache


class _Process:
    """Stands for the process that compiles."""

    def __init__(self, command, **streams):
        self.command, self.ended = command, False
        started.append(self)

    def __enter__(self):
        return self

    def __exit__(self, *error):
        assert self.ended

    def terminate(self):
        self.ended = True


started: list[_Process] = []


@pytest.fixture
def processes(monkeypatch):
    started.clear()
    monkeypatch.setattr(compile_cache.subprocess, "Popen", _Process)
    monkeypatch.setattr(compile_cache, "available_cores", lambda: 2)
    monkeypatch.setattr(compile_cache, "_is_on_disk", lambda: False)
    return started


def test_every_listed_kernel_exists_and_has_a_type_for_each_argument():
    lines = compile_cache.listed()
    assert len(lines) == len(set(lines)) > 50
    for name, types in compile_cache.listed():
        kernel = compile_cache.kernel_named(name)
        assert len(compile_cache.argument_types(types)) == len(inspect.signature(kernel.py_func).parameters), name


def test_the_process_ends_with_the_job(processes):
    with compile_cache.compiled_ahead():
        assert len(processes) == 1
        assert not processes[0].ended
    assert processes[0].ended


def test_the_process_ends_when_the_job_fails(processes):
    with pytest.raises(ValueError, match="photographs"), compile_cache.compiled_ahead():
        raise ValueError("no photographs")
    assert processes[0].ended


@pytest.mark.parametrize(("name", "value"), [("_is_on_disk", lambda: True), ("available_cores", lambda: 1)])
def test_nothing_starts_where_it_would_not_help(processes, monkeypatch, name, value):
    monkeypatch.setattr(compile_cache, name, value)
    with compile_cache.compiled_ahead():
        assert processes == []


@pytest.mark.slow
def test_what_is_compiled_counts_as_compiled(tmp_path):
    """In a process of its own, whose cache is empty: the last kernel is missing, is compiled, and is found."""
    program = (
        "from mammometry.cli import compile_cache\n"
        "before = compile_cache._is_on_disk()\n"
        "name, types = compile_cache.listed()[-1]\n"
        "compile_cache.kernel_named(name).compile(compile_cache.argument_types(types))\n"
        "print(before, compile_cache._is_on_disk())\n"
    )
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path)}
    done = subprocess.run([sys.executable, "-c", program], env=environment, capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["False", "True"]


@pytest.mark.slow
def test_the_job_calls_the_kernels_with_the_listed_types(tmp_path):
    """The demo on one core, where nothing is compiled ahead; of what is on disk it loads what it calls.

    Where this fails it shows the lines that are right.
    """
    program = (
        "import os, sys\n"
        "os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})\n"
        "from mammometry.cli import compile_cache\n"
        "from mammometry.cli.main import run\n"
        f"code = run(['demo', {str(tmp_path / 'demo')!r}, '--quiet'])\n"
        "listed = {}\n"
        "for name, types in compile_cache.listed():\n"
        "    listed.setdefault(name, set()).add(compile_cache.argument_types(types))\n"
        "for name, types in listed.items():\n"
        "    called = compile_cache.kernel_named(name).signatures\n"
        "    if set(called) != types:\n"
        "        print(name, *called)\n"
        "sys.exit(code)\n"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert done.stdout == ""
