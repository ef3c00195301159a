"""An acceptance test from photographs: a virtual ball is photographed, measured and decided on, by commands alone."""

import csv
import json
import re
import shutil
from pathlib import Path
from typing import Any

import pytest
from benchmarks.accuracy import boards
from tests.made_once import made_once

from mammometry.cli import main
from mammometry.cli.acceptance import REJECT, UNDECIDED

ABOUT = """\
format = 1
[device]
name = "Stand"
person = "ab"
date = 2026-11-29
[sphere]
diameter_mm = 145.0
diameter_std_mm = 0.02
form_std_mm = 0.02
source = "drawn"
"""
RIG = Path(boards.__file__).parent / "rigs" / "stand.toml"
STATED = re.compile(r"^(square_mm|marker_mm) = (.*)$", re.MULTILINE)


@pytest.fixture(scope="module")
def photographs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A session without results: a pair of cameras photographs a board, and the ball in the middle."""

    def make(folder: Path) -> None:
        command = ["simulate", str(folder / "session"), "--rig", f"{RIG}:front", "--subject", "test-sphere_1"]
        assert main.run([*command, "--skin", "speckled", "--scale", "0.6", "--seed", "3", "--poses", "8"]) == 0

    return made_once(tmp_path_factory, "acceptance-sphere", make) / "session"


def run_with(
    photographs: Path, folder: Path, capsys: pytest.CaptureFixture[str], board: float
) -> tuple[int, dict[str, Any]]:
    """Exit code and answer of `acceptance run` if the board's size is stated as so many times the true one."""
    session = folder / "sphere" / "1"
    shutil.copytree(photographs, session)
    manifest = session / "session.toml"
    text, stated = STATED.subn(lambda line: f"{line[1]} = {board * float(line[2])}", manifest.read_text())
    assert stated == 2
    manifest.write_text(text)
    (folder / "acceptance.toml").write_text(ABOUT)
    capsys.readouterr()
    code = main.run(["acceptance", "run", str(folder), "--json"])
    return code, json.loads(capsys.readouterr().out)


@pytest.mark.slow
@pytest.mark.requirement("R-ACCEPT-1")
@pytest.mark.requirement("R-ACCEPT-2")
def test_photographs_of_a_ball_lead_to_a_verdict(
    photographs: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """True: not beyond any limit, nine positions missing. Board stated 1 % too large: rejected."""
    code, true = run_with(photographs, tmp_path / "true", capsys, 1.0)
    found = {one["quantity"]: one for one in true["findings"]}
    assert (code, true["decision"], len(true["missing"]["sphere"])) == (UNDECIDED, "undecided", 9)
    assert abs(found["size"]["error"]) <= found["size"]["expanded_uncertainty"]
    assert found["size"]["expanded_uncertainty"] < 0.5  # pixels of 0.9 mm
    assert 0 < found["form"]["error"] < found["form"]["limit"]
    results = Path(true["results"])
    with (results / "acceptance.csv").open(encoding="utf-8") as rows:
        assert [float(row["error"]) for row in csv.DictReader(rows)] == [one["error"] for one in true["findings"]]
    assert (results / "acceptance.pdf").read_bytes().startswith(b"%PDF")

    code, wrong = run_with(photographs, tmp_path / "wrong", capsys, 1.01)
    size = next(one for one in wrong["findings"] if one["quantity"] == "size")
    assert (code, wrong["decision"], size["decision"]) == (REJECT, "reject", "reject")
    # 1 % of the diameter that was measured before; matching the same photographs again changes nothing else
    assert size["measured"] == pytest.approx(1.01 * found["size"]["measured"], abs=0.01)
