"""What released versions left opens in this one: sessions with settings and results, and clinics with their data."""

import json
import re
from contextlib import nullcontext
from pathlib import Path

import pytest
from tests.clinic_server import command
from tests.postgresql import ABSENT, binaries, server
from tests.released import EXAMPLES, SETTINGS, in_process, unpacked

from mammometry.api.job import open_session
from mammometry.cli import main
from mammometry.clinic.config import FILE
from mammometry.io.drawn import landmarks_in
from mammometry.settings import Settings

VERSIONS = sorted(path.name for path in EXAMPLES.iterdir())


@pytest.mark.requirement("R-NEXT-3")
def test_each_release_has_left_an_example(repository: Path) -> None:
    log = (repository / "CHANGELOG.md").read_text(encoding="utf-8")
    released = set(re.findall(r"^## \[?(\d+\.\d+\.\d+)", log, re.MULTILINE))
    assert released <= set(VERSIONS), "run python -m tests.released before a version is released"
    assert sum(path.stat().st_size for path in EXAMPLES.rglob("*") if path.is_file()) < 1_000_000 * len(VERSIONS)


@pytest.mark.requirement("R-NEXT-1")
@pytest.mark.parametrize("version", VERSIONS)
def test_a_session_of_a_release_opens(version: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    session = unpacked(version, "session", tmp_path)
    expected = json.loads((EXAMPLES / version / "expected.json").read_text())["session"]
    settings = Settings.load(session / SETTINGS)
    assert settings.surface.extract.cube_mm == 1.0
    job = open_session(session, settings=settings)
    assert sorted(job.inputs.photographs) == ["front_left", "front_right"]
    assert landmarks_in(session / "landmarks.json", "model", None)["nipple_model"].tolist() == [
        expected["nipple_model"]
    ]
    assert main.run(["info", str(session), "--settings", str(session / SETTINGS), "--json"]) == 0
    stages = json.loads(capsys.readouterr().out)["stages"]
    assert set(stages) >= {"calibrate", "match", "surface", "measure", "report"}
    assert not {stage["state"] for stage in stages.values()} & {"damaged", "unreadable"}


@pytest.mark.requirement("R-NEXT-1")
@pytest.mark.slow
@pytest.mark.parametrize("version", VERSIONS)
def test_a_session_of_a_release_is_measured_again(version: str, tmp_path: Path) -> None:
    session = unpacked(version, "session", tmp_path)
    expected = json.loads((EXAMPLES / version / "expected.json").read_text())["session"]
    results = open_session(session, settings=Settings.load(session / SETTINGS)).run()
    low, high = expected["interval_cc"]
    assert low < results.volumes_cc["model"] < high
    assert main.run(["verify", str(session)]) == 0


@pytest.mark.requirement("R-NEXT-2")
@pytest.mark.slow
@pytest.mark.parametrize("database", ["sqlite", "postgresql"])
@pytest.mark.parametrize("version", VERSIONS)
def test_a_clinic_of_a_release_is_upgraded_with_all_its_data(version: str, database: str, tmp_path: Path) -> None:
    if database == "postgresql" and binaries() is None:
        pytest.skip(ABSENT)
    clinic = unpacked(version, "clinic", tmp_path)
    expected = json.loads((EXAMPLES / version / "expected.json").read_text())["clinic"]
    with server() if database == "postgresql" else nullcontext() as address:
        if address is not None:
            config = (clinic / FILE).read_text(encoding="utf-8")
            (clinic / FILE).write_text(
                config.replace('database = "sqlite"', f'database = "{address}"'), encoding="utf-8"
            )
            in_process("move", str(clinic))
        command("upgrade", str(clinic))
        found = in_process("look", str(clinic))
        assert command("upgrade", str(clinic))["applied"] == []
    assert found["audit"] >= expected["audit"]
    assert {name: count for name, count in found["rows"].items() if name in expected["rows"]} == expected["rows"]
    for what in ("names", "volumes", "pages"):
        assert found[what] == expected[what]
    assert (clinic / "clinic.sqlite3").exists() == (database == "sqlite")
