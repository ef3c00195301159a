"""Lengths in another unit: of a printed target, and of imported cameras."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.unit.calibration.virtual_rig import PAIRS, cameras_in_rig, observe
from tests.unit.measure.solids import dome
from tests.unit.report import synthetic

from mammometry.base.errors import CalibrationError, MammometryError, SessionError
from mammometry.base.notices import words_of
from mammometry.calibration.adjust.calibrated import Calibration
from mammometry.calibration.judge.findings import about_scale
from mammometry.calibration.judge.scale import require_scale
from mammometry.calibration.targets.kinds.chessboard import ChessboardTarget
from mammometry.calibration.targets.table import target_from_table
from mammometry.cli import main
from mammometry.geometry.camera import Camera, Rig
from mammometry.geometry.mesh_files.ply import write_ply
from mammometry.geometry.transform import Transform
from mammometry.io.cameras.formats import CameraFormat, camera_texts, require_rig
from mammometry.io.meshes.foreign import read_foreign
from mammometry.job.stages import calibrate

# Rigs by how far their cameras stand from the subject, mm, the distance of a pair's cameras, and the width of the
# shorter side of a picture as a share of its distance.
RIGS = {
    "reference": (780, 210, 0.37),
    "cross": (1400, 440, 0.26),
    "two cameras before a tube": (340, 180, 0.55),
    "three cameras before a face": (480, 110, 0.60),
    "telephones": (600, 200, 0.75),
}
RARE_RIGS = {
    "ring around a cast of 5 cm": (300, 155, 0.30),
    "small stereo module": (150, 18, 0.60),
    "whole bodies": (2500, 400, 0.70),
}


def moved(transform: Transform, factor: float) -> Transform:
    return replace(transform, translation_mm=transform.translation_mm * factor)


def pair_of(distance_mm: float, baseline_mm: float, share: float) -> Rig:
    """Two cameras that look at the world's origin, where their axes meet."""
    cameras = {}
    for name, side in (("left", -0.5), ("right", 0.5)):
        angle = np.arcsin(side * baseline_mm / distance_mm)
        turn = Transform.from_rotation_vector(np.array([0.0, angle, 0.0]), np.zeros(3)).rotation
        cameras[name] = Camera(
            name=name,
            size_wh=(1500, 1000),
            matrix=np.array([[1000 / share, 0, 749.5], [0, 1000 / share, 499.5], [0, 0, 1]]),
            distortion=np.zeros(5),
            camera_from_world=Transform(rotation=turn, translation_mm=np.array([0.0, 0.0, distance_mm])),
        )
    return Rig(name="pair", cameras=cameras, pair_names={"front": ("left", "right")})


def scaled_rig(rig: Rig, factor: float) -> Rig:
    cameras = {
        name: replace(camera, camera_from_world=moved(camera.camera_from_world, factor))
        for name, camera in rig.cameras.items()
    }
    return replace(rig, cameras=cameras)


def calibrated(rig: Rig, board_mm: float, factor: float = 1.0) -> Calibration:
    """A chessboard, `board_mm` long, held where the cameras look; all sizes entered times `factor`."""
    board = ChessboardTarget(squares=(8, 6), square_mm=board_mm / 8)
    entered = ChessboardTarget(squares=(8, 6), square_mm=factor * board_mm / 8)
    poses = {"00": Transform(rotation=np.eye(3), translation_mm=-board.points_target.mean(axis=0))}
    return replace(
        synthetic.calibration(synthetic.rig()),
        rig=scaled_rig(rig, factor),
        target_points=entered.points_target,
        world_from_target={pose: moved(placed, factor) for pose, placed in poses.items()},
        observations=replace(observe(rig.cameras, poses, target=board), target=entered),
    )


def noticed(calibration: Calibration, kind: str) -> tuple[bool, str]:
    """Whether it is refused, and the error or the warnings about its size. Empty: nothing."""
    try:
        require_scale(calibration, kind)
    except CalibrationError as error:
        return True, str(error)
    return False, " ".join(words_of(found.notice) for found in about_scale(calibration) if found.verdict == "warn")


def noticed_of_cameras(rig: Rig, kind: str) -> str:
    try:
        return " ".join(map(words_of, require_rig("a.yml", rig.cameras, rig.pair_names, kind)))
    except SessionError as error:
        return str(error)


