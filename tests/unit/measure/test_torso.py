"""A torso from its surface to both volumes, on a trunk whose breasts are known exactly."""

import re
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from solids import as_surface, rig_around
from tests.first_cases import first
from trunks import LEFT, RADIUS_MM, RIGHT, bump_mm, edge_of, trunk_mesh, volume_cc

from mammometry.base.errors import CrossingError, MeasureError
from mammometry.geometry.mesh import TriangleMesh
from mammometry.measure.boundary.boundary import Boundary, find_boundaries, given_boundary, outline_torso
from mammometry.measure.settings import MeasureSettings
from mammometry.measure.trunk.body import rig_frame
from mammometry.measure.trunk.thorax import (
    ASSUMED_DEPTH_MM,
    SkinSamples,
    Thorax,
    Trunk,
    find_trunk,
    fit_thorax,
    frame_from_sides,
    seen_skin,
)
from mammometry.measure.volume import volumes
from mammometry.measure.wall import chest_wall
from mammometry.measure.wall.open_breast import OpenBreast
from mammometry.measure.wall.registry import TORSO_WALLS
from mammometry.surface.repair.repair import Provenance, RepairedSurface

RIG = rig_around()
EDGES = (edge_of(LEFT, "left"), edge_of(RIGHT, "right"))


@cache
def torso() -> RepairedSurface:
    mesh = trunk_mesh(3.0)
    return as_surface(mesh, mesh.vertices[:, 2] > -0.35 * RADIUS_MM)  # the back is not seen


@cache
def walls(name: str) -> dict[str, chest_wall.ChestWall]:
    boundary = next(edge for edge in EDGES if edge.name == name)
    return {wall.kind: wall for wall in chest_wall.fit_all(breast_of(boundary))}


def breast_of(boundary: Boundary, **other: object) -> OpenBreast:
    return replace(OpenBreast(boundary=boundary, surface=torso(), boundaries=EDGES, frame=rig_frame(RIG)), **other)


@pytest.mark.slow
@pytest.mark.parametrize(("name", "breast"), [("left", LEFT), ("right", RIGHT)])
@pytest.mark.parametrize("kind", ["cylinder-membrane", "thorax-fit"])
def test_walls_that_know_the_trunk_give_the_exact_volume(name: str, breast: tuple[float, ...], kind: str) -> None:
    closed = walls(name)[kind].closed
    assert closed.is_watertight()
    # The cut follows 3 mm edges, where the bump is flat; the axis depth is estimated, in part from a breast's flank.
    assert closed.volume_mm3() / 1000 == pytest.approx(volume_cc(breast), rel=0.022)  # type: ignore[arg-type]


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["plane", "membrane"])
def test_flat_walls_overestimate(kind: str) -> None:
    """What lies between the cylinder and its chord is taken for breast.

    Over a disc of radius a, a cylinder's −x²/2R lies a²/8R above its mean on the edge, where the wall is.
    """
    wall = walls("left")[kind]
    assert wall.closed.is_watertight()
    extra_cc = LEFT[2] ** 2 / (8 * RADIUS_MM) * np.pi * LEFT[2] ** 2 / 1000
    assert wall.closed.volume_mm3() / 1000 == pytest.approx(volume_cc(LEFT) + extra_cc, rel=0.02)


def test_the_rounded_wall_stands_out_by_a_quarter_of_a_usual_chest_where_the_skin_is_straight() -> None:
    """A membrane of curvature κ over a disc of radius a lies κa²/8 before a flat one, on average."""
    rounded, straight = (
        walls("left")[kind].closed.volume_mm3() / 1000 for kind in ("rounded-membrane", "cylinder-membrane")
    )
    assert straight - rounded == pytest.approx(0.0033 / 4 * LEFT[2] ** 2 / 8 * np.pi * LEFT[2] ** 2 / 1000, rel=0.15)


