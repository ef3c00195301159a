"""A virtual telephone: what its fused scans have of the body, and what they lose as real ones do."""

import math
from functools import partial

import numpy as np
import pytest
import trimesh

from mammometry.geometry.mesh import TriangleMesh
from mammometry.geometry.nearest import point_tree
from mammometry.simulate.disturbances.registry import disturbed
from mammometry.simulate.recipe import parse_situation
from mammometry.simulate.scan import QUALITIES, ScanQuality, add_picture, clean_front, scan
from mammometry.simulate.subjects.registry import make_subject
from mammometry.simulate.subjects.solid import SubjectSolid
from mammometry.simulate.subjects.torso_shape import torso_shape

RADIUS_MM = 100.0
SMALL = ScanQuality(noise_mm=1.0, cube_mm=8.0, width_px=96)


def ball() -> SubjectSolid:
    sphere = trimesh.creation.icosphere(subdivisions=4, radius=RADIUS_MM)
    return SubjectSolid(
        name="ball",
        subject_kind="torso",
        mesh=TriangleMesh(vertices=np.array(sphere.vertices), faces=np.array(sphere.faces, dtype=np.int32)),
        back_vertices=0,
        areola=np.zeros(len(sphere.vertices), dtype=np.float32),
        base_boundary=None,
        landmarks={"midline": np.array([[0.0, 0.0, RADIUS_MM]])},
        facts={},
    )


def radii(mesh: TriangleMesh) -> np.ndarray:
    return np.linalg.norm(mesh.vertices, axis=1)


def torso(situation: str) -> SubjectSolid:
    reshape = partial(disturbed, stage="patient", situation=parse_situation(situation), seed=3)
    return make_subject("torso_3", 0, edge_mm=6.0, reshape=reshape)


def test_a_scan_is_one_open_piece_near_the_skin_with_noise():
    mesh = scan(ball(), SMALL, 1).mesh
    assert mesh.components()[0] == 1
    assert not mesh.is_watertight()
    off = radii(mesh) - RADIUS_MM
    assert abs(np.median(off)) < 1.0  # fusion of skin seen at a slant leaves it within a fraction of a cube
    assert 0.1 < off.std() < 2.0
    assert (np.einsum("ij,ij->i", mesh.vertex_normals(), mesh.vertices) > 0).all()  # faces look outwards
    assert mesh.vertices[:, 2].min() > -RADIUS_MM / 2  # nobody walked behind it


def test_more_noise_gives_a_rougher_scan():
    rough = [
        radii(scan(ball(), ScanQuality(noise_mm=noise, cube_mm=8.0, width_px=96), 1).mesh).std() for noise in (0.2, 3)
    ]
    assert rough[1] > 1.5 * rough[0]


@pytest.mark.slow
def test_the_same_seed_gives_the_same_scan_and_another_one_scans_anew():
    first, again, other = (scan(ball(), SMALL, seed).mesh for seed in (1, 1, 2))
    assert np.array_equal(first.vertices, again.vertices)
    assert len(first.vertices) != len(other.vertices)


def test_the_clean_front_is_the_bodys_own_skin():
    mesh = clean_front(ball()).mesh
    assert np.allclose(radii(mesh), RADIUS_MM)
    assert not mesh.is_watertight()


def test_the_kernel_equals_its_plain_twin():
    rng = np.random.default_rng(5)
    depth = rng.uniform(40, 60, (12, 16)).astype(np.float32)
    depth[3, 4] = np.nan
    trust = rng.uniform(0.2, 1.0, depth.shape).astype(np.float32)
    matrix = np.array([[2.0, 0, 0, -9], [0, 2.0, 0, -7], [0, 0, 2.0, 35]])
    total, weight = np.zeros((9, 8, 12), dtype=np.float32), np.zeros((9, 8, 12), dtype=np.float32)
    add_picture(total, weight, depth, trust, matrix, 40.0, 5.0)
    for index in np.ndindex(total.shape):
        x, y, z = matrix[:, :3] @ index + matrix[:, 3]
        column, row = math.floor(40.0 * x / z + 8.0), math.floor(40.0 * y / z + 6.0)
        distance = depth[row, column] - z if 0 <= row < 12 and 0 <= column < 16 else np.nan
        counts = distance > -5.0
        assert weight[index] == pytest.approx(trust[row, column] if counts else 0.0)
        assert total[index] == pytest.approx(trust[row, column] * min(distance, 5.0) if counts else 0.0, abs=1e-4)


def test_gravity_moves_the_nipple_down_where_she_stands_and_aside_where_she_lies():
    standing, lying = (
        disturbed(torso_shape("torso_3", 0), "patient", parse_situation(f"posture={posture}"), 3)
        for posture in ("standing", "lying")
    )
    assert 0 <= standing.lean_rad < 0.2
    assert lying.lean_rad < -1.2
    assert lying.breasts["left"].radii_mm[3] > standing.breasts["left"].radii_mm[3]


@pytest.mark.slow
def test_a_lying_breast_falls_to_the_side_and_a_telephone_sees_the_front_of_a_standing_one():
    standing, lying = torso("posture=standing"), torso("posture=lying")
    for sign, side in ((1, "left"), (-1, "right")):
        there = [solid.landmarks[f"nipple_{side}"][0] for solid in (standing, lying)]
        assert sign * there[1][0] > sign * there[0][0] + 5.0
        assert there[1][1] > there[0][1] + 5.0
    mesh = scan(standing, QUALITIES["telephone"], 1).mesh
    assert mesh.components()[0] == 1
    away = point_tree(mesh.vertices).query(np.concatenate(list(standing.landmarks.values())))[0]
    assert np.median(away) < 4.0


@pytest.mark.slow
def test_the_clean_front_has_the_underside_of_a_hanging_breast():
    """It looks back, as the back does, and was cut out with it: a hole in the truth."""
    solid = torso("posture=standing,ptosis=3")
    skin = np.unique(solid.mesh.faces[np.concatenate([breast.skin_faces for breast in solid.breasts.values()])])
    away = point_tree(clean_front(solid).mesh.vertices).query(solid.mesh.vertices[skin])[0]
    assert np.asarray(away).max() == 0
    assert (solid.mesh.vertex_normals()[skin, 2] < -0.6).any()
