"""The road of docs/how-to/capture.md, from the first click to the last, with the simulator as cameras."""

import json
import re
from itertools import count
from pathlib import Path

import pytest

from mammometry.cli import main

ROAD = "docs/how-to/capture.md"
_TOML = re.compile(r"```toml\n(.*?)```", re.DOTALL)


@pytest.fixture
def rig(repository: Path, tiny: Path, tmp_path: Path) -> Path:
    """The guide's own rig.toml. Cameras and subject alone are others."""
    (text,) = _TOML.findall((repository / ROAD).read_text(encoding="utf-8"))
    text = re.sub(r'backend = "pylon" .*', 'backend = "virtual"', text)
    text = re.sub(r"cameras = .*", "", text.replace('kind = "torso"', 'kind = "model"'))
    text = re.sub(r"\[capture.options\].*", f'[capture.options]\nsession = "{tiny}"\n', text, flags=re.DOTALL)
    (tmp_path / "rig.toml").write_text(text)
    return tmp_path / "rig.toml"


def put(rig: Path, scene: str) -> None:
    """Hold something else before the cameras."""
    text = re.sub(r"\nscene = .*", "", rig.read_text())
    rig.write_text(f'{text}\nscene = "{scene}"\n')


def said(capsys: pytest.CaptureFixture[str], *arguments: str | Path, code: int = 0) -> str:
    capsys.readouterr()
    assert main.run([*map(str, arguments)]) == code
    out = capsys.readouterr()
    return out.out + out.err


@pytest.mark.requirement("R-FIRE-1")
@pytest.mark.slow
def test_poses_are_taken_before_there_is_a_calibration(
    rig: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    calibration = tmp_path / "rig-calibration"  # as the file names it
    assert 'calibration = "rig-calibration"' in rig.read_text()
    words = said(capsys, "capture", tmp_path / "visit", "--rig", rig, code=3)
    assert "mammometry capture" in words
    assert not (tmp_path / "visit").exists()
    put(rig, "lamps")
    words = said(capsys, "skew", calibration, "--rig", rig, code=12)
    assert "front_left: " in words  # it fired: these pictures are too small for lamps
    put(rig, "00")
    assert "Pose 00 is stored" in said(capsys, "capture", calibration, "--rig", rig, "--pose")
    put(rig, "capture")
    assert "no camera saw it" in said(capsys, "capture", calibration, "--rig", rig, "--pose", code=12)
    assert [path.name for path in (calibration / "calibration").iterdir()] == ["00"]
    assert len(list(calibration.rglob("front_left.jpg"))) == 2  # the pose, and the firing that it was


@pytest.mark.slow
def test_the_whole_road(
    rig: Path,
    tmp_path: Path,
    tiny_settings: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    seeds = (
        count()
    )  # the same noise in every run: the tiny cast's rim is seen in hardly more directions than are needed
    monkeypatch.setattr("mammometry.capture.backends.virtual.secrets.randbits", lambda _: next(seeds))
    calibration, visit = tmp_path / "rig-calibration", tmp_path / "visit"
    for pose in range(8):
        put(rig, f"0{pose}")
        table = json.loads(said(capsys, "capture", calibration, "--rig", rig, "--pose", "--json"))
    assert table["poses"] == 8
    assert table["error_mm"] > 0
    put(rig, "capture")
    fired = json.loads(said(capsys, "capture", visit, "--rig", rig, "--json"))
    assert fired["accepted"], fired["checks"]
    answer = json.loads(said(capsys, "run", visit, "--settings", tiny_settings, "--json"))
    low, high = answer["intervals_cc"]["model"]
    assert low < 426.4 < high
    put(rig, "07")
    check = tmp_path / "monday"
    words = said(capsys, "capture", check, "--rig", rig)  # the board instead of a patient: it goes on beyond a picture
    assert "The cast is cut off" in words
    (shot,) = (check / "shots").iterdir()
    (shot / "shot.json").unlink()
    words = said(capsys, "check", visit, "--image-set", shot)
    assert "No camera has moved" in words
