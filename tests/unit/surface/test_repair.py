"""Elastic repair pulls a wrong first surface to the valid data, and says what it did not see."""

import numpy as np
import pytest
from scipy.spatial import cKDTree
from spheres import camera_towards, ellipsoid_range, range_image, sphere_mesh

from mammometry.base.errors import SurfaceError
from mammometry.geometry.mesh import TriangleMesh
from mammometry.surface.ranges.dents import ValidPatches, decompose, remove_dents
from mammometry.surface.repair.energy import graph_of
from mammometry.surface.repair.repair import Provenance, RepairedSurface, propagate, repair
from mammometry.surface.repair.untangle import crossing_faces
from mammometry.surface.settings import DentSettings, RepairSettings

RADIUS = 30.0
AROUND = [(1, 0, 0.1), (-1, 0, 0.1), (0, 1, 0.1), (0, -1, 0.1), (0.1, 0, 1), (0.1, 0, -1)]


def valid_views(directions, keep=lambda points: np.ones(points.shape[:2], dtype=bool)) -> ValidPatches:
    images = []
    for k, direction in enumerate(directions):
        camera = camera_towards(f"c{k}", direction)
        image = range_image(camera, ellipsoid_range(camera, (RADIUS,) * 3))
        with np.errstate(invalid="ignore"):
            images.append(image.keeping(keep(image.points_world())))
    return remove_dents(images, decompose(images), DentSettings(drop_seen_through=False))


def dented(depth=1.5) -> TriangleMesh:
    sphere = sphere_mesh(RADIUS, rings=60)
    inwards = depth * np.exp(-((sphere.vertices - [0, 0, RADIUS]) ** 2).sum(axis=1) / 10.0**2)
    return TriangleMesh(vertices=sphere.vertices * (1 - inwards / RADIUS)[:, None], faces=sphere.faces)


def radial_error(mesh):
    return np.linalg.norm(mesh.vertices, axis=1) - RADIUS


@pytest.mark.parametrize("target", ["closest", "blend"])
def test_a_dented_sphere_is_pulled_back(target):
    first, valid = dented(), valid_views(AROUND)
    assert np.abs(radial_error(first)).max() > 1.4
    result = repair(first, valid, RepairSettings(target=target))
    # ρ = 1 ties a vertex to its neighbours as strongly as to the data: a smooth dent still vanishes but for ~10 %
    assert np.abs(radial_error(result.mesh)).max() < 0.25
    assert np.abs(radial_error(result.mesh)).mean() < 0.03
    assert result.mesh.is_watertight()
    np.testing.assert_array_equal(result.mesh.faces, first.faces)
    assert len(result.convergence) >= 1
    assert (np.diff(result.convergence) < 0).all()
    assert (result.provenance == Provenance.MEASURED).mean() > 0.95


@pytest.mark.slow
def test_a_stiffer_surface_moves_less():
    first, valid = dented(), valid_views(AROUND)
    left = [np.abs(radial_error(repair(first, valid, RepairSettings(rho=rho)).mesh)).max() for rho in (0.1, 10.0, 1e4)]
    assert left[0] < left[1] < left[2]


def test_a_true_surface_stays():
    first = sphere_mesh(RADIUS, rings=40)
    result = repair(first, valid_views(AROUND))
    # foot points on tangent planes of data at up to 0.7 mm: sagitta .7²/(2·30) = .008 mm
    assert np.abs(radial_error(result.mesh)).max() < 0.02


def test_what_is_invented_far_from_data_is_left_out_without_a_trace(monkeypatch):
    first, valid = dented(), valid_views([(0, 0, 1)])
    # displacements that fade over 1 mm do not reach the far side; with a reach of 90 mm nothing is left out
    results = []
    for reach in (8.0, 90.0):
        monkeypatch.setattr("mammometry.surface.repair.repair.BRIDGED_REACH_MM", reach)
        results.append(repair(first, valid))
    near, whole = results
    # the solver stops at a thousandth of displacements of up to 1.5 mm
    np.testing.assert_allclose(near.mesh.vertices, whole.mesh.vertices, atol=1.5e-3)
    np.testing.assert_array_equal(near.pair_bits, whole.pair_bits)
    np.testing.assert_array_equal(near.sigma_mm, whole.sigma_mm)
    far = first.vertices[:, 2] < -0.9 * RADIUS
    np.testing.assert_array_equal(near.mesh.vertices[far], first.vertices[far])
    assert (near.provenance[far] == Provenance.INVENTED).all()


