"""What `info` and `verify` say of a session: what was changed, whether a run is at work, and what to do next."""

import json
import os
import shlex
import shutil
from pathlib import Path
from typing import Any

import pytest
from tests.later_exposure import later_exposure
from tests.trust.read_only_disk import read_only

from mammometry.api.exposures import require_later
from mammometry.base.errors import SessionError
from mammometry.cli import main
from mammometry.io.drift import read_history
from mammometry.io.photographs.images import read_photograph
from mammometry.io.results.store import Store


def answer(capsys: pytest.CaptureFixture[str], *arguments: str | Path, code: int = 0) -> dict[str, Any]:
    capsys.readouterr()
    assert main.run([*map(str, arguments), "--json"]) == code
    table: dict[str, Any] = json.loads(capsys.readouterr().out)
    return table


def test_a_copied_session_says_that_its_name_alone_is_another(
    tiny_finished_original: Path, tiny_settings: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    copy = shutil.copytree(tiny_finished_original, tmp_path / "a copy of 'it'")
    table = answer(capsys, "info", copy, "--settings", tiny_settings)
    changed = {stage: about["changed"] for stage, about in table["stages"].items() if about["changed"]}
    assert changed == {"report": ["the folder's name"]}
    assert answer(capsys, "verify", copy, "--settings", tiny_settings)["changed"] == []


def test_the_next_step_can_be_pasted_anywhere(
    tiny_original: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    copy = shutil.copytree(tiny_original, tmp_path / "a copy of 'it'")
    monkeypatch.chdir(tmp_path)
    chosen = ("--set", "measure.wall=plane", "--set", "surface.extract.cube_mm=1.0")
    table = answer(capsys, "info", copy.name, *chosen)
    assert shlex.split(table["next"]) == ["mammometry", "run", str(copy), *chosen]
    assert main.run(["info", copy.name]) == 0
    assert f"Next: mammometry run {shlex.quote(str(copy))}" in capsys.readouterr().out


def test_changed_photographs_and_settings_are_named(
    tiny_finished: Path, tiny_settings: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    photograph = next((tiny_finished / "capture").glob("front_left.*"))
    with photograph.open("ab") as file:
        file.write(b"\0")
    target = next((tiny_finished / "calibration" / "01").glob("front_right.*"))
    with target.open("ab") as file:
        file.write(b"\0")
    table = answer(capsys, "info", tiny_finished, "--settings", tiny_settings, "--set", "measure.wall=plane")
    assert table["stages"]["calibrate"]["changed"] == ["calibration/01/front_right"]
    assert "capture/front_left" in table["stages"]["match"]["changed"]
    assert "setting measure.wall" in table["stages"]["measure"]["changed"]
    table = answer(capsys, "verify", tiny_finished, "--settings", tiny_settings, code=9)
    assert sorted(table["changed"]) == ["calibration/01/front_right", "capture/front_left"]
    assert table["damaged"] == []
    (tiny_finished / "capture").rename(tiny_finished / "elsewhere")
    target.unlink()
    table = answer(capsys, "verify", tiny_finished, "--settings", tiny_settings, code=9)
    assert sorted(table["absent"]) == ["capture/front_left", "capture/front_right"]


def test_verify_needs_results(tiny: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main.run(["verify", str(tiny)]) == 3
    assert "found no results yet" in capsys.readouterr().err


def test_a_run_at_work_is_said(tiny: Path, capsys: pytest.CaptureFixture[str]) -> None:
    store = Store(tiny / "results")
    with store.taken():
        assert f"process {os.getpid()}" in answer(capsys, "info", tiny)["at_work"]
        assert main.run(["info", str(tiny)]) == 0
        assert "(process" in capsys.readouterr().out
        holder = json.loads((tiny / "results" / ".lock-holder").read_text())
        left = holder | {"since": "2001-01-01T00:00:00+00:00"}  # by an earlier process of that number
        (tiny / "results" / ".lock-holder").write_text(json.dumps(left))
        assert answer(capsys, "info", tiny)["at_work"] == ""
    assert answer(capsys, "info", tiny)["at_work"] == ""


@pytest.mark.slow
@pytest.mark.requirement("R-LOSS-14")
def test_a_current_session_is_used_where_nothing_may_be_written(
    tiny_finished: Path, tiny_settings: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with read_only(tiny_finished):
        for command in ("info", "verify", "run", "measure", "report", "calibrate", "surface"):
            answer(capsys, command, tiny_finished, "--settings", tiny_settings)
        assert main.run(["run", str(tiny_finished), "--set", "measure.wall=plane"]) == 9
        assert "no permission" in capsys.readouterr().err


@pytest.mark.slow
@pytest.mark.requirement("R-RIG-1")
def test_a_check_refuses_what_cannot_show_a_later_movement(
    tiny_finished: Path, tiny_settings: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The calibration's files, their pixels in other files, another day's photographs; a new exposure is judged."""

    def check(folder: Path, code: int) -> str:
        capsys.readouterr()
        words = ["check", str(tiny_finished), "--image-set", str(folder), "--settings", str(tiny_settings)]
        assert main.run(words) == code
        out = capsys.readouterr()
        return out.out + out.err

    pose = tiny_finished / "calibration" / "01"
    assert "(calibration/01/front_left)" in check(pose, 3)
    saved_again = later_exposure(pose, tmp_path / "again", lighter=0)
    assert "(calibration/01/front_left)" in check(saved_again, 3)
    assert read_history(tiny_finished).entries == ()

    monday = later_exposure(pose, tmp_path / "monday")
    assert "No camera has moved" in check(monday, 0)
    assert "No camera has moved" in check(monday, 0)  # the same folder may be judged again
    tuesday = Path(shutil.copytree(monday, tmp_path / "tuesday"))
    words = check(tuesday, 3)
    assert "a photograph of the check of" in words
    assert "monday" in words
    assert len(read_history(tiny_finished).entries) == 2


def test_a_check_refuses_photographs_older_than_the_calibration(tiny: Path, tmp_path: Path) -> None:
    pose = tiny / "calibration" / "01"
    before, after = (
        later_exposure(pose, tmp_path / name, taken=when)
        for name, when in (("before", "2026:03:01 08:00:00"), ("after", "2026:03:03 08:00:00"))
    )
    calibrated = later_exposure(pose, tmp_path / "timed", lighter=2, taken="2026:03:02 08:00:00")
    known = {("01", path.stem): path for path in calibrated.iterdir()}
    for folder, is_later in ((before, False), (after, True)):
        files = {("later", path.stem): path for path in folder.iterdir()}
        seen = {shot: read_photograph(path, path.name) for shot, path in files.items()}
        if is_later:
            assert len(require_later(folder, files, seen, known, ())) == len(files)
        else:
            with pytest.raises(SessionError, match="newer"):
                require_later(folder, files, seen, known, ())