@pytest.mark.parametrize("kind", ["model", "torso", "surface"])
@pytest.mark.parametrize("name", RIGS)
def test_a_rig_in_millimetres_is_taken_without_a_word(name: str, kind: str) -> None:
    calibration = calibrated(pair_of(*RIGS[name]), 200.0)
    assert noticed(calibration, kind) == (False, "")
    assert noticed_of_cameras(calibration.rig, kind) == ""


@pytest.mark.parametrize("name", RARE_RIGS)
def test_a_rare_rig_is_measured_with(name: str) -> None:
    distance_mm, baseline_mm, share = RARE_RIGS[name]
    calibration = calibrated(pair_of(distance_mm, baseline_mm, share), 0.5 * share * distance_mm)
    refused, sentence = noticed(calibration, "model")
    assert not refused
    assert "rare" in sentence
    assert "rare" in noticed_of_cameras(calibration.rig, "model")


def test_a_small_open_surface_decides_the_size_of_its_rig() -> None:
    """A strain measurement's field of 62 mm is right, and ten times as large would be usual of a body alone."""
    rig = pair_of(200.0, 25.0, 0.31)
    assert noticed_of_cameras(rig, "surface") == ""
    for kind in ("model", "torso"):
        assert "62 mm" in noticed_of_cameras(rig, kind)


@pytest.mark.parametrize(("factor", "unit"), [(0.1, "cm"), (1e-3, "m"), (10.0, "tenths of a mm"), (1 / 25.4, "inches")])
@pytest.mark.parametrize("kind", ["model", "torso"])
@pytest.mark.parametrize("name", RIGS)
@pytest.mark.requirement("R-UNIT-1")
def test_another_unit_never_goes_unnoticed(name: str, kind: str, factor: float, unit: str) -> None:
    calibration = calibrated(pair_of(*RIGS[name]), 200.0, factor)
    refused, sentence = noticed(calibration, kind)
    assert refused or "rare" in sentence
    assert f"target.square_mm{':' if refused else ' ='} " in sentence
    assert "25 mm" in sentence
    assert f"{1 / factor:g})" in noticed_of_cameras(calibration.rig, kind)


@pytest.mark.parametrize("kind", ["model", "torso"])
@pytest.mark.parametrize("name", ["reference", "cross", "two cameras before a tube", "three cameras before a face"])
@pytest.mark.requirement("R-UNIT-1")
def test_centimetres_are_refused_before_anything_is_matched(name: str, kind: str) -> None:
    refused, sentence = noticed(calibrated(pair_of(*RIGS[name]), 200.0, 0.1), kind)
    assert refused
    assert sentence.startswith("session.toml: target.square_mm: found 2.5 mm")
    assert sentence.endswith((": 25 mm would fit.", ": 25 mm or 63.5 mm (if it was in inches) would fit."))


@pytest.mark.parametrize(
    ("table", "sentence"),
    [
        ({"kind": "charuco", "squares": [14, 10], "square_mm": 0.025, "marker_mm": 0.018, "dictionary": "DICT_5X5_250"},
         r"\[target\] square_mm: .*0\.025 mm, .*0\.3 mm.*: 25 mm"),
        ({"kind": "charuco", "squares": [14, 10], "square_mm": 250.0, "marker_mm": 180.0, "dictionary": "DICT_5X5_250"},
         r"\[target\] square_mm: .*250 mm.*: 25 mm"),
        ({"kind": "chessboard", "squares": [10, 7], "square_mm": 0.98},
         r"\[target\] square_mm: .*0\.98 mm.*: 9\.8 mm or 24\.89 mm"),
        ({"kind": "circles", "grid": [11, 8], "pitch_mm": 0.02, "diameter_mm": 0.012},
         r"\[target\] pitch_mm: .*0\.02 mm.*: 20 mm"),
        ({"kind": "dotted-cylinder", "dots": [20, 36], "radius_mm": 0.05715, "row_pitch_mm": 0.01,
          "column_pitch_mm": 0.00997}, r"\[target\] radius_mm: .*0\.05715 mm.*: 57\.15 mm"),
        ({"kind": "points", "points_mm": [[0.0, 0.0, 0.0], [0.1, 0.0, 0.0], [0.0, 0.1, 0.0], [0.0, 0.0, 0.1]]},
         r"\[target\] points_mm: .*0\.1 mm.*: 100 mm"),
    ],
)  # fmt: skip
def test_a_target_of_impossible_size_is_refused_where_it_is_read(table: dict[str, object], sentence: str) -> None:
    with pytest.raises(SessionError, match=sentence):
        target_from_table(table)


