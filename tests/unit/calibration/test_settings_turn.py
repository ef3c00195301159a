"""Every setting does what its docstring says: turned, it changes the finding or the adjustment that it belongs to."""

from dataclasses import fields, replace

import numpy as np
import pytest
from virtual_rig import BOARD, PAIRS, cameras_in_rig, observe, placements, smooth_errors, with_views

from mammometry.base.photograph import Photograph
from mammometry.calibration.adjust.assemble import all_views, network_of
from mammometry.calibration.adjust.bundle import Calibration, calibrate
from mammometry.calibration.adjust.initialise import initialise
from mammometry.calibration.adjust.robust import bad_views
from mammometry.calibration.detection import detect as detection
from mammometry.calibration.judge.check import Reference, check
from mammometry.calibration.judge.quality import assess
from mammometry.calibration.settings import BundleSettings, CalibrateSettings, CheckSettings, QualitySettings
from mammometry.geometry.transform import Transform

CAMERAS = cameras_in_rig()
POSES = placements(7)
STIFF = CalibrateSettings(bundle=BundleSettings(free_target="never", k3="zero", reject_sigma=3.0))
NEVER = 1e-12
"""A limit that everything exceeds."""

TURNED = {
    "bias_warn": ({"bias_warn": NEVER, "bias_refuse": 1e9}, "warn", "are shifted together"),
    "bias_refuse": ({"bias_warn": NEVER, "bias_refuse": NEVER}, "refuse", "are shifted together"),
    "focal_std_warn": ({"focal_std_warn": NEVER}, "warn", "the focal length of"),
    "focal_std_refuse": ({"focal_std_warn": NEVER, "focal_std_refuse": NEVER}, "refuse", "the focal length of"),
    "geometry_warn_mm": ({"geometry_warn_mm": NEVER}, "warn", "reconstructs the target to"),
    "geometry_refuse_mm": (
        {"geometry_warn_mm": NEVER, "geometry_refuse_mm": NEVER},
        "refuse",
        "reconstructs the target",
    ),
    "scale_warn_ppm": ({"scale_warn_ppm": NEVER}, "warn", "% in volume"),
    "scale_refuse_ppm": ({"scale_warn_ppm": NEVER, "scale_refuse_ppm": NEVER}, "refuse", "% in volume"),
    "expected_warn_mm": ({"expected_warn_mm": NEVER}, "warn", "moves measured points by"),
    "expected_refuse_mm": (
        {"expected_warn_mm": NEVER, "expected_refuse_mm": NEVER},
        "refuse",
        "moves measured points by",
    ),
    "coverage_warn": ({"coverage_warn": 1.1}, "warn", "of the photographs of"),
    "volume_coverage_warn": ({"volume_coverage_warn": 1.1}, "warn", "of the space that the pairs see"),
    "moved_sigma": ({"moved_sigma": NEVER, "moved_refuse_mm": 1e9}, "warn", "standard errors)"),
    "moved_refuse_mm": ({"moved_sigma": NEVER, "moved_refuse_mm": NEVER}, "refuse", "standard errors)"),
    "residual_good_mm": ({"residual_good_mm": NEVER}, "pass", "which is fair"),
    "residual_warn_mm": ({"residual_good_mm": NEVER, "residual_warn_mm": NEVER}, "warn", "which is poor"),
    "left_out_warn": ({"left_out_warn": NEVER}, "warn", "poses were left out"),
    "blurred_ratio": ({"blurred_ratio": 0.5}, "warn", "blurred, shaken or badly lit"),
    "rejected_warn": ({"rejected_warn": NEVER}, "warn", "were left out as outliers"),
}
"""Field → settings, and the verdict and words that they bring."""
QUIET = QualitySettings(
    **{name: 1e9 for name in TURNED if "coverage" not in name}, coverage_warn=0.0, volume_coverage_warn=0.0
)
"""Limits that nothing exceeds."""


@pytest.fixture(scope="module")
def calibration() -> Calibration:
    seen = with_views(observe(CAMERAS, POSES, noise_px=0.05), smooth_errors(5, 0.05))
    return calibrate(seen, PAIRS, "virtual", STIFF)


def test_every_limit_of_the_judge_is_here() -> None:
    assert set(TURNED) == {field.name for field in fields(QualitySettings)}


def test_limits_that_nothing_exceeds_find_nothing(calibration: Calibration) -> None:
    assert assess(calibration, QUIET).verdict == "pass"


