"""Camera files of other programs, against OpenCV's writer, COLMAP's documentation and third-party calibrations."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from mammometry.errors import SessionError
from mammometry.geometry.camera import Camera
from mammometry.geometry.transform import Transform
from mammometry.io.cameras import cameras_from_table, cameras_table, import_cameras, read_cameras

PAIR = {"front": ("front_left", "front_right")}
K = np.array([[2018.25, 0, 570.3], [0, 2019.5, 373.2], [0, 0, 1.0]])
DIST = np.array([-0.047, 0.18, -3e-4, 1.3e-4, 0.02])
R = Rotation.from_rotvec([0.1, -0.3, 2.0]).as_matrix()
T = np.array([-12.5, 3.25, 783.5])


def camera(name: str = "front_left") -> Camera:
    return Camera(
        name=name,
        size_wh=(1126, 750),
        matrix=K,
        distortion=DIST,
        camera_from_world=Transform(rotation=R, translation_mm=T),
    )


def assert_same(a: Camera, b: Camera, atol: float = 0.0) -> None:
    assert (a.name, a.size_wh) == (b.name, b.size_wh)
    for one, other in (
        (a.matrix, b.matrix),
        (a.distortion, b.distortion),
        (a.camera_from_world.matrix, b.camera_from_world.matrix),
    ):
        np.testing.assert_allclose(one, other, rtol=0, atol=atol)


def test_own_format_keeps_every_digit(tmp_path: Path) -> None:
    path = tmp_path / "cameras.json"
    path.write_text(json.dumps(cameras_table({"front_left": camera()}, {"front_left": {"fx_px": 0.1}})))
    assert_same(read_cameras(path)["front_left"], camera())
    assert json.loads(path.read_text())["cameras"]["front_left"]["std"] == {"fx_px": 0.1}


@pytest.mark.parametrize("ending", ["yml", "xml"])
@pytest.mark.parametrize("vector", [True, False], ids=["rodrigues", "matrix"])
def test_opencv_file_storage(tmp_path: Path, ending: str, vector: bool) -> None:
    path = tmp_path / f"front_left.{ending}"
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    storage.write("image_width", 1126)
    storage.write("image_height", 750)
    storage.write("camera_matrix", K)
    storage.write("distortion_coefficients", DIST.reshape(5, 1))
    storage.write("R", cv2.Rodrigues(R)[0] if vector else R)
    storage.write("T", T.reshape(3, 1))
    storage.release()
    assert_same(import_cameras([path], PAIR)["front_left"], camera(), atol=1e-9)


def test_opencv_stereo_file_makes_the_left_camera_the_world(tmp_path: Path) -> None:
    path = tmp_path / "rig.yml"
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    storage.write("image_size", np.array([[1126.0, 750.0]]))
    for name, value in {"M1": K, "D1": DIST, "M2": K, "D2": DIST, "R": R, "T": T}.items():
        storage.write(name, value)
    storage.release()
    cameras = import_cameras([path], PAIR)
    np.testing.assert_array_equal(cameras["front_left"].camera_from_world.matrix, np.eye(4))
    assert_same(cameras["front_right"], camera("front_right"), atol=1e-12)


@pytest.mark.data
def test_opencv_sample(shared_data: Path) -> None:
    (found,) = import_cameras([shared_data / "opencv_samples" / "left_intrinsics.yml"], PAIR).values()
    assert found.size_wh == (640, 480)
    assert found.matrix[0, 0] == pytest.approx(535.91573396163199)
    assert found.distortion[0] == pytest.approx(-0.26637260909660682)


COLMAP_CAMERAS = """\
# Camera list with one line of data per camera:
#   CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]
1 OPENCV 1126 750 2018.25 2019.5 570.8 373.7 -0.047 0.18 -0.0003 0.00013
2 SIMPLE_RADIAL 1126 750 2000 563 375 -0.05
"""
# COLMAP: the origin is the upper left corner of the image, so pixel centres lie at halves.


def colmap(tmp_path: Path) -> list[Path]:
    x, y, z, w = Rotation.from_matrix(R).as_quat()
    images = f"# IMAGE_ID, QW, …, NAME\n1 {w} {x} {y} {z} -12.5 3.25 783.5 1 front_left.jpg\n"
    images += "100.5 200.5 -1 3 4 7\n2 1 0 0 0 0 0 0 2 rig/front_right.png\n\n"
    (tmp_path / "cameras.txt").write_text(COLMAP_CAMERAS)
    (tmp_path / "images.txt").write_text(images)
    return [tmp_path / "cameras.txt", tmp_path / "images.txt"]


def test_colmap_text(tmp_path: Path) -> None:
    cameras = import_cameras(colmap(tmp_path), PAIR)
    expected = cameras_from_table(cameras_table({"front_left": camera()}), "")["front_left"]
    np.testing.assert_allclose(cameras["front_left"].matrix, expected.matrix, atol=1e-9)
    np.testing.assert_allclose(cameras["front_left"].distortion[:4], DIST[:4])
    np.testing.assert_allclose(cameras["front_left"].camera_from_world.rotation, R, atol=1e-12)
    assert cameras["front_right"].matrix[0, 2] == 562.5
    np.testing.assert_array_equal(cameras["front_right"].distortion, [-0.05, 0, 0, 0, 0])


@pytest.mark.parametrize(
    ("name", "text", "said"),
    [
        ("front_left.yml", "%YAML:1.0\n---\nimage_width: 5\nimage_height: 4\n", "no camera matrix"),
        ("front_left.yml", "not yaml at all: [", "front_left.yml"),
        ("front_left.obj", "", "a file of unknown kind"),
        ("cameras.txt", COLMAP_CAMERAS, "part of a COLMAP model"),
        ("cameras.json", "{}", "no table of cameras"),
        ("cameras.json", '{"cameras": {"a": {"K": 1}}}', "no R, dist, image_size, t"),
        ("cameras.json", "{", "cannot be read"),
    ],
)
def test_unfit_files_are_named(tmp_path: Path, name: str, text: str, said: str) -> None:
    (tmp_path / name).write_text(text)
    with pytest.raises(SessionError, match=said):
        import_cameras([tmp_path / name], PAIR)


def test_unknown_colmap_model_is_named(tmp_path: Path) -> None:
    paths = colmap(tmp_path)
    paths[0].write_text("1 FOV 1126 750 2018 2019 570 373 0.9\n")
    with pytest.raises(SessionError, match="camera model FOV"):
        import_cameras(paths, PAIR)


def test_a_lens_of_more_terms_than_ours_is_refused() -> None:
    table = cameras_table({"a": camera("a")})
    table["cameras"]["a"]["dist"] = [0.1, 0, 0, 0, 0, 0.2, 0, 0]
    with pytest.raises(SessionError, match="8 distortion coefficients"):
        cameras_from_table(table, "cameras.json")
