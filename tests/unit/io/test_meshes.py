"""PLY files: exact, readable by others, and refused when cut short or of another kind."""

from pathlib import Path

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st

from mammometry.base.errors import StorageError
from mammometry.geometry.mesh import TriangleMesh, on_microns
from mammometry.geometry.mesh_files.ply import write_ply
from mammometry.io.meshes.own import read_ply


def tetrahedron() -> TriangleMesh:
    corners = np.array([[0, 0, 0], [1.1, 0, 0], [0, 1, 0], [0, 0, 1 / 3]]) + 1e6
    return TriangleMesh(vertices=corners, faces=np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]], np.int32))


def test_round_trip_is_exact(tmp_path: Path) -> None:
    depth = np.array([0.1, np.nan, 3, 4], np.float32)
    write_ply(tmp_path / "a.ply", tetrahedron(), {"sigma_mm": depth}, ("mm", "two words"))
    mesh, properties, comments = read_ply(tmp_path / "a.ply")
    np.testing.assert_array_equal(mesh.vertices, tetrahedron().vertices)
    np.testing.assert_array_equal(mesh.faces, tetrahedron().faces)
    np.testing.assert_array_equal(properties["sigma_mm"], depth)
    assert comments == ("mm", "two words")


def test_files_of_trimesh_are_read(tmp_path: Path) -> None:
    sphere = trimesh.creation.icosphere(subdivisions=1)
    sphere.export(tmp_path / "a.ply")
    mesh, _, _ = read_ply(tmp_path / "a.ply")
    np.testing.assert_allclose(mesh.vertices, sphere.vertices, atol=1e-7)  # it writes float32
    assert mesh.is_watertight()


def test_a_mesh_without_faces(tmp_path: Path) -> None:
    write_ply(tmp_path / "a.ply", TriangleMesh(vertices=np.zeros((2, 3)), faces=np.empty((0, 3), np.int32)))
    assert len(read_ply(tmp_path / "a.ply")[0].faces) == 0


@pytest.mark.parametrize("text", [b"", b"ply\nformat ascii 1.0\nend_header\n", b"solid a\n"])
def test_other_files_are_refused(tmp_path: Path, text: bytes) -> None:
    (tmp_path / "a.ply").write_bytes(text)
    with pytest.raises(StorageError, match=r"a\.ply"):
        read_ply(tmp_path / "a.ply")


@pytest.mark.parametrize("values", [np.zeros(3, np.float32), np.zeros((4, 2), np.float32), np.zeros(4, np.int64)])
def test_unfit_properties_are_refused(tmp_path: Path, values: np.ndarray) -> None:
    with pytest.raises(ValueError, match="vertex"):
        write_ply(tmp_path / "a.ply", tetrahedron(), {"a": values})


@given(place=st.tuples(*[st.floats(-8000, 8000)] * 3))
def test_positions_on_microns_are_written_as_floats_and_lose_nothing(
    tmp_path_factory: pytest.TempPathFactory, place: tuple[float, float, float]
) -> None:
    corners = on_microns(np.array([place, (0.1, 0.2, 0.3), (1.0, 2.0, 1 / 3)]))
    assert np.abs(corners[1] - [0.1, 0.2, 0.3]).max() <= 1 / 2048
    mesh = TriangleMesh(vertices=corners, faces=np.array([[0, 1, 2]], dtype=np.int32))
    path = tmp_path_factory.mktemp("floats") / "a.ply"
    write_ply(path, mesh)
    assert b"property float x" in path.read_bytes()
    np.testing.assert_array_equal(read_ply(path)[0].vertices, corners)


def test_positions_that_are_no_floats_are_written_as_doubles(tmp_path: Path) -> None:
    mesh = TriangleMesh(vertices=np.full((3, 3), 1 / 3), faces=np.array([[0, 1, 2]], dtype=np.int32))
    write_ply(tmp_path / "a.ply", mesh)
    assert b"property double x" in (tmp_path / "a.ply").read_bytes()
    np.testing.assert_array_equal(read_ply(tmp_path / "a.ply")[0].vertices, mesh.vertices)
