"""Two scans of one visit: registration from anywhere, refusals, and one mesh of both."""

from __future__ import annotations

import re

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from tests.first_cases import first
from tests.unit.measure.two_scans import SIDE_MM, height_mm, painted, part

from mammometry.base.errors import MeasureError
from mammometry.geometry import Transform, TriangleMesh
from mammometry.measure.merging.fusion import fuse_scans
from mammometry.measure.merging.registration import LARGEST_SCALE, REFUSE_MM, fit_scans

FIRST = part(-150.0, 90.0, seed=1)
SECOND = part(-90.0, 150.0, seed=2)
FIRST_FROM_SECOND = Transform(
    rotation=Rotation.from_rotvec([1.2, -0.8, 2.0]).as_matrix(), translation_mm=np.array([300.0, -80.0, 900.0])
)


@pytest.mark.slow
@pytest.mark.parametrize("first_from_second", [Transform.identity(), FIRST_FROM_SECOND], ids=["as given", "anywhere"])
@pytest.mark.requirement("R-MERGE-1")
def test_a_scan_is_found_on_the_other_one_wherever_it_lies(first_from_second: Transform) -> None:
    fit = fit_scans(FIRST, SECOND.transformed(first_from_second.inverse()))
    back = (fit.first_from_second @ first_from_second.inverse()).apply(SECOND.vertices)
    off_mm = np.linalg.norm(back - SECOND.vertices, axis=1)
    assert off_mm.mean() < 0.1  # the noise of a vertex
    assert fit.within_mm < 0.1
    assert abs(fit.scale) < 5e-4
    assert fit.overlap > 0.6  # 180 of 240 mm are in both, less the edges
    assert not fit.doubtful
    assert 0 < fit.sigma_mm < 0.2


def scaled(factor: float) -> TriangleMesh:
    return SECOND.mapped(lambda points: factor * points)


@pytest.mark.slow
@pytest.mark.parametrize("factor", first(1, [1.01, 0.99, 1.1]))
@pytest.mark.requirement("R-MERGE-2")
def test_another_scale_is_refused_with_its_percentage(factor: float) -> None:
    with pytest.raises(MeasureError) as refused:
        fit_scans(FIRST, scaled(factor))
    assert abs(factor - 1) > LARGEST_SCALE
    words = "larger" if factor > 1 else "smaller"
    assert words in refused.value.found
    stated = float(refused.value.found.split()[1])
    assert stated == pytest.approx(100 * abs(factor - 1), abs=0.15)


@pytest.mark.slow
@pytest.mark.requirement("R-MERGE-2")
def test_a_mirrored_scan_is_refused_as_one() -> None:
    mirrored = SECOND.mapped(lambda points: points * [-1.0, 1.0, 1.0]).turned_over()
    with pytest.raises(MeasureError, match="mirror"):
        fit_scans(FIRST, mirrored)


@pytest.mark.slow
@pytest.mark.requirement("R-MERGE-2")
def test_a_breast_that_moved_between_the_scans_is_refused() -> None:
    with pytest.raises(MeasureError, match="moved") as refused:
        fit_scans(FIRST, part(-90.0, 150.0, lift_mm=-4 * REFUSE_MM, seed=2))
    assert re.search(r"\d mm\b", refused.value.found)


@pytest.mark.slow
@pytest.mark.requirement("R-MERGE-2")
def test_scans_that_share_too_little_are_refused() -> None:
    with pytest.raises(MeasureError) as refused:
        fit_scans(part(-150.0, 10.0, seed=1), part(-25.0, 150.0, seed=2))
    assert re.search("front|again", refused.value.remedy)


@pytest.mark.requirement("R-MERGE-3")
def test_both_scans_become_one_surface_that_says_who_showed_what() -> None:
    fused = fuse_scans([painted(FIRST, 0), painted(SECOND, 200)])
    x, y, z = fused.mesh.vertices.T
    inside = (np.abs(x) < 130) & (np.abs(y) < 130)
    off_mm = (z - height_mm(x, y))[inside]
    assert np.sqrt(np.mean(off_mm**2)) < 0.25  # noise, and chords of 5 mm on bumps of 38 mm radius
    assert fused.mesh.components()[0] == 1
    assert y.min() < -140
    assert y.max() > 140
    assert set(fused.sources[y < -100]) == {1}
    assert set(fused.sources[y > 100]) == {2}
    assert set(fused.sources[(np.abs(y) < 50) & (np.abs(x) < 130)]) == {3}
    assert fused.colours[y < -100].max() == 0
    assert fused.colours[y > 100].min() == 200
    assert np.abs(fused.colours[np.abs(y) < 20].mean() - 100) < 15


@pytest.mark.slow
@pytest.mark.requirement("R-MERGE-3")
def test_a_difference_of_both_scans_makes_no_step_at_the_seam() -> None:
    lifted = SECOND.mapped(lambda points: points + np.array([0.0, 0.0, 1.0]))
    fused = fuse_scans([painted(FIRST, 0), painted(lifted, 0)])
    x, y, z = fused.mesh.vertices.T
    off_mm = z - height_mm(x, y)
    for seam in (-90.0, 90.0):
        rows = [
            off_mm[(np.abs(x) < 100) & (np.abs(y - seam - k) < SIDE_MM)].mean() for k in np.arange(-25.0, 26.0, 5.0)
        ]
        assert np.abs(np.diff(rows)).max() < 0.35  # of 1 mm: spread over 25 mm, not at one edge


@pytest.mark.slow
@pytest.mark.requirement("R-MERGE-3")
def test_what_neither_scan_shows_stays_open() -> None:
    def holed(mesh: TriangleMesh) -> TriangleMesh:
        away = np.linalg.norm(mesh.vertices[:, :2] - [-60.0, -10.0], axis=1)
        return mesh.submesh((away > 25.0)[mesh.faces].all(axis=1))

    fused = fuse_scans([painted(holed(FIRST), 0), painted(holed(SECOND), 0)])
    away = np.linalg.norm(fused.mesh.vertices[:, :2] - [-60.0, -10.0], axis=1)
    assert away.min() > 20.0
    whole = fuse_scans([painted(holed(FIRST), 0), painted(SECOND, 0)])
    away = np.linalg.norm(whole.mesh.vertices[:, :2] - [-60.0, -10.0], axis=1)
    near = away < 15.0
    assert near.sum() > 50
    assert set(whole.sources[near]) == {2}