@pytest.mark.parametrize("name", TURNED)
def test_a_limit_of_the_judge_brings_its_finding(calibration: Calibration, name: str) -> None:
    turned, verdict, words = TURNED[name]
    quality = assess(calibration, replace(QUIET, **turned))
    assert any(words in reason for reason in quality.reasons), quality.reasons
    assert quality.verdict == verdict


def test_view_ratio_decides_which_views_are_set_aside() -> None:
    seen = observe(CAMERAS, POSES, noise_px=0.05)
    settings = STIFF.bundle
    initial = initialise(seen)
    network, state = network_of(all_views(seen, {}, initial), seen, {}, initial, {}, settings)
    network = replace(network, uv=network.uv + np.where(network.view == 3, 20.0, 0.0)[:, None])
    assert list(bad_views(network, state, BundleSettings(view_ratio=5.0).view_ratio, 0.0)) == [3]
    assert bad_views(network, state, 1e6, 0.0) == {}


@pytest.mark.parametrize(("least", "is_free"), [(7, True), (8, False)])
def test_free_target_poses_decides_whether_the_board_is_adjusted(least: int, is_free: bool) -> None:
    settings = replace(STIFF.bundle, free_target="auto", free_target_poses=least)
    seen = observe(CAMERAS, POSES)
    initial = initialise(seen)
    network, _ = network_of(all_views(seen, {}, initial), seen, {}, initial, {}, settings)
    assert (len(network.free_points) > 0) == is_free


@pytest.mark.parametrize(("sigma", "is_free"), [pytest.param(NEVER, True, marks=pytest.mark.slow), (1e9, False)])
def test_k3_sigma_decides_whether_k3_is_adjusted(sigma: float, is_free: bool) -> None:
    settings = CalibrateSettings(bundle=replace(STIFF.bundle, k3="auto", k3_sigma=sigma))
    found = calibrate(observe(CAMERAS, POSES, noise_px=0.05), PAIRS, "virtual", settings)
    assert all((camera.distortion[4] != 0.0) == is_free for camera in found.rig.cameras.values())


@pytest.fixture(scope="module")
def exposure(calibration: Calibration):
    """The reference, and what it sees after one camera was pushed by 0.2 mm."""
    pushed = CAMERAS["front_left"].camera_from_world
    pushed = Transform(rotation=pushed.rotation, translation_mm=pushed.translation_mm + np.array([0.2, 0.0, 0.0]))
    cameras = CAMERAS | {"front_left": replace(CAMERAS["front_left"], camera_from_world=pushed)}
    return Reference.of(calibration), observe(cameras, {"00": placements(1, seed=9)["00"]}, noise_px=0.05, seed=4)


@pytest.mark.parametrize(
    ("turned", "verdict"),
    [
        ({"refuse_mm": NEVER}, "refuse"),
        ({"refuse_mm": 1e9}, "moved"),
        ({"refuse_mm": 1e9, "chance": 1e-300}, "unmoved"),
        ({"refuse_mm": 1e9, "least_inflation": 1e4}, "unmoved"),
        ({"refuse_mm": 1e9, "lens_ratio": NEVER}, "refuse"),
    ],
)
def test_a_limit_of_the_check_changes_its_verdict(exposure, turned: dict[str, float], verdict: str) -> None:
    assert (
        check(
            *exposure,
            CheckSettings(lens_ratio=1e9, **turned) if "lens_ratio" not in turned else CheckSettings(**turned),
        ).verdict
        == verdict
    )


def test_window_squares_and_search_width_reach_the_detector(monkeypatch) -> None:
    given = {}

    def find(self, photograph, **words):
        given.update(words)

    monkeypatch.setattr(type(BOARD), "find", find)
    settings = detection.DetectSettings(search_width_px=321, window_squares=0.3)
    picture = Photograph(name="a", pixels=np.zeros((20, 30), np.uint8))
    assert detection.detect_in(picture, BOARD, settings, camera="a", pose="0") is None
    assert given == {"search_width_px": 321, "window_squares": 0.3}


def test_threads_are_so_many(monkeypatch) -> None:
    asked = []
    pool = detection.ThreadPoolExecutor
    monkeypatch.setattr(detection, "ThreadPoolExecutor", lambda count: asked.append(count) or pool(count))
    detection.detect({}, BOARD, detection.DetectSettings(threads=3))
    assert asked == [3]
