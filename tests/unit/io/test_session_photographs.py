"""Which files a session takes for its cameras' photographs, and which it refuses by name."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from tests.brought.photograph_damage import written

from mammometry.base.errors import ImageError, SessionError
from mammometry.io.session import Session

MANIFEST = """\
format = 1
units = "mm"
rig = { name = "two", pairs = [{ name = "front", left = "l", right = "r" }] }
target = { kind = "chessboard", squares = [5, 4], square_mm = 25.0 }
subject = { kind = "model" }
"""
PLACES = ("capture", "calibration/00", "calibration/01", "calibration/02")


@pytest.fixture
def session(tmp_path: Path) -> Path:
    for number, (place, camera) in enumerate((place, camera) for place in PLACES for camera in ("l", "r")):
        (tmp_path / place).mkdir(parents=True, exist_ok=True)
        Image.fromarray(np.full((20, 30), 100 + number, np.uint8)).save(tmp_path / place / f"{camera}.jpg")
    (tmp_path / "session.toml").write_text(MANIFEST)
    Session.open(tmp_path).require("report")
    return tmp_path


@pytest.mark.parametrize(
    ("source", "goal"),
    [
        ("capture/l.jpg", "capture/r.jpg"),
        ("calibration/01/l.jpg", "calibration/01/r.jpg"),
        ("calibration/00/r.jpg", "calibration/02/l.jpg"),
    ],
)
@pytest.mark.requirement("R-IN-19")
def test_one_file_for_two_cameras_is_refused_by_both_names(session: Path, source: str, goal: str) -> None:
    (session / goal).write_bytes((session / source).read_bytes())
    with pytest.raises(SessionError, match="same") as caught:
        Session.open(session).require("report")
    assert source in str(caught.value)
    assert goal in str(caught.value)


def test_one_file_for_two_poses_of_a_camera_is_left_to_the_calibration(session: Path) -> None:
    (session / "calibration/01/l.jpg").write_bytes((session / "calibration/00/l.jpg").read_bytes())
    Session.open(session).require("report")


@pytest.mark.parametrize("ending", ["NEF", "heic", "DNG", "CR3", "arw"])
@pytest.mark.parametrize("place", PLACES[:2])
@pytest.mark.requirement("R-IN-19")
def test_a_raw_picture_instead_of_a_photograph_is_named(session: Path, place: str, ending: str) -> None:
    (session / place / "l.jpg").rename(session / place / f"l.{ending}")
    with pytest.raises(SessionError, match=rf"{place}/l\.{ending}: .*format"):
        Session.open(session).require("report")


@pytest.mark.parametrize("road", ["capture", "calibration", "intrinsics", "check", "masks"])
@pytest.mark.requirement("R-IN-18")
def test_a_damaged_photograph_is_refused_on_every_road(session: Path, road: str) -> None:
    """4,096 zeros in the middle, and its end as it was: OpenCV and Pillow read it."""
    whole = written("JPEG", 0)
    middle = len(whole) // 2
    damaged = whole[:middle] + bytes(4096) + whole[middle + 4096 :]
    places = {"capture": "capture/l.jpg", "calibration": "calibration/01/l.jpg", "intrinsics": "intrinsics/l/a.jpg",
              "check": "later/l.jpg", "masks": "masks/l.jpg"}  # fmt: skip
    with (session / "session.toml").open("a") as manifest:
        if road == "intrinsics":
            manifest.write("[intrinsics.target]\nkind = 'chessboard'\nsquares = [5, 4]\nsquare_mm = 25.0\n")
    for place in (*PLACES, "intrinsics/l", "intrinsics/r", "later", "masks"):
        (session / place).mkdir(parents=True, exist_ok=True)
        for number, camera in enumerate(("l", "r")):
            name = "a" if place.startswith("intrinsics") else camera
            (session / place / f"{name}.jpg").write_bytes(written("JPEG", 1 + number))
    (session / places[road]).write_bytes(damaged)
    opened = Session.open(session)
    inputs = opened.inputs()
    look_up = {
        "capture": lambda: inputs.photographs["l"],
        "calibration": lambda: inputs.calibration_photographs["01", "l"],
        "intrinsics": lambda: inputs.intrinsics_photographs["l"]["a", "l"],
        "check": lambda: opened.image_set(session / "later")[0]["later", "l"],
        "masks": lambda: inputs.masks["l"],
    }[road]
    with pytest.raises(ImageError, match=rf"{places[road]}: .*damaged"):
        look_up()


def test_a_raw_picture_beside_a_photograph_is_left_alone(session: Path) -> None:
    for place in PLACES:
        (session / place / "l.NEF").write_bytes(b"raw")
    Session.open(session).require("report")
