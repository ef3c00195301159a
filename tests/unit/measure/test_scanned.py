"""Other scanners' meshes: what is wrong with one is named; what is right is the same value as a session's surface."""

import numpy as np
import pytest
from solids import ball, dome
from trunks import LEFT, RADIUS_MM, RIGHT, edge_of, radius_mm, trunk_mesh

from mammometry.base.errors import MeasureError
from mammometry.geometry.mesh import TriangleMesh, joined
from mammometry.measure.scan_repair import RepairedScan, largest_part, repair_scan
from mammometry.measure.scanned import (
    as_scanned,
    check_cut,
    check_mesh,
    finer_scan,
    frame_from_axes,
    viewer,
    viewing_frame,
)
from mammometry.measure.trunk.body import rig_frame
from mammometry.surface.repair.repair import Provenance

EDGES = {"left": edge_of(LEFT, "left").points_world, "right": edge_of(RIGHT, "right").points_world}


def with_faces(mesh: TriangleMesh, faces: np.ndarray) -> TriangleMesh:
    return TriangleMesh(vertices=mesh.vertices, faces=np.ascontiguousarray(faces, dtype=np.int32))


def test_a_whole_mesh_is_taken_as_measured_everywhere() -> None:
    surface = as_scanned(ball(50.0, 3))
    assert (surface.provenance == Provenance.MEASURED).all()
    assert surface.pair_names == ()
    assert np.isnan(surface.sigma_mm).all()
    check_mesh(ball(50.0, 2).submesh(np.arange(100)))  # open ones are as good


def test_what_is_no_surface_is_named() -> None:
    mesh = ball(50.0, 2)
    doubled = np.concatenate([mesh.faces, mesh.faces[:1, [0, 2, 1]]])
    with pytest.raises(MeasureError, match=r"^mesh: .*\b3 .*three"):
        check_mesh(with_faces(mesh, doubled))
    turned = mesh.faces.copy()
    turned[7] = turned[7, ::-1]
    with pytest.raises(MeasureError, match=r"^mesh: .*\b3 .*opposite"):
        check_mesh(with_faces(mesh, turned))
    with pytest.raises(MeasureError, match=r"^mesh: .*triangles"):
        repair_scan(with_faces(mesh, mesh.faces[:0]))


def test_pieces_are_counted_and_the_largest_can_be_taken() -> None:
    large, small = ball(50.0, 2), ball(5.0, 1)
    both = TriangleMesh(
        vertices=np.concatenate([small.vertices + 100, large.vertices]),
        faces=np.concatenate([small.faces, large.faces + len(small.vertices)]),
    )
    assert largest_part(both).volume_mm3() == pytest.approx(large.volume_mm3(), rel=1e-12)
    scan = repair_scan(both)
    assert scan.mesh.volume_mm3() == pytest.approx(large.volume_mm3(), rel=1e-12)
    (notice,) = scan.notices
    assert notice.code == "mesh-pieces-removed"
    assert notice.values == {"pieces": 1, "percent": pytest.approx(0.94, abs=0.005)}
    twins = joined([large, ball(40.0, 2).mapped(lambda points: points + 200)])
    with pytest.raises(MeasureError, match=r"^mesh: .*\b2 .*61%, 39% .*--largest"):
        repair_scan(twins)
    assert repair_scan(twins, largest=True).mesh.volume_mm3() == pytest.approx(large.volume_mm3(), rel=1e-12)


@pytest.mark.slow
def test_a_finer_mesh_has_the_same_shape() -> None:
    coarse = trunk_mesh(9.0)
    fine = finer_scan(RepairedScan.unchanged(coarse), list(EDGES.values())).mesh
    assert fine.is_watertight()
    assert fine.volume_mm3() == pytest.approx(coarse.volume_mm3(), rel=1e-12)
    assert fine.area_mm2() == pytest.approx(coarse.area_mm2(), rel=1e-12)
    ends = fine.vertices[fine.edges()]
    length = np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1)
    middle = ends.mean(axis=1)
    near = np.linalg.norm(middle[:, None] - EDGES["left"][None, ::4], axis=2).min(axis=1) < 10
    assert length[near].max() <= 3.0
    assert finer_scan(RepairedScan.unchanged(coarse), []).mesh is coarse