def test_a_trunks_curvature_along_the_body_is_that_of_its_radius() -> None:
    trunk = Trunk(frame=np.eye(3), origin=np.zeros(3), half_width_mm=150.0)
    thorax = Thorax(trunk=trunk, coefficients=np.random.default_rng(4).normal(size=27), rms_mm=1.0)
    places, up = np.array([[20.0, -30.0], [-90.0, 55.0]]), np.array([0.0, 5.0])
    below, here, above = (thorax.radius_mm(places + step * up) for step in (-1, 0, 1))
    np.testing.assert_allclose(thorax.bend_per_mm(places), (2 * here - below - above) / 25, rtol=1e-6)


@pytest.mark.slow
def test_the_plane_has_a_skirt_and_an_exact_volume() -> None:
    """A curve that dips symmetrically about its plane: the volume over the plane is that of the lid's height field."""
    wall = walls("right")["plane"]
    normals = wall.mesh.face_vectors()
    assert wall.mesh.area_mm2() > np.linalg.norm(normals.sum(axis=0)) * 1.1  # more than its shadow: the skirt
    assert np.allclose(wall.closed.face_vectors().sum(axis=0), 0, atol=1e-6)


@pytest.mark.parametrize("kind", first(3, sorted(set(TORSO_WALLS) - {"mirrored", "measured"})))
def test_one_wall_is_the_same_alone_and_among_all(kind: str) -> None:
    alone = chest_wall.fit(breast_of(EDGES[0]), kind)
    assert alone.closed.volume_mm3() == pytest.approx(walls("left")[kind].closed.volume_mm3(), rel=1e-9)
    assert alone.definition


def test_both_breasts_are_found_each_on_its_side() -> None:
    left, right = find_boundaries(torso(), {}, RIG, "torso")
    assert (left.name, right.name) == ("left", "right")
    for found, breast in ((left, LEFT), (right, RIGHT)):
        theta = np.arctan2(found.points_world[:, 0], found.points_world[:, 2])
        middle = np.array([RADIUS_MM * theta.mean(), found.points_world[:, 1].mean()])
        assert np.abs(middle - [RADIUS_MM * breast[0], breast[1]]).max() < 10
        reach = np.hypot(RADIUS_MM * (theta - breast[0]), found.points_world[:, 1] - breast[1])
        # The bump's curvature jumps to zero at its edge, and that is where half of the smoothed crease is; 3 mm: the
        # pixels' 2, and the trunk's axis.
        assert np.median(np.abs(reach - breast[2])) < 3
        assert np.abs(reach - breast[2]).max() < 8
        assert "to-be-confirmed" in found.remarks
        wall = chest_wall.fit(breast_of(found, boundaries=(left, right)), "cylinder-membrane")
        measured = volumes.measure(found, wall, alternatives=())
        assert measured.volume_cc == pytest.approx(volume_cc(breast), rel=0.04)
        assert measured.interval_cc is not None
        assert measured.interval_cc[0] < volume_cc(breast) < measured.interval_cc[1]
        assert set(measured.interval_terms_cc) == {"chest wall", "boundary", "matching"}


@pytest.mark.slow
def test_cameras_are_not_needed_where_both_boundaries_are_given() -> None:
    with_rig, without = (chest_wall.fit(breast_of(EDGES[1], frame=frame)) for frame in (rig_frame(RIG), None))
    assert without.closed.volume_mm3() == pytest.approx(with_rig.closed.volume_mm3(), rel=0.01)
    with pytest.raises(MeasureError, match=r"wall: .*boundary"):
        chest_wall.fit(OpenBreast(boundary=EDGES[1], surface=torso()))


