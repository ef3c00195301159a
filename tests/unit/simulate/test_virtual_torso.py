"""Torsos: closed, of exactly known volume over a known wall, without self-crossing, as various as they claim."""

import functools
import math

import manifold3d
import numpy as np
import pytest
from embreex.mesh_construction import TriangleMesh as EmbreeMesh
from embreex.rtcore_scene import EmbreeScene

from mammometry.geometry.mesh import TriangleMesh
from mammometry.simulate.subjects.body import TrunkField
from mammometry.simulate.subjects.registry import make_subject
from mammometry.simulate.subjects.solid import SubjectSolid, rig_from_solid
from mammometry.simulate.subjects.torso import torso
from mammometry.simulate.subjects.torso_shape import torso_shape

SIDES = ("left", "right")


@functools.cache
def made(name: str, seed: int = 1) -> SubjectSolid:
    return make_subject(name, seed, edge_mm=3.0)


def wall_of(solid: SubjectSolid) -> TriangleMesh:
    assert solid.wall_vertices is not None
    return TriangleMesh(vertices=solid.wall_vertices, faces=solid.mesh.faces)


def manifold_cc(mesh: TriangleMesh) -> float:
    body = manifold3d.Manifold(
        manifold3d.Mesh64(
            vert_properties=np.array(mesh.vertices), tri_verts=np.array(mesh.faces, dtype=np.uint64), tolerance=0.0
        )
    )
    assert body.status() == manifold3d.Error.NoError
    return float(body.volume()) / 1000.0


@pytest.mark.slow
@pytest.mark.parametrize("name", ["torso", pytest.param("torso_4", marks=pytest.mark.slow)])
def test_breasts_are_closed_and_their_volume_is_that_of_skin_less_wall(name):
    solid = made(name)
    for mesh in (solid.mesh, *(solid.closed_breast(side) for side in SIDES)):
        assert mesh.is_watertight()
        assert mesh.euler_number() == 2
        assert mesh.components()[0] == 1
    volumes = solid.volumes_cc
    assert set(volumes) == {"left", "right"}
    for side in SIDES:
        # Manifold, an independent implementation, on the same solid.
        assert volumes[side] == pytest.approx(manifold_cc(solid.closed_breast(side)), rel=1e-6)
    # The body with breasts less the body without: 30 litres, of which a millionth is 0.03 cc.
    difference = (solid.mesh.volume_mm3() - wall_of(solid).volume_mm3()) / 1000.0
    assert difference == pytest.approx(sum(volumes.values()), rel=1e-6)


@pytest.mark.slow
def test_volume_is_kept_where_it_stands():
    solid = made("torso")
    placed = solid.placed(rig_from_solid(solid, 3))
    for side in SIDES:
        # Coordinates are rounded to float32 again: 1e-5 mm on 200 mm, a millionth of a volume or so.
        assert placed.volumes_cc[side] == pytest.approx(solid.volumes_cc[side], rel=3e-6)
    assert placed.mesh.is_watertight()


@pytest.mark.slow
@pytest.mark.parametrize("name", ["torso", "torso_4"])
def test_boundary_is_where_skin_and_wall_part(name):
    solid = made(name)
    apart = np.linalg.norm(solid.mesh.vertices - solid.wall_vertices, axis=1)
    for side in SIDES:
        breast = solid.breasts[side]
        assert apart[breast.boundary].max() == 0.0
        inside = np.setdiff1d(np.unique(solid.mesh.faces[breast.skin_faces]), breast.boundary)
        assert (apart[inside] > 0).mean() > 0.97  # at the rim skin and wall differ by less than float32 tells
        # Consecutive points are edges of the mesh: the curve lies on it.
        edges = {tuple(edge) for edge in solid.mesh.edges().tolist()}
        loop = np.stack([breast.boundary, np.roll(breast.boundary, -1)], axis=1)
        assert {tuple(sorted(pair)) for pair in loop.tolist()} <= edges
    moved = np.flatnonzero(apart > 0)
    both = np.concatenate([solid.mesh.faces[solid.breasts[side].skin_faces].ravel() for side in SIDES])
    assert np.isin(moved, both).all()


@pytest.mark.parametrize(
    "name", ["torso", *(pytest.param(name, marks=pytest.mark.slow) for name in ("torso_4", "torso_8"))]
)
def test_skin_crosses_neither_itself_nor_the_wall(name):
    solid = made(name)
    assert solid.wall_vertices is not None
    mesh = solid.mesh
    moved = np.linalg.norm(mesh.vertices - solid.wall_vertices, axis=1) > 0
    field = TrunkField(torso_shape(name, 1).body)(mesh.vertices[moved])
    assert field.min() > -0.01  # mm: nowhere inside the chest
    scene = EmbreeScene()
    EmbreeMesh(scene, mesh.vertices.astype(np.float32), mesh.faces)
    edges = mesh.edges()
    start, way = mesh.vertices[edges[:, 0]], mesh.vertices[edges[:, 1]] - mesh.vertices[edges[:, 0]]
    hit = scene.run((start + 0.02 * way).astype(np.float32), (0.96 * way).astype(np.float32), output=True)
    face = hit["primID"]
    own = (mesh.faces[np.maximum(face, 0)][:, :, None] == edges[:, None, :]).any(axis=(1, 2))
    assert not ((face >= 0) & (hit["tfar"] < 1.0) & ~own).any()