def test_provenance_and_pair_bits_say_who_saw_what():
    first = sphere_mesh(RADIUS, rings=60)
    valid = valid_views([(0, 0, 1), (1, 0, 1)])
    result = repair(first, valid)
    z, x = first.vertices[:, 2], first.vertices[:, 0]
    top = z > 0.9 * RADIUS
    assert (result.provenance[top] == Provenance.MEASURED).all()
    assert (result.pair_bits[top & (x > 0)] == 0b11).all()
    far_left = (x < -0.6 * RADIUS) & (z > 0.6 * RADIUS)  # the second view sees it at 80° and more
    assert (result.pair_bits[far_left] == 0b01).all()
    assert result.pair_names == ("c0", "c1")
    below = (z < -0.9 * RADIUS) & (x < 0)
    assert (result.provenance[below] == Provenance.INVENTED).all()
    assert np.isnan(result.sigma_mm[result.provenance != Provenance.MEASURED]).all()
    assert (result.pair_bits[result.provenance != Provenance.MEASURED] == 0).all()
    # across the surface σ = .05 mm cos(incidence), with the floor of .05 mm; two views reduce it
    seen_once, seen_twice = result.sigma_mm[far_left], result.sigma_mm[top & (x > 0)]
    assert (seen_once > 0.05).all()
    assert (seen_once < 0.071).all()
    assert seen_twice.max() < 0.051
    measured, beside = (
        first.vertices[result.provenance == kind] for kind in (Provenance.MEASURED, Provenance.REPAIRED)
    )
    assert len(beside)
    assert cKDTree(measured).query(beside)[0].max() <= 2.0  # nothing further away is claimed


def test_a_hole_in_the_data_keeps_the_shape_between():
    hole = lambda points: np.linalg.norm(points - [0, 0, RADIUS], axis=-1) > 8.0  # noqa: E731
    first = sphere_mesh(RADIUS + 0.4, rings=60)
    filled = repair(first, valid_views(AROUND, hole), RepairSettings(fade_mm=0.0))
    # The paper's propagation carries the displacement of the hole's rim (−.4 mm) over the hole.
    inside = np.linalg.norm(first.vertices - [0, 0, RADIUS], axis=1) < 5.0
    assert (filled.provenance[inside] != Provenance.MEASURED).all()
    # What is left is the sagitta of the data's own spacing and the rim's weaker weights: a quarter of the way.
    assert np.abs(radial_error(filled.mesh)[inside]).max() < 0.12
    faded = repair(first, valid_views(AROUND, hole), RepairSettings(fade_mm=1.0))
    assert radial_error(faded.mesh)[inside].mean() > 0.15


def test_displacements_are_carried_ring_by_ring():
    edges = np.array([[0, 1], [1, 2], [2, 3], [3, 4], [5, 6]])
    known = np.array([True, False, False, False, True, False, False])
    along = np.array([0.0, 2.0, 3.0, 5.0, 6.0, 8.0, 9.0])
    vertices = np.stack([along, 0 * along, 0 * along], axis=1)
    values, away_mm = propagate(np.array([[1.0], [9], [9], [9], [3.0], [9], [9]]), known, graph_of(edges, 7), vertices)
    # 1 → 1, 3 → 3, then 2 takes the mean of both; 5–6 are reached by none
    np.testing.assert_allclose(values[:, 0], [1, 1, 2, 3, 3, 0, 0])
    np.testing.assert_allclose(away_mm, [0, 2, 3, 1, 0, np.inf, np.inf])


def test_no_triangle_turns_over():
    rng = np.random.default_rng(5)
    sphere = sphere_mesh(RADIUS, rings=80)  # edges down to .05 mm at the poles, far below the moves
    noisy = TriangleMesh(
        vertices=sphere.vertices * (1 + 0.01 * rng.normal(size=(len(sphere.vertices), 1))), faces=sphere.faces
    )
    result = repair(noisy, valid_views(AROUND))
    turned = np.einsum("ij,ij->i", noisy.face_vectors(), result.mesh.face_vectors()) < 0
    assert turned.mean() < 1e-3


@pytest.mark.slow
def test_two_sheets_that_data_pull_through_one_another_stay_apart(monkeypatch):
    """The near side of a second body lies where the data have the first: both are drawn to one surface."""
    sphere, above = sphere_mesh(RADIUS - 0.3, rings=60), sphere_mesh(12.0, rings=40)
    both = TriangleMesh(
        vertices=np.concatenate([sphere.vertices, above.vertices * [1, 1, 0.3] + [0, 0, RADIUS + 3.6]]),
        faces=np.concatenate([sphere.faces, above.faces + len(sphere.vertices)]),
    )
    assert len(crossing_faces(both)) == 0
    # almost without a limit to the normals the second body's lower side follows the data, too
    monkeypatch.setattr("mammometry.surface.repair.repair.NORMAL_ANGLE_DEG", 179.0)
    result = repair(both, valid_views(AROUND), RepairSettings(rho=0.01))
    assert result.crossings == 0
    assert len(crossing_faces(result.mesh)) == 0
    np.testing.assert_array_equal(result.mesh.faces, both.faces)
    far = sphere.vertices[:, 2] < 0  # elsewhere nothing is held back
    assert np.abs(np.linalg.norm(result.mesh.vertices[: len(far)][far], axis=1) - RADIUS).max() < 0.05


def test_data_far_from_the_first_surface_are_an_error():
    far = sphere_mesh(RADIUS + 20.0)
    with pytest.raises(SurfaceError, match="pairs c0, c1: "):
        repair(far, valid_views([(0, 0, 1), (1, 0, 1)]))


def test_a_surface_needs_one_entry_per_vertex():
    mesh = sphere_mesh(10.0, rings=4)
    with pytest.raises(ValueError, match="vertex"):
        RepairedSurface(
            mesh=mesh,
            provenance=np.zeros(3, dtype=np.uint8),
            sigma_mm=np.zeros(3, dtype=np.float32),
            pair_bits=np.zeros(3, dtype=np.int32),
            pair_names=(),
            convergence=np.zeros(0),
        )
