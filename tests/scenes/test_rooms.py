"""Captures as they come from outside clinics, measured by the defaults: axes meet elsewhere, tables are bright."""

import shutil
from pathlib import Path

import numpy as np
import pytest

from mammometry.api.job import open_session
from mammometry.geometry.nearest import closest_on_mesh
from mammometry.io.truth import read_truth
from mammometry.job.stages import match
from mammometry.simulate.recipe import SessionRecipe, parse_situation
from mammometry.simulate.rendering.skin import make_skin
from mammometry.simulate.session import write_session
from mammometry.simulate.studio import Studio


@pytest.mark.slow
def test_a_head_before_a_pale_wall_is_measured_where_the_axes_meet_before_it(tmp_path: Path, repository: Path) -> None:
    """Three cameras whose axes meet 335 mm ahead; the head stands at 540. It was refused: the wall was the subject."""
    session = tmp_path / "session"
    recipe = SessionRecipe(
        rig=str(repository / "benchmarks" / "accuracy" / "rigs" / "three.toml"),
        subject="head",
        scale=0.15,
        seed=4,
        situation=parse_situation("pale-wall"),
    )
    write_session(session, recipe, Studio(skin=make_skin("skin")))
    job = open_session(session)
    job.ensure("surface", drawn=False)
    assert not job.plan[match.subjects]().blind
    truth = read_truth(session / "truth", job.inputs.pair_names)
    calibration = job.calibration()
    assert calibration is not None
    world = next(iter(calibration.world_from_target))
    mesh = job.surface().repaired.mesh.transformed(truth.rig_from_target[world])
    away = closest_on_mesh(mesh.vertices[::5], truth.mesh).distances_mm
    assert np.median(away) < 0.3
    assert (away > 3.0).mean() < 0.01
    assert np.ptp(mesh.vertices, axis=0)[1] > 200.0  # of a head of 265 mm


@pytest.mark.slow
def test_a_dark_figure_on_a_bright_table_is_found_by_given_cameras(tmp_path: Path, repository: Path) -> None:
    """No target was seen by them. The table was the subject in all twelve photographs."""
    from mammometry.io.photographs.images import read_photograph
    from mammometry.matching.foreground.all_cameras import find_subjects
    from mammometry.study.rays import RayScene, pixel_grid

    session = tmp_path / "session"
    rig = str(repository / "benchmarks" / "accuracy" / "rigs" / "around.toml")
    recipe = SessionRecipe(
        rig=f"{rig}:pair_00,pair_01,pair_02", subject="figure", scale=0.4, seed=4, poses=1,
        situation=parse_situation("table,grey"),
    )  # fmt: skip
    write_session(session, recipe, Studio(skin=make_skin("dark-skin")))
    shutil.rmtree(session / "calibration")
    names = {f"pair_0{k}": (f"camera_0{k}", f"camera_0{k + 1}") for k in range(3)}
    truth = read_truth(session / "truth", names)
    shots = {name: read_photograph(session / "capture" / f"{name}.jpg", name) for name in truth.rig.cameras}
    found = find_subjects(truth.rig, shots)
    assert set(found.blocks) == set(shots)
    scene = RayScene(truth.mesh)
    for name, camera in truth.rig.cameras.items():
        true = scene.cast(camera.centre_world, camera.rays_world(pixel_grid(camera))).hit
        mask = np.kron(found.blocks[name], np.ones((2, 2), dtype=bool))[: true.shape[0], : true.shape[1]]
        assert (mask & true).sum() > 0.95 * true.sum()
        assert (mask & ~true).sum() < 0.1 * true.sum()
