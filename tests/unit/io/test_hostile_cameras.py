"""Cameras that cannot be, and damaged files of every format: refused in one sentence, and no process dies of them."""

import copy
import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mammometry.base.errors import MammometryError, SessionError
from mammometry.geometry.camera import Camera
from mammometry.geometry.lens import distort, fold_xy, undistort
from mammometry.geometry.transform import Transform
from mammometry.io.cameras.formats import CameraFormat, camera_texts, import_cameras
from mammometry.io.cameras.own import cameras_table, read_cameras, read_priors

PAIR = {"front": ("left", "right")}
K = np.array([[2018.25, 0, 570.3], [0, 2019.5, 373.2], [0, 0, 1.0]])
CAMERA = Camera(
    name="left",
    size_wh=(1126, 750),
    matrix=K,
    distortion=np.array([-0.047, 0.18, -3e-4, 1.3e-4, 0.0]),
    camera_from_world=Transform.from_rotation_vector(np.array([0.1, -0.3, 2.0]), np.array([-12.5, 3.25, 783.5])),
)
CAMERAS = {"left": CAMERA, "right": replace(CAMERA, name="right")}


def own(tmp_path: Path, **changes: Any) -> Path:
    """A cameras.json whose left camera has other values."""
    table = json.loads(json.dumps(cameras_table(CAMERAS)))
    table["cameras"]["left"] |= changes
    path = tmp_path / "cameras.json"
    path.write_text(json.dumps(table))
    return path


def changed(row: int, column: int, value: object) -> list[list[Any]]:
    matrix: list[list[Any]] = copy.deepcopy(K.tolist())
    matrix[row][column] = value
    return matrix


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"K": changed(0, 0, float("nan"))}, "nan"),
        ({"K": changed(1, 2, float("inf"))}, "inf"),
        ({"K": changed(0, 0, 1e300)}, "outside"),
        ({"K": changed(0, 0, -2000.0)}, "positive"),
        ({"K": changed(0, 0, 0.0)}, "positive"),
        ({"K": changed(0, 1, 3.5)}, "cy, 0 0 1"),  # skew
        ({"K": changed(2, 2, 2.0)}, "cy, 0 0 1"),
        ({"K": K.T.tolist()}, "cy, 0 0 1"),
        ({"K": changed(0, 0, 20.0)}, "20 and 2019.5 pixels"),
        ({"K": changed(0, 0, 2e5)}, "200000 and 2019.5 pixels"),
        ({"K": changed(0, 0, 900.0)}, "square"),
        ({"K": changed(0, 2, 57030.0)}, "u 57030, v 373.2"),
        ({"K": changed(0, 0, "2018")}, "'2018'"),
        ({"K": changed(0, 0, True)}, "True"),
        ({"K": [[2018.25, 0], [570.3, 0, 2019.5, 373.2], [0, 0, 1.0]]}, "lengths"),
        ({"K": [1, 2, 3]}, "not 9"),
        ({"K": None}, "None"),
        ({"image_size": [-1126, 750]}, "pixel"),
        ({"image_size": [0, 750]}, "pixel"),
        ({"image_size": [1126.5, 750]}, "whole"),
        ({"image_size": [1126, 750, 3]}, "not 2"),
        ({"image_size": [10**30, 750]}, "digits"),
        ({"image_size": [600_000, 750]}, "65535"),
        ({"image_size": "ab"}, "'ab'"),
        ({"dist": [0.1, 0, 0, 0, float("nan")]}, "nan"),
        ({"dist": [-5.0, 0, 0, 0, 0]}, "93%"),
        ({"R": (-np.eye(3)).tolist()}, "rotation"),
        ({"R": np.diag([1.0, 1.0, -1.0]).tolist()}, "determinant -1"),
        ({"R": np.zeros((3, 3)).tolist()}, "rotation"),
        ({"R": (1.01 * np.eye(3)).tolist()}, "rotation"),
        ({"t": [0.0, 0.0]}, "not 3"),
        ({"t": [0.0, 0.0, 5e6]}, "4.82e+06 mm"),
        ({"t": [0.0, 0.0, [1.0]]}, "lengths"),
    ],
)
@pytest.mark.requirement("R-IN-9")
def test_a_camera_that_cannot_be_is_refused(tmp_path: Path, changes: dict[str, Any], said: str) -> None:
    path = own(tmp_path, **changes)
    for read in (read_cameras, read_priors):
        with pytest.raises(SessionError, match=re.escape(said)) as caught:
            read(path)
        assert str(caught.value).startswith("cameras.json")
        assert "\n" not in str(caught.value)


