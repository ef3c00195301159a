"""The session folder: what is accepted, and which sentence each mistake gets."""

import json
import re
import shutil
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from mammometry.base.errors import ImageError, SessionError
from mammometry.io.manifest import RIGS, TARGETS, manifest_template, parse_manifest, read_manifest
from mammometry.io.session import Session

MANIFEST = """\
format = 1
units = "mm"
[rig]
name = "two"
pairs = [ { name = "front", left = "front_left", right = "front_right" } ]
[target]
kind = "charuco"
squares = [5, 4]
square_mm = 25.0
marker_mm = 18.0
dictionary = "DICT_5X5_250"
[subject]
kind = "model"
"""
GREY = Image.fromarray(np.full((20, 30), 128, np.uint8))


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    session = tmp_path / "session"
    for place in ("capture", "calibration/00", "calibration/01", "calibration/02"):
        (session / place).mkdir(parents=True)
        for camera in ("front_left", "front_right"):
            GREY.save(session / place / f"{camera}.jpg", comment=f"{place} {camera}")  # no two are one file
    (session / "session.toml").write_text(MANIFEST)
    return session


def test_a_whole_session(folder: Path) -> None:
    (folder / "capture" / ".DS_Store").touch()
    (folder / "capture" / "notes.txt").touch()
    session = Session.open(folder)
    inputs = session.inputs()
    assert session.cameras == ("front_left", "front_right")
    assert list(inputs.photographs) == ["front_left", "front_right"]
    assert list(inputs.calibration_photographs)[:2] == [("00", "front_left"), ("00", "front_right")]
    assert inputs.photographs["front_left"].name == "capture/front_left.jpg"
    assert inputs.photographs["front_left"].size_wh == (30, 20)
    assert inputs.target is not None
    assert inputs.target.kind == "charuco"


def test_a_manifest_with_a_mark_of_utf_8_is_read(folder: Path) -> None:
    """As editors on Windows write it."""
    (folder / "session.toml").write_bytes(b"\xef\xbb\xbf" + MANIFEST.encode())
    assert Session.open(folder).manifest.units == "mm"


def test_the_subject_is_told_and_composed(folder: Path) -> None:
    text = MANIFEST.replace("[subject]", '[subject]\nid = "Mu\u0308"').replace("[rig]", "date = 2026-01-31\n[rig]")
    (folder / "session.toml").write_text(text, encoding="utf-8")
    identity = Session.open(folder).identity
    assert (identity.name, identity.subject, identity.date) == ("session", "Mü", "2026-01-31")


def test_digests_follow_content_not_dates(folder: Path) -> None:
    def digest() -> str:
        return Session.open(folder).inputs().digests["capture/front_left"]

    before = digest()
    path = folder / "capture" / "front_left.jpg"
    shutil.copy(path, folder / "copy.jpg")
    path.unlink()
    shutil.move(folder / "copy.jpg", path)
    assert digest() == before
    Image.fromarray(np.full((20, 30), 90, np.uint8)).save(path)
    assert digest() != before


def refused(folder: Path, error: type[Exception] = SessionError) -> str:
    def opened() -> None:
        session = Session.open(folder)
        session.inputs()
        session.require("report")

    with pytest.raises(error) as caught:
        opened()
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_a_missing_camera(folder: Path) -> None:
    (folder / "capture" / "front_right.jpg").unlink()
    said = refused(folder)
    assert said.startswith("capture/front_right:")


def test_wrong_pair_names(folder: Path) -> None:
    (folder / "session.toml").write_text(MANIFEST.replace('"front_right"', '"front_rihgt"'))
    assert "front_right?" in refused(folder)


def test_a_camera_without_calibration(folder: Path) -> None:
    for path in folder.glob("calibration/*/front_right.jpg"):
        path.unlink()
    assert refused(folder).startswith("calibration/*/front_right:")


def test_a_photograph_by_an_unknown_camera(folder: Path) -> None:
    GREY.save(folder / "capture" / "top.jpg")
    assert refused(folder).startswith("capture/top.jpg:")


