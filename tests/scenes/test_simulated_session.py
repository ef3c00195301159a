"""A virtual session is a whole session, and its truth is true."""

import json
import signal
import subprocess
import sys
import tomllib
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import tifffile
import trimesh
from filelock import FileLock
from PIL import Image

from mammometry.base.errors import SessionError, StorageError
from mammometry.base.new_folder import whole_folder
from mammometry.calibration.targets.kinds.charuco import charuco_board
from mammometry.calibration.targets.table import target_from_table
from mammometry.geometry.camera import Camera
from mammometry.geometry.nearest import closest_on_mesh
from mammometry.geometry.transform import Transform
from mammometry.io.photographs.images import read_photograph
from mammometry.simulate import studio
from mammometry.simulate.recipe import SessionRecipe
from mammometry.simulate.rendering.film import Film
from mammometry.simulate.rendering.render import subject_coverage
from mammometry.simulate.rendering.skin import make_skin
from mammometry.simulate.rigs.targets import make_target
from mammometry.simulate.session import SimulatedSession, true_volumes_cc, write_session
from mammometry.simulate.studio import Studio
from mammometry.simulate.subjects.shapes import sphere
from mammometry.simulate.subjects.user_mesh import MeshFile

_RECIPE = SessionRecipe(rig="reference:front,left", subject="plaster_3", scale=0.1, seed=4, poses=3)


@pytest.fixture(scope="module")
def made(tmp_path_factory) -> SimulatedSession:
    fractions: list[float] = []
    session = write_session(tmp_path_factory.mktemp("virtual") / "session", _RECIPE, progress=fractions.append)
    assert fractions == sorted(fractions)
    assert fractions[-1] == 1.0
    return session


def _files(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}


def _true_cameras(folder: Path) -> dict[str, Camera]:
    table = json.loads((folder / "truth" / "cameras.json").read_text())
    return {
        name: Camera(
            name=name,
            size_wh=tuple(camera["image_size"]),
            matrix=np.array(camera["K"]),
            distortion=np.array(camera["dist"]),
            camera_from_world=Transform(rotation=np.array(camera["R"]), translation_mm=np.array(camera["t"])),
        )
        for name, camera in table["cameras"].items()
    }


def test_folder_is_complete_and_as_documented(made):
    manifest = tomllib.loads((made.folder / "session.toml").read_text())
    assert (manifest["format"], manifest["units"]) == (1, "mm")
    assert manifest["subject"] == {"kind": "model", "rim_radius_mm": 0.0}
    assert [pair["name"] for pair in manifest["rig"]["pairs"]] == ["front", "left"]
    target = target_from_table(manifest["target"])
    assert (target.squares, target.square_mm, target.marker_mm) == ((14, 10), 25.0, 18.0)
    cameras = {pair[side] for pair in manifest["rig"]["pairs"] for side in ("left", "right")}
    assert {path.stem for path in (made.folder / "capture").iterdir()} == cameras
    poses = sorted(path.name for path in (made.folder / "calibration").iterdir())
    assert poses == ["00", "01", "02"]
    assert {path.stem for path in (made.folder / "calibration" / "00").iterdir()} == cameras
    for path in made.folder.rglob("*.jpg"):
        with Image.open(path) as image:
            assert (image.size, image.mode) == ((450, 300), "RGB")
    assert not [path for path in made.folder.parent.iterdir() if path != made.folder]  # nothing left over


def test_truth_agrees_with_itself(made):
    truth = json.loads((made.folder / "truth" / "truth.json").read_text())
    mesh = trimesh.load(made.folder / "truth" / "mesh.ply", process=False)
    assert mesh.is_watertight
    assert mesh.volume / 1000.0 == pytest.approx(truth["volume_cc"], rel=1e-6)
    assert truth["volumes_cc"] == made.true_volumes_cc == {"model": truth["volume_cc"]}
    assert truth["area_mm2"] == pytest.approx(mesh.area, rel=1e-6)
    boundary = np.loadtxt(made.folder / "truth" / "boundary_base.xyz")
    steps = np.linalg.norm(np.roll(boundary, -1, axis=0) - boundary, axis=1)
    assert steps.max() < 3.0  # in order, and closed
    near = trimesh.proximity.ProximityQuery(mesh).vertex(boundary)[0]
    assert near.max() < 1e-3