def test_names_are_a_files_and_stand_there_once(tmp_path: Path) -> None:
    text = own(tmp_path).read_text()
    for name in ("../left", "a/b", "..", "", "a\\\\b", "\\u0000"):
        (tmp_path / "cameras.json").write_text(text.replace('"left"', f'"{name}"', 1))
        with pytest.raises(SessionError, match=r"letters|name"):
            read_cameras(tmp_path / "cameras.json")
    (tmp_path / "cameras.json").write_text(text.replace('"left"', '"right"', 1))
    with pytest.raises(SessionError, match="'right'"):
        read_cameras(tmp_path / "cameras.json")
    for name in ("a.json", "b.json"):
        (tmp_path / name).write_text(text)
    with pytest.raises(SessionError, match=r"\bleft"):
        import_cameras([tmp_path / "a.json", tmp_path / "b.json"], PAIR)


@pytest.mark.parametrize("std", [{"fx_px": -1.0}, {"fx_px": "1"}, {"fx_px": None}, [1.0], 3, {"fx_px": [1.0, 2.0]}])
def test_a_prior_that_is_none(tmp_path: Path, std: object) -> None:
    with pytest.raises(SessionError, match=r"cameras\.json, camera left: .*\bprior"):
        read_priors(own(tmp_path, std=std))


@given(st.tuples(*[st.floats(-2, 2)] * 3))
def test_where_a_lens_folds(radial: tuple[float, float, float]) -> None:
    """Up to its fold a lens is undone; there its slope is zero."""
    k1, k2, k3 = radial
    lens = np.array([k1, k2, 0.0, 0.0, k3])
    fold = fold_xy(lens)
    radii = np.linspace(0.0, 3.0, 4001)
    distorted = distort(np.stack([radii, np.zeros_like(radii)], axis=1), lens)[:, 0]
    growing = np.diff(distorted) > 0
    first = int(np.argmin(growing)) if not growing.all() else None
    if fold == np.inf:
        assert first is None or np.diff(distorted)[first] > -1e-5
    elif first is not None:
        assert fold == pytest.approx(distorted[: first + 1].max(), abs=1e-3)
        inside = np.array([[0.8 * fold, 0.0]])
        undone = undistort(inside, lens)
        if 0 < undone[0, 0] <= radii[first]:
            np.testing.assert_allclose(distort(undone, lens), inside, atol=1e-9)


def written(folder: Path, form: CameraFormat) -> list[Path]:
    texts = camera_texts(CAMERAS, form)
    for name, text in texts.items():
        (folder / name).write_text(text)
    return [folder / name for name in texts]


def refused(paths: list[Path]) -> str:
    with pytest.raises(SessionError) as caught:
        import_cameras(paths, PAIR)
    assert "\n" not in str(caught.value)
    return str(caught.value)