def test_two_photographs_of_one_camera(folder: Path) -> None:
    GREY.save(folder / "capture" / "front_left.png")
    assert "front_left.jpg" in refused(folder)


def test_too_few_poses(folder: Path) -> None:
    shutil.rmtree(folder / "calibration" / "02")
    assert refused(folder).startswith("calibration: found 2 poses (00, 01)")


def test_a_wrong_size(folder: Path) -> None:
    GREY.resize((15, 10)).save(folder / "capture" / "front_left.jpg")
    said = refused(folder, ImageError)
    assert said.startswith("capture/front_left.jpg: found 15 × 10 pixels")


def test_an_unreadable_photograph(folder: Path) -> None:
    (folder / "calibration" / "01" / "front_left.jpg").write_bytes(b"\xff\xd8nonsense")
    assert refused(folder, ImageError).startswith("calibration/01/front_left.jpg:")


def test_intrinsics_photographs_are_wanted_of_every_camera(folder: Path) -> None:
    table = '[intrinsics]\ntarget = { kind = "chessboard", squares = [7, 6], square_mm = 20.0 }\n'
    (folder / "session.toml").write_text(MANIFEST + table)
    assert refused(folder).startswith("intrinsics/front_left:")
    for camera in ("front_left", "front_right"):
        (folder / "intrinsics" / camera).mkdir(parents=True)
        GREY.save(folder / "intrinsics" / camera / "a.jpg")
    inputs = Session.open(folder).inputs()
    assert list(inputs.intrinsics_photographs["front_left"]) == [("a", "front_left")]
    assert inputs.intrinsics_target is not None
    assert inputs.intrinsics_target.kind == "chessboard"


def test_a_mask_of_another_size(folder: Path) -> None:
    (folder / "masks").mkdir()
    GREY.resize((15, 10)).save(folder / "masks" / "front_left.png")
    inputs = Session.open(folder).inputs()
    with pytest.raises(ImageError, match=r"15 × 10 pixels, .*30 × 20"):
        inputs.masks["front_left"]
    GREY.save(folder / "masks" / "top.png")
    assert "mask" in refused(folder)


def test_ready_made_cameras_need_no_calibration(folder: Path) -> None:
    shutil.rmtree(folder / "calibration")
    entry = {
        "K": [[100, 0, 15], [0, 100, 10], [0, 0, 1]],
        "dist": [0, 0, 0, 0, 0],
        "R": np.eye(3).tolist(),
        "t": [0, 0, 0],
        "image_size": [30, 20],
    }
    (folder / "cameras.json").write_text(json.dumps({"cameras": {"front_left": entry, "front_right": entry}}))
    inputs = Session.open(folder).inputs()
    assert inputs.cameras is not None
    assert inputs.cameras["front_left"].size_wh == (30, 20)
    entry["image_size"] = [60, 40]
    (folder / "cameras.json").write_text(json.dumps({"cameras": {"front_left": entry, "front_right": entry}}))
    assert "cameras.json" in refused(folder, ImageError)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ('{"boundaries": {"left": {"points": [[0, 0, 0], [1, 0, 0], [0, 1, 0]]}}}', "boundaries.json: left"),
        (
            '{"boundaries": {"model": {"points": [[0, 0], [1, 0], [0, 1, 0]]}}}',
            "boundaries.json: model:",
        ),
        ("[", "boundaries.json: found JSON"),
    ],
)
def test_unfit_boundaries(folder: Path, text: str, said: str) -> None:
    (folder / "boundaries.json").write_text(text)
    assert refused(folder).startswith(said)


def test_no_folder_and_no_manifest(tmp_path: Path) -> None:
    with pytest.raises(SessionError, match="folder"):
        Session.open(tmp_path / "nowhere")
    with pytest.raises(SessionError, match=r"session\.toml"):
        Session.open(tmp_path)


@pytest.mark.parametrize("rig", RIGS)
@pytest.mark.parametrize("target", TARGETS)
def test_the_template_is_a_manifest(rig: str, target: str) -> None:
    from mammometry.calibration.targets.table import target_from_table

    manifest = parse_manifest(manifest_template(rig=rig, target=target))
    assert manifest.target is not None
    assert target_from_table(manifest.target).kind == target


