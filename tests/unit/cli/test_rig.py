"""`mammometry check` on rendered photographs, the history that it keeps, and cameras in and out."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from board_session import expose, write_board_session
from scipy.spatial.transform import Rotation

from mammometry.cli import main
from mammometry.geometry.camera import Camera, Rig
from mammometry.geometry.transform import Transform
from mammometry.io.drift import FOLDER, HISTORY, read_history

POSES = 5


@pytest.fixture(scope="module")
def rig_session(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Rig, dict[str, Transform]]:
    folder = tmp_path_factory.mktemp("rig") / "session"
    folder.mkdir()
    rig, placed = write_board_session(folder, POSES)
    assert main.run(["calibrate", str(folder)]) == 0
    return folder, rig, placed


def turned(camera: Camera, degrees: float) -> Camera:
    rotation = Rotation.from_rotvec([0.0, np.radians(degrees), 0.0]).as_matrix()
    about_itself = Transform(rotation=rotation, translation_mm=np.zeros(3))
    return replace(camera, camera_from_world=about_itself @ camera.camera_from_world)


def answer(capsys: pytest.CaptureFixture[str], *arguments: str) -> tuple[int, dict]:
    code = main.run([*arguments, "--json"])
    return code, json.loads(capsys.readouterr().out)


@pytest.mark.slow
def test_check_names_the_camera_that_moved_and_keeps_a_history(
    rig_session: tuple[Path, Rig, dict[str, Transform]], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """0.006° of one camera is 0.08 mm at 0.8 m."""
    session, rig, placed = rig_session
    later = list(placed)[POSES:]
    expose(tmp_path / "still", rig.cameras, placed[later[0]], 50)
    moved = {**rig.cameras, "floor_left": turned(rig.cameras["floor_left"], 0.006)}
    expose(tmp_path / "moved", moved, placed[later[1]], 51)

    code, still = answer(capsys, "check", str(session), "--image-set", str(tmp_path / "still"))
    assert (code, still["verdict"]) == (0, "unmoved")
    assert max(one["sigma"] for one in still["cameras"].values()) < 5
    assert (still["verdict"], still["unseen"]) == ("unmoved", [])

    code, table = answer(capsys, "check", str(session), "--image-set", str(tmp_path / "moved"))
    assert (code, table["verdict"]) == (10, "refuse")
    assert table["alternatives"] == [["floor_left"]]
    assert [name for name, one in table["cameras"].items() if one["moved"]] == ["floor_left"]
    assert table["cameras"]["floor_left"]["turn_deg"] == pytest.approx(0.006, abs=0.001)
    assert set(table["pairs"]) == {"floor"}
    assert table["pairs"]["floor"]["displacement_mm"] == pytest.approx(0.28, rel=0.2)  # 0.082 mm · 0.8 m / 0.24 m

    lines = (session / FOLDER / HISTORY).read_text().splitlines()
    assert [json.loads(line)["verdict"] for line in lines] == ["unmoved", "refuse"]
    entries = read_history(session).entries
    assert entries[0].calibration == entries[1].calibration
    assert (session / FOLDER / "drift.png").read_bytes().startswith(b"\x89PNG")

    code, history = answer(capsys, "check", str(session), "--history")
    assert code == 0
    assert [check["effect_mm"] for check in history["checks"]] == [still["effect_mm"], table["effect_mm"]]

    assert main.run(["check", str(session), "--history"]) == 0
    assert "floor_left" in capsys.readouterr().out


@pytest.mark.slow
def test_a_check_names_exchanged_pictures(
    rig_session: tuple[Path, Rig, dict[str, Transform]], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    session, rig, placed = rig_session
    expose(tmp_path / "swapped", rig.cameras, placed[list(placed)[POSES + 2]], 52)
    ending = next((tmp_path / "swapped").iterdir()).suffix
    one, other, between = (tmp_path / "swapped" / f"{name}{ending}" for name in ("front_left", "floor_right", "x"))
    one.rename(between)
    other.rename(one)
    between.rename(other)
    code, table = answer(capsys, "check", str(session), "--image-set", str(tmp_path / "swapped"))
    assert (code, table["verdict"]) == (10, "refuse")
    assert "exchanged" in table["reasons"][0]
    assert "front_left" in table["reasons"][0]
    assert "floor_right" in table["reasons"][0]


@pytest.mark.slow
def test_check_refuses_what_it_cannot_use(
    rig_session: tuple[Path, Rig, dict[str, Transform]], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    session, rig, placed = rig_session
    assert main.run(["check", str(session)]) == main.USAGE
    assert main.run(["check", str(session), "--image-set", str(tmp_path / "nowhere")]) == 3
    (tmp_path / "empty").mkdir()
    assert main.run(["check", str(session), "--image-set", str(tmp_path / "empty")]) == 3
    one = {"front_left": rig.cameras["front_left"]}
    expose(tmp_path / "alone", one, placed["00"], 1)
    assert main.run(["check", str(session), "--image-set", str(tmp_path / "alone")]) == 5
    (tmp_path / "alone" / "front_left.png").rename(tmp_path / "alone" / "front_lift.png")
    assert main.run(["check", str(session), "--image-set", str(tmp_path / "alone")]) == 3
    said = capsys.readouterr().err
    for words in (
        "either --image-set",
        "no such folder",
        "no photographs",
        "no two cameras",
        "Did you mean front_left",
    ):
        assert words in said


@pytest.mark.slow
def test_cameras_go_out_and_come_in_again(
    rig_session: tuple[Path, Rig, dict[str, Transform]], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    session, rig, _ = rig_session
    for form, count in (("opencv", 4), ("colmap", 3), ("kalibr", 1), ("json", 1)):
        code, table = answer(capsys, "export-cameras", str(session), str(tmp_path / form), "--format", form)
        assert (code, len(table["files"])) == (0, count)
    other = tmp_path / "other"
    other.mkdir()
    (other / "session.toml").write_bytes((session / "session.toml").read_bytes())
    files = [str(tmp_path / "colmap" / name) for name in ("cameras.txt", "images.txt")]
    code, table = answer(capsys, "import-cameras", str(other), *files)
    assert (code, sorted(table["cameras"])) == (0, sorted(rig.cameras))
    same = [json.loads((folder / "cameras.json").read_text())["cameras"] for folder in (other, tmp_path / "json")]
    for name in rig.cameras:
        for key in ("K", "dist", "R", "t"):
            np.testing.assert_allclose(same[0][name][key], same[1][name][key], atol=1e-9)


@pytest.mark.slow
def test_ready_made_cameras_are_checked_with_their_errors_unknown(
    rig_session: tuple[Path, Rig, dict[str, Transform]], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    session, rig, placed = rig_session
    ready = tmp_path / "ready"
    ready.mkdir()
    (ready / "session.toml").write_bytes((session / "session.toml").read_bytes())
    code, _ = answer(capsys, "import-cameras", str(ready), str(session / "results" / "calibrate" / "cameras.json"))
    assert code == 0
    moved = {**rig.cameras, "front_right": turned(rig.cameras["front_right"], 0.1)}
    expose(tmp_path / "moved", moved, placed[list(placed)[POSES + 2]], 60)
    code, table = answer(capsys, "check", str(ready), "--image-set", str(tmp_path / "moved"))
    assert (code, table["alternatives"]) == (10, [["front_right"]])
    assert "errors" in table["reasons"][-1]
