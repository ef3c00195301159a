"""`mammometry doctor` and `--version`: what is installed here, and what is missing for each job."""

from __future__ import annotations

import platform
import re
import shutil
import subprocess
import webbrowser
from collections.abc import Iterator
from importlib import import_module, metadata
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal, TypeAlias

import typer

import mammometry
from mammometry.base.errors import MammometryError
from mammometry.base.machine.cores import available_cores
from mammometry.base.value import value
from mammometry.cli.common import Answer, OutputOptions, command

if TYPE_CHECKING:
    from mammometry.clinic.config import ClinicConfig

app = typer.Typer()
UNWELL = 13
"""Exit code: something that measuring or the clinic needs is missing."""
JOBS = {
    "": "measure and report",
    "usdz": "measure scans in USDZ",
    "heic": "read photographs in HEIC",
    "edit": "draw in the browser",
    "batch": "measure many sessions",
    "cluster": "measure on a cluster",
    "hospital": "export DICOM and FHIR",
    "clinic": "run a clinic",
    "sim": "render by Mitsuba",
}
"""Extra → its purpose."""
CAMERAS = {"pylon": "basler", "aravis": "genicam", "gphoto2": "tethered"}
"""Kind of cameras → its extra."""
_LEAST_MEMORY_GB = 4.0  # the largest process of a full-size torso takes 1.6 (docs/speed.md)
_LEAST_DISK_GB = 2.0  # a full-size session has 0.5 of results
_OLD_BACKUP_DAYS = 2  # one is made every night
_GB = 1e9  # bytes
_SIGNS = {"ok": "ok", "absent": "–", "wrong": "!!"}
State: TypeAlias = Literal["ok", "absent", "wrong"]


@value
class Check:
    """The result of one check."""

    name: str
    state: State
    """``absent``: an optional part is not installed."""
    words: str
    """The finding and the remedy."""


def program() -> str:
    """The program, its commit and where it runs, in one line."""
    commit = _commit()
    made = f" (commit {commit})" if commit else ""
    return f"mammometry {mammometry.__version__}{made}, {_python()}, {_system()}"


@command(app, "mammometry doctor", "mammometry doctor --clinic my-clinic")
def doctor(
    options: OutputOptions,
    clinic: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Also check this clinic.", show_default=False)
    ] = None,
) -> Answer:
    """List what is installed here, what is missing, and for which task.

    The exit code is 13 if something that measuring or the clinic needs is wrong.
    """
    checks = [*_libraries(), *_machine(), *_cameras(), _browser(), *([] if clinic is None else _clinic(clinic))]
    table = {
        "version": mammometry.__version__,
        "commit": _commit(),
        "python": _python(),
        "system": _system(),
        "checks": [{"name": check.name, "state": check.state, "words": check.words} for check in checks],
    }
    wide = max(len(check.name) for check in checks)
    lines = [f"{_SIGNS[check.state]:>2}  {check.name:<{wide}}  {check.words}" for check in checks]
    return Answer(table, [program(), *lines], exit_code=UNWELL if any(c.state == "wrong" for c in checks) else 0)


def _libraries() -> Iterator[Check]:
    for extra, job in JOBS.items():
        absent = missing_for(extra)
        if not absent:
            yield Check(name=job, state="ok", words="all libraries are installed")
        else:
            install = f"pip install 'mammometry[{extra}]'" if extra else "pip install mammometry"
            state: State = "absent" if extra else "wrong"
            yield Check(name=job, state=state, words=f"{', '.join(absent)} missing: {install}")


def missing_for(extra: str) -> list[str]:
    """Missing distributions of an extra, or with an empty name of the basic installation."""
    absent: list[str] = []
    for line in metadata.requires("mammometry") or ():
        needed, _, condition = line.partition(";")
        wanted = re.search(r"""extra == ['"]([\w-]+)['"]""", condition)
        if (wanted[1] if wanted else "") != extra:
            continue
        name = re.split(r"[^\w.-]", needed.strip(), maxsplit=1)[0]
        if name == "mammometry":
            parts = re.findall(r"[\w-]+", needed.partition("[")[2])
            absent += [distribution for part in parts for distribution in missing_for(part)]
        elif not any(metadata.distributions(name=name)):
            absent.append(name)
    return sorted(set(absent))


