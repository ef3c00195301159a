"""Who imports whom: the layers by import-linter, OpenCV and printing by the source itself."""

import ast
import subprocess
import sys
from collections.abc import Iterator
from fnmatch import fnmatch
from functools import cache
from pathlib import Path

import pytest

PACKAGE = "src/mammometry"
CV2_MAY = (
    "calibration/features/*.py",
    "calibration/targets/*/*.py",
    "calibration/detection/*.py",
    "calibration/detection/*/*.py",
    "calibration/adjust/initialise.py",
    "matching/rectify.py",
    "io/photographs/images.py",
    "io/photographs/video.py",
    "io/cameras/opencv.py",
)
SERVERS = {"web/server.py"}
"""Written in terms of such a library throughout, and themselves imported where they are used."""
SYSTEM = "base/machine/system.py"
"""May name what only some systems have."""
POSIX_ONLY = {
    "": "crypt curses fcntl grp posix pty pwd readline resource spwd syslog termios tty",
    "os": "chown fchmod fchown fork forkpty getegid geteuid getgid getgroups getloadavg getpgid getpgrp getpriority "
    "getsid getuid killpg lchown mkfifo mknod nice openpty posix_fadvise pread preadv pwrite sched_getaffinity "
    "sched_setaffinity setgid setpgid setpriority setsid setuid statvfs sysconf tcgetpgrp uname wait3 wait4 waitid",
    "signal": "SIGALRM SIGCHLD SIGHUP SIGKILL SIGSTOP SIGUSR1 SIGUSR2 alarm pause sigwait",
    "asyncio": "start_unix_server open_unix_connection",
    "socket": "AF_UNIX",
}
"""Module → what of it Windows lacks; under no name, modules that it lacks."""
LAZY = ("matplotlib", "jinja2", "weasyprint", "mitsuba", "django")
"""Heavy or optional: imported where they are used, not when a module is."""


def modules(repository: Path) -> list[Path]:
    return sorted((repository / PACKAGE).rglob("*.py"))


@cache
def syntax(path: Path) -> ast.Module:
    """What the file says; every test walks it."""
    return ast.parse(path.read_text(encoding="utf-8"))


@cache
def nodes(tree: ast.AST) -> tuple[ast.AST, ...]:
    """All nodes; a walk costs more than what a test asks of them."""
    return tuple(ast.walk(tree))


