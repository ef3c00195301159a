"""What a scan's mesh is mended of, said and marked; the volume that comes after it is the whole mesh's."""

import re
from dataclasses import replace

import numpy as np
import pytest
from solids import as_surface, ball, dome
from tests.first_cases import first
from trunks import LEFT, RADIUS_MM, RIGHT, edge_of, radius_mm, trunk_mesh

from mammometry.base.errors import MeasureError
from mammometry.geometry.mesh import TriangleMesh, joined
from mammometry.measure.boundary.boundary import Boundary
from mammometry.measure.boundary.trace import edge_loop
from mammometry.measure.scan_repair import WIDEST_HOLE_MM, RepairedScan, repair_scan
from mammometry.measure.scanned import as_scanned, check_cut, check_mesh, finer_scan
from mammometry.measure.solid.cut import inside_curve, opening_loops
from mammometry.measure.volume.uncertainty import VolumeEvidence
from mammometry.measure.volume.volumes import measured_or_refused
from mammometry.measure.wall import chest_wall
from mammometry.measure.wall.open_breast import OpenBreast, open_breasts
from mammometry.surface.repair.repair import RepairedSurface

TRUNK = trunk_mesh(3.0)
FRONT = TRUNK.submesh(TRUNK.corners().mean(axis=1)[:, 2] > -20)
TIP = np.array([np.sin(LEFT[0]), 0, np.cos(LEFT[0])]) * (RADIUS_MM + LEFT[3]) + [0, LEFT[1], 0]
CURVES = {name: edge_of(breast, name) for name, breast in (("left", LEFT), ("right", RIGHT))}


def holed(mesh: TriangleMesh, width_mm: float) -> TriangleMesh:
    """The mesh with a round hole at the left breast's tip."""
    return mesh.submesh(np.linalg.norm(mesh.corners().mean(axis=1) - TIP, axis=1) > width_mm / 2)


def off_mm(scan: RepairedScan) -> np.ndarray:
    """How far the invented skin lies outside the true one."""
    x, y, z = scan.mesh.vertices[scan.invented].T
    return np.hypot(x, z) - radius_mm(np.arctan2(x, z), y)


def surface_of(scan: RepairedScan, curves: dict[str, Boundary] = CURVES) -> RepairedSurface:
    fine = finer_scan(scan, [curve.points_world for curve in curves.values()])
    return as_scanned(fine.mesh, fine.invented)


def cc(scan: RepairedScan, curves: dict[str, Boundary] = CURVES) -> dict[str, float]:
    """Volumes within drawn curves."""
    surface = surface_of(scan, curves)
    return {
        breast.boundary.name: chest_wall.fit(breast).closed.volume_mm3() / 1000
        for breast in open_breasts(list(curves.values()), surface)
    }


@pytest.mark.parametrize("width_mm", [8.0, 16.0, 29.0])
def test_a_small_hole_is_closed_as_the_skin_around_it_curves(width_mm: float) -> None:
    scan = repair_scan(holed(FRONT, width_mm))
    assert scan.invented.any() == (width_mm > 8)
    assert not scan.invented[: len(holed(FRONT, width_mm).vertices)].any()
    assert np.abs(off_mm(scan)).max(initial=0.0) < 0.1
    (notice,) = scan.notices
    assert (notice.code, notice.values["holes"]) == ("mesh-holes-closed", 1)
    assert notice.values["mm"] == pytest.approx(width_mm, abs=1.5)
    assert notice.values["cm2"] == pytest.approx(
        (scan.mesh.area_mm2() - holed(FRONT, width_mm).area_mm2()) / 100, abs=0.051
    )
    assert scan.mesh.area_mm2() == pytest.approx(FRONT.area_mm2(), rel=1e-4)


@pytest.mark.slow
def test_a_wide_hole_stays_and_the_volume_is_refused_on_every_road() -> None:
    scan = repair_scan(holed(TRUNK, 1.3 * WIDEST_HOLE_MM))
    assert scan.notices == ()
    surface = surface_of(scan)
    (left,) = open_breasts([CURVES["left"]], surface, frame=np.eye(3))
    (refusal,) = measured_or_refused([left])
    assert isinstance(refusal, MeasureError)
    assert (refusal.code, refusal.subject) == ("measurement", "boundary 'left'")
    part = inside_curve(surface.mesh, edge_loop("left", CURVES["left"].points_world, surface.mesh))
    with pytest.raises(MeasureError, match=r"^boundary 'left': .*hole"):
        chest_wall.fit(replace(left, cut=part))


