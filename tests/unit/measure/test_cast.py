"""A cast from its silhouettes to its volumes, on domes whose base and volume are known."""

from collections.abc import Mapping
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from solids import as_surface, dome, rig_around, silhouettes

from mammometry.base.errors import MeasureError
from mammometry.base.normal import COVERAGE_95
from mammometry.matching.foreground.foreground import Foreground
from mammometry.measure.boundary.boundary import (
    RIM_RADIUS_SIGMA_MM,
    Boundary,
    find_base,
    find_boundaries,
    leaving_whole,
)
from mammometry.measure.boundary.cast_base import Base, moved
from mammometry.measure.boundary.cast_rim import adjust_base, mean_height, require_separate, rim_candidates
from mammometry.measure.settings import BaseRimSettings, MeasureSettings
from mammometry.measure.volume import volumes
from mammometry.measure.wall import chest_wall
from mammometry.measure.wall.open_breast import OpenBreast
from mammometry.surface.repair.repair import Provenance, RepairedSurface

RIG = rig_around()
# The made silhouettes show the dome to its very edge.
EXACT = MeasureSettings(base_rim=BaseRimSettings(rim_radius_mm=0.0))


@cache
def photographed(bend_radius_mm: float | None) -> Mapping[str, Foreground]:
    return silhouettes(dome(bend_radius_mm), RIG)


@cache
def seen_surface(bend_radius_mm: float | None) -> RepairedSurface:
    """The dome as a repaired surface gives it: measured down to 1.5 mm above the rim, its floor closed 6 mm behind."""
    whole = dome(bend_radius_mm, sink_mm=6.0)
    normals = whole.vertex_normals()
    rim = dome(bend_radius_mm).vertices
    measured = np.zeros(len(whole.vertices), dtype=bool)
    skirt = 1 + 59 * 240  # ring 59 of the dome lies 1.3 mm above the rim
    measured[:skirt] = normals[:skirt] @ np.array([0.0, 0.0, 1.0]) > -0.2
    assert np.array_equal(rim[:skirt], whole.vertices[:skirt])
    return as_surface(whole, measured)


@cache
def found_boundary(bend_radius_mm: float | None, settings: MeasureSettings = EXACT) -> Boundary:
    surface = seen_surface(bend_radius_mm)
    (boundary,) = find_boundaries(surface, photographed(bend_radius_mm), RIG, "model", settings)
    return boundary


@pytest.mark.parametrize("bend_radius_mm", [None, pytest.param(200.0, marks=pytest.mark.slow)])
def test_a_cast_is_measured_to_half_a_percent(bend_radius_mm: float | None) -> None:
    surface = seen_surface(bend_radius_mm)
    boundary = found_boundary(bend_radius_mm)
    wall = chest_wall.fit(OpenBreast(boundary=boundary, surface=surface, settings=EXACT))
    found = volumes.measure(boundary, wall, EXACT)
    exact_cc = dome(bend_radius_mm).volume_mm3() / 1000
    assert found.volume_cc == pytest.approx(exact_cc, rel=5e-3)
    assert found.wall_kind == ("plane" if bend_radius_mm is None else "convex-cylinder")
    assert found.watertight
    assert found.interval_cc is not None
    assert found.interval_cc[0] < found.volume_cc < found.interval_cc[1]
    assert found.base_area_cm2 == pytest.approx(np.pi * 36, rel=0.05)
    assert found.projection_mm == pytest.approx(50, abs=6)  # over the rim's best plane, which a bent base dips below
    assert len(boundary.evidence_world) > 500
    assert "cameras" in boundary.method


@pytest.mark.slow
def test_the_base_is_put_behind_a_rounded_rim() -> None:
    """By half its radius, be it assumed or told; what is told overrules what is assumed."""
    surface, silhouettes = seen_surface(None), photographed(None)

    def height_mm(given_mm: float | None, assumed: float) -> float:
        settings = MeasureSettings(base_rim=BaseRimSettings(rim_radius_mm=assumed))
        (found,) = find_boundaries(surface, silhouettes, RIG, "model", settings, rim_radius_mm=given_mm)
        assert f"as {assumed if given_mm is None else given_mm:g} mm" in found.method
        return float(found.points_world[:, 2].mean())

    sharp = found_boundary(None, EXACT).points_world[:, 2].mean()
    assert sharp - height_mm(None, 0.6) == pytest.approx(0.3, abs=1e-3)
    assert sharp - height_mm(0.2, 0.6) == pytest.approx(0.1, abs=1e-3)


@pytest.mark.slow
def test_half_of_the_rims_own_uncertainty_is_the_bases(monkeypatch: pytest.MonkeyPatch) -> None:
    """Once for all: the rest of the base's uncertainty does not depend on how well the rim's radius is known."""
    one = found_boundary(None).sigma_mm
    monkeypatch.setattr("mammometry.measure.boundary.boundary.RIM_RADIUS_SIGMA_MM", 0.8)
    other = found_boundary.__wrapped__(None).sigma_mm  # not the cached one
    assert one is not None
    assert other is not None
    assert other**2 - one**2 == pytest.approx(0.4**2 - 0.07**2)