def test_written_cameras_are_the_rigs(made):
    points = np.random.default_rng(0).uniform(-60.0, 60.0, (20, 3))
    for name, camera in _true_cameras(made.folder).items():
        assert camera.project(points) == pytest.approx(made.rig.cameras[name].project(points), abs=1e-9)


@pytest.mark.slow
def test_board_stands_where_the_truth_says(made):
    # OpenCV finds the board's corners in the written pictures; the truth projects them. JPEG, noise and OpenCV's own
    # scatter (0.13–0.16 px RMS at this kind of board) leave a small mean.
    boards = json.loads((made.folder / "truth" / "boards.json").read_text())["rig_from_board"]
    first = np.array(json.loads((made.folder / "truth" / "cameras.json").read_text())["rig_from_board0"])
    assert np.array_equal(first, np.array(boards["00"]))
    target = target_from_table(tomllib.loads((made.folder / "session.toml").read_text())["target"])
    detector = cv2.aruco.CharucoDetector(charuco_board(target))
    errors = []
    for pose, matrix in boards.items():
        points = Transform.from_matrix(np.array(matrix)).apply(target.points_target)
        for name, camera in _true_cameras(made.folder).items():
            path = made.folder / "calibration" / pose / f"{name}.jpg"
            if not path.exists():
                continue
            # Four times the size: at a tenth of the rig's the markers' bits are two pixels.
            image = np.asarray(Image.open(path).convert("L").resize((1800, 1200), Image.Resampling.BICUBIC))
            corners, ids, _, _ = detector.detectBoard(image)
            if ids is None or len(ids) < 8:
                continue
            uv = (np.asarray(corners).reshape(-1, 2) + 0.5) / 4.0 - 0.5
            errors.append(uv - camera.project(points)[np.ravel(ids)])
    error = np.concatenate(errors)
    assert len(error) > 150
    assert np.abs(np.median(error, axis=0)).max() < 0.03
    assert np.median(np.linalg.norm(error, axis=1)) < 0.2


def test_subject_stands_where_the_truth_says(made):
    for name, camera in _true_cameras(made.folder).items():
        coverage = subject_coverage(made.scene, camera, samples=4)
        picture = np.asarray(Image.open(made.folder / "capture" / f"{name}.jpg"), dtype=np.float64)
        red = picture[..., 0] - picture[..., 2]  # the paint is reddish, the backdrop grey
        bright = red > 20.0
        assert (bright & (coverage > 0.5)).sum() / (bright | (coverage > 0.5)).sum() > 0.97


@pytest.mark.slow
def test_same_seed_same_bytes_other_seed_other_rig(tmp_path):
    small = replace(_RECIPE, scale=0.03, poses=1)
    one, again = (write_session(tmp_path / name, small) for name in ("one", "again"))
    assert _files(again.folder) == _files(one.folder)
    other = write_session(tmp_path / "other", replace(small, seed=5))
    capture = "capture/front_left.jpg"
    assert _files(other.folder)[capture] != _files(one.folder)[capture]


@pytest.mark.slow
def test_png_and_other_subjects(tmp_path):
    session = write_session(
        tmp_path / "ball",
        SessionRecipe(rig="reference:front", subject="sphere", scale=0.05, poses=1),
        Studio(image_format="png"),
    )
    assert (session.folder / "capture" / "front_left.png").exists()
    assert tomllib.loads((session.folder / "session.toml").read_text())["subject"] == {"kind": "surface"}
    assert not (session.folder / "truth" / "boundary_base.xyz").exists()
    assert session.true_volumes_cc["model"] == pytest.approx(4.0 / 3.0 * np.pi * 6.0**3, rel=5e-3)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("subject", "kind"), [("plate", "surface"), ("cylinder", "surface"), ("plaster", "model"), ("plaster_8", "model")]
)
def test_every_kind_of_subject_is_photographed(tmp_path, subject, kind):
    session = write_session(
        tmp_path / "out", SessionRecipe(rig="reference:front", subject=subject, scale=0.03, poses=1)
    )
    assert tomllib.loads((session.folder / "session.toml").read_text())["subject"] == (
        {"kind": "model", "rim_radius_mm": 0.0} if kind == "model" else {"kind": kind}
    )
    mesh = trimesh.load(session.folder / "truth" / "mesh.ply", process=False)
    assert mesh.volume / 1000.0 == pytest.approx(session.true_volumes_cc["model"], rel=1e-6)
    with Image.open(session.folder / "capture" / "front_left.jpg") as image:
        bright = (np.asarray(image).max(axis=2) > 60).mean()
    assert 0.01 < bright < 0.9


