"""Mesh files of other programs: four formats, a unit that is told or stated, and everything else refused by name."""

from pathlib import Path

import numpy as np
import pytest
import trimesh

from mammometry.base.errors import SessionError
from mammometry.geometry.mesh_files.ply import write_ply
from mammometry.io.meshes.foreign import read_foreign


def box(scale: float = 1.0) -> trimesh.Trimesh:
    return trimesh.creation.box((100 * scale, 80 * scale, 60 * scale))


@pytest.mark.parametrize("suffix", ["ply", "obj", "stl", "glb"])
@pytest.mark.parametrize(
    ("units", "scale"), [("mm", 1.0), ("cm", 0.1), ("m", 0.001), ("in", 1 / 25.4), ("ft", 1 / 304.8)]
)
def test_every_format_in_every_unit_is_the_same_solid(tmp_path: Path, suffix: str, units: str, scale: float) -> None:
    path = tmp_path / f"box.{suffix}"
    box(scale).export(path)
    found = read_foreign(path, units)
    assert found.mesh.is_watertight()  # STL repeats corners
    assert found.mesh.volume_mm3() == pytest.approx(480_000, rel=1e-5)  # STL and GLB hold single precision
    assert found.units.startswith(f"{units}, ")
    assert len(found.colours) == len(found.mesh.vertices) == 8


def test_the_file_may_state_its_unit(tmp_path: Path) -> None:
    box(0.001).export(tmp_path / "box.glb")
    assert read_foreign(tmp_path / "box.glb").units == "m, glTF's unit"
    assert read_foreign(tmp_path / "box.glb").mesh.volume_mm3() == pytest.approx(480_000, rel=1e-5)
    (tmp_path / "box.obj").write_text("# units: cm\n" + box(0.1).export(file_type="obj"))
    assert read_foreign(tmp_path / "box.obj").units.startswith("cm, ")
    mesh = read_foreign(tmp_path / "box.obj").mesh
    write_ply(tmp_path / "ours.ply", mesh, comments=("mm, world frame",))
    assert read_foreign(tmp_path / "ours.ply").mesh.volume_mm3() == pytest.approx(480_000, rel=1e-5)


@pytest.mark.parametrize("suffix", ["ply", "obj", "stl"])
def test_no_unit_is_guessed(tmp_path: Path, suffix: str) -> None:
    box().export(tmp_path / f"box.{suffix}")
    with pytest.raises(SessionError, match=r"--units"):
        read_foreign(tmp_path / f"box.{suffix}")


def test_an_implausible_unit_is_refused_with_what_it_would_mean(tmp_path: Path) -> None:
    box().export(tmp_path / "box.ply")
    with pytest.raises(SessionError, match=r"1e\+05 mm .*\bm\b.*--units"):
        read_foreign(tmp_path / "box.ply", "m")
    box(0.001).export(tmp_path / "small.ply")
    with pytest.raises(SessionError, match=r"0\.1 mm"):
        read_foreign(tmp_path / "small.ply", "mm")
    with pytest.raises(SessionError, match="'furlong'"):
        read_foreign(tmp_path / "box.ply", "furlong")


def test_what_is_no_mesh_is_refused(tmp_path: Path) -> None:
    (tmp_path / "broken.ply").write_bytes(b"ply\nformat ascii 1.0\nelement vertex 3\n")
    with pytest.raises(SessionError, match=r"\.ply: .*read"):
        read_foreign(tmp_path / "broken.ply", "mm")
    with pytest.raises(SessionError, match=r"absent\.stl: "):
        read_foreign(tmp_path / "absent.stl", "mm")
    (tmp_path / "points.obj").write_text("v 0 0 0\nv 100 0 0\nv 0 100 0\n")
    with pytest.raises(SessionError, match=r"triangles|read"):
        read_foreign(tmp_path / "points.obj", "mm")
    (tmp_path / "flat.obj").write_text("v 0 0 0\nv 100 0 0\nv 100 0 0\nf 1 2 3\n")
    with pytest.raises(SessionError, match=r"triangle.*area"):
        read_foreign(tmp_path / "flat.obj", "mm")
    with pytest.raises(SessionError, match="file type"):
        read_foreign(tmp_path / "scan.txt", "mm")


def test_colours_of_vertices_are_kept(tmp_path: Path) -> None:
    mesh = box()
    mesh.visual.vertex_colors = np.arange(32, dtype=np.uint8).reshape(8, 4)
    mesh.export(tmp_path / "box.ply")
    found = read_foreign(tmp_path / "box.ply", "mm")
    by_place = {tuple(place): tuple(colour) for place, colour in zip(found.mesh.vertices, found.colours, strict=True)}
    for place, colour in zip(mesh.vertices, np.arange(32).reshape(8, 4), strict=True):
        assert by_place[tuple(place)] == tuple(colour[:3])
