"""A fold under a hanging breast that a scan does not show."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from trunks import trunk_mesh

from mammometry.api.mesh import MeshFiles, MeshJob
from mammometry.job.stages import measure
from mammometry.measure.boundary.hidden_fold import hidden_fold_cm2
from mammometry.measure.scanned import as_scanned
from mammometry.report.words.doubts import body_doubts

CLEAN_CC = {"left": 601.7, "right": 665.8}  # the same body's clean mesh, measured by the same method


@pytest.mark.requirement("R-FRONT-3")
@pytest.mark.parametrize(("radius_mm", "found"), [(0.0, False), (17.0, False), (33.0, True)])
def test_a_fold_is_hidden_where_the_lower_border_runs_along_a_closed_hole(radius_mm: float, found: bool) -> None:
    """A round hole of 9 or 34 cm² below the middle of a border 90 mm long."""
    mesh = trunk_mesh(4.0)
    away_mm = np.linalg.norm(mesh.vertices - [0.0, -radius_mm, 125.0], axis=1)
    surface = as_scanned(mesh, away_mm < radius_mm)
    lower = np.stack([np.linspace(-45, 45, 37), np.zeros(37), np.full(37, 118.0)], axis=1)
    area_cm2 = hidden_fold_cm2(lower, surface)
    if found:
        assert area_cm2 == pytest.approx(np.pi * radius_mm**2 / 100, rel=0.15)
        assert hidden_fold_cm2(lower + np.array([0.0, 150.0, 0.0]), surface) == 0.0
        assert hidden_fold_cm2(lower, replace(surface, pair_names=("a",))) == 0.0
    else:
        assert area_cm2 == 0.0


@pytest.mark.slow
@pytest.mark.requirement("R-FRONT-3")
def test_a_hanging_breasts_interval_holds_its_clean_mesh_and_no_ptosis_is_stated(
    shared_data: Path, tmp_path: Path
) -> None:
    scan = shared_data / "scans" / "hanging_2_scan.ply"
    job = MeshJob(MeshFiles(mesh=scan, units="m", automatic=True), tmp_path / "out")
    for measured in job.plan[measure.measurements]():
        assert measured.interval_cc is not None
        low, high = measured.interval_cc
        assert low < CLEAN_CC[measured.name] < high
    assert job.plan[measure.dimensions]().ptosis == ()
    assert sum(notice.code == "fold-not-seen" for notice in body_doubts(job.plan)) == 2


@pytest.mark.slow
@pytest.mark.requirement("R-FRONT-3")
def test_breasts_that_reach_further_aside_than_the_trunk_are_measured_whole(shared_data: Path, tmp_path: Path) -> None:
    """The true volumes are those above the smallest cup that the body's generator has, not above a flat chest."""
    files = MeshFiles(mesh=shared_data / "scans" / "hanging_3_clean.ply", units="mm", automatic=True)
    truth = json.loads((shared_data / "scans" / "hanging_3_truth.json").read_text())["above_smallest_cup_cc"]
    measured = {one.name: one for one in MeshJob(files, tmp_path / "out").plan[measure.measurements]()}
    for name, true_cc in truth.items():
        assert measured[name].interval_cc is not None
        low_cc, high_cc = measured[name].interval_cc
        assert low_cc < true_cc < high_cc
        assert measured[name].volume_cc == pytest.approx(true_cc, rel=0.15)