@pytest.mark.parametrize("ending", ["ply", "obj", "stl"])
def test_a_mesh_from_a_file_is_photographed(tmp_path, ending):
    trimesh.creation.icosphere(subdivisions=4, radius=5.0).export(tmp_path / f"ball.{ending}")
    session = write_session(
        tmp_path / "out",
        SessionRecipe(
            rig="reference:front",
            subject=str(tmp_path / f"ball.{ending}"),
            scale=0.03,
            poses=1,
            mesh_file=MeshFile(mm_per_unit=10.0),
        ),
    )
    assert session.true_volumes_cc["model"] == pytest.approx(4.0 / 3.0 * np.pi * 5.0**3, rel=5e-3)
    kind = tomllib.loads((session.folder / "session.toml").read_text())["subject"]["kind"]
    assert kind == "model"


@pytest.mark.slow
def test_sixteen_bits_say_more_than_eight(tmp_path):
    film = Film(electrons=1e9, read_noise=0.0, blur_px=0.0)
    recipe = SessionRecipe(rig="reference:front", subject="sphere", scale=0.04, poses=1)
    read = {}
    for ending in ("tif", "png"):
        studio_ = Studio(image_format=ending, film=film)
        folder = write_session(tmp_path / ending, recipe, studio_).folder
        read[ending] = read_photograph(folder / "capture" / f"front_left.{ending}", "front_left")
    assert (read["tif"].pixels.dtype, read["png"].pixels.dtype) == (np.uint16, np.uint8)
    # The same picture: rounded to eight bits they differ by the roundings alone.
    assert np.abs(read["tif"].pixels / 257.0 - read["png"].pixels).max() < 0.51
    assert len(np.unique(read["tif"].pixels)) > 4 * len(np.unique(read["png"].pixels))


def test_nothing_there_is_overwritten(tmp_path):
    (tmp_path / "patient").mkdir()
    (tmp_path / "patient" / "notes.txt").write_text("mine")
    with pytest.raises(SessionError, match="something there already"):
        write_session(tmp_path / "patient", _RECIPE)
    assert (tmp_path / "patient" / "notes.txt").read_text() == "mine"


@pytest.mark.parametrize("wrong", [{"rig": "teapot"}, {"subject": "teapot"}, {"scale": 3.0}, {"poses": 0}])
def test_wrong_argument_is_one_sentence(tmp_path, wrong):
    with pytest.raises(SessionError, match="found"):
        write_session(tmp_path / "out", replace(_RECIPE, **wrong))
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
def test_interrupted_leaves_nothing(tmp_path):
    def stop(fraction: float) -> None:
        if fraction > 0.3:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_session(tmp_path / "out", replace(_RECIPE, scale=0.03), progress=stop)
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
def test_place_that_cannot_be_written_is_one_sentence(tmp_path):
    (tmp_path / "file").write_text("not a folder")
    with pytest.raises(StorageError, match="space"):
        write_session(tmp_path / "file" / "out", _RECIPE)


@pytest.mark.slow
def test_full_disk_is_one_sentence_and_leaves_nothing(tmp_path, monkeypatch):
    def full(self: Image.Image, path: Path, **options: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Image.Image, "save", full)
    with pytest.raises(StorageError, match=r"(?i:space) left"):
        write_session(tmp_path / "out", replace(_RECIPE, scale=0.03))
    assert not list(tmp_path.iterdir())


def test_depth_is_the_distance_to_the_true_surface(made):
    for name, camera in _true_cameras(made.folder).items():
        with tifffile.TiffFile(made.folder / "truth" / "depth" / f"{name}.tif") as tiff:
            depth, valid = (page.asarray() for page in tiff.pages)
        assert (depth.dtype, depth.shape) == (np.float32, (300, 450))
        row, column = (index[::37] for index in np.nonzero(valid))
        uv = np.stack([column, row], axis=1).astype(np.float64)
        seen = subject_coverage(made.scene, camera, samples=4)
        assert ((seen > 0.5) == (valid > 0)).mean() > 0.997
        # Straight on: a point of that depth on the pixel's ray lies on the true mesh, to what float32 rays can tell.
        z = depth[row, column].astype(np.float64)
        normalised = camera.normalised_from_pixels(uv)
        points = camera.camera_from_world.inverse().apply(np.column_stack([normalised, np.ones(len(z))]) * z[:, None])
        assert closest_on_mesh(points, made.scene.subject).distances_mm.max() < 5e-3


