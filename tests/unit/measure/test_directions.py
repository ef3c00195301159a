"""Which way a scanned body faces, where its skin looks to all sides or a lid closes it."""

from pathlib import Path

import numpy as np
import pytest
from solids import ball
from trunks import RADIUS_MM, trunk_mesh

from mammometry.api.mesh import MeshFiles, MeshJob
from mammometry.geometry.mesh import TriangleMesh
from mammometry.geometry.mesh_files.ply import write_ply
from mammometry.io.meshes.foreign import read_foreign
from mammometry.measure.scan_planes import planar_faces
from mammometry.measure.scan_repair import repair_scan
from mammometry.measure.scanned import DirectionError, as_scanned, frame_from_axes
from mammometry.measure.solid.cut import above, opening_loops
from mammometry.measure.trunk.body import find_body

BODY = trunk_mesh(6.0)
"""Closed by flat ends."""
SKIN = BODY.submesh(np.abs(BODY.face_vectors()[:, 1]) < 0.9 * np.linalg.norm(BODY.face_vectors(), axis=1))


def front(mesh: TriangleMesh) -> TriangleMesh:
    """What lies before a plane."""
    return above(mesh, lambda points: points[:, 2] + 20.0).mesh


def lidded(mesh: TriangleMesh) -> TriangleMesh:
    """The same with a fan of triangles in each opening."""
    vertices, faces = [mesh.vertices], [mesh.faces]
    for number, loop in enumerate(opening_loops(mesh.faces.astype(np.int64), len(mesh.vertices))):
        vertices.append(mesh.vertices[loop].mean(axis=0)[None])
        middle = np.full(len(loop), len(mesh.vertices) + number)
        faces.append(np.stack([middle, np.roll(loop, -1), loop], axis=1).astype(np.int32))
    return TriangleMesh(vertices=np.concatenate(vertices), faces=np.concatenate(faces))


@pytest.mark.requirement("R-FRONT-1")
def test_a_flat_lid_is_no_skin() -> None:
    closed, skin = lidded(front(BODY)), front(SKIN)
    planar = planar_faces(closed)
    assert planar.sum() == len(closed.faces) - len(skin.faces)
    scan = repair_scan(closed, skin_alone=True)
    assert scan.mesh.area_mm2() == pytest.approx(skin.area_mm2(), rel=1e-6)
    assert "mesh-lids-removed" in {notice.code for notice in scan.notices}
    assert np.allclose(frame_from_axes(scan.mesh), np.eye(3))


def test_skin_is_no_lid() -> None:
    assert not planar_faces(SKIN).any()


@pytest.mark.slow
@pytest.mark.requirement("R-FRONT-1")
@pytest.mark.parametrize("head", [None, "y"])
def test_an_open_tube_faces_where_its_breasts_are(shared_data: Path, head: str | None) -> None:
    """Its skin looks along its axis on average, by what one unequal arm and the open ends leave."""
    mesh = repair_scan(read_foreign(shared_data / "scans" / "torso_open.ply", "mm").mesh, skin_alone=True).mesh
    assert np.allclose(frame_from_axes(mesh, head), np.eye(3), atol=1e-6)


@pytest.mark.requirement("R-FRONT-3")
def test_hanging_breasts_do_not_tilt_the_trunks_axis() -> None:
    """Breasts slope from the collarbone at 30° to an edge below, on an upright trunk: with them it leans by 35°."""
    low_mm, high_mm, middle_rad, half_rad = -60.0, 200.0, 0.8, 0.6
    plain = above(front(SKIN), lambda points: points[:, 1] + 100.0).mesh
    x, y, z = plain.vertices.T
    within = (np.abs(np.abs(np.arctan2(x, z)) - middle_rad) < half_rad) & (y > low_mm) & (y < high_mm)
    out_mm = np.where(within, np.tan(np.deg2rad(30.0)) * (high_mm - y), 0.0)
    stretched = ((RADIUS_MM + out_mm) / np.hypot(x, z))[:, None] ** [1, 0, 1]
    scan = as_scanned(TriangleMesh(vertices=plain.vertices * stretched, faces=plain.faces))
    turn = np.linspace(0, 2 * np.pi, 100, endpoint=False)
    across, up = (np.sign(wave) * np.sqrt(np.abs(wave)) for wave in (np.cos(turn), np.sin(turn)))  # nearly a square
    curves = []
    for middle in (middle_rad, -middle_rad):
        angle = middle + 1.1 * half_rad * across
        height = (low_mm + high_mm) / 2 + 1.1 * (high_mm - low_mm) / 2 * up
        curves.append(np.stack([RADIUS_MM * np.sin(angle), height, RADIUS_MM * np.cos(angle)], axis=1))
    lean_deg = np.rad2deg(np.arccos(find_body(scan, np.eye(3), boundaries=curves).up[1]))
    assert lean_deg < 3.0


@pytest.mark.slow
@pytest.mark.requirement("R-FRONT-1")
def test_a_scan_without_a_front_is_refused_with_a_picture_of_all_sides(tmp_path: Path) -> None:
    path, results = tmp_path / "egg.ply", tmp_path / "out" / "results"
    round_all_over = ball(150.0, 4)
    body = TriangleMesh(vertices=round_all_over.vertices * (1.0, 2.0, 0.7), faces=round_all_over.faces)
    write_ply(path, body, {}, comments=())
    with pytest.raises(DirectionError) as refused:
        MeshJob(MeshFiles(mesh=path, units="mm", automatic=True), results)
    assert refused.value.code == "direction"
    assert set(refused.value.fronts) == {"--ahead z", "--ahead -z", "--ahead x", "--ahead -x"}
    for option, frame in refused.value.fronts.items():
        assert np.allclose(frame[1], [0, 1, 0])
        assert np.argmax(np.abs(frame[2])) == "xyz".index(option[-1])
    assert refused.value.page == results / "refused" / "refused.html"
    assert (results / "refused" / "directions.png").is_file()
