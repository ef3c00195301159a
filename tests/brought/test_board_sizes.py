"""Two sizes of one printed target that contradict its photographs."""

import re
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from tests.first_cases import first
from tests.unit.calibration import printed
from tests.unit.calibration.virtual_rig import PAIRS, SIZE_WH, cameras_in_rig, see

from mammometry.base.photograph import Photograph
from mammometry.calibration.adjust.bundle import calibrate
from mammometry.calibration.detection.detect import Observations, detect
from mammometry.calibration.judge.findings import about_pixels
from mammometry.calibration.targets.board import Board
from mammometry.calibration.targets.kinds.charuco import CharucoTarget
from mammometry.calibration.targets.kinds.circles import CirclesTarget
from mammometry.calibration.targets.kinds.cylinder import DottedCylinderTarget
from mammometry.geometry.camera import Camera
from mammometry.geometry.transform import Transform

CHARUCO = CharucoTarget(squares=(8, 6), square_mm=25.0, marker_mm=18.0, dictionary="DICT_5X5_250")
CIRCLES = CirclesTarget(grid=(7, 5), pitch_mm=25.0, diameter_mm=14.0)


def light_of(board: Board) -> np.ndarray:
    """What falls onto the sensor, on `develop`'s finer raster, of a board seen somewhat aslant."""
    view = printed.camera(size_wh=(480, 360), focal_px=800.0, turn_deg=(12.0, -9.0, 4.0))
    pattern = printed.charuco(board) if isinstance(board, CharucoTarget) else printed.circles(board)
    x_mm, y_mm, _ = printed.centred(board.points_target).translation_mm
    return printed.radiance_of_board(view, lambda x, y: pattern(x - x_mm, y - y_mm))


@pytest.fixture(scope="module")
def light() -> dict[str, np.ndarray]:
    return {"charuco": light_of(CHARUCO), "circles": light_of(CIRCLES)}


@pytest.fixture(scope="module")
def pictures(light: dict[str, np.ndarray]) -> dict[str, Photograph]:
    return {kind: printed.develop(radiance) for kind, radiance in light.items()}


def seen(photograph: Photograph, target: Board) -> Observations:
    return detect({("00", "a"): photograph}, target)


@pytest.mark.parametrize(
    "target",
    [
        CHARUCO,
        replace(CHARUCO, marker_mm=17.5),  # a ruler's error
        CHARUCO.scaled(1.2),  # both wrong alike: no picture shows it
        CIRCLES,
        replace(CIRCLES, diameter_mm=14.8),
        CIRCLES.scaled(0.8),
    ],
)
def test_sizes_that_fit_the_picture_are_taken(pictures: dict[str, Photograph], target: Board) -> None:
    found = seen(pictures[target.kind], target)
    assert len(found.detections) == 1
    assert len(found.detections[0].ids) == len(target.points_target)


@pytest.mark.parametrize(
    ("target", "sentence", "ratio", "fits"),
    [
        (
            replace(CHARUCO, square_mm=30.0),
            r"marker_mm (\S+) times square_mm, but in \[target\] 18 and 30 mm, 0.600 times\. "
            r".*either square_mm = 30 and marker_mm = (\S+), or marker_mm = 18 and square_mm = (\S+)",
            0.72,
            (21.6, 25.0),
        ),
        (
            replace(CHARUCO, marker_mm=14.0),
            r"marker_mm (\S+) times square_mm, but in \[target\] 14 and 25 mm, 0.560 times\. "
            r".*either square_mm = 25 and marker_mm = (\S+), or marker_mm = 14 and square_mm = (\S+)",
            0.72,
            (18.0, 14 / 0.72),
        ),
        (
            replace(CIRCLES, pitch_mm=30.0),
            r"diameter_mm (\S+) times pitch_mm, but in \[target\] 14 and 30 mm, 0.467 times\. "
            r".*either pitch_mm = 30 and diameter_mm = (\S+), or diameter_mm = 14 and pitch_mm = (\S+)",
            0.56,
            (16.8, 25.0),
        ),
    ],
    ids=["square", "marker", "pitch"],
)
@pytest.mark.requirement("R-UNIT-2")
def test_a_size_that_contradicts_the_picture_is_named_with_those_that_fit(
    pictures: dict[str, Photograph], target: Board, sentence: str, ratio: float, fits: tuple[float, float]
) -> None:
    observations = seen(pictures[target.kind], target)
    assert observations.detections == ()
    (missed,) = observations.missed
    read = re.fullmatch(sentence, f"{missed.found}. {missed.remedy}")
    assert read is not None, str(missed)
    assert [float(value) for value in read.groups()] == pytest.approx([ratio, *fits], rel=0.01)


@pytest.mark.parametrize(
    ("blur_px", "exposure"),
    [pytest.param(2.0, 1.0, id="soft"), pytest.param(0.7, 2.5, id="over-exposed"), pytest.param(0.7, 0.1, id="dark")],
)
@pytest.mark.parametrize("target", first(1, [CHARUCO, CIRCLES]))
def test_a_poor_picture_contradicts_nothing(
    light: dict[str, np.ndarray], target: Board, blur_px: float, exposure: float
) -> None:
    photograph = printed.develop(exposure * light[target.kind], blur_px)
    assert len(seen(photograph, target).detections[0].ids) > 12


CYLINDER = DottedCylinderTarget(dots=(14, 30), radius_mm=57.3, row_pitch_mm=12.0, column_pitch_mm=12.0, dot_mm=6.0)


def observed_cylinder() -> Observations:
    """What four cameras see of an upright cylinder, in points."""
    rng = np.random.default_rng(0)
    upright = Transform.from_rotation_vector(np.array([np.pi / 2, 0.0, 0.0]), np.zeros(3))
    placed = replace(upright, translation_mm=-upright.rotation @ CYLINDER.points_target.mean(axis=0))
    outward = CYLINDER.points_target * np.array([1.0, 1.0, 0.0]) / CYLINDER.radius_mm @ placed.rotation.T

    def turned_away(camera: Camera) -> Callable[[np.ndarray], np.ndarray]:
        towards = camera.centre_world - placed.apply(CYLINDER.points_target)
        towards /= np.linalg.norm(towards, axis=1, keepdims=True)
        return lambda points: (towards * outward).sum(axis=1) < 0.5

    cameras = cameras_in_rig()
    detections = tuple(
        see(camera, "00", placed, CYLINDER.points_target, rng, noise_px=0.03, hidden=turned_away(camera))
        for camera in cameras.values()
    )
    return Observations(target=CYLINDER, sizes_wh=dict.fromkeys(cameras, SIZE_WH), detections=detections)


@pytest.mark.slow
def test_rows_of_another_pitch_than_stated_show_as_pixels_that_are_not_square() -> None:
    observations = observed_cylinder()
    assert list(about_pixels(calibrate(observations, PAIRS, "rig"))) == []
    stretched = replace(observations, target=replace(CYLINDER, row_pitch_mm=13.2))
    findings = list(about_pixels(calibrate(stretched, PAIRS, "rig")))
    assert len(findings) == 4
    assert {(found.verdict, found.notice.code) for found in findings} == {("refuse", "pixels-not-square")}
    assert findings[0].notice.about == ("front_left",)
    assert findings[0].notice.values["ratio"] == pytest.approx(1.1, abs=0.05)