@pytest.mark.slow
def test_a_boundary_that_crosses_itself_tells_how_much_of_it_was_seen() -> None:
    half = EDGES[0].points_world[: len(EDGES[0].points_world) // 2]
    there_and_back = replace(EDGES[0], points_world=np.concatenate([half, half[::-1]]))
    with pytest.raises(CrossingError) as seen:
        chest_wall.fit(breast_of(there_and_back))
    assert (seen.value.code, seen.value.subject) == ("boundary-crosses-itself", "boundary 'left'")
    assert "%" not in seen.value.found
    unseen = replace(torso(), provenance=np.full_like(torso().provenance, Provenance.REPAIRED))
    with pytest.raises(CrossingError) as hidden:
        chest_wall.fit(breast_of(there_and_back, surface=unseen))
    assert re.findall(r"(\d+) %", hidden.value.found) == ["100"]
    assert "mammometry edit" in hidden.value.remedy


@pytest.mark.slow
def test_a_turned_torso_has_the_same_volumes() -> None:
    turn, shift = Rotation.from_rotvec([0.4, 1.1, -0.3]).as_matrix(), np.array([900.0, -400.0, 2500.0])
    mesh = torso().mesh
    turned = as_surface(TriangleMesh(vertices=mesh.vertices @ turn.T + shift, faces=mesh.faces), torso().provenance > 0)
    edges = tuple(
        Boundary(name=edge.name, points_world=edge.points_world @ turn.T + shift, method="") for edge in EDGES
    )
    upright = chest_wall.fit(breast_of(EDGES[0], frame=None))
    again = chest_wall.fit(OpenBreast(boundary=edges[0], surface=turned, boundaries=edges))
    assert again.closed.volume_mm3() == pytest.approx(upright.closed.volume_mm3(), rel=1e-3)


def test_the_trunk_is_found() -> None:
    trunk = find_trunk(seen_skin(torso()), rig_frame(RIG), height_of=np.array([0.0, 7.0, 100.0]))
    assert np.abs(trunk.frame - np.eye(3)).max() < 0.03
    assert np.abs(trunk.origin[[0, 2]]).max() < 0.1 * RADIUS_MM
    assert trunk.half_width_mm == pytest.approx(RADIUS_MM, rel=0.03)
    points = np.random.default_rng(0).uniform(-90, 90, (100, 3))
    assert np.allclose(trunk.world(trunk.cylindrical(points)), points, atol=1e-9)


def test_the_thorax_is_fitted_under_the_breasts() -> None:
    skin = seen_skin(torso())
    trunk = find_trunk(skin, np.eye(3), height_of=np.array([0.0, 7.0, 100.0]))
    thorax = fit_thorax(trunk, skin, breasts_left_out=False)
    theta, y = np.meshgrid(np.linspace(-1.2, 1.2, 50), np.linspace(-60, 70, 40))
    on_cylinder = np.stack([RADIUS_MM * np.sin(theta), y, RADIUS_MM * np.cos(theta)], axis=-1).reshape(-1, 3)
    assert np.abs(thorax.bulge_mm(on_cylinder)).max() < 1.5  # breasts of 45 and 32 mm stand on it
    top = (RADIUS_MM + LEFT[3]) * np.array([[np.sin(LEFT[0]), 0, np.cos(LEFT[0])]]) + [[0, LEFT[1], 0]]
    assert thorax.bulge_mm(top)[0] == pytest.approx(LEFT[3], abs=1.5)
    assert bump_mm(np.array(LEFT[0]), np.array(LEFT[1]), LEFT) == LEFT[3]


def test_frames_agree_from_rig_and_from_sides() -> None:
    sides = frame_from_sides(EDGES[0].points_world, EDGES[1].points_world, seen_skin(torso()))
    assert np.abs(sides - np.eye(3)).max() < 0.1
    assert np.abs(rig_frame(RIG) - np.eye(3)).max() < 0.4


@pytest.mark.slow
def test_a_flat_chest_has_no_outline_and_does_not_show_that_a_breast_is_missing() -> None:
    mesh = trunk_mesh(4.0)
    flat = mesh.vertices.copy()
    side = np.hypot(flat[:, 0], flat[:, 2])
    flat[:, [0, 2]] *= np.where(side > 1, RADIUS_MM / np.maximum(side, 1), 1)[:, None]
    surface = as_surface(TriangleMesh(vertices=flat, faces=mesh.faces), flat[:, 2] > -40)
    found = outline_torso(surface, rig_frame(RIG))
    assert found.boundaries == ()
    assert [(side.name, side.unclear) for side in found.absent] == [("left", True), ("right", True)]


def test_a_torso_without_sides_has_an_axis_behind_its_breastbone() -> None:
    mesh = trunk_mesh(4.0)
    seen = seen_skin(as_surface(mesh, mesh.vertices[:, 2] > 0.8 * RADIUS_MM))
    trunk = find_trunk(seen, rig_frame(RIG), height_of=np.array([0.0, 7.0, 100.0]))
    assert trunk.assumed
    local = trunk.frame @ trunk.origin
    assert local[2] == pytest.approx(
        RADIUS_MM - ASSUMED_DEPTH_MM, abs=4.0
    )  # the bone, seen 15 mm aside, lies 1 mm deeper; the cameras are not quite upright
    assert not find_trunk(seen_skin(torso()), rig_frame(RIG), height_of=np.array([0.0, 7.0, 100.0])).assumed


def test_arms_that_show_more_skin_than_the_flanks_are_not_the_sides() -> None:
    skin, rng = seen_skin(torso()), np.random.default_rng(3)
    side = np.where(np.arange(2 * len(skin.points_world)) % 2, 1.0, -1.0)
    out_mm, y, z = rng.uniform([RADIUS_MM + 90, -70, -70], [RADIUS_MM + 180, 80, -40], (len(side), 3)).T
    arms = np.stack([side * out_mm, y, z], axis=1), np.stack([side, 0 * side, 0 * side], axis=1)
    both = SkinSamples(
        points_world=np.concatenate([skin.points_world, arms[0]]),
        normals_world=np.concatenate([skin.normals_world, arms[1]]),
    )
    alone, beside = (find_trunk(each, np.eye(3), height_of=np.array([0.0, 7.0, 100.0])) for each in (skin, both))
    assert beside.half_width_mm == pytest.approx(alone.half_width_mm, rel=0.02)
    assert np.abs(beside.origin - alone.origin).max() < 5.0


def test_an_open_curve_is_refused() -> None:
    half = EDGES[0].points_world[:80]
    with pytest.raises(MeasureError, match=r"^boundary 'left': .*gap.* \d+ mm"):
        given_boundary("left", half, torso())


def test_a_curve_off_the_surface_is_refused() -> None:
    with pytest.raises(MeasureError, match=r"^boundary 'left': .*160 of 160 .*\d+ mm"):
        given_boundary("left", EDGES[0].points_world * 1.3, torso())


def test_two_points_are_no_curve() -> None:
    with pytest.raises(MeasureError, match=r"^boundary 'left': .*\b2 points"):
        given_boundary("left", EDGES[0].points_world[:2], torso())


def test_a_curve_far_from_any_surface_cannot_be_traced() -> None:
    lost = Boundary(name="left", points_world=EDGES[0].points_world * 5, method="")
    with pytest.raises(MeasureError, match=r"^boundary 'left': .*\b40 mm"):
        chest_wall.fit(breast_of(lost, frame=None))


def test_a_given_curve_is_kept() -> None:
    boundary = given_boundary("left", EDGES[0].points_world, torso())
    assert np.array_equal(boundary.points_world, EDGES[0].points_world)
    assert "given: 160 points" in boundary.method


@pytest.mark.requirement("R-VOL-7")
def test_the_default_wall_of_a_torso_is_named_in_the_result() -> None:
    found = volumes.measure(
        EDGES[0], walls("left")["rounded-membrane"], MeasureSettings(), alternatives=list(walls("left").values())[1:]
    )
    assert found.wall_kind == "rounded-membrane"
    assert set(found.alternatives_cc) == set(TORSO_WALLS) - {"rounded-membrane", "mirrored", "measured"}
    assert found.interval_terms_cc["chest wall"] == pytest.approx(
        0.38 * np.sqrt(found.base_area_cm2 / 170) * found.base_area_cm2
    )
    assert found.projection_mm == pytest.approx(LEFT[3], abs=12)


@pytest.mark.parametrize("points", [np.zeros((2, 3)), np.full((4, 3), np.nan)])
def test_a_boundary_has_three_finite_points(points: np.ndarray) -> None:
    with pytest.raises(ValueError, match="finite"):
        Boundary(name="model", points_world=points, method="")


def test_a_curve_that_crosses_itself_is_refused() -> None:
    points = EDGES[0].points_world.copy()
    points[40:100] = points[40:100][::-1]  # two of its legs cross
    with pytest.raises(MeasureError, match=r"^boundary 'left': .*crosses"):
        given_boundary("left", points, torso())
