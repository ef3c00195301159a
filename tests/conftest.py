"""Annotated shapes and dtypes are checked while the tests run; third-party data are found or skipped."""

import functools
import gc
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import is_dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any, Self

# Tests fill the cores already; BLAS reads this when NumPy is loaded first, by the next import at the earliest.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import jaxtyping
import pytest
from tests.not_run import NotRun
from tests.record_seconds import Recorder
from tests.rota import RECORDED, chosen, function_of, longest_first, turn
from xdist.remote import Producer
from xdist.scheduler import LoadFileScheduling

gc.disable()  # until all is collected

# Images of containers often forbid bytecode. Each worker and command would compile all of it anew: 20 s and more.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False

# Numba compiles kernels and the lens, and cannot see through a checking wrapper; the command line has no arrays.
_CHECKED = ("base.photograph", "matching.dense.match", "matching.rectify", "surface.ranges.range_image")
REPOSITORY = Path(__file__).resolve().parents[1]
_PACKAGE = REPOSITORY / "src" / "mammometry"
_WITHOUT_KERNELS = [
    ".".join(path.relative_to(_PACKAGE).with_suffix("").parts)
    for package in ("calibration", "geometry", "measure")
    for path in (_PACKAGE / package).rglob("*.py")
    if path.stem not in ("__init__", "lens") and "machine.compiled import" not in path.read_text(encoding="utf-8")
]

# Loading every kernel takes longer. Two kernels are listed with two lists of argument types: either on disk is enough.
_IS_COMPILED = """
from mammometry.base.machine.compiled import is_cached
from mammometry.cli.compile_cache import kernel_named, listed
raise SystemExit(not all(is_cached(kernel_named(name)) for name, _ in listed()))
"""


_CHECKED_CALLS = 50
"""Calls of each function that are checked in each test: small functions are called many thousand times, and a check
costs as much as they do."""
_test = 0  # number of the test that runs


def _check_arrays(checked: Any = jaxtyping.jaxtyped, **checker: Any) -> Callable[[Any], Any]:
    """Check what names an array; the other types are mypy's. A checked function is made at its first call."""

    def check(function: Any) -> Any:
        left, within, made = 0, -1, None

        @functools.wraps(function)
        def call(*args: Any, **kwargs: Any) -> Any:
            nonlocal left, within, made
            if within != _test:
                left, within = _CHECKED_CALLS, _test
            if not left:
                return function(*args, **kwargs)
            left -= 1
            made = made or checked(function, **checker)
            return made(*args, **kwargs)

        return call

    def decorate(item: Any) -> Any:
        function = item.__init__ if isinstance(item, type) else item
        named = map(str, getattr(function, "__annotations__", {}).values())
        if not any("Array" in name or "jaxtyping" in name for name in named):
            return item
        if not isinstance(item, type):
            return check(item)
        if is_dataclass(item):
            item.__init__ = check(function)
        return item

    return decorate


def pytest_runtest_setup() -> None:
    global _test
    _test += 1


jaxtyping.jaxtyped = _check_arrays  # by which the hook decorates
jaxtyping.install_import_hook([f"mammometry.{name}" for name in (*_CHECKED, *_WITHOUT_KERNELS)], "beartype.beartype")


# After the hook, which sees only what is imported later.
from mammometry.base import limited_call  # noqa: E402
from mammometry.base.child_process import CallError, ChildProcess  # noqa: E402
from mammometry.base.errors import MammometryError  # noqa: E402


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--rota", metavar="RUN", help="of the tests that -m chose, those whose turn it is in this run")
    parser.addoption("--all-must-run", action="store_true", help="fail when a test is skipped that need not be")
    parser.addoption("--record-seconds", action="store_true", help="put what the tests take into tests/seconds.txt")


def pytest_configure(config: pytest.Config) -> None:
    # A shell's background job ignores Ctrl-C, and so would every command that a test starts and interrupts.
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    if config.getoption("--record-seconds"):
        config.pluginmanager.register(Recorder(RECORDED))
    if config.getoption("--all-must-run"):
        config.pluginmanager.register(NotRun())