@pytest.mark.parametrize(("kind", "posture"), [("torso", "leaning"), ("model", ""), ("surface", "")])
def test_only_a_patient_has_a_posture(kind: str, posture: str) -> None:
    manifest = parse_manifest(MANIFEST.replace('kind = "model"', f'kind = "{kind}"'))
    assert (manifest.subject.kind, manifest.subject.patient_posture) == (kind, posture)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("format = 1\n", "", "session.toml: format:"),
        ("format = 1", "format = 2", "session.toml: format: found 2, expected 1"),
        ('units = "mm"', 'units = "inch"', "'inch'"),
        ('units = "mm"', 'unit = 1\nunits = "mm"', "session.toml: unit:"),
        ('name = "front"', 'nmae = "front"', "session.toml: rig.pairs.1.n"),
        ('kind = "model"', 'kind = "cast"', "'cast'"),
        ('kind = "model"', 'kind = "model"\nid = "a/b"', "session.toml: subject.id: found 'a/b', expected 1 to 64 "),
        ('kind = "model"', 'kind = "model"\nid = 7', "session.toml: subject.id: found 7"),
        ('kind = "model"', 'kind = "model"\nrim_radius_mm = -0.1', "session.toml: subject.rim_radius_mm: found -0.1"),
        ('kind = "model"', 'kind = "torso"\nrim_radius_mm = 0.1', "rim"),
        ("pairs = [", "pairs = 3 #", "session.toml: rig.pairs: found 3"),
        ('name = "two"', 'name = "two"\ncamera = 3', "session.toml: rig.camera:"),
        ('right = "front_right"', 'right = "front_left"', "'front'"),
        ('"front_left"', '"../front_left"', "digits"),
        ("square_mm = 25.0", "square_cm = 2.5", "[target] square_cm"),
        ("[rig]", "[rig", "TOML"),
    ],
)  # fmt: skip
def test_manifest_mistakes_are_named(folder: Path, old: str, new: str, said: str) -> None:
    (folder / "session.toml").write_text(MANIFEST.replace(old, new))
    assert said in refused(folder)


def test_points_measured_elsewhere_are_read_beside_their_photograph(folder: Path) -> None:
    (folder / "calibration" / "01" / "front_left.csv").write_text("id,u,v\n2,10.5,3\n0,1,2\n")
    inputs = Session.open(folder).inputs()
    assert list(inputs.measured_points) == [("01", "front_left")]
    table = inputs.measured_points["01", "front_left"]
    assert table.name == "calibration/01/front_left.csv"
    np.testing.assert_array_equal(table.ids, [2, 0])
    np.testing.assert_array_equal(table.uv, [[10.5, 3.0], [1.0, 2.0]])
    assert len(inputs.digests["points/01/front_left"]) == 64


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("u,v\n1,2\n", "columns u, v"),
        ("id,u,v\none,1,2\n", "column id: "),
        ("id,u,v\n1.5,1,2\n", "found 1.5,"),
        ("id,u,v\n1,2\n", ", row 2, column v:"),
        ("id,u,v\n1,1e308,2\n", ", row 2, column u: found '1e308'"),
        ("id,u,v\n1,nan,2\n", "column u: "),
        ("id,u,v\n1," + "9" * 200_000 + ",2\n", ", row 2: "),
    ],
)
def test_a_malformed_table_of_points_is_named(folder: Path, text: str, said: str) -> None:
    (folder / "calibration" / "01" / "front_left.csv").write_text(text)
    with pytest.raises(SessionError, match=rf"^calibration/01/front_left\.csv\b.*{re.escape(said)}"):
        Session.open(folder).inputs()