def test_a_boundary_over_a_hole_is_refused_and_not_led_around_it() -> None:
    """It would cut off what the hole hides: a telephone does not see the fold below a hanging breast."""
    x, y = (axis.ravel() for axis in np.meshgrid(np.arange(-90, 91, 3.0), np.arange(-90, 91, 3.0)))
    corner = np.arange(61 * 61).reshape(61, 61)
    a, b, c, d = (part.ravel() for part in (corner[:-1, :-1], corner[:-1, 1:], corner[1:, :-1], corner[1:, 1:]))
    faces = np.concatenate([np.stack([a, b, d], axis=1), np.stack([a, d, c], axis=1)]).astype(np.int32)
    sheet = TriangleMesh(vertices=np.stack([x, y, 0 * x], axis=1), faces=faces)
    turn = np.linspace(0, 2 * np.pi, 120, endpoint=False)
    curve = 60 * np.stack([np.cos(turn), np.sin(turn), 0 * turn], axis=1)

    def with_hole(middle_mm: float, reach_mm: float) -> TriangleMesh:
        return sheet.submesh(np.linalg.norm(sheet.corners().mean(axis=1) - [middle_mm, 0, 0], axis=1) > reach_mm)

    check_cut("left", curve, with_hole(60, 8))
    for middle_mm, away_mm in ((60, 20), (42, 38)):  # the second reaches the curve from inside
        with pytest.raises(MeasureError) as refused:
            check_cut("left", curve, with_hole(middle_mm, 20))
        assert refused.value.subject == "boundary 'left'"
        assert float(re.findall(r"(\d+) mm", refused.value.found)[0]) == pytest.approx(away_mm, abs=3.0)  # an edge


def test_a_casts_hole_is_refused_too() -> None:
    mesh = dome(sink_mm=10.0)
    open_dome = mesh.submesh(np.linalg.norm(mesh.corners().mean(axis=1) - [0, 0, 50], axis=1) > 25)
    t = np.linspace(0, 2 * np.pi, 90, endpoint=False)
    rim = Boundary(
        name="model", points_world=60 * np.stack([np.cos(t), np.sin(t), 0 * t], axis=1), method="drawn", sigma_mm=0.5
    )
    with pytest.raises(MeasureError, match=r"^model: .*hole"):
        chest_wall.fit(OpenBreast(boundary=rim, surface=as_surface(open_dome)))
    assert chest_wall.fit(OpenBreast(boundary=rim, surface=as_surface(mesh))).closed.is_watertight()


@pytest.mark.slow
def test_a_closed_holes_uncertainty_is_in_the_interval() -> None:
    whole, mended = (
        measured_or_refused(open_breasts([CURVES["left"]], surface_of(scan), frame=np.eye(3)), VolumeEvidence())[0]
        for scan in (repair_scan(FRONT), repair_scan(holed(FRONT, 24.0)))
    )
    assert not isinstance(whole, MeasureError)
    assert not isinstance(mended, MeasureError)
    assert mended.volume_cc == pytest.approx(whole.volume_cc, rel=2e-3)
    assert "invented surface" not in whole.interval_terms_cc
    assert mended.interval_terms_cc["invented surface"] > 0.5


@pytest.mark.slow
def test_a_hole_in_noisy_skin_is_closed_too() -> None:
    """Its edge may cross itself, seen from ahead."""
    for seed in range(2):
        noise = np.random.default_rng(seed).normal(0, 1.0, FRONT.vertices.shape)
        noisy = TriangleMesh(vertices=FRONT.vertices + noise, faces=FRONT.faces)
        scan = repair_scan(holed(noisy, 24.0))
        assert "mesh-holes-closed" in {notice.code for notice in scan.notices}
        assert np.abs(off_mm(scan)).max(initial=0.0) < 3.0
        assert cc(scan)["left"] == pytest.approx(cc(repair_scan(noisy))["left"], rel=0.01)


def halves() -> tuple[TriangleMesh, TriangleMesh]:
    across = FRONT.corners().mean(axis=1)[:, 0] > 5
    return FRONT.submesh(across), FRONT.submesh(~across)


def split_once(mesh: TriangleMesh) -> TriangleMesh:
    """Every third face in three, about its middle, and its first edge halved: neighbours keep their whole edge."""
    chosen = np.arange(0, len(mesh.faces), 3)
    a, b, c = mesh.faces[chosen].T
    middle = len(mesh.vertices) + np.arange(len(chosen))
    on_edge = middle + len(chosen)
    new = [mesh.corners()[chosen].mean(axis=1), (mesh.vertices[a] + mesh.vertices[b]) / 2]
    parts = [(a, on_edge), (on_edge, b), (b, c), (c, a)]
    faces = [np.delete(mesh.faces, chosen, axis=0), *(np.stack([p, q, middle], axis=1) for p, q in parts)]
    return TriangleMesh(vertices=np.concatenate([mesh.vertices, *new]), faces=np.concatenate(faces).astype(np.int32))


