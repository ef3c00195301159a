"""The rulers themselves, on spheres whose distances are known."""

import numpy as np
import pytest
import trimesh

from mammometry.geometry.mesh import TriangleMesh
from mammometry.geometry.transform import Transform
from mammometry.study.accuracy import align_surfaces, compare_surfaces, compare_volumes, map_errors


def sphere(radius_mm: float, centre: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> TriangleMesh:
    ball = trimesh.creation.icosphere(subdivisions=4, radius=radius_mm)
    return TriangleMesh(vertices=np.asarray(ball.vertices) + centre, faces=np.asarray(ball.faces).astype(np.int32))


@pytest.mark.parametrize(("radius_mm", "signed"), [(50.3, 0.3), (49.7, -0.3)])
def test_concentric_spheres_differ_by_their_radii(radius_mm: float, signed: float) -> None:
    found = compare_surfaces(sphere(radius_mm), sphere(50.0))
    # The facets of an icosphere of 2562 vertices lie up to .07 mm inside a sphere of 50 mm.
    assert found.bias_mm == pytest.approx(signed, abs=0.07)
    assert found.mean_mm == pytest.approx(0.3, abs=0.07)
    assert found.p95_mm >= found.median_mm
    assert found.rms_mm >= found.mean_mm
    assert found.complete_percent == pytest.approx(100)
    area = 4 * np.pi * 50.0**2
    assert found.volume_bias_cc == pytest.approx(signed * area / 1000, rel=0.25)  # the facets again


def test_a_shift_has_no_bias_and_its_known_rms() -> None:
    found = compare_surfaces(sphere(50.0, (0.2, 0.0, 0.0)), sphere(50.0))
    assert found.bias_mm == pytest.approx(0.0, abs=0.02)
    assert found.rms_mm == pytest.approx(0.2 / np.sqrt(3), abs=0.02)  # mean of cos² over the sphere is 1/3


def test_half_a_sphere_is_half_complete() -> None:
    truth = sphere(50.0)
    centres = truth.corners().mean(axis=1)
    half = truth.submesh(centres[:, 2] > 0)
    found = compare_surfaces(half, truth)
    assert found.complete_percent == pytest.approx(50, abs=2)
    seen = np.flatnonzero(truth.vertices[:, 2] > 1.0)
    found = compare_surfaces(half, truth, at=seen)
    assert (found.rms_mm, found.complete_percent) == (pytest.approx(0.0, abs=1e-9), pytest.approx(100))


def test_skin_that_is_not_claimed_counts_for_the_share_alone() -> None:
    truth = sphere(50.0)
    behind = truth.vertices[:, 2] < 0
    dented = TriangleMesh(vertices=truth.vertices * np.where(behind, 0.9, 1.0)[:, None], faces=truth.faces)
    assert compare_surfaces(dented, truth).mean_mm > 2
    found = compare_surfaces(dented, truth, at=np.flatnonzero(np.abs(truth.vertices[:, 2]) > 8), claimed=~behind)
    assert found.claimed_percent == pytest.approx(50, abs=1)
    assert (found.mean_mm, found.complete_percent) == (pytest.approx(0.0, abs=1e-9), pytest.approx(100))


def test_a_true_point_counts_by_its_area() -> None:
    # Two squares far apart, one a hundred times the other: the small one is measured 1 mm too high.
    def square(side: float, x: float, z: float) -> np.ndarray:
        return np.array([[0, 0, 0], [side, 0, 0], [side, side, 0], [0, side, 0]]) + np.array([x, 0.0, z])

    faces = np.array([[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]], dtype=np.int32)
    truth = TriangleMesh(vertices=np.concatenate([square(100.0, 0, 0), square(10.0, 500, 0)]), faces=faces)
    raised = TriangleMesh(vertices=np.concatenate([square(100.0, 0, 0), square(10.0, 500, 1)]), faces=faces)
    found = compare_surfaces(raised, truth)
    assert found.mean_mm == pytest.approx(1 / 101)
    assert found.rms_mm == pytest.approx(np.sqrt(1 / 101))
    assert found.volume_bias_cc == pytest.approx(0.1)  # 10 mm × 10 mm × 1 mm
    assert (found.median_mm, found.p95_mm) == (0.0, 0.0)
    assert found.complete_percent == pytest.approx(100 * 100 / 101)


def test_strays_show_in_the_map_of_the_measured_surface() -> None:
    truth = sphere(50.0)
    moved = truth.vertices.copy()
    moved[0] *= 1.2
    measured = TriangleMesh(vertices=moved, faces=truth.faces)
    everything = np.ones(len(moved), dtype=bool)
    found = map_errors(measured, truth, everything, truth_from_measured=Transform.identity())
    assert found.signed_mm[0] == pytest.approx(10.0, abs=0.01)
    assert np.abs(found.signed_mm[1:]).max() < 1e-9
    assert found.stray_percent == pytest.approx(100 / len(moved))
    unseen = map_errors(measured, truth, ~everything, truth_from_measured=Transform.identity())
    assert not unseen.judged.any()
    assert np.isnan(unseen.stray_percent)


def test_alignment_undoes_a_rigid_motion() -> None:
    # An ellipsoid, whose rotation shows.
    ball = sphere(1.0)
    truth = TriangleMesh(vertices=ball.vertices * (40.0, 55.0, 70.0), faces=ball.faces)
    measured_from_truth = Transform.from_rotation_vector(np.array([0.01, -0.006, 0.008]), np.array([0.5, -0.8, 0.3]))
    measured = truth.transformed(measured_from_truth)
    before = compare_surfaces(measured, truth)
    found = align_surfaces(measured, truth, np.arange(len(truth.vertices)))
    after = compare_surfaces(measured, truth, truth_from_measured=found)
    assert before.rms_mm > 0.4
    assert after.rms_mm < 0.01
    assert found.translation_mm == pytest.approx(measured_from_truth.inverse().translation_mm, abs=0.02)


def test_nothing_to_compare_is_refused() -> None:
    ball = sphere(50.0)
    with pytest.raises(ValueError, match="compare"):
        compare_surfaces(ball, ball, at=np.zeros(0, dtype=np.int64))


def test_volumes_beside_one_another() -> None:
    found = compare_volumes(410.0, 400.0, (395.0, 425.0))
    assert (found.error_cc, found.error_percent, found.covered) == (10.0, 2.5, True)
    assert compare_volumes(410.0, 400.0, (405.0, 425.0)).covered is False
    assert compare_volumes(410.0, 400.0).covered is None
