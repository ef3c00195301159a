"""Camera files of other programs, against OpenCV's writer, COLMAP's documentation and third-party calibrations."""

import json
import re
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml
from scipy.spatial.transform import Rotation

from mammometry.base.errors import SessionError
from mammometry.geometry.camera import Camera
from mammometry.geometry.transform import Transform
from mammometry.io.cameras.formats import CameraFormat, camera_texts, import_cameras
from mammometry.io.cameras.own import cameras_from_table, cameras_table, read_cameras, read_priors

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
        ("front_left.yml", "%YAML:1.0\n---\nimage_width: 5\nimage_height: 4\n", "matrix"),
        ("front_left.yml", "yaml", "front_left.yml"),
        ("front_left.obj", "", "unknown"),
        ("cameras.txt", COLMAP_CAMERAS, "COLMAP"),
        ("cameras.json", "{}", "table"),
        ("cameras.json", '{"cameras": {"a": {"K": 1}}}', "no R, dist, image_size, t"),
        ("cameras.json", "{", r"JSON"),
    ],
)
def test_unfit_files_are_named(tmp_path: Path, name: str, text: str, said: str) -> None:
    (tmp_path / name).write_text(text)
    with pytest.raises(SessionError, match=said):
        import_cameras([tmp_path / name], PAIR)


def test_unknown_colmap_model_is_named(tmp_path: Path) -> None:
    paths = colmap(tmp_path)
    paths[0].write_text("1 FOV 1126 750 2018 2019 570 373 0.9\n")
    with pytest.raises(SessionError, match="FOV"):
        import_cameras(paths, PAIR)


def test_a_lens_of_more_terms_than_ours_is_refused() -> None:
    table = cameras_table({"a": camera("a")})
    table["cameras"]["a"]["dist"] = [0.1, 0, 0, 0, 0, 0.2, 0, 0]
    with pytest.raises(SessionError, match=r"\b8 .*coefficients"):
        cameras_from_table(table, "cameras.json")


# --- cameras for other programs ---
# Oracles: each format's own documented formula, read from the text that was written by a plain parser.

POINTS = np.array([[10.0, -20.0, 30.0], [-80.0, 60.0, -40.0], [55.0, 70.0, 90.0]])


def rig_cameras(k3: float = 0.0) -> dict[str, Camera]:
    left = replace(camera("front_left"), distortion=np.array([*DIST[:4], k3]))
    aside = Transform(
        rotation=Rotation.from_rotvec([0.02, 0.3, -0.1]).as_matrix(), translation_mm=np.array([-240, 3, 40.0])
    )
    right = replace(left, name="front_right", camera_from_world=aside @ left.camera_from_world)
    return {"front_left": left, "front_right": right}


def written(folder: Path, texts: dict[str, str]) -> list[Path]:
    for name, text in texts.items():
        (folder / name).write_text(text)
    return [folder / name for name in texts]


@pytest.mark.parametrize("form", ["json", "opencv", "colmap"])
@pytest.mark.parametrize("k3", [0.0, 0.02])
def test_what_is_exported_is_imported_again(tmp_path: Path, form: CameraFormat, k3: float) -> None:
    cameras = rig_cameras(k3)
    again = import_cameras(written(tmp_path, camera_texts(cameras, form)), PAIR)
    for name in cameras:
        assert_same(again[name], cameras[name], atol=1e-9)


def test_kalibr_keeps_all_but_the_world(tmp_path: Path) -> None:
    cameras = rig_cameras()
    again = import_cameras(written(tmp_path, camera_texts(cameras, "kalibr")), PAIR)
    np.testing.assert_array_equal(again["front_left"].camera_from_world.matrix, np.eye(4))
    for name in cameras:
        in_first = replace(
            cameras[name],
            camera_from_world=cameras[name].camera_from_world @ cameras["front_left"].camera_from_world.inverse(),
        )
        assert_same(again[name], in_first, atol=1e-9)