@pytest.mark.parametrize(
    ("file", "old", "new", "said"),
    [
        ("cameras.txt", " 1126 ", " ", "7 parameters"),
        ("cameras.txt", " 1126 ", " wide ", "'wide'"),
        ("cameras.txt", " 1126 ", " -1126 ", "pixel"),
        ("cameras.txt", " 1126 ", " " + "1" * 5000 + " ", "number"),
        ("cameras.txt", "1 OPENCV 1126 750 ", "1 OPENCV 1126 750 1 ", "9 parameters"),
        ("cameras.txt", "1 OPENCV", "OPENCV", "model 1126"),
        ("cameras.txt", "2 OPENCV", "1 OPENCV", "camera 1"),
        ("cameras.txt", "2018.25", "nan", "'nan'"),
        ("cameras.txt", "2018.25", "-2018.25", "positive"),
        ("images.txt", "783.5 1 left", "left", "line"),
        ("images.txt", "783.5 1 left", "inf 1 left", "'inf'"),
        ("images.txt", "783.5 1 left", "783.5 7 left", "camera 7"),
        ("images.txt", "right.jpg", "left.png", "left"),
        ("images.txt", "right.jpg", "again/left.jpg", "left"),
        ("images.txt", "left.jpg\n\n", "left.jpg\n", "points"),
    ],
)
def test_unfit_colmap_lines_are_named(tmp_path: Path, file: str, old: str, new: str, said: str) -> None:
    paths = written(tmp_path, "colmap")
    text = (tmp_path / file).read_text()
    assert old in text
    (tmp_path / file).write_text(text.replace(old, new, 1))
    sentence = refused(paths)
    assert said in sentence
    assert re.match(r"(cameras|images)\.txt[,:] ", sentence)


def test_a_quaternion_of_zeros_is_no_rotation(tmp_path: Path) -> None:
    paths = written(tmp_path, "colmap")
    (tmp_path / "images.txt").write_text("1 0 0 0 0 1 2 3 1 left.jpg\n\n")
    assert "length" in refused(paths)


def test_names_with_blanks_stay_whole(tmp_path: Path) -> None:
    paths = written(tmp_path, "colmap")
    text = (tmp_path / "images.txt").read_text().replace("left.jpg", "my left camera.jpg")
    (tmp_path / "images.txt").write_text(text)
    assert list(import_cameras(paths, PAIR)) == ["my left camera", "right"]


OPENCV = [
    ("rows: 3", "rows: 4", "9 values in a matrix of 4 × 3"),
    ("rows: 3", "rows: 100000\n   cols: 100000", "two values of 'cols'"),
    ("cols: 3", "cols: 100000", "9 values in a matrix of 3 × 100000"),
    ("rows: 3", "rows: -3", "9 values in a matrix of -3 × 3"),
    ("   rows: 3\n", "", "no 'rows'"),
    ("data: [", "data: [ 1., ", "10 values in a matrix of 3 × 3"),
    ("data: [", "data: [ .inf, ", "inf, which is not a number"),
    ("1126", "wide", "'wide' where a number is expected"),
    ("1126", ".nan", "nan is not a finite number"),
    ("1126", "-1126", "at least one pixel"),
    ("image_width: 1126\n", "", "no image_width and image_height"),
]


@pytest.mark.parametrize(("old", "new", "said"), OPENCV)
def test_unfit_opencv_files_are_named(tmp_path: Path, old: str, new: str, said: str) -> None:
    path = written(tmp_path, "opencv")[0]
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))
    sentence = refused([path])
    assert said in sentence
    assert sentence.startswith("left.yml")


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["flow", "block", "xml", "entities", "alias"])
def test_nested_opencv_files_do_not_end_the_process(tmp_path: Path, kind: str) -> None:
    """`cv::FileStorage` dies of the first and third by a segmentation fault."""
    texts = {
        "flow": "%YAML:1.0\n---\na: " + "[" * 200_000,
        "block": "%YAML:1.0\n---\n" + "\n".join(" " * depth + "a:" for depth in range(400)),
        "xml": '<?xml version="1.0"?>\n<opencv_storage>' + "<a>" * 200_000,
        "entities": '<?xml version="1.0"?>\n<!DOCTYPE a [<!ENTITY b "c">]>\n<opencv_storage>&b;</opencv_storage>',
        "alias": "%YAML:1.0\n---\na: &a [1, 1]\nb: &b [*a, *a]\nimage_width: *b\n",
    }
    (tmp_path / "left.yml").write_text(texts[kind])
    assert refused([tmp_path / "left.yml"]).startswith("left.yml: found ")