def test_the_interval_of_an_assumed_rim_holds_a_sharp_one() -> None:
    """Each base lies half a radius behind its rim: what holds for the radii holds for the volumes."""
    assert BaseRimSettings().rim_radius_mm <= COVERAGE_95 * RIM_RADIUS_SIGMA_MM


@pytest.mark.slow
def test_the_sharper_a_limb_may_be_the_fewer_points_can_only_be_rim(monkeypatch: pytest.MonkeyPatch) -> None:
    counts = []
    for radius_mm in (2.0, 8.0, 40.0):
        monkeypatch.setattr("mammometry.measure.boundary.cast_rim.SHARPEST_LIMB_MM", radius_mm)
        counts.append(len(rim_candidates(seen_surface(None), photographed(None), RIG).points_world))
    assert counts[0] < counts[1] < counts[2]


@pytest.mark.slow
def test_a_base_moves_with_an_outline_as_told() -> None:
    """One camera's rays turned outwards by a twentieth of a pixel, against the linear theory behind the interval."""
    candidates = rim_candidates(seen_surface(None), photographed(None), RIG)
    start = Base(origin=np.zeros(3), frame=np.eye(3), curvature_per_mm=0.0)
    rim = dome().vertices[1 + 59 * 240 : 1 + 60 * 240]
    before = adjust_base(start, candidates, bend=False)
    seen = np.unique(candidates.camera)
    for number, camera in enumerate(seen):
        distance = np.linalg.norm(candidates.points_world - candidates.centres_world, axis=1)
        out = np.where(candidates.camera == camera, 0.05 * candidates.mm_per_px / distance, 0.0)
        turned = candidates.rays + out[:, None] * candidates.outward
        turned /= np.linalg.norm(turned, axis=1, keepdims=True)
        after = adjust_base(start, replace(candidates, rays=turned), bend=False)
        moves = [mean_height(moved(before.base, 0.01 * unit, before.extent_mm), rim) / 0.01 for unit in np.eye(3)]
        predicted_mm = 0.05 * (np.array(moves) - mean_height(before.base, rim) / 0.01) @ before.per_camera[:, number]
        found = mean_height(after.base, rim) - mean_height(before.base, rim)
        assert found == pytest.approx(predicted_mm, rel=0.25, abs=0.004)  # Tukey's weights change as well


@pytest.mark.slow
def test_a_rim_seen_in_part_leaves_the_base_uncertain() -> None:
    candidates = rim_candidates(seen_surface(None), photographed(None), RIG)
    part = candidates.chosen(candidates.points_world[:, 1] > 25.0)
    start = Base(origin=np.zeros(3), frame=np.eye(3), curvature_per_mm=0.0)
    rim = dome().vertices[1 + 59 * 240 : 1 + 60 * 240]
    whole_mm, part_mm = (adjust_base(start, seen, bend=False).sigma_mm(rim) for seen in (candidates, part))
    assert whole_mm < 0.2
    assert part_mm > 3 * whole_mm


@pytest.mark.slow
def test_a_sixth_of_a_rim_is_too_little() -> None:
    surface = seen_surface(None)
    candidates = rim_candidates(surface, photographed(None), RIG)
    part = candidates.chosen(candidates.points_world[:, 1] > 52.0)
    with pytest.raises(MeasureError, match="directions"):
        find_base(part, surface.mesh.vertices, np.array([0.0, 0.0, 1.0]))


@pytest.mark.slow
def test_a_flat_base_has_a_bent_rival_close_by() -> None:
    surface = seen_surface(None)
    candidates = rim_candidates(surface, photographed(None), RIG)
    found, rivals = find_base(candidates, surface.mesh.vertices, np.array([0.0, 0.0, 1.0]))
    rim = dome().vertices[1 + 59 * 240 : 1 + 60 * 240]
    assert found.base.is_plane
    assert rivals
    assert max(abs(mean_height(rival, rim) - mean_height(found.base, rim)) for rival in rivals) < 0.1


@pytest.mark.slow
def test_a_bent_base_is_found_where_a_part_of_its_rim_only_is_seen() -> None:
    """A third of the rim is hidden; a plane, and cylinders bent another way, fit the rest nearly."""
    surface = seen_surface(200.0)
    candidates = rim_candidates(surface, photographed(200.0), RIG)
    part = candidates.chosen(candidates.points_world[:, 1] < 30.0)
    measured = surface.mesh.vertices[surface.provenance == Provenance.MEASURED]
    found, _ = find_base(part, measured, np.array([0.0, 0.0, 1.0]))
    rim = dome(200.0).vertices[1 + 59 * 240 : 1 + 60 * 240]
    true = Base(origin=np.zeros(3), frame=np.eye(3), curvature_per_mm=1 / 200)
    assert 1 / found.base.curvature_per_mm == pytest.approx(200.0, rel=0.05)  # .5 mm of a sag of 9
    assert mean_height(found.base, rim) == pytest.approx(mean_height(true, rim), abs=0.3)