@pytest.mark.slow
def test_torso_has_the_truth_of_both_breasts(tmp_path):
    session = write_session(
        tmp_path / "torso", SessionRecipe(rig="reference:front", subject="torso_1", scale=0.05, seed=2, poses=1)
    )
    truth = session.folder / "truth"
    true_values = json.loads((truth / "truth.json").read_text())
    assert tomllib.loads((session.folder / "session.toml").read_text())["subject"] == {"kind": "torso"}
    body = trimesh.load(truth / "mesh.ply", process=False)
    assert body.is_watertight
    marks = json.loads((truth / "landmarks.json").read_text())["landmarks"]
    for side in ("left", "right"):
        breast = trimesh.load(truth / f"breast_{side}.ply", process=False)
        assert breast.is_watertight
        assert breast.volume / 1000.0 == pytest.approx(true_values["volumes_cc"][side], rel=1e-6)
        boundary = np.loadtxt(truth / f"boundary_{side}.xyz")
        wall = trimesh.load(truth / f"wall_{side}.ply", process=False)
        for surface in (body, wall):  # the boundary lies on the skin and on the wall; it is written to 0.1 µm
            assert trimesh.proximity.ProximityQuery(surface).vertex(boundary)[0].max() < 1e-3
        assert trimesh.proximity.ProximityQuery(body).vertex(np.array(marks[f"nipple_{side}"]))[0].max() < 3.0
        rim = wall.edges_sorted[trimesh.grouping.group_rows(wall.edges_sorted, require_count=1)]
        assert len(rim) == len(boundary)


def test_killed_simulation_leaves_nothing_for_long(tmp_path):
    def workplace(name, says):
        (tmp_path / name / "made" / "capture").mkdir(parents=True)
        if says:
            (tmp_path / name / "maker.json").write_text(json.dumps({"workplace of mammometry": says, "for": "out"}))
        return tmp_path / name

    left = workplace(".out.making-killed", ".out.making-killed")  # what a killed process leaves: no lock on it
    kept = [
        workplace(".out.making-busy", ".out.making-busy"),
        workplace(".out.making-copied", ".out.making-killed"),
        workplace(".out.making-deep", "DEEP"),
        workplace(".out.making-mine", None),  # somebody's own, by chance of such a name
        workplace(".out.simulated", ".out.simulated"),
    ]
    deep = kept[2] / "maker.json"
    deep.write_text(deep.read_text().replace('"DEEP"', "[" * 100_000))
    with FileLock(kept[0] / ".lock"), whole_folder(tmp_path / "out") as folder:
        (folder / "file").touch()
        assert not left.exists()
    assert sorted(tmp_path.iterdir()) == [*kept, tmp_path / "out"]
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["file"]


def test_what_has_taken_the_place_meanwhile_is_left_alone(tmp_path):
    def make():
        with whole_folder(tmp_path / "out"):
            (tmp_path / "out").mkdir()
            (tmp_path / "out" / "mine").touch()

    with pytest.raises(OSError, match="empty"):
        make()
    assert [path.relative_to(tmp_path).as_posix() for path in tmp_path.rglob("*")] == ["out", "out/mine"]


@pytest.mark.slow
def test_killed_in_the_middle_and_started_again(tmp_path):
    code = (
        "import os, sys, pathlib; from mammometry.simulate.recipe import SessionRecipe\n"
        "from mammometry.simulate.session import write_session\n"
        "write_session(pathlib.Path(sys.argv[1]), SessionRecipe(rig='reference:front', scale=0.02, poses=1),"
        " progress=lambda done: os.kill(os.getpid(), 9) if done > 0.2 else None)"
    )
    ended = subprocess.run([sys.executable, "-c", code, str(tmp_path / "out")], check=False, capture_output=True)
    assert ended.returncode == -signal.SIGKILL, ended.stderr
    assert [path.name.rpartition("-")[0] for path in tmp_path.iterdir()] == [".out.making"]
    write_session(tmp_path / "out", SessionRecipe(rig="reference:front", scale=0.02, poses=1))
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