def session(folder: Path, kind: str = "torso") -> Path:
    assert main.run(["new", str(folder), "--rig", "single", "-q"]) == 0
    manifest = folder / "session.toml"
    manifest.write_text(manifest.read_text().replace('kind = "model" ', f'kind = "{kind}" '))
    return folder


def cameras_of(factor: float) -> dict[str, Camera]:
    rig = scaled_rig(Rig(name="rig", cameras=cameras_in_rig(), pair_names=PAIRS), factor)
    return {name: rig.cameras[name] for name in ("front_left", "front_right")}


@pytest.mark.parametrize("form", ["json", "opencv", "colmap", "kalibr"])
@pytest.mark.parametrize(("factor", "unit"), [(1e-3, "m"), (0.1, "cm")])
def test_cameras_in_another_unit_are_refused_at_import(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], form: CameraFormat, factor: float, unit: str
) -> None:
    folder = session(tmp_path / "s")
    files = []
    for name, text in camera_texts(cameras_of(factor), form).items():
        (tmp_path / name).write_text(text)
        files.append(str(tmp_path / name))
    capsys.readouterr()
    assert main.run(["import-cameras", str(folder), *files]) == 3
    sentence = capsys.readouterr().err
    assert f"{1 / factor:g})" in sentence
    assert Path(files[0]).name in sentence
    assert not (folder / "cameras.json").exists()


def test_cameras_in_millimetres_are_imported(tmp_path: Path) -> None:
    folder = session(tmp_path / "s")
    (tmp_path / "c.json").write_text(camera_texts(cameras_of(1.0), "json")["cameras.json"])
    assert main.run(["import-cameras", str(folder), str(tmp_path / "c.json"), "-q"]) == 0


@pytest.mark.parametrize(
    ("lacking", "sentence"),
    [
        (("R", "T"), "front_left and front_right"),
        (("R",), "front_left.yml: found no R"),
        (("T",), "front_left.yml: found no T"),
    ],
)
def test_opencv_cameras_without_pose_are_refused_at_import(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], lacking: tuple[str, ...], sentence: str
) -> None:
    folder = session(tmp_path / "s")
    files = []
    for name, text in camera_texts(cameras_of(1.0), "opencv").items():
        blocks = text.split("\n")
        for key in lacking:
            start = next(k for k, line in enumerate(blocks) if line.startswith(f"{key}:"))
            end = next((k for k in range(start + 1, len(blocks)) if not blocks[k].startswith(" ")), len(blocks))
            blocks = blocks[:start] + blocks[end:]
        (tmp_path / name).write_text("\n".join(blocks))
        files.append(str(tmp_path / name))
    capsys.readouterr()
    assert main.run(["import-cameras", str(folder), *files]) == 3
    assert sentence in capsys.readouterr().err
    assert not (folder / "cameras.json").exists()


def test_edited_cameras_json_is_refused_before_matching(tmp_path: Path) -> None:
    """The file in the session is checked as well: it may have been written by hand."""
    from mammometry import open_session

    folder = session(tmp_path / "s")
    (folder / "cameras.json").write_text(camera_texts(cameras_of(1e-3), "json")["cameras.json"])
    with pytest.raises(MammometryError, match=r"^cameras\.json: t: .* m\b"):
        open_session(folder).plan[calibrate.cameras]()


@pytest.mark.parametrize(("factor", "fits"), [(1e-3, "m"), (0.1, "cm")])
@pytest.mark.requirement("R-UNIT-1")
def test_a_mesh_in_another_unit_is_refused_with_the_one_that_fits(tmp_path: Path, factor: float, fits: str) -> None:
    trunk = dome(sink_mm=10.0, rings=6, around=20)
    write_ply(tmp_path / "scan.ply", replace(trunk, vertices=trunk.vertices * factor * 0.9))
    with pytest.raises(SessionError, match=rf"--units: .*\b{fits} \(\d+ mm\)"):
        read_foreign(tmp_path / "scan.ply", "mm")


def test_a_measured_wall_in_metres_is_refused(tmp_path: Path) -> None:
    from mammometry.io.session import Session

    folder = session(tmp_path / "s")
    wall = dome(sink_mm=10.0, rings=6, around=20)
    write_ply(folder / "wall.ply", replace(wall, vertices=wall.vertices * 1e-3))
    with pytest.raises(SessionError, match=r"^wall\.ply: .* mm"):
        Session.open(folder).inputs()
