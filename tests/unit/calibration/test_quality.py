"""The judge: clean calibrations pass, and each fault is named in words."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from virtual_rig import BOARD, PAIRS, cameras_in_rig, observe, placements, with_views

from mammometry.calibration.adjust.bundle import calibrate
from mammometry.calibration.adjust.calibrated import Calibration, SetAside
from mammometry.calibration.detection.detect import Detection, MissedView, Observations
from mammometry.calibration.judge import quality
from mammometry.calibration.judge.quality import CalibrationQuality, assess
from mammometry.calibration.judge.reconstruction import reconstruct, triangulate
from mammometry.geometry.camera import Rig
from mammometry.geometry.transform import Transform

CAMERAS = cameras_in_rig()
POSES = placements(10)


@pytest.fixture(scope="module")
def clean() -> Calibration:
    return calibrate(observe(CAMERAS, POSES), PAIRS, "virtual")


def judged(change: Callable[[Detection], Detection]) -> CalibrationQuality:
    return assess(calibrate(with_views(observe(CAMERAS, POSES), change), PAIRS, "virtual"))


def codes_of(quality: CalibrationQuality) -> set[str]:
    return {notice.code for notice in quality.notices}


def test_clean_calibration_passes(clean: Calibration) -> None:
    quality = assess(clean)
    assert quality.verdict == "pass"
    # In order: what the cameras' uncertainty does, the residuals in words, poses left out, what no residual shows.
    codes = ["expected-error", "residuals", "left-out-fit", "target-not-measured"]
    assert [notice.code for notice in quality.notices] == codes
    assert 0.001 < max(quality.expected_mm.values()) < 0.02
    assert quality.notices[1].values == {
        "px": pytest.approx(0.028, abs=5e-4), "mm": pytest.approx(0.011, abs=5e-4), "good_mm": 0.05, "grade": "good"
    }  # fmt: skip
    assert quality.movements == ()
    assert quality.volume_coverage > 0.25
    assert quality.rms_px == clean.rms_px
    for name in CAMERAS:
        assert quality.rms_px_per_camera[name] == pytest.approx(0.028, abs=0.002)
    assert set(quality.rms_px_per_pose) == set(POSES)
    assert quality.rms_mm == pytest.approx(quality.rms_px * 800 / 2000, rel=0.1)  # 0.4 mm a pixel at 0.8 m
    assert max(view.bias for view in quality.views) < 5
    assert len(quality.views) == len(clean.observations.detections)


@pytest.mark.slow
def test_photographs_that_could_not_be_used_are_named_and_those_without_the_target_are_not(clean: Calibration) -> None:
    mirrored = MissedView(camera="a", pose="90", found="a mirrored board", remedy="Do not flip it")
    elsewhere = MissedView(camera="b", pose="91", found="no target", remedy="")
    seen = replace(clean.observations, missed=(mirrored, elsewhere))
    quality = assess(replace(clean, observations=seen))
    assert quality.verdict == "warn"
    first = quality.notices[0]
    assert (first.code, first.about, first.photographs) == ("target-not-found", ("a",), ("calibration/90/a",))
    assert first.values == {"pose": "90", "found": mirrored.found, "remedy": mirrored.remedy}
    assert not any("calibration/91/b" in notice.photographs for notice in quality.notices)


@pytest.mark.slow
def test_dark_photograph_of_a_target_that_faces_away_is_nothing_to_warn_of(clean: Calibration) -> None:
    """A camera behind the board, or beside it, need not see it; one in front of it should have."""
    dark = MissedView(camera="front_left", pose="00", found="an image that is nearly black", remedy="Expose it more")
    observations = replace(clean.observations, missed=(dark,))
    assert "target-not-found" in codes_of(assess(replace(clean, observations=observations)))
    for degrees in (110.0, 180.0):
        about_y = Transform.from_rotation_vector(np.array([0.0, np.radians(degrees), 0.0]), np.zeros(3))
        middle = BOARD.points_target.mean(axis=0)
        about_middle = Transform(rotation=about_y.rotation, translation_mm=middle - about_y.rotation @ middle)
        turned = {**clean.world_from_target, "00": clean.world_from_target["00"] @ about_middle}
        seen = assess(replace(clean, observations=observations, world_from_target=turned))
        assert "target-not-found" not in codes_of(seen)


def test_pairs_reconstruct_the_target(clean: Calibration) -> None:
    for pair in assess(clean).pairs:
        assert pair.poses == len(POSES)
        assert abs(pair.scale_ppm) < 50
        # 0.02 px at 0.4 mm a pixel, and depth 0.8 m : 0.24 m ÷ √2 times that of it
        assert 0.01 < pair.geometry_mm < 0.05
        assert pair.planarity_mm is not None
        assert pair.planarity_mm < pair.geometry_mm


def test_triangulation_inverts_projection() -> None:
    rig = Rig(name="virtual", cameras=CAMERAS, pair_names=PAIRS)
    points = np.random.default_rng(0).uniform(-80, 80, size=(50, 3))
    pair = rig.pair("floor")
    np.testing.assert_allclose(
        triangulate(pair, pair.left.project(points), pair.right.project(points)), points, atol=1e-8
    )


@pytest.mark.requirement("R-CAL-1")
def test_scale_error_of_a_pair_is_measured_on_the_target(clean: Calibration) -> None:
    """A rig blown up by 0.1 % about its origin sees everything 0.1 % larger, with the same pictures."""
    larger = {
        name: replace(
            camera,
            camera_from_world=Transform(
                rotation=camera.camera_from_world.rotation,
                translation_mm=camera.camera_from_world.translation_mm * 1.001,
            ),
        )
        for name, camera in clean.rig.cameras.items()
    }
    blown_up = replace(clean, rig=replace(clean.rig, cameras=larger))
    for pair in blown_up.rig.pairs:
        found, before = reconstruct(blown_up, pair), reconstruct(clean, clean.rig.pair(pair.name))
        assert found.scale_ppm - before.scale_ppm == pytest.approx(1000, abs=0.5)
    errors = [notice.values for notice in assess(blown_up).notices if notice.code == "pair-scale-error"]
    assert errors
    for values in errors:
        assert values["percent"] == pytest.approx(0.1, abs=0.006)
        assert values["volume_percent"] == pytest.approx(0.3, abs=0.02)


@pytest.mark.slow
def test_outliers_are_counted() -> None:
    def change(detection: Detection) -> Detection:
        if (detection.camera, detection.pose) != ("front_right", "04"):
            return detection
        shift = np.zeros_like(detection.uv)
        shift[::5] = 4.0
        return replace(detection, uv=detection.uv + shift)

    quality = judged(change)
    assert quality.verdict == "warn"
    assert quality.notices[0].code == "points-left-out"
    assert quality.notices[0].values == {"pose": "04", "points": 18, "total": 88}


@pytest.mark.slow
@pytest.mark.requirement("R-CAL-1")
def test_poor_focal_length_is_refused_in_percent_and_mm() -> None:
    poses = {pose: POSES[pose] for pose in list(POSES)[:3]}
    quality = assess(calibrate(observe(CAMERAS, poses, noise_px=0.3), PAIRS, "virtual"))
    assert quality.verdict == "refuse"
    assert "focal-length-uncertain" in {notice.code for notice in quality.refusals}


@pytest.mark.slow
def test_small_coverage_is_a_warning() -> None:
    observations = observe(CAMERAS, POSES)

    def middle_only(detection: Detection) -> Detection:
        keep = (np.abs(detection.uv - (563, 375)) < (180, 120)).all(axis=1)
        return Detection(
            camera=detection.camera,
            pose=detection.pose,
            ids=detection.ids[keep],
            uv=detection.uv[keep],
            covariance_px2=detection.covariance_px2[keep],
        )

    quality = assess(calibrate(with_views(observations, middle_only), PAIRS, "virtual"))
    assert max(quality.coverage.values()) < 0.4
    assert "lens-little-covered" in codes_of(quality)
    assert quality.verdict != "pass"


@pytest.mark.slow
def test_pair_without_a_common_pose_is_a_warning() -> None:
    skip = [("front_left", pose) for pose in list(POSES)[:5]] + [("front_right", pose) for pose in list(POSES)[5:]]
    quality = assess(calibrate(observe(CAMERAS, POSES, skip=skip), PAIRS, "virtual"))
    pair = next(pair for pair in quality.pairs if pair.pair == "front")
    assert pair.poses == 0
    assert np.isnan(pair.geometry_mm)
    assert ("pair-without-target", ("front",)) in [(notice.code, notice.about) for notice in quality.notices]


@pytest.mark.slow
def test_limits_refuse_and_unsettled_adjustments_are_said(clean: Calibration) -> None:
    findings = "mammometry.calibration.judge.findings."
    with pytest.MonkeyPatch.context() as strict:
        strict.setattr(quality, "_assessed", quality._assessed.__wrapped__)  # the constants change, so nothing is kept
        strict.setattr(findings + "_GEOMETRY_WARN_MM", 0.001)
        strict.setattr(findings + "_GEOMETRY_REFUSE_MM", 0.002)
        assert assess(clean).verdict == "refuse"
    with pytest.MonkeyPatch.context() as strict:
        strict.setattr(quality, "_assessed", quality._assessed.__wrapped__)
        strict.setattr(findings + "_EXPECTED_WARN_MM", 1e-4)
        strict.setattr(findings + "_EXPECTED_REFUSE_MM", 2e-4)
        uncertain = assess(clean)
    assert uncertain.verdict == "refuse"
    assert uncertain.notices[0].code == "expected-error-large"
    assert uncertain.notices[0].values["limit_mm"] == 2e-4
    unsettled = replace(clean, converged=False, set_aside=(SetAside(camera="front_left", pose="00", residual_px=9.0),))
    found = assess(unsettled)
    assert "not-converged" in codes_of(found)
    assert ("calibration/00/front_left",) in [notice.photographs for notice in found.notices]


@pytest.mark.slow
def test_rig_of_one_camera_has_no_pairs() -> None:
    observations: Observations = observe({"front_left": CAMERAS["front_left"]}, POSES)
    quality = assess(calibrate(observations, {}, "single"))
    assert quality.pairs == ()
    assert quality.verdict in ("pass", "warn")
