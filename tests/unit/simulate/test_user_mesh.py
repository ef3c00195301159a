"""Anybody's mesh: the same solid whatever its format and unit; named errors for what is none."""

import numpy as np
import pytest
import trimesh

from mammometry.base.errors import SessionError
from mammometry.simulate.subjects.registry import make_subject
from mammometry.simulate.subjects.user_mesh import MeshFile, read_user_mesh

MM = MeshFile(mm_per_unit=1.0)


@pytest.fixture
def egg() -> trimesh.Trimesh:
    mesh = trimesh.creation.icosphere(subdivisions=3, radius=50.0)
    mesh.apply_scale([1.0, 1.3, 0.8])
    mesh.apply_translation([400.0, -30.0, 2.0])
    return mesh


@pytest.mark.parametrize("suffix", ["ply", "obj", "stl"])
def test_closed_mesh_of_any_format_keeps_its_volume(egg, tmp_path, suffix):
    egg.export(tmp_path / f"egg.{suffix}")
    solid = make_subject(str(tmp_path / f"egg.{suffix}"), 1, edge_mm=1.0, mesh_file=MM)
    assert solid.mesh.is_watertight()
    assert solid.subject_kind == "model"
    assert solid.volume_cc == pytest.approx(egg.volume / 1000.0, rel=1e-6)
    assert np.abs(0.5 * (solid.mesh.vertices.min(axis=0) + solid.mesh.vertices.max(axis=0))).max() < 1e-4
    corners = solid.mesh.corners()
    assert np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max() <= 3.0  # fine enough to be lit


def test_units_and_turn(egg, tmp_path):
    egg.apply_scale(0.001)
    egg.export(tmp_path / "egg.ply")
    solid = read_user_mesh(tmp_path / "egg.ply", MeshFile(mm_per_unit=1000.0, turn_deg=(90.0, 0.0, 0.0)), edge_mm=3.0)
    # About x by a right angle: what was y is z.
    assert np.ptp(solid.mesh.vertices, axis=0) == pytest.approx([100.0, 80.0, 130.0], rel=1e-3)
    assert solid.volume_cc == pytest.approx(egg.volume * 1e6, rel=1e-6)


def test_faces_that_look_inwards_are_turned(egg, tmp_path):
    egg.invert()
    egg.export(tmp_path / "egg.ply")
    assert read_user_mesh(tmp_path / "egg.ply", MM).volume_cc > 200.0


def test_open_mesh_has_no_volume_and_looks_ahead(tmp_path):
    x, y = np.meshgrid(np.linspace(-50, 50, 11), np.linspace(-40, 40, 9))
    a = (np.arange(8)[:, None] * 11 + np.arange(10)).ravel()
    faces = np.concatenate([np.stack([a, a + 12, a + 1], axis=1), np.stack([a, a + 11, a + 12], axis=1)])
    sheet = trimesh.Trimesh(np.stack([x.ravel(), y.ravel(), 0.01 * x.ravel() ** 2], axis=1), faces, process=False)
    sheet.export(tmp_path / "sheet.ply")
    solid = read_user_mesh(tmp_path / "sheet.ply", MM)
    assert solid.volumes_cc == {}
    assert solid.subject_kind == "surface"
    assert solid.facts["closed"] is False
    assert solid.mesh.face_vectors().sum(axis=0)[2] > 0


@pytest.mark.parametrize(
    ("how", "found"),
    [
        (MeshFile(), "no unit"),
        (MeshFile(mm_per_unit=1000.0), "1.3e"),
        (MeshFile(mm_per_unit=0.01), "1.3 mm long"),
        (MeshFile(mm_per_unit=-1.0), "scale of -1"),
        (MeshFile(mm_per_unit=float("nan")), "scale of nan"),
    ],
)
def test_unfit_unit_is_named(egg, tmp_path, how, found):
    egg.export(tmp_path / "egg.ply")
    with pytest.raises(SessionError, match=found):
        read_user_mesh(tmp_path / "egg.ply", how)


@pytest.mark.parametrize("content", [b"", b"ply\nformat", b"solid nothing\nendsolid nothing\n", b"v 0 0 0\n"])
@pytest.mark.parametrize("suffix", ["ply", "obj", "stl"])
def test_what_is_no_mesh_is_one_sentence(tmp_path, content, suffix):
    path = tmp_path / f"broken.{suffix}"
    path.write_bytes(content)
    with pytest.raises(SessionError, match="broken"):
        read_user_mesh(path, MM)
    with pytest.raises(SessionError, match=r"missing\.\w+: "):
        read_user_mesh(path.with_name(f"missing.{suffix}"), MM)
