"""Every limit does what its docstring says: turned, it changes the finding or the adjustment that it belongs to."""

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from tests.first_cases import first
from virtual_rig import BOARD, PAIRS, cameras_in_rig, observe, placements, smooth_errors, with_views

from mammometry.base.photograph import Photograph
from mammometry.calibration.adjust.bundle import all_views, calibrate, network_of
from mammometry.calibration.adjust.calibrated import Calibration
from mammometry.calibration.adjust.initialise import initialise
from mammometry.calibration.adjust.robust import bad_views
from mammometry.calibration.detection import detect as detection
from mammometry.calibration.judge import quality
from mammometry.calibration.judge.check import Reference, check
from mammometry.calibration.judge.quality import assess
from mammometry.calibration.settings import BundleSettings, CalibrateSettings, CheckSettings, QualitySettings
from mammometry.geometry.transform import Transform

CAMERAS = cameras_in_rig()
POSES = placements(7)
STIFF = CalibrateSettings(bundle=BundleSettings(free_target="never", k3="zero"))
NEVER = 1e-12
"""A limit that everything exceeds."""

LIMITS = {
    "bias": ("_BIAS_WARN", "BIAS_REFUSE", "points-shifted"),
    "focal length": ("_FOCAL_STD_WARN", "focal_std_refuse", "focal-length-uncertain"),
    "geometry": ("_GEOMETRY_WARN_MM", "_GEOMETRY_REFUSE_MM", "pair-reconstruction-error"),
    "scale": ("_SCALE_WARN_PPM", "_SCALE_REFUSE_PPM", "pair-scale-error"),
    "expected": ("_EXPECTED_WARN_MM", "_EXPECTED_REFUSE_MM", "expected-error-large"),
    "coverage": ("_COVERAGE_WARN", "", "lens-little-covered"),
    "volume coverage": ("_VOLUME_COVERAGE_WARN", "", "space-little-covered"),
    "poses left out": ("_LEFT_OUT_WARN", "", "left-out-misfit"),
    "blur": ("_BLURRED_RATIO", "", "photograph-blurred"),
    "outliers": ("_REJECTED_WARN", "", "points-left-out"),
    "residuals": ("_RESIDUAL_WARN_MM", "", "residuals-large"),
}
"""What is judged: the constant that warns, the constant or setting that refuses, and the code of the finding."""
FINDINGS = "mammometry.calibration.judge.findings."
REFUSING_NOTHING = QualitySettings(focal_std_refuse=1e9)


@pytest.fixture(scope="module")
def calibration() -> Calibration:
    seen = with_views(observe(CAMERAS, POSES, noise_px=0.05), smooth_errors(5, 0.05))
    with pytest.MonkeyPatch.context() as stricter:  # so that there are outliers
        stricter.setattr("mammometry.calibration.adjust.robust.REJECT_SIGMA", 3.0)
        return calibrate(seen, PAIRS, "virtual", STIFF)


@pytest.fixture(scope="module")
def computed() -> dict[str, Any]:
    """What the judge computes and no limit changes, kept: most of its time."""
    names = ("view_qualities", "reconstruct", "sightings", "expected_error", "_coverage")
    return {name: cache(getattr(quality, name)) for name in names}


@pytest.fixture
def warning_of_nothing(monkeypatch: pytest.MonkeyPatch, computed: dict[str, Any]) -> pytest.MonkeyPatch:
    for name, function in computed.items():
        monkeypatch.setattr(quality, name, function)
    for warn, refuse, _ in LIMITS.values():
        monkeypatch.setattr(FINDINGS + warn, 0.0 if "COVERAGE" in warn else 1e9)
        if refuse.isupper():
            monkeypatch.setattr(FINDINGS + refuse, 1e9)
    monkeypatch.setattr(FINDINGS + "RESIDUAL_GOOD_MM", 1e9)
    monkeypatch.setattr(quality, "_MOVED_SIGMA", 1e9)
    monkeypatch.setattr(quality, "_assessed", quality._assessed.__wrapped__)  # the constants change, so nothing is kept
    return monkeypatch


@pytest.mark.usefixtures("warning_of_nothing")
def test_limits_that_nothing_exceeds_find_nothing(calibration: Calibration) -> None:
    assert assess(calibration, REFUSING_NOTHING).verdict == "pass"


