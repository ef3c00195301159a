"""A disturbed session is a whole session; its truth says what was disturbed, and nothing else differs."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import tifffile
from PIL import Image, JpegImagePlugin

from mammometry.base.errors import SessionError
from mammometry.io.meshes.own import read_ply
from mammometry.io.truth import read_true_cameras, read_truth
from mammometry.simulate import studio
from mammometry.simulate.recipe import SessionRecipe, parse_situation
from mammometry.simulate.rendering.film import Film
from mammometry.simulate.session import write_session

_CLEAN = SessionRecipe(rig="reference:front,left", subject="plaster_2", scale=0.06, seed=4, poses=1)
_TEXT = "pale-wall,drift=0.05,asynchronous=100"


@pytest.fixture(scope="module")
def both(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """The same cast without and with disturbances."""
    folder = tmp_path_factory.mktemp("clinic")
    clean = write_session(folder / "clean", _CLEAN).folder
    disturbed = write_session(folder / "disturbed", replace(_CLEAN, situation=parse_situation(_TEXT))).folder
    return clean, disturbed


@pytest.mark.slow
def test_truth_says_what_was_disturbed(both):
    clean, disturbed = (json.loads((folder / "truth" / "truth.json").read_text()) for folder in both)
    assert "disturbances" not in clean
    told = {one["name"]: one["size"] for one in disturbed["disturbances"]}
    assert told == {"pale-wall": 0.75, "drift": 0.05, "asynchronous": 100.0}
    for camera in disturbed["capture"].values():
        assert camera["turned_deg"] == pytest.approx(0.05, rel=1e-6)
        assert abs(camera["exposed_ms"]) == pytest.approx(50.0)
        assert 0.1 < camera["subject_moved_mm"]["mean"] < 1.0
    assert f"{_TEXT}" in (both[1] / "session.toml").read_text()


@pytest.mark.slow
def test_nothing_else_differs(both):
    clean, disturbed = both
    for name in ("mesh.ply", "cameras.json", "boards.json", "boundary_base.xyz"):
        assert (clean / "truth" / name).read_bytes() == (disturbed / "truth" / name).read_bytes()
    volumes = [read_truth(folder / "truth", {}).volumes_cc for folder in both]
    assert volumes[0] == volumes[1]
    assert not (clean / "truth" / "things.ply").exists()
    wall = read_ply(disturbed / "truth" / "things.ply")[0]
    assert np.ptp(wall.vertices[:, 2]) == 0.0
    for path in (clean / "calibration").rglob("*.jpg"):  # the cameras had not moved yet
        assert path.read_bytes() == (disturbed / path.relative_to(clean)).read_bytes()


def test_colour_is_halved_in_the_files_if_asked_for(tmp_path):
    light = np.full((32, 48, 3), 0.3, dtype=np.float32)
    for halved in (False, True):
        studio.take_picture(tmp_path / "p.jpg", lambda: light, Film(chroma_halved=halved), 1)
        with Image.open(tmp_path / "p.jpg") as picture:
            assert JpegImagePlugin.get_sampling(picture) == (2 if halved else 0)


@pytest.mark.slow
def test_the_wall_is_bright_behind_the_cast_and_no_part_of_its_depth(both):
    clean, disturbed = (np.asarray(Image.open(folder / "capture" / "front_left.jpg"), dtype=float) for folder in both)
    known = tifffile.imread(both[1] / "truth" / "depth" / "front_left.tif", key=1).astype(bool)
    corner = np.zeros_like(known)
    corner[:20, :20] = True
    assert not known[corner].any()
    assert disturbed[corner].mean() > clean[corner].mean() + 60.0


@pytest.mark.slow
def test_depth_is_that_of_the_cameras_at_the_capture(both):
    truth = both[1] / "truth"
    camera = read_true_cameras(truth)["front_left"]
    now = json.loads((truth / "capture_cameras.json").read_text())["cameras"]["front_left"]
    turn = np.array(now["R"]) @ camera.camera_from_world.rotation.T
    assert np.degrees(np.arccos((np.trace(turn) - 1) / 2)) == pytest.approx(0.05, rel=1e-3)


def test_what_cannot_be_is_one_sentence(tmp_path):
    for text, said in (("removed=right", "only torsos"), ("nonsense", "disturbances are")):
        with pytest.raises(SessionError, match=said):
            write_session(tmp_path / "out", replace(_CLEAN, situation=parse_situation(text)))