def _machine() -> Iterator[Check]:
    import psutil

    yield Check(name="cores", state="ok", words=f"{available_cores()} may be used")
    memory = psutil.virtual_memory()
    total, free = memory.total / _GB, memory.available / _GB
    words = f"{total:.1f} GB, {free:.1f} of it free"
    yield _at_least("memory", total, _LEAST_MEMORY_GB, f"{words}", "photographs of full size")
    disk = shutil.disk_usage(Path.cwd()).free / _GB
    yield _at_least("disk", disk, _LEAST_DISK_GB, f"{disk:.1f} GB free in this folder", "a session's results")


def _at_least(name: str, found_gb: float, least_gb: float, words: str, what: str) -> Check:
    short = found_gb < least_gb
    return Check(
        name=name,
        state="wrong" if short else "ok",
        words=f"{words}; {what} may need {least_gb:.0f} GB" if short else words,
    )


def _cameras() -> Iterator[Check]:
    for kind, extra in CAMERAS.items():
        name = f"cameras by {kind}"
        try:
            found = import_module(f"mammometry.capture.backends.{kind}").attached()
        except MammometryError as error:
            yield Check(name=name, state="absent", words=f"{error.found} (extra {extra}): {error.remedy}")
        except Exception as error:  # a maker's library may fail in any way
            yield Check(name=name, state="wrong", words=f"its library fails: {type(error).__name__}")
        else:
            words = ", ".join(found) or "no camera is connected"
            yield Check(name=name, state="ok" if found else "absent", words=words)


def _browser() -> Check:
    try:
        found = webbrowser.get()
    except webbrowser.Error:
        return Check(name="browser", state="absent", words="none: open the printed addresses on another machine")
    return Check(name="browser", state="ok", words=str(getattr(found, "name", "") or "the system's own"))


def _clinic(folder: Path) -> Iterator[Check]:
    from mammometry.cli.clinic import installed, opened

    try:
        installed()
        config = opened(folder)
        from mammometry.clinic.maintenance.backups import state_of
        from mammometry.clinic.maintenance.disk import measure_usage
        from mammometry.clinic.web.server import require_current

        require_current(config)
    except MammometryError as error:
        yield Check(name="clinic", state="wrong", words=str(error))
        return
    kind = config.database.partition(":")[0]
    yield Check(name="clinic's database", state="ok", words=f"{kind}, with the tables of this version")
    days = state_of(config).age_days
    if days is None:
        yield Check(name="clinic's backup", state="absent", words=f"none yet: mammometry clinic backup {folder}")
    else:
        words = f"{days} days old" if days else "of the last 24 hours"
        yield Check(name="clinic's backup", state="wrong" if days > _OLD_BACKUP_DAYS else "ok", words=words)
    yield _audit(config)
    usage = measure_usage(config)
    words = f"{usage.free / _GB:.1f} GB free" + ("" if usage.days_left is None else f", for {usage.days_left} days")
    yield Check(name="clinic's disk", state="wrong" if usage.is_short else "ok", words=words)


def _audit(config: ClinicConfig) -> Check:
    from mammometry.clinic import audit_chain
    from mammometry.clinic.maintenance.backups import chain_of_newest

    try:
        audit_chain.extend()
        end = audit_chain.verify(chain_of_newest(config))
    except MammometryError as error:
        return Check(name="clinic's audit", state="wrong", words=str(error))
    return Check(name="clinic's audit", state="ok", words=f"{end.place} entries unchanged, {end.digest[:16]}")


def _commit() -> str | None:
    """Commit of this installation. None if unknown."""
    package = Path(mammometry.__file__).parent
    made = package / "commit.txt"
    if made.is_file():
        return made.read_text(encoding="ascii").strip()
    if not (package.parents[1] / ".git").exists():
        return None
    describe = ["git", "-C", str(package), "describe", "--always", "--dirty", "--exclude=*"]
    try:
        return subprocess.run(describe, capture_output=True, text=True, check=False).stdout.strip() or None
    except OSError:  # no Git here
        return None


def _python() -> str:
    return f"Python {platform.python_version()}"


def _system() -> str:
    return f"{platform.system()} {platform.machine()}"
