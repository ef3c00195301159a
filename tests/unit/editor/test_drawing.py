"""What is drawn lies on the surface, encloses what it should, and is never lost."""

import json
from pathlib import Path

import numpy as np
import pytest
import trimesh

from mammometry.editor.drawing import DrawingBoard, drawing_board, handles_of
from mammometry.errors import SessionError, StorageError
from mammometry.geometry.camera import Camera, Rig
from mammometry.geometry.mesh import TriangleMesh
from mammometry.geometry.transform import Transform
from mammometry.io.drawn import read_boundaries, read_landmarks, write_drawn
from mammometry.measure.settings import MeasureSettings
from mammometry.surface.repair import Provenance, RepairedSurface

RADIUS_MM = 60.0


def ball() -> RepairedSurface:
    """Measured above, invented below; the camera looks down on it."""
    mesh = trimesh.creation.icosphere(subdivisions=6, radius=RADIUS_MM)
    vertices = np.asarray(mesh.vertices, dtype=np.float64)
    above = vertices[:, 2] > 30.0
    return RepairedSurface(
        mesh=TriangleMesh(vertices=vertices, faces=np.asarray(mesh.faces, dtype=np.int32)),
        provenance=np.where(above, Provenance.MEASURED, Provenance.INVENTED).astype(np.uint8),
        sigma_mm=np.where(above, np.float32(0.1), np.float32(np.nan)),
        pair_bits=above.astype(np.int32),
        pair_names=("one",),
        convergence=np.array([0.1]),
    )


def rig() -> Rig:
    """A pair above the ball that looks down."""
    cameras = {}
    for name, x in (("a", -50.0), ("b", 50.0)):
        down = np.array([[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, -1.0]])
        cameras[name] = Camera(
            name=name,
            size_wh=(400, 300),
            matrix=np.array([[1000.0, 0, 200], [0, 1000.0, 150], [0, 0, 1]]),
            distortion=np.zeros(5),
            camera_from_world=Transform(rotation=down, translation_mm=-down @ np.array([x, 0.0, 800.0])),
        )
    return Rig(name="r", cameras=cameras, pair_names={"one": ("a", "b")})


@pytest.fixture(scope="module")
def board() -> DrawingBoard:
    return drawing_board(ball(), rig(), MeasureSettings(), triangles=30_000)


def circle(height_mm: float, count: int) -> np.ndarray:
    angle = 2 * np.pi * np.arange(count) / count
    radius = np.sqrt(RADIUS_MM**2 - height_mm**2)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), np.full(count, height_mm)], axis=1)


@pytest.mark.parametrize("height_mm", [0.0, 20.0])
def test_a_drawn_circle_encloses_its_cap(board: DrawingBoard, height_mm: float) -> None:
    live = board.measure({"model": circle(height_mm, 12)})["model"]
    assert live.problem is None
    # A handle every 30 degrees leaves the spline 0.1 mm from the circle, thinning 0.05 mm: 0.2 mm of height over
    # the cap's base.
    tall = RADIUS_MM - height_mm
    true_cc = np.pi * tall**2 * (RADIUS_MM - tall / 3) / 1000
    base_cm2 = np.pi * (RADIUS_MM**2 - height_mm**2) / 100
    assert live.volume_cc == pytest.approx(true_cc, abs=base_cm2 * 0.02)
    assert np.abs(np.linalg.norm(live.curve_world, axis=1) - RADIUS_MM).max() < 0.1
    assert np.abs(live.curve_world[:, 2] - height_mm).max() < 0.5


def test_a_curve_that_cannot_be_closed_says_why(board: DrawingBoard) -> None:
    there_and_back = np.concatenate([circle(0.0, 40)[:8], circle(0.0, 40)[6:0:-1]])
    live = board.measure({"left": there_and_back})["left"]
    assert live.volume_cc is None
    assert live.problem is not None
    assert "'left'" in live.problem


def test_handles_are_few_even_and_on_the_curve() -> None:
    curve = circle(0.0, 2000)
    handles = handles_of(curve)
    assert len(handles) == int(2 * np.pi * RADIUS_MM / 18)
    gaps = np.linalg.norm(handles - np.roll(handles, 1, axis=0), axis=1)
    assert np.ptp(gaps) < 0.01
    assert len(handles_of(curve / 20)) == 8


def test_what_is_written_is_read_back_and_every_earlier_version_is_kept(tmp_path: Path) -> None:
    curves, marks = {"left": circle(0, 9)}, {"sternal_notch": np.array([[1.0, 2.0, 3.0]])}
    changed = write_drawn(tmp_path, curves, marks, author="a test")
    assert [path.name for path in changed] == ["boundaries.json", "landmarks.json"]
    assert np.allclose(read_boundaries(tmp_path, "torso")["left"], curves["left"], atol=1e-4)
    assert np.allclose(read_landmarks(tmp_path, "torso")["sternal_notch"], [[1, 2, 3]])
    assert not (tmp_path / "history").exists()
    first = (tmp_path / "boundaries.json").read_bytes()
    assert write_drawn(tmp_path, curves, marks, author="a test") == ()
    changed = write_drawn(tmp_path, {"left": circle(5, 9)}, marks, author="a test")
    assert [path.name for path in changed] == ["boundaries.json"]
    (kept,) = (tmp_path / "history").iterdir()
    assert kept.read_bytes() == first
    write_drawn(tmp_path, {}, {}, author="a test")
    assert read_boundaries(tmp_path, "torso") == {}
    assert len(list((tmp_path / "history").iterdir())) == 3
    assert not [path for path in tmp_path.rglob(".*")]


@pytest.mark.parametrize("content", [b"{", b"[]", b"[" * 100_000, b"\xff", b'{"boundaries": 3}'])
def test_a_damaged_file_is_kept_and_replaced(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "boundaries.json").write_bytes(content)
    write_drawn(tmp_path, {"model": np.eye(3)}, {}, author="a test")
    (kept,) = (tmp_path / "history").iterdir()
    assert kept.read_bytes() == content
    np.testing.assert_array_equal(read_boundaries(tmp_path, "model")["model"], np.eye(3))


@pytest.mark.parametrize(
    ("table", "found"),
    [
        ({"landmarks": {"elbow": {"points": [[0, 0, 0]]}}}, "unknown name"),
        ({"landmarks": {"sternal_notch": {"points": [[0, 0, 0], [1, 1, 1]]}}}, "2 points"),
        ({"landmarks": {"midline": {"points": [[0, 0, 0]]}}}, "1 points"),
        ({"landmarks": {"midline": {"points": [["a", 0, 0]]}}}, "another content"),
        (
            {"landmarks": {"midline": {"points": [[0, 0, float("nan")], [1, 1, 1]]}}},
            r"midline\.points\[0\]\[2\]: nan, which is no finite number",
        ),
        ({"units": "cm", "landmarks": {}}, "units 'cm'"),
        ([], "another content"),
    ],
)
def test_a_landmark_file_that_is_not_as_documented_is_named(tmp_path: Path, table: object, found: str) -> None:
    (tmp_path / "landmarks.json").write_text(json.dumps(table))
    with pytest.raises(SessionError, match=found):
        read_landmarks(tmp_path, "torso")


def test_a_session_that_cannot_be_written_to_is_an_error_in_words(tmp_path: Path) -> None:
    with pytest.raises(StorageError, match="refuses"):
        write_drawn(tmp_path / "missing", {"left": circle(0, 9)}, {}, author="a test")