@pytest.mark.slow
def test_a_base_that_cuts_measured_skin_off_is_none() -> None:
    surface = seen_surface(None)
    candidates = rim_candidates(surface, photographed(None), RIG)
    start = Base(origin=np.zeros(3), frame=np.eye(3), curvature_per_mm=0.0)
    good = adjust_base(start, candidates, bend=False)
    high = replace(good, base=moved(good.base, np.array([0.0, 0.0, 20.0]), 1.0))
    measured = surface.mesh.vertices[surface.provenance == Provenance.MEASURED]
    assert leaving_whole([high, good], measured) == [good]
    assert leaving_whole([high], measured) == [high]


@pytest.mark.slow
def test_limbs_are_no_candidates_for_the_rim() -> None:
    candidates = rim_candidates(seen_surface(None), photographed(None), RIG)
    heights = candidates.points_world[:, 2]
    assert len(heights) > 900
    # From the left and right the far limb stands up to 40 mm above the base; hardly a point of it may remain.
    assert (np.abs(heights) < 1.5).mean() > 0.95
    assert np.allclose(np.linalg.norm(candidates.rays, axis=1), 1)
    radial = candidates.points_world * [1, 1, 0]
    assert ((candidates.outward * radial).sum(axis=1) > 0).mean() > 0.99


@pytest.mark.slow
def test_rays_go_through_their_candidates() -> None:
    candidates = rim_candidates(seen_surface(None), photographed(None), RIG)
    towards = candidates.points_world - candidates.centres_world
    along = (towards * candidates.rays).sum(axis=1, keepdims=True) * candidates.rays
    assert np.abs(towards - along).max() < 1e-9
    assert np.abs((candidates.outward * candidates.rays).sum(axis=1)).max() < 1e-9


@pytest.mark.slow
def test_without_silhouettes_there_is_no_rim() -> None:
    everything = {name: replace(seen, everything=True) for name, seen in photographed(None).items()}
    with pytest.raises(MeasureError, match=f"model: .*{len(everything)} of {len(everything)}"):
        find_boundaries(seen_surface(None), everything, RIG, "model")
    with pytest.raises(MeasureError, match=r"model: .*\b0 "):
        find_boundaries(seen_surface(None), {}, RIG, "model")


def reaching_the_edge(count: int) -> dict[str, Foreground]:
    """Silhouettes, of which `count` contain the surroundings up to the photograph's edge."""
    found = dict(photographed(None))
    for name in list(found)[:count]:
        coverage = found[name].coverage.copy()
        coverage[-1] = 1.0
        found[name] = replace(found[name], coverage=coverage)
    return found


def test_a_cast_that_runs_into_its_surroundings_in_most_photographs_is_refused() -> None:
    most = len(photographed(None)) // 2 + 1
    with pytest.raises(MeasureError, match=list(photographed(None))[most - 1]):
        require_separate(reaching_the_edge(most))
    require_separate(reaching_the_edge(most - 1))


def test_a_base_far_from_the_surface_does_not_cut_it() -> None:
    whole = seen_surface(None)
    far = Boundary(name="model", points_world=dome().vertices[-300:-1] - [0, 0, 40.0], method="test")
    with pytest.raises(MeasureError, match=r"model: .*opening"):
        chest_wall.fit(OpenBreast(boundary=far, surface=whole))


@pytest.mark.parametrize("kind", ["mirrored", "cylinder-membrane", "thorax-fit"])
def test_a_cast_has_no_chest_wall(kind: str) -> None:
    rim = Boundary(name="model", points_world=dome().vertices[-300:-1], method="test")
    with pytest.raises(MeasureError, match=r"^measure\.wall: .*default, plane, convex-cylinder"):
        chest_wall.fit(OpenBreast(boundary=rim, surface=seen_surface(None)), kind)


def test_a_surface_has_no_boundary() -> None:
    assert find_boundaries(seen_surface(None), {}, RIG, "surface") == ()


def test_no_interval_without_knowing_the_boundary() -> None:
    surface = seen_surface(None)
    rim = dome().vertices[1 + 59 * 240 : 1 + 60 * 240]
    boundary = Boundary(name="model", points_world=rim, method="test")
    found = volumes.measure(boundary, chest_wall.fit(OpenBreast(boundary=boundary, surface=surface)))
    assert found.interval_cc is None
    assert found.interval_note
    assert found.volume_cc == pytest.approx(dome().volume_mm3() / 1000, rel=1e-3)