def test_a_hole_or_a_hollow_within_the_boundary_is_named() -> None:
    mesh = trunk_mesh(3.0)
    top = np.array([np.sin(LEFT[0]), 0, np.cos(LEFT[0])]) * (RADIUS_MM + LEFT[3]) + [0, LEFT[1], 0]
    check_cut("left", EDGES["left"], mesh)
    holed = mesh.submesh(np.linalg.norm(mesh.corners().mean(axis=1) - top, axis=1) > 8)
    with pytest.raises(MeasureError, match=r"^boundary 'left': .*hole"):
        check_cut("left", EDGES["left"], holed)
    front = mesh.submesh(mesh.corners().mean(axis=1)[:, 2] > -20)  # open, as scanners give it
    check_cut("left", EDGES["left"], front)
    with pytest.raises(MeasureError, match=r"^boundary 'left': .*concave"):
        check_cut("left", EDGES["left"], with_faces(front, front.faces[:, ::-1]))


def test_the_viewer_stands_upright_before_the_patient() -> None:
    turned = frame = np.array([[0.8, 0.6, 0.0], [-0.6, 0.8, 0.0], [0.0, 0.0, 1.0]])
    rig = viewer(frame, dome())
    assert np.allclose(rig_frame(rig), turned, atol=1e-12)
    for camera in rig.cameras.values():
        u, v = camera.project(dome().vertices.mean(axis=0)[None])[0]
        assert 0 < u < 1000
        assert 0 < v < 1000


def test_the_frame_comes_from_both_boundaries_or_from_landmarks_of_one_side() -> None:
    surface = as_scanned(trunk_mesh(4.0))
    both = viewing_frame(surface, EDGES, {})
    assert np.abs(both - np.eye(3)).max() < 0.1

    def skin(theta: float, y: float) -> np.ndarray:
        r = float(radius_mm(np.array(theta), np.array(y)))
        return np.array([[r * np.sin(theta), y, r * np.cos(theta)]])

    angle, height, reach, _ = RIGHT
    marks = {
        "medial_right": skin(angle + reach / RADIUS_MM, height),
        "lateral_right": skin(angle - reach / RADIUS_MM, height),
        "inframammary_fold_right": skin(angle, height - reach),
    }
    one = viewing_frame(surface, {"right": EDGES["right"]}, marks)
    assert one[1] @ [0, 1, 0] > 0.9  # head
    assert one[0] @ [np.cos(angle), 0, -np.sin(angle)] > 0.95  # the patient's left, as that breast lies
    with pytest.raises(MeasureError, match=r"^mesh: .*landmarks"):
        viewing_frame(surface, {"right": EDGES["right"]}, {})


@pytest.mark.requirement("R-SIDE-2")
def test_exchanged_sides_are_told_by_the_notch() -> None:
    surface = as_scanned(trunk_mesh(4.0))
    notch = {"sternal_notch": np.array([[0.0, 130.0, RADIUS_MM]])}
    assert viewing_frame(surface, EDGES, notch)[1, 1] > 0.9
    exchanged = {"left": EDGES["right"], "right": EDGES["left"]}
    with pytest.raises(MeasureError, match=r"^landmark 'sternal_notch': .*\d mm .*left and right"):
        viewing_frame(surface, exchanged, notch)


def test_a_cast_is_looked_at_from_where_it_stands_out() -> None:
    rim = 60 * np.stack([np.cos(t := np.linspace(0, 2 * np.pi, 90, endpoint=False)), np.sin(t), 0 * t], axis=1)
    frame = viewing_frame(as_scanned(dome()), {"model": rim}, {})
    assert np.allclose(frame, np.eye(3), atol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_closed_torso_looks_where_it_is_round_as_breasts_are(sign: float) -> None:
    trunk = trunk_mesh(4.0)
    flat = TriangleMesh(vertices=trunk.vertices * (sign, 1.0, 0.7 * sign), faces=trunk.faces)
    frame = frame_from_axes(flat)
    assert np.allclose(frame, np.diag([sign, 1.0, sign]))
    plain = TriangleMesh(vertices=ball(150.0, 4).vertices * (1.0, 2.0, 0.7), faces=ball(150.0, 4).faces)
    with pytest.raises(MeasureError, match="sides"):
        frame_from_axes(plain)
