"""The same tests with a PostgreSQL server that they start; what a run without one leaves out."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from tests.clinic_server import command
from tests.postgresql import ABSENT, VARIABLE, binaries, new_database, server


def test_the_services_were_there() -> None:
    if VARIABLE not in os.environ:
        pytest.skip("the clinic was tested with SQLite alone; `make test-services` tests it with PostgreSQL")


@pytest.mark.slow
def test_the_clinics_tests_pass_with_postgresql(repository: Path) -> None:
    if VARIABLE in os.environ:
        pytest.skip("this is that run")
    if binaries() is None:
        pytest.skip(ABSENT)
    words = [sys.executable, "-m", "tests.postgresql", sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider"]
    done = subprocess.run(
        [*words, "tests/unit/clinic"], cwd=repository, capture_output=True, text=True, timeout=600, check=False
    )
    assert done.returncode == 0, done.stdout[-4000:] + done.stderr[-2000:]


@pytest.mark.slow
def test_a_clinic_moves_to_postgresql_and_back(tmp_path: Path) -> None:
    if binaries() is None:
        pytest.skip(ABSENT)
    command("init", str(tmp_path / "first"), "--administrator", "boss")
    command("people", "add", str(tmp_path / "first"), "ä.b@c", "--role", "clinician", "--name", "Ä 'B' \\ \N{SNOWMAN}")
    everybody = command("people", "list", str(tmp_path / "first"))
    command("backup", str(tmp_path / "first"), "--to", str(tmp_path / "1.tar"))
    with server() as address, new_database(address, "clinic") as database:
        command("restore", str(tmp_path / "1.tar"), str(tmp_path / "second"), "--database", database)
        assert command("people", "list", str(tmp_path / "second")) == everybody
        command("people", "add", str(tmp_path / "second"), "later", "--role", "technician")
        command("backup", str(tmp_path / "second"), "--to", str(tmp_path / "2.tar"))
    command("restore", str(tmp_path / "2.tar"), str(tmp_path / "third"), "--database", "sqlite")
    names = [each["name"] for each in command("people", "list", str(tmp_path / "third"))["people"]]  # type: ignore[attr-defined]
    assert names == ["boss", "later", "ä.b@c"]
