"""`mammometry doctor` and `--version`: what is there, and what is missing for which job."""

import json
import re
import subprocess
import sys
import tomllib
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from tests.clinic_server import command

import mammometry
from mammometry.cli import doctor, main


@pytest.fixture(autouse=True)
def basler_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    """Cameras of other makers are looked for on the network, which takes a second."""
    monkeypatch.setattr(doctor, "CAMERAS", {"pylon": "basler"})


def looked(capsys: pytest.CaptureFixture[str], *options: str) -> tuple[int, dict[str, dict[str, str]]]:
    """Exit code, and what was found by name."""
    code = main.run(["doctor", "--json", *options])
    return code, {check["name"]: check for check in json.loads(capsys.readouterr().out)["checks"]}


def test_the_version_names_commit_python_and_system(capsys: pytest.CaptureFixture[str], repository: Path) -> None:
    assert main.run(["--version"]) == 0
    line = capsys.readouterr().out.strip()
    found = re.fullmatch(
        r"mammometry ([\d.]+)(?: \(commit ([0-9a-f]{7,})(?:-dirty)?\))?, Python 3\.\d+\.\d+, \w+ \w+", line
    )
    assert found is not None, line
    assert found[1] == mammometry.__version__
    head = subprocess.run(["git", "rev-parse", "HEAD"], cwd=repository, capture_output=True, text=True, check=False)
    if head.returncode == 0:
        assert head.stdout.startswith(found[2])


def test_each_extra_has_its_job(repository: Path) -> None:
    extras = tomllib.loads((repository / "pyproject.toml").read_text())["project"]["optional-dependencies"]
    cameras = {"basler", "genicam", "tethered"}
    assert {*doctor.JOBS, *cameras} == {"", *extras} - {"all", "dev"}


def test_a_job_whose_library_is_missing_is_named_with_its_remedy(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    needs = ["numpy>=2", "no-such-core>=1", "mammometry[usdz]; extra == 'hospital'", 'no-such-usd>=2; extra == "usdz"']
    monkeypatch.setattr(doctor.metadata, "requires", lambda name: needs)
    code, found = looked(capsys)
    assert code == doctor.UNWELL
    assert found["measure and report"]["words"] == "no-such-core missing: pip install mammometry"
    assert found["measure and report"]["state"] == "wrong"
    for job in ("measure scans in USDZ", "export DICOM and FHIR"):
        assert found[job]["state"] == "absent"
        assert re.match(r"no-such-usd .*'mammometry\[", found[job]["words"])
    assert found["run a clinic"]["state"] == "ok"


def test_a_small_machine_is_named(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    import psutil

    monkeypatch.setattr(psutil, "virtual_memory", lambda: SimpleNamespace(total=2e9, available=1e9))
    monkeypatch.setattr(doctor.shutil, "disk_usage", lambda path: SimpleNamespace(free=1e9))
    code, found = looked(capsys)
    assert code == doctor.UNWELL
    assert re.match(r"2\.0 GB, 1\.0 .*4 GB", found["memory"]["words"])
    assert found["disk"]["state"] == "wrong"


@pytest.mark.parametrize(("ids", "state"), [([], "absent"), (["4001", "4002"], "ok"), (None, "wrong")])
def test_cameras_are_counted(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, ids: list[str] | None, state: str
) -> None:
    def attached() -> list[str]:
        if ids is None:
            raise OSError("the bus is on fire")
        return ids

    monkeypatch.setattr("mammometry.capture.backends.pylon.attached", attached)
    check = looked(capsys)[1]["cameras by pylon"]
    assert check["state"] == state
    assert (
        check["words"]
        == {"absent": "no camera is connected", "ok": "4001, 4002", "wrong": "its library fails: OSError"}[state]
    )


@pytest.mark.slow
def test_a_clinic_is_looked_at(tmp_path: Path) -> None:
    def found() -> tuple[int, dict[str, Any]]:
        words = [sys.executable, "-m", "mammometry", "doctor", "--json", "--clinic", str(tmp_path / "clinic")]
        done = subprocess.run(words, capture_output=True, text=True, check=False)
        return done.returncode, {check["name"]: check for check in json.loads(done.stdout)["checks"]}

    code, checks = found()
    assert (code, checks["clinic"]["state"]) == (doctor.UNWELL, "wrong")
    command("init", str(tmp_path / "clinic"))
    code, checks = found()
    assert (code, checks["clinic's backup"]["state"]) == (0, "absent")
    assert checks["clinic's database"]["words"].startswith("sqlite, ")
    command("backup", str(tmp_path / "clinic"))
    assert found()[1]["clinic's backup"]["state"] == "ok"
    (tmp_path / "clinic/clinic.sqlite3").write_bytes(b"")
    assert found()[0] == doctor.UNWELL