@pytest.mark.slow
def test_number_of_threads_changes_nothing(tmp_path, monkeypatch):
    recipe = replace(_RECIPE, scale=0.03, poses=1)
    monkeypatch.setattr(studio, "available_cores", lambda: 1)
    alone = write_session(tmp_path / "alone", recipe)
    monkeypatch.setattr(studio, "available_cores", lambda: 4)
    together = write_session(tmp_path / "together", recipe)
    assert _files(alone.folder) == _files(together.folder)


@pytest.mark.slow
@pytest.mark.parametrize(
    "how",
    [
        Studio(skin=make_skin("sweat", hair_per_cm2=1.0), background="clutter", image_format="tif"),
        Studio(skin=make_skin("dark-skin"), film=Film(f_number=4.0, vignetting=0.4, jpeg_quality=60).with_noise(3.0)),
        Studio(target=make_target("frame"), skin=make_skin("plaster", contrast=0.01), image_format="png"),
    ],
    ids=["sweat-hair-clutter", "unsharp-noisy", "frame"],
)
def test_number_of_threads_changes_nothing_whatever_is_photographed(tmp_path, monkeypatch, how):
    recipe = SessionRecipe(rig="reference:front", subject="plaster_4", scale=0.03, poses=1, seed=3)
    made_by = {}
    for cores in (1, 3):
        monkeypatch.setattr(studio, "available_cores", lambda cores=cores: cores)
        folder = write_session(tmp_path / str(cores), recipe, how).folder
        made_by[cores] = _files(folder)
    assert made_by[1] == made_by[3]


@pytest.mark.slow
def test_each_camera_is_focused_on_the_middle_of_the_rig(tmp_path):
    recipe = SessionRecipe(rig="reference:front,floor", subject="sphere", scale=0.02, poses=1)
    for folder, given in (("own", None), ("set", 640.0)):
        lens = Studio(film=Film(f_number=4.0, focus_mm=given), target=make_target("frame"))
        session = write_session(tmp_path / folder, recipe, lens)
        true_cameras = json.loads((session.folder / "truth" / "cameras.json").read_text())["cameras"]
        for name, camera in session.rig.cameras.items():
            middle = camera.camera_from_world.apply(np.zeros((1, 3)))[0, 2]
            assert true_cameras[name]["focus_mm"] == pytest.approx(middle if given is None else given)


@pytest.mark.slow
def test_a_given_subject_is_photographed_instead_of_the_recipes(tmp_path: Path) -> None:
    recipe = replace(_RECIPE, rig="reference:front", poses=1)
    ball = sphere(60.0, edge_mm=4.0)
    session = write_session(tmp_path / "ball", recipe, subject=ball, truth=False)
    assert session.true_volumes_cc == pytest.approx(ball.volumes_cc)
    assert tomllib.loads((tmp_path / "ball" / "session.toml").read_text())["subject"]["kind"] == ball.subject_kind
    assert session.scene.subject_faces == len(ball.mesh.faces)


@pytest.mark.slow
def test_rig_from_a_file_is_photographed(tmp_path, repository):
    session = write_session(
        tmp_path / "bench",
        SessionRecipe(rig=str(repository / "examples" / "rig.toml") + ":side", scale=0.05, poses=1, seed=3),
    )
    assert {path.stem for path in (session.folder / "capture").iterdir()} == {"upper", "lower"}
    manifest = tomllib.loads((session.folder / "session.toml").read_text())
    assert manifest["rig"]["pairs"] == [{"name": "side", "left": "upper", "right": "lower"}]
    with Image.open(session.folder / "capture" / "upper.jpg") as image:
        assert image.size == (150, 100)
        assert np.asarray(image).max() > 60  # lit


@pytest.mark.slow
def test_camera_that_never_sees_the_target_is_named(tmp_path, repository):
    right = (repository / "examples" / "rig.toml").read_text()
    (tmp_path / "rig.toml").write_text(right.replace("target_mm = [0, 0, 0]", "target_mm = [0, 900, 0]"))
    with pytest.raises(SessionError, match="camera upper"):
        write_session(tmp_path / "out", SessionRecipe(rig=str(tmp_path / "rig.toml") + ":side", scale=0.05, poses=5))
    assert not (tmp_path / "out").exists()


def test_recipe_alone_gives_the_true_volume(made):
    assert true_volumes_cc(_RECIPE) == made.true_volumes_cc
    lines = (made.folder / "session.toml").read_text().splitlines()
    assert _RECIPE.line in lines
    assert replace(_RECIPE, seed=5).line not in lines