@pytest.mark.slow
def test_pieces_that_touch_are_joined() -> None:
    left, right = halves()
    for other in (right, right.turned_over(), right.mapped(lambda points: points + 0.02)):
        scan = repair_scan(joined([left, other]))
        assert (scan.notices[0].code, scan.notices[0].values) == ("mesh-seams-joined", {"pieces": 2})
        assert scan.mesh.components()[0] == 1
        assert len(scan.mesh.faces) == len(FRONT.faces)
        assert not scan.invented.any()
    with pytest.raises(MeasureError, match=r"^mesh: .*\b2 .*pieces"):
        repair_scan(joined([left, right.mapped(lambda points: points + np.array([-0.5, 0.3, 1.0]))]))


@pytest.mark.slow
def test_edges_that_one_side_alone_has_split_are_joined() -> None:
    torn = split_once(FRONT)
    scan = repair_scan(torn)
    assert scan.mesh.area_mm2() == pytest.approx(FRONT.area_mm2(), rel=1e-3)
    assert cc(scan) == pytest.approx(cc(repair_scan(FRONT)), rel=0.01)


@pytest.mark.parametrize("mesh", first(1, [FRONT, dome(sink_mm=10.0)]), ids=["open", "closed"])
def test_what_is_inside_out_is_turned(mesh: TriangleMesh) -> None:
    assert repair_scan(mesh).notices == ()
    scan = repair_scan(mesh.turned_over())
    assert scan.inside_out
    assert [notice.code for notice in scan.notices] == ["mesh-inside-out"]
    assert np.array_equal(scan.mesh.face_vectors(), mesh.face_vectors())
    some = mesh.faces.copy()
    some[::3] = some[::3, ::-1]
    scan = repair_scan(TriangleMesh(vertices=mesh.vertices, faces=some))
    assert not scan.inside_out
    assert [notice.code for notice in scan.notices] == ["mesh-faces-turned"]
    assert scan.mesh.face_vectors() == pytest.approx(mesh.face_vectors())


def test_a_few_fins_are_cut_off_and_slivers_stay() -> None:
    fins = np.stack([TRUNK.faces[500:510:3, 0], TRUNK.faces[500:510:3, 1], TRUNK.faces[900:910:3, 2]], axis=1)
    scan = repair_scan(TriangleMesh(vertices=TRUNK.vertices, faces=np.concatenate([TRUNK.faces, fins])))
    assert scan.mesh.is_watertight()
    assert scan.mesh.volume_mm3() == pytest.approx(TRUNK.volume_mm3(), rel=1e-4)
    a, b = opening_loops(FRONT.faces.astype(np.int64), len(FRONT.vertices))[0][:2]
    near = (FRONT.vertices[a] + FRONT.vertices[b]) / 2 + [0, 0, 0.01]
    sliver = np.array([[b, a, len(FRONT.vertices)]], dtype=np.int32)
    mesh = TriangleMesh(vertices=np.concatenate([FRONT.vertices, [near]]), faces=np.concatenate([FRONT.faces, sliver]))
    assert repair_scan(mesh).mesh.area_mm2() == pytest.approx(FRONT.area_mm2(), rel=1e-4)


@pytest.mark.slow
def test_a_triangle_that_hangs_on_by_a_corner_is_left_out() -> None:
    """Where a body was cut off some stay. Closed as a hole each would have two faces, which finer edges then join."""
    rim = opening_loops(FRONT.faces.astype(np.int64), len(FRONT.vertices))[0]
    beside = FRONT.vertices[rim[0]] + np.array([[0.0, -2.0, -3.0], [0.0, 2.0, -3.0]])
    count = len(FRONT.vertices)
    hanging = TriangleMesh(
        vertices=np.concatenate([FRONT.vertices, beside]),
        faces=np.concatenate([FRONT.faces, [[rim[0], count, count + 1]]]).astype(np.int32),
    )
    scan = repair_scan(hanging)
    check_mesh(finer_scan(scan, [scan.mesh.vertices]).mesh)
    assert len(scan.mesh.faces) == len(FRONT.faces)


def test_both_sides_of_a_surface_are_one_surface() -> None:
    both = TriangleMesh(vertices=FRONT.vertices, faces=np.concatenate([FRONT.faces, FRONT.faces[:, ::-1]]))
    assert len(repair_scan(both).mesh.faces) == len(FRONT.faces)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1])
def test_skin_full_of_holes_that_touch_is_closed(seed: int) -> None:
    """A patch may need an edge that the skin beside the hole has already."""
    whole = ball(50.0, 4)
    scan = repair_scan(whole.submesh(np.random.default_rng(seed).random(len(whole.faces)) > 0.06))
    check_mesh(scan.mesh)
    assert scan.mesh.is_watertight()
    assert scan.mesh.volume_mm3() == pytest.approx(whole.volume_mm3(), rel=2e-3)
