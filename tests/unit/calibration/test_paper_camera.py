"""The paper's eleven parameters and our cameras say the same."""

import json
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from virtual_rig import PAIRS, cameras_in_rig, observe, placements

from mammometry.calibration.adjust.bundle import calibrate
from mammometry.calibration.settings import BundleSettings, CalibrateSettings
from mammometry.io.cameras.own import PaperCamera, cameras_from_table, cameras_table

ANGLE = st.floats(-3.1, 3.1)
MM = st.floats(-2000.0, 2000.0)


@st.composite
def paper_cameras(draw: st.DrawFn) -> PaperCamera:
    x_mm, y_mm, z_mm = draw(st.tuples(MM, MM, MM))
    return PaperCamera(
        alpha_rad=draw(ANGLE),
        beta_rad=draw(st.floats(-1.5, 1.5) | st.sampled_from([-np.pi / 2, np.pi / 2])),
        gamma_rad=draw(ANGLE),
        x_mm=x_mm,
        y_mm=y_mm,
        z_mm=z_mm,
        x0_px=draw(st.floats(0.0, 4000.0)),
        y0_px=draw(st.floats(0.0, 3000.0)),
        f_px=draw(st.floats(500.0, 9000.0)),
        mu=draw(st.floats(-0.2, 0.2)),
        nu=draw(st.floats(-0.2, 0.2)),
    )


@settings(deadline=None, max_examples=50)
@given(paper_cameras())
def test_there_and_back(paper: PaperCamera) -> None:
    """The same camera, and, but for β at a right angle where the angles are not unique, the same numbers."""
    camera = paper.camera("one", (4504, 3000))
    expected = Rotation.from_euler("xyz", [paper.alpha_rad, paper.beta_rad, paper.gamma_rad]).as_matrix()
    np.testing.assert_allclose(camera.camera_from_world.rotation, expected, atol=1e-12)
    np.testing.assert_allclose(camera.centre_world, [paper.x_mm, paper.y_mm, paper.z_mm], atol=1e-9)
    found = PaperCamera.of(camera)
    assert found is not None
    again = found.camera("one", (4504, 3000))
    np.testing.assert_allclose(again.camera_from_world.rotation, camera.camera_from_world.rotation, atol=1e-12)
    np.testing.assert_array_equal(again.matrix, camera.matrix)
    np.testing.assert_array_equal(again.distortion, camera.distortion)
    if abs(paper.beta_rad) <= 1.5:
        np.testing.assert_allclose(list(found.as_table().values()), list(paper.as_table().values()), atol=1e-9)


def test_cameras_with_more_parameters_have_no_eleven() -> None:
    angles = {"alpha_rad": 0.1, "beta_rad": 0.2, "gamma_rad": 0.3}
    paper = PaperCamera(**angles, x_mm=1.0, y_mm=2.0, z_mm=3.0, x0_px=4.0, y0_px=5.0, f_px=6.0, mu=0.1, nu=0.2)
    camera = paper.camera("one", (10, 10))
    matrix = camera.matrix.copy()
    matrix[1, 1] *= 1.0001
    assert PaperCamera.of(replace(camera, matrix=matrix)) is None
    for place in (2, 3, 4):
        distortion = camera.distortion.copy()
        distortion[place] = 1e-4
        assert PaperCamera.of(replace(camera, distortion=distortion)) is None


def test_calibrating_with_the_paper_s_model_gives_its_parameters_in_cameras_json() -> None:
    papers = CalibrateSettings(bundle=BundleSettings(model="paper", free_target="never"))
    rig = calibrate(observe(cameras_in_rig(), placements(4)), PAIRS, "virtual", papers).rig
    table = json.loads(json.dumps(cameras_table(rig.cameras)))
    for name, camera in cameras_from_table(table, "cameras.json").items():
        eleven = table["cameras"][name]["paper"]
        assert len(eleven) == 11
        again = PaperCamera(**eleven).camera(name, camera.size_wh)
        points = np.random.default_rng(0).uniform(-80, 80, size=(20, 3)) + camera.centre_world
        points += 800 * camera.axis_world
        np.testing.assert_allclose(again.project(points), camera.project(points), atol=1e-8)
    assert "paper" not in cameras_table(cameras_in_rig())["cameras"]["front_left"]
    assert eleven["f_px"] == pytest.approx(2000, rel=0.02)
