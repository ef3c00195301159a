"""A later exposure of the target against a calibration, in points: a rig that stands still, and one that does not."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from virtual_rig import PAIRS, cameras_in_rig, observe, placements, shifted, smooth_errors, with_views

from mammometry.base.errors import CalibrationError, ImageError
from mammometry.calibration.adjust.bundle import calibrate
from mammometry.calibration.adjust.linear_model import FREE
from mammometry.calibration.judge.check import Reference, check
from mammometry.calibration.judge.sighting import disagreement, sightings
from mammometry.calibration.settings import BundleSettings, CalibrateSettings
from mammometry.geometry.camera import Camera
from mammometry.geometry.transform import Transform

CAMERAS = cameras_in_rig()
POSES = placements(8)
LATER = placements(9, seed=31)
SHARED_PX = 0.03
STIFF = CalibrateSettings(bundle=BundleSettings(free_target="never", k3="zero"))


@pytest.fixture(scope="module")
def calibration():
    """With errors that the points of a photograph share, as real ones have."""
    observations = with_views(observe(CAMERAS, POSES), smooth_errors(5, SHARED_PX))
    return calibrate(observations, PAIRS, "virtual", STIFF)


@pytest.fixture(scope="module")
def reference(calibration):
    return Reference.of(calibration)


def exposed(cameras: dict[str, Camera], pose: str, seed: int):
    observations = observe(cameras, {pose: LATER[pose]}, seed=seed)
    return with_views(observations, smooth_errors(1000 + seed, SHARED_PX))


def test_rig_that_stands_still_gives_no_alarm_and_its_errors_are_counted_once(reference):
    """A camera's distance from the others is 2.3 of its own standard errors in the median if they are normal.

    Shared errors are in the covariance of the calibration and, estimated from its views, in the exposure's: counted
    twice, the distances would halve; not at all, they would be three times as long.
    """
    sigmas = []
    for seed, pose in enumerate(LATER):
        found = check(reference, exposed(CAMERAS, pose, seed))
        assert found.verdict == "unmoved"
        assert (found.verdict, len(found.cameras)) == ("unmoved", 4)
        sigmas += [one.motion.sigma for one in found.cameras.values()]
    assert 1.2 < np.median(sigmas) < 3.5


def test_inflation_of_the_exposure_leaves_the_calibration_s_errors_as_they_are(calibration):
    seen = sightings(calibration)[:3]

    def covariance_of(cameras, inflation=1.0):
        model = disagreement(seen, calibration.world_from_target, np.eye(3), cameras, inflation=inflation)
        return model.fit(np.full(18, FREE)).covariance

    own, once = covariance_of(None), covariance_of(calibration.covariance)
    thrice = covariance_of(calibration.covariance, inflation=3.0)
    np.testing.assert_allclose(thrice - 9 * own, once - own, rtol=1e-6, atol=1e-9 * np.abs(once).max())
    assert np.linalg.norm(once - own) > 0


@pytest.mark.requirement("R-CAL-2")
def test_camera_that_moved_is_named(reference):
    """By 0.02°, 0.28 mm at 0.8 m: 0.7 px."""
    camera = CAMERAS["floor_left"]
    turn = Transform(
        rotation=Rotation.from_rotvec([0.0, np.radians(0.02), 0.0]).as_matrix(), translation_mm=np.zeros(3)
    )
    moved = {**CAMERAS, "floor_left": replace(camera, camera_from_world=turn @ camera.camera_from_world)}
    found = check(reference, exposed(moved, "00", 1))
    assert found.verdict == "refuse"
    assert [name for name, one in found.cameras.items() if one.moved] == ["floor_left"]
    assert found.alternatives == (("floor_left",),)
    assert found.reasons[0].startswith("floor_left moved: ")
    assert found.cameras["floor_left"].shift_px == pytest.approx(0.7, rel=0.25)
    assert set(found.pairs) == {"floor"}
    assert found.effect_mm == pytest.approx(0.28 * 800 / 225, rel=0.25)


def test_either_of_two_cameras_may_have_moved(reference):
    """Both explain everything exactly: rounding does not choose the order."""
    moved = shifted(CAMERAS["front_left"], (0.5, 0.0, 0.0))
    for seed in range(3):
        seen = exposed({**CAMERAS, "front_left": moved}, "00", seed)
        front = replace(seen, detections=tuple(each for each in seen.detections if each.camera.startswith("front")))
        assert check(reference, front).alternatives == (("front_left",), ("front_right",))


def test_what_cannot_be_compared_is_said(reference):
    alone = observe({"front_left": CAMERAS["front_left"]}, {"00": LATER["00"]})
    with pytest.raises(CalibrationError, match="front_left"):
        check(reference, alone)
    seen = exposed(CAMERAS, "00", 1)
    cropped = replace(seen, sizes_wh={**seen.sizes_wh, "front_left": (1126, 700)})
    with pytest.raises(ImageError, match="1126 × 700 pixels"):
        check(reference, cropped)