@pytest.mark.parametrize("name", first(4, LIMITS))
def test_a_limit_of_the_judge_brings_its_finding(
    calibration: Calibration, name: str, warning_of_nothing: pytest.MonkeyPatch
) -> None:
    warn, refuse, code = LIMITS[name]
    warning_of_nothing.setattr(FINDINGS + "RESIDUAL_GOOD_MM", NEVER)
    if refuse:
        with pytest.MonkeyPatch.context() as strict:
            if refuse.isupper():
                strict.setattr(FINDINGS + refuse, NEVER)
                strict.setattr(FINDINGS + warn, NEVER)
            settings = REFUSING_NOTHING if refuse.isupper() else QualitySettings(focal_std_refuse=NEVER)
            refused = assess(calibration, settings)
        assert refused.verdict == "refuse"
        assert code in {notice.code for notice in refused.refusals}
    warning_of_nothing.setattr(FINDINGS + warn, 1.1 if "COVERAGE" in warn else 0.5 if name == "blur" else NEVER)
    warned = assess(calibration, REFUSING_NOTHING)
    assert warned.verdict == "warn"
    assert code in {notice.code for notice in warned.doubts}


@pytest.mark.parametrize(("most_mm", "verdict"), [(1e9, "warn"), (NEVER, "refuse")])
def test_a_movement_between_poses_is_named_and_refused(
    calibration: Calibration, most_mm: float, verdict: str, warning_of_nothing: pytest.MonkeyPatch
) -> None:
    warning_of_nothing.setattr("mammometry.calibration.judge.quality._MOVED_SIGMA", NEVER)
    warning_of_nothing.setattr(FINDINGS + "_MOVED_REFUSE_MM", most_mm)
    quality = assess(calibration, REFUSING_NOTHING)
    assert quality.verdict == verdict
    assert {notice.code for notice in quality.notices} & {"camera-moved", "camera-not-together", "cameras-not-together"}


def test_view_ratio_decides_which_views_are_set_aside() -> None:
    seen = observe(CAMERAS, POSES, noise_px=0.05)
    settings = STIFF.bundle
    initial = initialise(seen)
    network, state = network_of(all_views(seen, {}, initial), seen, {}, initial, {}, settings)
    network = replace(network, uv=network.uv + np.where(network.view == 3, 20.0, 0.0)[:, None])
    assert list(bad_views(network, state, 5.0, 0.0)) == [3]
    assert bad_views(network, state, 1e6, 0.0) == {}


@pytest.mark.parametrize(("least", "is_free"), [(7, True), (8, False)])
def test_free_target_poses_decides_whether_the_board_is_adjusted(
    least: int, is_free: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("mammometry.calibration.adjust.bundle.FREE_TARGET_POSES", least)
    settings = replace(STIFF.bundle, free_target="auto")
    seen = observe(CAMERAS, POSES)
    initial = initialise(seen)
    network, _ = network_of(all_views(seen, {}, initial), seen, {}, initial, {}, settings)
    assert (len(network.free_points) > 0) == is_free


@pytest.mark.slow
@pytest.mark.parametrize(("sigma", "is_free"), [(NEVER, True), (1e9, False)])
def test_k3_sigma_decides_whether_k3_is_adjusted(sigma: float, is_free: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("mammometry.calibration.adjust.bundle.K3_SIGMA", sigma)
    settings = CalibrateSettings(bundle=replace(STIFF.bundle, k3="auto"))
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
    ("most_mm", "constants", "verdict"),
    [
        (NEVER, {}, "refuse"),
        (1e9, {}, "moved"),
        (1e9, {"_CHANCE": 1e-300}, "unmoved"),
        (1e9, {"_LEAST_INFLATION": 1e4}, "unmoved"),
        (1e9, {"_LENS_RATIO": NEVER}, "refuse"),
    ],
)
def test_a_limit_of_the_check_changes_its_verdict(
    exposure, most_mm: float, constants: dict[str, float], verdict: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name, value in {"_LENS_RATIO": 1e9, **constants}.items():
        monkeypatch.setattr(f"mammometry.calibration.judge.check.{name}", value)
    assert check(*exposure, CheckSettings(refuse_mm=most_mm)).verdict == verdict


def test_the_search_width_reaches_the_detector(monkeypatch) -> None:
    given = []
    monkeypatch.setattr(detection, "find", lambda *arguments: given.append(arguments))
    picture = Photograph(name="a", pixels=np.zeros((20, 30), np.uint8))
    assert detection.detect_in(picture, BOARD, camera="a", pose="0", search_width_px=321) is None
    assert given == [(BOARD, picture, 321)]


def test_threads_are_so_many(monkeypatch) -> None:
    asked = []
    pool = detection.ThreadPoolExecutor
    monkeypatch.setattr(detection, "ThreadPoolExecutor", lambda count: asked.append(count) or pool(count))
    detection.detect({}, BOARD, threads=3)
    assert asked == [3]