def pytest_sessionstart(session: pytest.Session) -> None:
    """Compile missing kernels before workers start: they would all compile the same ones at the same time.

    A second process begins at the list's end; where they meet, each finds on disk what the other compiled.
    """
    in_workers = session.config.getoption("numprocesses", None)
    if in_workers and subprocess.run([sys.executable, "-c", _IS_COMPILED]).returncode != 0:
        from_end = "from mammometry.cli.compile_cache import *; compile_kernels(reversed(listed()))"
        with subprocess.Popen([sys.executable, "-c", from_end]) as second:
            subprocess.run([sys.executable, "-m", "mammometry.cli.compile_cache"], check=True)
        assert second.returncode == 0


def pytest_collection_finish(session: pytest.Session) -> None:
    """Look for garbage among what tests make only, and seldom: modules and tests stay, two million objects."""
    gc.freeze()
    gc.set_threshold(50_000)
    gc.enable()


@pytest.hookimpl(trylast=True)  # after -m and -k have chosen
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    if hasattr(config, "workerinput"):  # else in the order of their names
        files = longest_first(_file(item) for item in items)
        tests = longest_first(function_of(item.nodeid) for item in items)
        items.sort(key=lambda item: tests[function_of(item.nodeid)] if _is_slow(item) else files[_file(item)])
    text = config.getoption("--rota")
    if text is None:
        return
    try:
        number = turn(text)
    except ValueError as error:
        raise pytest.UsageError(str(error)) from None
    groups: dict[str, list[str]] = {}
    for item in items:
        groups.setdefault(_group(item), []).append(item.nodeid)
    now = chosen(groups.items(), number)
    config.hook.pytest_deselected(items=[item for item in items if _group(item) not in now])
    items[:] = [item for item in items if _group(item) in now]


@pytest.hookimpl(optionalhook=True)  # of xdist
def pytest_xdist_make_scheduler(config: pytest.Config, log: Producer) -> LoadFileScheduling | None:
    """Give architecture tests to one worker: parsing all modules takes longer than any of these tests."""
    return _ByFile(config, log) if config.getoption("dist") == "loadfile" else None


class _ByFile(LoadFileScheduling):
    def _split_scope(self, nodeid: str) -> str:
        return "tests/architecture" if nodeid.startswith("tests/architecture/") else super()._split_scope(nodeid)


def _is_slow(item: pytest.Item) -> bool:
    return item.get_closest_marker("slow") is not None


def _file(item: pytest.Item) -> str:
    return item.nodeid.partition("::")[0]


def _group(item: pytest.Item) -> str:
    """Tests that share a costly fixture take their turn together."""
    marked = item.get_closest_marker("xdist_group")
    return str(marked.args[0]) if marked else item.nodeid


@pytest.fixture(scope="session")
def repository() -> Path:
    return REPOSITORY


@pytest.fixture(scope="session")
def shared_data() -> Path:
    folder = REPOSITORY.parent / "shared" / "data"
    if not folder.is_dir():
        pytest.skip("third-party captures are not beside the repository (shared/data)")
    return folder


class _InThisProcess:
    """Stands for the child in which files are read, half a second each. USD's library may crash: it has one."""

    def __init__(self) -> None:
        self.process = SimpleNamespace(kill=lambda: None)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        pass

    def call(self, within: Any, read: Any, arguments: Any, *others: Any) -> Any:
        if arguments[0].suffix.lower() == ".usdz":
            with ChildProcess() as child:
                return child.call(within, read, arguments, *others)
        named, _ = others
        try:
            return read(*arguments, **named)
        except MammometryError as error:
            return error
        except Exception as error:
            raise CallError from error


@pytest.fixture(scope="session", autouse=True)
def _readers_in_this_process() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(limited_call, "ChildProcess", _InThisProcess)
        yield


@pytest.fixture
def readers_in_a_child(monkeypatch: pytest.MonkeyPatch) -> None:
    """Read mesh files and videos in a child process, as in use."""
    monkeypatch.setattr(limited_call, "ChildProcess", ChildProcess)
