"""From the button to the volume: a virtual rig is fired, and what it fired is measured."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import pytest
from tests.scenes.conftest import TINY, TRUE_CC

from mammometry.base.errors import CaptureError
from mammometry.capture.loop import OpenRig
from mammometry.cli.main import run
from mammometry.simulate.session import write_session

RIG_TOML = """\
format = 1
units = "mm"
[rig]
name = "one pair"
pairs = [{ name = "front", left = "front_left", right = "front_right" }]
[target]
kind = "charuco"
squares = [14, 10]
square_mm = 25.0
marker_mm = 18.0
dictionary = "DICT_5X5_250"
[subject]
kind = "model"
"""
PAIRS = ("front", "floor", "left", "right")
TOLERANCE = 0.005
"""Eight cameras of .15 of the reference size: three firings were 0.06 to 0.1 % off."""


@pytest.fixture
def rig_toml(tmp_path: Path, tiny_finished_original: Path) -> Path:
    """A rig whose cameras are the tiny session's photographs, calibrated by its board; its truth stays away."""
    shutil.copytree(tiny_finished_original, tmp_path / "calibrated", ignore=shutil.ignore_patterns("truth"))
    path = tmp_path / "rig.toml"
    path.write_text(
        f'{RIG_TOML}[capture]\nbackend = "virtual"\ncalibration = "calibrated"\ntimeout_s = 30\n'
        f'options = {{ session = "{tmp_path / "calibrated"}" }}\n'
    )
    return path


@pytest.mark.slow
def test_a_fired_cast_has_its_true_volume(tmp_path, tiny_settings, capsys):
    write_session(tmp_path / "calibrated", replace(TINY, rig="reference", scale=0.15, poses=12), truth=False)
    pairs = ", ".join(f'{{ name = "{pair}", left = "{pair}_left", right = "{pair}_right" }}' for pair in PAIRS)
    rig = tmp_path / "rig.toml"
    rig.write_text(
        RIG_TOML.replace('{ name = "front", left = "front_left", right = "front_right" }', pairs)
        + '[capture]\nbackend = "virtual"\ncalibration = "calibrated"\ntimeout_s = 30\n'
        + f'options = {{ session = "{tmp_path / "calibrated"}" }}\n'
    )
    session = tmp_path / "s"
    assert run(["capture", str(session), "--rig", str(rig), "--json"]) == 0
    fired = json.loads(capsys.readouterr().out)
    assert fired["accepted"], fired["checks"]
    assert run(["run", str(session), "--settings", str(tiny_settings), "--json"]) == 0
    answer = json.loads(capsys.readouterr().out)
    assert answer["volumes_cc"]["model"] == pytest.approx(TRUE_CC, rel=TOLERANCE), answer["intervals_cc"]


@pytest.mark.slow
def test_an_exchanged_cable_is_found_on_the_board_and_the_pose_is_not_taken(rig_toml):
    text = rig_toml.read_text().replace('" }\n', '", scene = "03", faults = { front_left = "swapped=front_right" } }\n')
    rig_toml.write_text(text)
    session = rig_toml.parent / "new-calibration"
    with OpenRig(rig_toml) as rigged:
        with pytest.raises(CaptureError, match=r"^front_left and front_right: .*exchanged"):
            rigged.fire_pose(session)
        assert not list((session / "calibration").glob("*")) if (session / "calibration").exists() else True
        assert not list(session.rglob("*.jpg"))
    rig_toml.write_text(text.replace(', faults = { front_left = "swapped=front_right" }', ""))
    with OpenRig(rig_toml) as rigged:
        assert rigged.fire_pose(session).count == 1