@pytest.mark.parametrize("ending", ["yml", "xml"])
@pytest.mark.parametrize("keep", [0.1, 0.3, 0.5, 0.7, 0.9])
def test_truncated_opencv_files_are_refused(tmp_path: Path, ending: str, keep: float) -> None:
    path = tmp_path / f"left.{ending}"
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    storage.write("image_width", 1126)
    storage.write("image_height", 750)
    storage.write("camera_matrix", K)
    storage.write("distortion_coefficients", CAMERA.distortion)
    storage.release()
    whole = path.read_text()
    assert import_cameras([path], PAIR)
    path.write_text(
        whole[: whole.index("<data>") + 60] if ending == "xml" else whole[: int(keep * whole.index("dist"))]
    )
    assert refused([path]).startswith(f"left.{ending}")


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("resolution: [1126, 750]", "resolution: [.inf, 750]", "inf"),
        ("resolution: [1126, 750]", "resolution: [1126.5, 750]", "whole"),
        ("resolution: [1126, 750]", "resolution: wide", "'wide'"),
        ("resolution: [1126, 750]", "resolution: [1:30, 750]", "'1:30'"),
        ("camera_model: pinhole", "camera_model: [pinhole]", "a lens"),
        ("distortion_model: radtan", "distortion_model: [radtan]", "a lens"),
        ("cam0:", "cam0: &a\n  x: 1\ncam5: *a\ncam6:", "alias"),
        ("cam1:", "cam0:", "'cam0'"),
        ("cam1:", "a: " + "[" * 5000 + "\ncam1:", "nested"),
        ("cam1:", "a: !!python/object/apply:os.getcwd []\ncam1:", "parsed"),
        ("cam1:", "a: 2001-99-99\ncam1:", "parsed"),
        ("cam1:", "a: " + "1" * 5000 + "\ncam1:", "parsed"),
    ],
)
def test_unfit_kalibr_values_are_named(tmp_path: Path, old: str, new: str, said: str) -> None:
    (path,) = written(tmp_path, "kalibr")
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))
    assert said in refused([path])


@pytest.mark.parametrize(
    "matrix", [np.diag([1.0, 1.0, -1.0, 1.0]), np.vstack([np.eye(4)[:3], [0, 0, 1, 1]]), np.zeros((4, 4))]
)
def test_a_pose_that_is_none_is_refused(tmp_path: Path, matrix: np.ndarray) -> None:
    (path,) = written(tmp_path, "kalibr")
    head, _, _ = path.read_text().partition("T_cn_cnm1:")
    path.write_text(f"{head}T_cn_cnm1: {matrix.tolist()}\n")
    assert "T_cn_cnm1" in refused([path])


@pytest.mark.parametrize("form", ["json", "opencv", "colmap", "kalibr"])
def test_whatever_is_changed_it_is_cameras_or_one_sentence(tmp_path: Path, form: CameraFormat) -> None:
    paths = written(tmp_path, form)
    texts = {path: path.read_text() for path in paths}
    random = np.random.default_rng(3)
    pieces = [
        "",
        "-",
        "1e308",
        "nan",
        ".inf",
        "[",
        "]",
        "{",
        "}",
        ":",
        "\n",
        " ",
        '"',
        "9" * 400,
        "\x00",
        "ö",
        "&a ",
        "*a",
        "<a>",
    ]
    for _ in range(80):
        for path, text in texts.items():
            place, length = random.integers(0, len(text)), random.integers(0, 6)
            path.write_text(text[:place] + str(random.choice(pieces)) + text[place + length :])
        try:
            assert all(np.isfinite(camera.matrix).all() for camera in import_cameras(paths, PAIR).values())
        except MammometryError as error:
            assert "\n" not in str(error)  # noqa: PT017