def test_exported_opencv_cameras_project_as_opencv_says(tmp_path: Path) -> None:
    cameras = rig_cameras(0.02)
    for path in written(tmp_path, camera_texts(cameras, "opencv")):
        storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_READ)
        matrix, lens, r, t = (storage.getNode(n).mat() for n in ("camera_matrix", "distortion_coefficients", "R", "T"))
        size = storage.getNode("image_width").real(), storage.getNode("image_height").real()
        storage.release()
        uv, _ = cv2.projectPoints(POINTS, cv2.Rodrigues(r)[0], t, matrix, lens)
        np.testing.assert_allclose(uv.reshape(-1, 2), cameras[path.stem].project(POINTS), atol=1e-8)
        assert size == (1126, 750)


@pytest.mark.parametrize("k3", [0.0, 0.02])
def test_exported_colmap_cameras_project_as_colmap_documents(k3: float) -> None:
    """colmap.github.io/cameras: OPENCV and FULL_OPENCV; the upper left corner of the image is (0, 0)."""
    cameras = rig_cameras(k3)
    texts = camera_texts(cameras, "colmap")
    lenses = {line.split()[0]: line.split()[1:] for line in texts["cameras.txt"].splitlines() if line[0] != "#"}
    poses = [line.split() for line in texts["images.txt"].splitlines()[1::2]]
    assert [pose[9] for pose in poses] == ["front_left.jpg", "front_right.jpg"]
    for pose in poses:
        w, x, y, z, *t = map(float, pose[1:8])
        rotation = np.array(
            [
                [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
                [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
                [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
            ]
        )
        model, width, height, *values = lenses[pose[8]]
        assert (model, width, height) == ("FULL_OPENCV" if k3 else "OPENCV", "1126", "750")
        fx, fy, cx, cy, k1, k2, p1, p2, *rest = map(float, values)
        k3_read, *none = rest or [0.0]
        assert none == [0.0] * (3 if k3 else 0)
        for point in POINTS:
            a, b, c = rotation @ point + t
            u, v = a / c, b / c
            r2 = u * u + v * v
            radial = 1 + k1 * r2 + k2 * r2**2 + k3_read * r2**3
            du = u * radial + 2 * p1 * u * v + p2 * (r2 + 2 * u * u)
            dv = v * radial + 2 * p2 * u * v + p1 * (r2 + 2 * v * v)
            corner_based = np.array([fx * du + cx, fy * dv + cy])
            ours = cameras[pose[9].removesuffix(".jpg")].project(point[None])[0]
            np.testing.assert_allclose(corner_based - 0.5, ours, atol=1e-8)


def test_exported_kalibr_chain_projects_as_kalibr_documents() -> None:
    """github.com/ethz-asl/kalibr/wiki/yaml-formats: T_cn_cnm1 in metres, radtan, intrinsics fu fv pu pv."""
    cameras = rig_cameras()
    chain = yaml.safe_load(camera_texts(cameras, "kalibr")["camchain.yaml"])
    assert list(chain) == ["cam0", "cam1"]
    assert "T_cn_cnm1" not in chain["cam0"]
    first_m = cameras["front_left"].camera_from_world.apply(POINTS) / 1000.0
    second_m = first_m @ np.array(chain["cam1"]["T_cn_cnm1"])[:3, :3].T + np.array(chain["cam1"]["T_cn_cnm1"])[:3, 3]
    for entry, points_m in ((chain["cam0"], first_m), (chain["cam1"], second_m)):
        assert (entry["camera_model"], entry["distortion_model"]) == ("pinhole", "radtan")
        assert entry["resolution"] == [1126, 750]
        fu, fv, pu, pv = entry["intrinsics"]
        k1, k2, r1, r2 = entry["distortion_coeffs"]
        x, y = (points_m[:, :2] / points_m[:, 2:]).T
        mx2, my2, mxy = x * x, y * y, x * y
        rho2 = mx2 + my2
        radial = k1 * rho2 + k2 * rho2 * rho2
        dx = x + x * radial + 2 * r1 * mxy + r2 * (rho2 + 2 * mx2)
        dy = y + y * radial + 2 * r2 * mxy + r1 * (rho2 + 2 * my2)
        uv = np.stack([fu * dx + pu, fv * dy + pv], axis=1)
        name = entry["rostopic"].strip("/").split("/")[0]
        np.testing.assert_allclose(uv, cameras[name].project(POINTS), atol=1e-8)


KALIBR = """\
cam0:
  cam_overlaps: [1]
  camera_model: pinhole
  distortion_coeffs: [-0.05, 0.1, 0.0003, -0.0002]
  distortion_model: radtan
  intrinsics: [461.629, 460.152, 362.680, 246.049]
  resolution: [752, 480]
  rostopic: /front_left/image_raw
cam1:
  T_cn_cnm1:
  - [0.99998, -0.0062, 0.0012, -0.11]
  - [0.0062, 0.99998, 0.0001, 0.0004]
  - [-0.0012, -0.0001, 0.9999993, -0.0006]
  - [0.0, 0.0, 0.0, 1.0]
  camera_model: pinhole
  distortion_coeffs: [-0.05, 0.1, 0.0003, -0.0002]
  distortion_model: radtan
  intrinsics: [460.0, 459.0, 380.0, 255.0]
  resolution: [752, 480]
  rostopic: /front_right/image_raw
"""


def test_kalibr_file_as_kalibr_writes_it(tmp_path: Path) -> None:
    path = tmp_path / "camchain.yaml"
    path.write_text(KALIBR)
    cameras = import_cameras([path], PAIR)
    assert list(cameras) == ["front_left", "front_right"]
    assert cameras["front_left"].matrix[0].tolist() == [461.629, 0.0, 362.680]
    assert cameras["front_right"].camera_from_world.translation_mm.tolist() == [-110.0, 0.4, -0.6]
    assert cameras["front_right"].size_wh == (752, 480)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (("radtan", "equidistant"), "equidistant"),
        (("pinhole", "omni"), "radtan"),
        (("T_cn_cnm1", "T_cam_imu"), "no T_cn_cnm1"),
        (("intrinsics: [460.0, 459.0, 380.0, 255.0]", "intrinsics: [460.0]"), "invalid"),
        (("front_right", "front_left"), "called front_left"),
        (("- [0.99998,", "- [0.5,"), "T_cn_cnm1"),
        (("resolution", "size"), "resolution"),
        (("cam0:", "cam0: ["), "parsed"),
    ],
)
def test_unfit_kalibr_files_are_named(tmp_path: Path, change: tuple[str, str], said: str) -> None:
    path = tmp_path / "camchain.yaml"
    path.write_text(KALIBR.replace(*change))
    with pytest.raises(SessionError, match=re.escape(said)):
        import_cameras([path], PAIR)


def test_lens_that_a_format_cannot_tell_is_refused() -> None:
    with pytest.raises(SessionError, match=r"front_left: found k3 = 0.02, expected k1, k2, p1, p2 only"):
        camera_texts(rig_cameras(0.02), "kalibr")


def test_rational_colmap_lens_is_refused(tmp_path: Path) -> None:
    paths = colmap(tmp_path)
    paths[0].write_text("1 FULL_OPENCV 1126 750 2018 2019 570 373 -0.05 0.1 0 0 0.01 0.2 0 0\n")
    with pytest.raises(SessionError, match="FULL_OPENCV with k4, k5 or k6"):
        import_cameras(paths, PAIR)


def test_a_file_with_a_mark_of_utf_8_is_read(tmp_path: Path) -> None:
    path = tmp_path / "prior.json"
    path.write_bytes(b"\xef\xbb\xbf" + json.dumps(cameras_table({"front_left": camera()})).encode())
    assert set(read_priors(path)) == {"front_left"}
