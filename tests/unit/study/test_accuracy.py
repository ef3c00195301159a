"""The rulers themselves, on spheres whose distances are known."""

import numpy as np
import pytest
import trimesh

from mammometry.geometry.mesh import TriangleMesh
from mammometry.study.accuracy import compare_surfaces, compare_volumes


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
    assert found.completeness == 1.0


def test_a_shift_has_no_bias_and_its_known_rms() -> None:
    found = compare_surfaces(sphere(50.0, (0.2, 0.0, 0.0)), sphere(50.0))
    assert found.bias_mm == pytest.approx(0.0, abs=0.02)
    assert found.rms_mm == pytest.approx(0.2 / np.sqrt(3), abs=0.02)  # mean of cos² over the sphere is 1/3


def test_half_a_sphere_is_half_complete() -> None:
    truth = sphere(50.0)
    centres = truth.corners().mean(axis=1)
    found = compare_surfaces(truth.submesh(centres[:, 2] > 0), truth)
    assert found.completeness == pytest.approx(0.5, abs=0.02)
    assert found.rms_mm < 1e-9


def test_only_chosen_vertices_are_judged() -> None:
    bad = sphere(50.0)
    moved = bad.vertices.copy()
    moved[0] *= 2
    measured = TriangleMesh(vertices=moved, faces=bad.faces)
    good = np.arange(len(moved)) > 0
    assert compare_surfaces(measured, bad).rms_mm > 0.5
    assert compare_surfaces(measured, bad, of_measured=good).rms_mm < 1e-9


def test_nothing_to_compare_is_refused() -> None:
    ball = sphere(50.0)
    with pytest.raises(ValueError, match="nothing to compare"):
        compare_surfaces(ball, ball, of_measured=np.zeros(len(ball.vertices), dtype=bool))


def test_volumes_beside_one_another() -> None:
    found = compare_volumes(410.0, 400.0, (395.0, 425.0))
    assert (found.error_cc, found.error_percent, found.covered) == (10.0, 2.5, True)
    assert compare_volumes(410.0, 400.0, (405.0, 425.0)).covered is False
    assert compare_volumes(410.0, 400.0).covered is None