def imports(tree: ast.AST) -> Iterator[str]:
    for node in nodes(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.level == 0 and node.module:
            yield node.module


def imports_at_the_top(tree: ast.Module) -> Iterator[str]:
    """Imports that run when the module is imported: not those inside functions or under TYPE_CHECKING."""
    for node in tree.body:
        if isinstance(node, ast.Import | ast.ImportFrom):
            yield from imports(ast.Module(body=[node], type_ignores=[]))


def test_data_flow_one_way(repository: Path) -> None:
    command = [str(Path(sys.executable).with_name("lint-imports")), "--no-cache"]
    done = subprocess.run(command, cwd=repository, capture_output=True, text=True, check=False, timeout=120)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "0 broken" in done.stdout


def _is_image_open(function: ast.expr) -> bool:
    """Whether it is `Image.open`."""
    return (
        isinstance(function, ast.Attribute)
        and function.attr == "open"
        and isinstance(function.value, ast.Name)
        and function.value.id == "Image"
    )


def test_pictures_are_opened_by_named_formats_alone(repository: Path) -> None:
    """Left to guess, Pillow hands an EPS to Ghostscript."""
    calls = [
        (path.name, {keyword.arg for keyword in node.keywords})
        for path in modules(repository)
        for node in nodes(syntax(path))
        if isinstance(node, ast.Call) and _is_image_open(node.func)
    ]
    assert calls, "no module opens a picture: has this test lost its object?"
    assert [name for name, keywords in calls if "formats" not in keywords] == []


def test_opencv_is_used_where_it_may_be(repository: Path) -> None:
    using = [
        str(path.relative_to(repository / PACKAGE))
        for path in modules(repository)
        if any(name.partition(".")[0] == "cv2" for name in imports(syntax(path)))
    ]
    assert using, "no module imports OpenCV: has this test lost its object?"
    assert [name for name in using if not any(fnmatch(name, allowed) for allowed in CV2_MAY)] == []


def _posix_only(path: Path) -> Iterator[str]:
    """What a module names that Windows lacks: imports, attributes, arguments of a process, `%-d` in dates."""
    lacking = {module: set(names.split()) for module, names in POSIX_ONLY.items()}
    for node in nodes(syntax(path)):
        if isinstance(node, ast.Import):
            yield from {alias.name for alias in node.names} & lacking[""]
        elif isinstance(node, ast.ImportFrom):
            yield from {alias.name for alias in node.names} & lacking.get(node.module or "", set())
            yield from {str(node.module)} & lacking[""]
        elif isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
            yield from {node.attr} & lacking.get(node.value.id, set())
        elif isinstance(node, ast.keyword):
            yield from {str(node.arg)} & {"preexec_fn", "start_new_session", "process_group", "pass_fds"}
        elif isinstance(node, ast.Constant) and isinstance(node.value, str) and "%-" in node.value:
            yield repr(node.value)


def test_what_windows_lacks_is_named_in_one_module(repository: Path) -> None:
    named = {path.relative_to(repository / PACKAGE).as_posix(): set(_posix_only(path)) for path in modules(repository)}
    assert named.pop(SYSTEM) == {"resource", "sched_getaffinity"}, "has this test lost its object?"
    assert {name: words for name, words in named.items() if words} == {}


def test_heavy_libraries_are_imported_where_they_are_used(repository: Path) -> None:
    eager = [
        f"{path.relative_to(repository)} imports {name}"
        for path in modules(repository)
        for name in imports_at_the_top(syntax(path))
        if name.partition(".")[0] in LAZY
        and path.relative_to(repository / PACKAGE).as_posix() not in SERVERS
        and path.relative_to(repository / PACKAGE).parts[0] != "clinic"  # Django's own kind, imported by its commands
    ]
    assert eager == []


def test_pyplot_with_its_global_state_is_not_used(repository: Path) -> None:
    using = [
        str(path)
        for path in modules(repository)
        if any(name.startswith("matplotlib.pyplot") for name in imports(syntax(path)))
    ]
    assert using == []


@pytest.mark.requirement("R-SENT-1")
def test_only_what_serves_pages_exports_and_batches_speaks_to_the_network(repository: Path) -> None:
    """Nothing of a patient is sent anywhere but where somebody says: no other module has anything to send it with."""
    network = {"socket", "ssl", "http", "ftplib", "smtplib", "requests", "httpx", "aiohttp", "urllib3", "asyncio"}
    network |= {"pynetdicom", "distributed", "fsspec", "uvicorn"}
    using = {
        f"{path.relative_to(repository / PACKAGE)} imports {name}"
        for path in modules(repository)
        for name in imports(syntax(path))
        if name.partition(".")[0] in network or name == "urllib.request"
    }
    assert using == {
        # Shares of a batch go to the cluster, and sessions come from the store, that the command names:
        "batch/cluster.py imports distributed",
        "batch/engine.py imports distributed",
        "batch/worker_resources.py imports distributed",
        "batch/worker_resources.py imports distributed.system",
        "batch/supervise.py imports distributed",
        "batch/storage.py imports fsspec",
        "batch/storage.py imports fsspec.core",
        # Pages are served at the address that the command names:
        "web/server.py imports uvicorn",
        "web/server.py imports uvicorn.protocols.http.h11_impl",
        "clinic/web/server.py imports socket",  # whether the port is free
        "web/local.py imports socket",
        "clinic/jobs/events.py imports asyncio",  # to wait between two looks at the database
        "clinic/web/requests.py imports asyncio",  # to hand requests to threads
        "web/local.py imports asyncio",  # the same
        "web/limits.py imports asyncio",  # to stop waiting for a body
        "web/server.py imports asyncio",  # to close connections on which no request comes
        # To the archive that a command or the clinic's administrator names:
        "hospital/dicom/association.py imports pynetdicom",
        "hospital/dicom/association.py imports pynetdicom.sop_class",
        "hospital/dicom/store.py imports pynetdicom",
        "hospital/dicom/store.py imports pynetdicom.sop_class",
        "hospital/dicom/store.py imports ssl",
        "hospital/dicom/stow.py imports ssl",
        "hospital/dicom/stow.py imports urllib.request",
        "hospital/dicom/worklist.py imports pynetdicom.sop_class",
        "hospital/peers.py imports ssl",
    }


def test_only_the_command_line_prints(repository: Path) -> None:
    printing = [
        f"{path.relative_to(repository)}:{node.lineno}"
        for path in modules(repository)
        if path.parent.name != "cli"
        for node in nodes(syntax(path))
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "print"
    ]
    assert printing == []


def test_django_is_the_clinics_alone(repository: Path) -> None:
    """The rest is used without the extra `clinic`."""
    foreign = ("django", "allauth", "axes", "auditlog", "whitenoise", "psycopg")
    using = {
        path.relative_to(repository / PACKAGE).parts[0]
        for path in modules(repository)
        if any(name.partition(".")[0] in foreign for name in imports(syntax(path)))
    }
    assert using == {"clinic"}


@pytest.mark.parametrize("limit", [500])
def test_modules_stay_small(repository: Path, limit: int) -> None:
    long = {
        str(path.relative_to(repository)): lines
        for path in modules(repository)
        if "migrations" not in path.parts  # Django writes them
        and (lines := len(path.read_text(encoding="utf-8").splitlines())) > limit
    }
    assert long == {}


def test_public_settings_and_values_are_frozen(repository: Path) -> None:
    """A dataclass that is handed on must not be changed by whoever gets it."""
    loose = []
    for path in modules(repository):
        for node in nodes(syntax(path)):
            if not isinstance(node, ast.ClassDef) or node.name.startswith("_"):
                continue
            for decorator in node.decorator_list:
                if isinstance(decorator, ast.Name) and decorator.id == "dataclass":
                    loose.append(f"{path.name}: {node.name}")
                elif isinstance(decorator, ast.Call) and getattr(decorator.func, "id", "") == "dataclass":
                    options = {keyword.arg: getattr(keyword.value, "value", None) for keyword in decorator.keywords}
                    if not options.get("frozen"):
                        loose.append(f"{path.name}: {node.name}")
    assert loose == []


def test_each_field_of_a_settings_class_says_why(repository: Path) -> None:
    """`class …Settings`: every field is followed by its docstring."""
    silent = []
    for path in modules(repository):
        for node in nodes(syntax(path)):
            if isinstance(node, ast.ClassDef) and node.name.endswith("Settings"):
                for field, after in zip(node.body, [*node.body[1:], None], strict=True):
                    documented = isinstance(after, ast.Expr) and isinstance(after.value, ast.Constant)
                    if isinstance(field, ast.AnnAssign) and not documented:
                        silent.append(f"{node.name}.{getattr(field.target, 'id', '?')}")
    assert silent == []


def test_truth_is_read_by_evaluation_alone(repository: Path) -> None:
    """Nothing else names the folder of a virtual capture's truth, or imports what reads it."""
    names = (
        "simulate/truth.py",
        "simulate/session.py",
        "simulate/walk.py",
        "io/truth.py",
        "api/truth.py",
        "api/truth.py",
        "cli/study.py",
        "study/*.py",
    )
    readers = {"mammometry.io.truth"}
    found = []
    for path in modules(repository):
        tree = syntax(path)
        docstrings = {id(node.value) for node in nodes(tree) if isinstance(node, ast.Expr)}  # docstrings
        words = [
            node.value
            for node in nodes(tree)
            if isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in docstrings
        ]
        if any(word == "truth" or "truth/" in word or "truth.json" in word for word in words) or any(
            name in readers for name in imports(tree)
        ):
            found.append(str(path.relative_to(repository / PACKAGE)))
    assert "simulate/session.py" in found, "has this test lost its object?"
    assert [name for name in found if not any(fnmatch(name, allowed) for allowed in names)] == []