def test_family_has_the_range_it_is_said_to_have():
    shapes = [torso_shape(f"torso_{n}", 5) for n in range(1, 200)]
    volumes = np.array([[shape.breasts[side].volume_cc for side in SIDES] for shape in shapes])
    assert volumes.min() >= 100.0
    assert volumes.max() <= 1200.0
    assert volumes.min() < 130.0
    assert volumes.max() > 1000.0
    ratio = np.log(volumes[:, 0] / volumes[:, 1])
    assert 0.1 < ratio.std() < 0.25  # unequal, to both sides
    assert abs(ratio.mean()) < 0.05
    hang = np.array([shape.breasts["left"].hang_mm for shape in shapes])
    assert hang.min() < 5.0
    assert hang.max() > 60.0
    assert np.corrcoef(hang, volumes[:, 0])[0, 1] > 0.5
    widths = np.array([shape.body.half_width_mm for shape in shapes])
    assert np.ptp(widths) > 30.0


@pytest.mark.slow
@pytest.mark.parametrize("name", ["torso", "torso_4"])
def test_volume_is_about_what_was_wanted(name):
    for side, breast in torso_shape(name, 1).breasts.items():
        assert made(name).volumes_cc[side] == pytest.approx(breast.volume_cc, rel=0.03)


@pytest.mark.slow
def test_a_heavy_breast_hides_its_fold():
    """Not a height field: somewhere below the nipple the skin looks down and back, under the breast."""
    solid = made("torso_8")
    normals = solid.mesh.vertex_normals()
    below = np.unique(solid.mesh.faces[solid.breasts["left"].skin_faces])
    assert normals[below, 2].min() < -0.2


def test_landmarks_lie_on_the_skin_at_their_places():
    solid = made("torso")
    marks = solid.landmarks
    for name, points in marks.items():
        near = [np.linalg.norm(solid.mesh.vertices - point, axis=1).min() for point in points]
        assert max(near) < 9.0, name  # edges on the neck are that long
    for side, sign in (("left", 1.0), ("right", -1.0)):
        nipple, fold = marks[f"nipple_{side}"][0], marks[f"inframammary_fold_{side}"][0]
        medial, lateral = marks[f"medial_{side}"][0], marks[f"lateral_{side}"][0]
        assert sign * nipple[0] > 30.0
        assert fold[1] < nipple[1] + 30.0
        assert 0.0 < sign * medial[0] < sign * nipple[0] < sign * lateral[0] + 20.0
        assert len(marks[f"anterior_axillary_line_{side}"]) > 10
        assert sign * marks[f"anterior_axillary_line_{side}"][:, 0].min() * sign > 0 or sign < 0
        spot = solid.mesh.vertices[(solid.areola > 0.5) & (sign * solid.mesh.vertices[:, 0] > 0)]
        assert np.linalg.norm(spot.mean(axis=0) - nipple) < 10.0
    assert np.abs(marks["midline"][:, 0]).max() == 0.0
    assert marks["sternal_notch"][0, 1] > marks["nipple_left"][0, 1] + 100.0


@pytest.mark.slow
def test_seed_and_number_decide_everything():
    shape = torso_shape("torso_3", 9)
    first, again = (torso(shape, seed=9, edge_mm=6.0) for _ in range(2))
    assert np.array_equal(first.mesh.vertices, again.mesh.vertices)
    assert torso_shape("torso_3", 9) == shape
    assert torso_shape("torso_3", 10) != shape
    assert torso_shape("torso_4", 9) != shape


def test_leans_forward_and_stands_with_its_breasts_in_the_middle():
    solid = made("torso")
    placed = rig_from_solid(solid, 1)
    head = placed.rotate(np.array([[0.0, 1.0, 0.0]]))[0]
    assert math.radians(20) < math.atan2(head[2], head[1]) < math.radians(50)
    nipples = placed.apply(np.concatenate([solid.landmarks["nipple_left"], solid.landmarks["nipple_right"]]))
    assert np.abs(nipples.mean(axis=0)).max() < 70.0


@pytest.mark.parametrize("name", ["torso_0", "torso_x", "torso_", "torsos"])
def test_unknown_torso_is_refused_by_name(name):
    with pytest.raises(ValueError, match=name):
        make_subject(name, 1)


@pytest.mark.slow
@pytest.mark.parametrize("number", range(1, 41, 4))
def test_the_whole_family_is_sound(number):
    name = f"torso_{number}"
    solid = make_subject(name, 2, edge_mm=2.0)
    for side, breast in torso_shape(name, 2).breasts.items():
        closed = solid.closed_breast(side)
        assert closed.is_watertight()
        assert closed.euler_number() == 2
        assert 100.0 <= solid.volumes_cc[side] <= 1200.0
        assert solid.volumes_cc[side] == pytest.approx(breast.volume_cc, rel=0.03)
    assert solid.mesh.is_watertight()