def test_ready_made_cameras_need_no_separate_photographs(folder: Path) -> None:
    manifest = MANIFEST + '[intrinsics]\ntarget = { kind = "chessboard", squares = [5, 4], square_mm = 25.0 }\n'
    (folder / "session.toml").write_text(manifest)
    with pytest.raises(SessionError, match="intrinsics/front_left"):
        Session.open(folder).inputs()
    entry = {"K": [[40, 0, 15], [0, 40, 10], [0, 0, 1]], "dist": [0] * 5, "image_size": [30, 20]}
    entry |= {"R": np.eye(3).tolist(), "t": [0, 0, 500]}
    (folder / "cameras.json").write_text(json.dumps({"cameras": {"front_left": entry, "front_right": entry}}))
    assert Session.open(folder).inputs().intrinsics_photographs == {}


def test_a_rig_is_calibrated_before_any_capture(folder: Path) -> None:
    shutil.rmtree(folder / "capture")
    session = Session.open(folder)
    session.require("calibrate")
    assert list(session.inputs().photographs) == ["front_left", "front_right"]
    assert session.inputs().digests["capture/front_left"] == "missing"
    with pytest.raises(SessionError, match="capture/front_left: "):
        session.require("match")


def test_the_rigs_last_cameras_guide_the_next_calibration(folder: Path) -> None:
    entry = {"K": [[40, 0, 15], [0, 41, 10], [0, 0, 1]], "dist": [0.1, 0, 0, 0, 0], "image_size": [30, 20]}
    entry |= {"R": np.eye(3).tolist(), "t": [0, 0, 500], "std": {"fx_px": 0.2, "k3": 0.0, "centre_x_mm": 0.1}}
    before = Session.open(folder).inputs()
    assert before.priors == {}
    (folder / "prior.json").write_text(json.dumps({"cameras": {"front_left": entry}}))
    inputs = Session.open(folder).inputs()
    assert inputs.priors["front_left"].std == {"fx_px": 0.2, "k3": 0.0}
    np.testing.assert_array_equal(inputs.priors["front_left"].intrinsics, [40, 41, 15, 10, 0.1, 0, 0, 0, 0, 0])
    assert len(inputs.digests["prior"]) == 64
    entry["std"] = {"fx_px": -1.0}
    (folder / "prior.json").write_text(json.dumps({"cameras": {"front_left": entry}}))
    assert "-1.0" in refused(folder)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("a = " + "[" * 100_000, "nested"),
        ("a." * 100_000 + "b = 1", "nested"),
        (MANIFEST + "edge_mm = " + "9" * 5000, "TOML"),
        (MANIFEST.replace("25.0", "inf"), "target.square_mm: inf"),
        (MANIFEST.replace("25.0", "1e300"), "target.square_mm: a number"),
        (MANIFEST.replace('"two"', '"' + "x" * 100_000 + '"').replace('"model"', '"' + "y" * 100_000 + '"'), "yyy…"),
        (MANIFEST.replace("[5, 4]", "[100000, 100000]"), "2000 × 2000"),
    ],
)
def test_a_hostile_manifest_is_one_short_sentence(folder: Path, text: str, said: str) -> None:
    (folder / "session.toml").write_text(text)
    sentence = refused(folder)
    assert said in sentence
    assert len(sentence) < 500


def test_points_as_a_spreadsheet_writes_them(folder: Path) -> None:
    (folder / "calibration" / "01" / "front_left.csv").write_bytes("\ufeffid;u;v\r\n2;10,5;3\r\n".encode())
    table = Session.open(folder).inputs().measured_points["01", "front_left"]
    assert (table.ids.tolist(), table.uv.tolist()) == ([2], [[10.5, 3.0]])


@pytest.mark.parametrize("name", ["cameras.json", "prior.json", "boundaries.json", "landmarks.json"])
def test_hostile_json_beside_the_manifest(folder: Path, name: str) -> None:
    for content in (b"[" * 100_000, b'{"cameras": ' + b"9" * 5000 + b"}", b"\xff", b'{"a": 1, "a": 2}', b"null"):
        (folder / name).write_bytes(content)
        assert refused(folder).startswith(name)


def test_an_empty_folder_is_told_both_roads(tmp_path: Path) -> None:
    with pytest.raises(SessionError) as error:
        read_manifest(tmp_path / "session.toml")
    assert "`mammometry new`" in error.value.remedy
    assert "`mammometry import mesh`" in error.value.remedy
