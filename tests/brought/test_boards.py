"""Boards and photographs of them that do not fit what session.toml says: the right number, or the cause by name."""

import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from functools import cache

import cv2
import numpy as np
import pytest
from tests.unit.calibration.virtual_rig import BOARD as CHESS_IN_RIG
from tests.unit.calibration.virtual_rig import PAIRS, cameras_in_rig, observe, placements, shifted

from mammometry.base.errors import CalibrationError
from mammometry.base.notices import words_of
from mammometry.base.photograph import Photograph
from mammometry.calibration.adjust.bundle import calibrate
from mammometry.calibration.adjust.calibrated import Calibration
from mammometry.calibration.adjust.initialise import TooFewViewsError
from mammometry.calibration.detection.detect import Observations, detect, detect_in, set_duplicates_aside
from mammometry.calibration.judge.no_target import no_target, with_causes
from mammometry.calibration.judge.quality import assess
from mammometry.calibration.judge.suspects import SuspectPhotographsError, refusal, spared_photograph
from mammometry.calibration.settings import BundleSettings, CalibrateSettings, QualitySettings
from mammometry.calibration.targets.kinds.charuco import CharucoTarget, charuco_board
from mammometry.calibration.targets.kinds.chessboard import ChessboardTarget
from mammometry.calibration.targets.kinds.circles import CirclesTarget
from mammometry.calibration.targets.target import Target
from mammometry.geometry.transform import Transform
from mammometry.simulate.rendering.develop import develop
from mammometry.simulate.rendering.film import Film
from mammometry.simulate.rendering.solid_target import render_target
from mammometry.simulate.rigs.build import flashes
from mammometry.simulate.rigs.rig_file import make_rig

NEW = CharucoTarget(squares=(10, 8), square_mm=28.0, marker_mm=20.0, dictionary="DICT_5X5_250")
OLD = replace(NEW, legacy_pattern=True)
CHESS = ChessboardTarget(squares=(11, 8), square_mm=24.0)
CIRCLES = CirclesTarget(grid=(9, 7), pitch_mm=26.0, diameter_mm=13.0)
VIEW = make_rig("reference", 0.2, 3).cameras["front_left"]


@cache
def photographed(printed: Target) -> Photograph:
    """The printed target before one camera of the virtual rig."""
    middle = Transform(rotation=np.eye(3), translation_mm=-printed.points_target.mean(axis=0))
    placed = Transform.from_rotation_vector(np.array([np.pi, 0.1, 0.0]), np.zeros(3)) @ middle
    return develop(render_target(VIEW, placed, printed, flashes(), background=0.02), Film(), name="a.png", seed=1)


def negative(photograph: Photograph) -> Photograph:
    return Photograph(name=photograph.name, pixels=255 - photograph.pixels)


def mirrored(photograph: Photograph) -> Photograph:
    return Photograph(name=photograph.name, pixels=np.ascontiguousarray(photograph.pixels[:, ::-1]))


def as_it_is(photograph: Photograph) -> Photograph:
    return photograph


TABLE = {
    "older pattern": (OLD, as_it_is, NEW, "Write legacy_pattern = true in [target]"),
    "newer pattern": (NEW, as_it_is, OLD, "Write legacy_pattern = false in [target]"),
    "columns and rows exchanged": (NEW, as_it_is, replace(NEW, squares=(8, 10)), "Write squares = [10, 8] in"),
    "corners counted": (NEW, as_it_is, replace(NEW, squares=(9, 7)), "Write squares = [10, 8] in"),
    "a column too many": (NEW, as_it_is, replace(NEW, squares=(11, 8)), "Write squares = [10, 8] in"),
    "older, exchanged": (OLD, as_it_is, replace(NEW, squares=(8, 10)), "squares = [10, 8] and legacy_pattern = true"),
    "other dictionary": (NEW, as_it_is, replace(NEW, dictionary="DICT_6X6_250"), 'Write dictionary = "DICT_5X5_50" in'),
    "mirrored": (NEW, mirrored, NEW, "without flipping them"),
    "chessboard's corners counted": (CHESS, as_it_is, replace(CHESS, squares=(10, 7)), "Write squares = [11, 8] in"),
    "chessboard's row forgotten": (CHESS, as_it_is, replace(CHESS, squares=(11, 7)), "Write squares = [11, 8] in"),
    "a column of circles too many": (CIRCLES, as_it_is, replace(CIRCLES, grid=(10, 7)), "Write grid = [9, 7] in"),
}

REPEATED = {"other dictionary", "a column of circles too many"}
"""Searched again with other descriptions, as `test_detect_bad_input` does."""


@pytest.mark.parametrize(
    "case",
    [pytest.param(case, marks=pytest.mark.slow) if "chess" in case or case in REPEATED else case for case in TABLE],
)
def test_what_the_photograph_shows_instead_is_named_with_its_remedy(case: str) -> None:
    printed, changed, described, remedy = TABLE[case]
    photographs = {("00", "a"): changed(photographed(printed))}
    seen = detect(photographs, described)
    assert seen.detections == ()
    error = no_target(described, [seen], photographs)
    assert remedy in error.remedy
    assert "1 of 1" in error.found


@pytest.mark.parametrize("printed", [NEW, OLD, CHESS, CIRCLES])
def test_what_is_described_rightly_is_found_whole(printed: Target) -> None:
    found = detect_in(photographed(printed), printed, camera="a", pose="00")
    assert found is not None
    assert len(found.ids) == len(printed.points_target)


@pytest.mark.slow
@pytest.mark.parametrize("printed", [NEW, CIRCLES, pytest.param(CHESS, marks=pytest.mark.slow)])
def test_a_negative_is_read_as_well_and_named(printed: Target) -> None:
    photograph = photographed(printed)
    right, seen = (detect_in(picture, printed, camera="a", pose="00") for picture in (photograph, negative(photograph)))
    assert right is not None
    assert seen is not None
    assert len(seen.ids) == len(printed.points_target)
    assert seen.inverse
    turned = isinstance(printed, ChessboardTarget)  # begins at a dark square, which was bright
    assert np.abs((seen.uv[::-1] if turned else seen.uv) - right.uv).max() < 0.1


@pytest.mark.parametrize("legacy", [False, True])
def test_a_board_that_opencv_drew_is_found_as_opencv_numbers_it(legacy: bool) -> None:
    """OpenCV's own picture of a board of either pattern, in perspective: the corners lie where it drew them."""
    target = replace(NEW, legacy_pattern=legacy)
    side_px, margin_px = 60, 40
    columns, rows = target.squares
    size = (columns * side_px + 2 * margin_px, rows * side_px + 2 * margin_px)
    drawn = charuco_board(target).generateImage(size, marginSize=margin_px)
    corners = np.array([[0, 0], [size[0], 0], [size[0], size[1]], [0, size[1]]], np.float32)
    seen_from = np.array([[120, 90], [980, 40], [1040, 700], [60, 640]], np.float32)
    picture_from_drawing = cv2.getPerspectiveTransform(corners, seen_from)
    picture = cv2.warpPerspective(drawn, picture_from_drawing, (1100, 760), flags=cv2.INTER_AREA, borderValue=90)
    photograph = Photograph(name="a.png", pixels=cv2.GaussianBlur(picture, (0, 0), 0.8))
    found = detect_in(photograph, target, camera="a", pose="00")
    assert found is not None
    assert len(found.ids) == (columns - 1) * (rows - 1)
    squares = target.points_target[found.ids, :2] / target.square_mm
    expected = cv2.perspectiveTransform((squares * side_px + margin_px - 0.5)[:, None], picture_from_drawing)[:, 0]
    assert np.abs(found.uv - expected).max() < 0.3
    assert detect_in(photograph, replace(target, legacy_pattern=not legacy), camera="a", pose="00") is None


@pytest.mark.slow
def test_one_camera_s_mirrored_photographs_are_named_before_its_lack_of_views() -> None:
    photographs = {(f"{k:02d}", "b"): mirrored(photographed(NEW)) for k in range(3)}
    seen = detect(photographs, NEW)
    few = TooFewViewsError(
        "camera b", cameras=["b"], found="0 usable views of the target", expected="at least 3", remedy="Add 3 or more"
    )
    error = with_causes(few, [seen], photographs)
    assert error.found.startswith(
        "0 usable views of the target: where it is missing, 3 of 3 photographs show a mirrored"
    )
    assert "without flipping them" in error.remedy
    assert error.details == ("b, poses 00, 01, 02: a mirrored board: its markers are found only in the mirrored image",)
    assert "…" not in str(error)


# --- points alone: what is wrong with the board, or with single photographs ---

CAMERAS = cameras_in_rig()


def recalibrate(observations: Observations, target_prior_mm: tuple[float, float, float] | None = None) -> Calibration:
    bundle = BundleSettings()
    if target_prior_mm is not None:
        bundle = replace(bundle, free_target="always", target_prior_mm=target_prior_mm)
    return calibrate(observations, PAIRS, "virtual", CalibrateSettings(bundle=bundle))


def judged(observations: Observations) -> tuple[str, str, float]:
    """Verdict, first sentence of the refusal or judgement, and relative error of the front pair's baseline."""
    calibration = recalibrate(set_duplicates_aside(observations))
    quality = assess(calibration)
    pair, true = calibration.rig.pair("front"), [CAMERAS[name].centre_world for name in PAIRS["front"]]
    baseline = np.linalg.norm(pair.right.centre_world - pair.left.centre_world) / np.linalg.norm(true[1] - true[0])
    said = words_of(quality.notices[0])
    if quality.verdict == "refuse":
        said = str(refusal(calibration, quality, recalibrate, QualitySettings()))
    return quality.verdict, said, float(baseline) - 1.0


def reshaped(change: Callable[[np.ndarray], np.ndarray], poses: int) -> Observations:
    return observe(CAMERAS, placements(poses), points=change(CHESS_IN_RIG.points_target.copy()))


def stretched(share: float) -> Callable[[np.ndarray], np.ndarray]:
    return lambda points: points * np.array([1.0 + share, 1.0, 1.0])


def bent(bow_mm: float) -> Callable[[np.ndarray], np.ndarray]:
    def change(points: np.ndarray) -> np.ndarray:
        x = points[:, 0] - points[:, 0].mean()
        return points + np.array([0.0, 0.0, bow_mm]) * (1 - (x / x.max())[:, None] ** 2)

    return change


@pytest.mark.slow
@pytest.mark.parametrize(
    ("share", "poses", "verdict"), [(-0.03, 5, "refuse"), (-0.03, 7, "refuse"), (0.005, 7, "warn")]
)
def test_a_print_at_another_scale_one_way_is_noticed(share: float, poses: int, verdict: str) -> None:
    """Where the board's shape is adjusted, no residual shows it: the two scales do."""
    found, said, _ = judged(reshaped(stretched(share), poses))
    assert found == verdict
    named = re.search(r"a board that is (\S+) % (shorter|longer) along its rows", said)
    assert named is not None
    assert float(named[1]) == pytest.approx(100 * abs(share), rel=0.1)
    assert named[2] == ("shorter" if share < 0 else "longer")
    assert "scaling" in said


@pytest.mark.parametrize(
    ("bow_mm", "poses", "verdict"), [(3.0, 5, "refuse"), pytest.param(3.0, 7, "warn", marks=pytest.mark.slow)]
)
@pytest.mark.slow
def test_a_bent_board_is_named_and_with_enough_poses_measured(bow_mm: float, poses: int, verdict: str) -> None:
    found, said, off = judged(reshaped(bent(bow_mm), poses))
    assert found == verdict
    assert "a board that is bent by 3." in said or "a board that is bent by 2.9" in said
    if found == "warn":
        assert abs(off) < 5e-4


def with_moved(moved_mm: Mapping[tuple[str, str], tuple[float, float, float]], poses: int) -> Observations:
    """Views in which a camera stood elsewhere, by (pose, camera)."""
    clean = observe(CAMERAS, placements(poses))

    def views() -> Iterator[object]:
        for seen in clean.detections:
            away = moved_mm.get((seen.pose, seen.camera))
            if away is None:
                yield seen
            else:
                cameras = {seen.camera: shifted(CAMERAS[seen.camera], away)}
                yield observe(cameras, {seen.pose: placements(poses)[seen.pose]}).detections[0]

    return replace(clean, detections=tuple(views()))


BAD = {
    ("03", "front_left"): (0.2, 0.0, 0.0),
    ("07", "floor_right"): (0.15, 0.1, 0.0),
    ("09", "front_right"): (0.18, 0.1, 0.0),
}


@pytest.mark.slow
def test_all_suspect_photographs_are_named_at_once_with_what_is_left() -> None:
    calibration = recalibrate(with_moved(BAD, 12))
    error = refusal(calibration, assess(calibration), recalibrate, QualitySettings())
    assert isinstance(error, SuspectPhotographsError)
    assert set(error.suspects.reasons) == set(BAD)
    assert error.suspects.suffices
    assert "front_left in pose 03, floor_right in pose 07" in error.found
    assert "12 poses" in error.remedy
    assert [line.partition(":")[0] for line in error.details] == [f"pose {pose}, {camera}" for pose, camera in BAD]


def spared(moved_mm: Mapping[tuple[str, str], tuple[float, float, float]], poses: int) -> Calibration | None:
    calibration = recalibrate(with_moved(moved_mm, poses))
    quality = assess(calibration)
    assert quality.verdict == "refuse"
    found = spared_photograph(calibration, quality, recalibrate, QualitySettings())
    if found is not None:
        assert found[1].verdict == "warn"
        assert found[1].notices[0].code == "photograph-unfitting"
        return found[0]
    return None


@pytest.mark.slow
def test_one_photograph_that_all_others_contradict_is_left_out_and_named() -> None:
    calibration = spared({("03", "front_left"): (0.2, 0.0, 0.0)}, 8)
    assert calibration is not None
    (aside,) = calibration.set_aside
    assert (aside.pose, aside.camera) == ("03", "front_left")
    assert 0.1 < aside.residual_px < 2.0
    clean = recalibrate(with_moved({}, 8)).rig.cameras["front_left"].centre_world
    assert np.linalg.norm(calibration.rig.cameras["front_left"].centre_world - clean) < 0.02


@pytest.mark.parametrize(
    "moved_mm",
    [
        {("07", "front_left"): (0.2, 0.0, 0.0)},  # for good, perhaps: the subject's photographs come later
        pytest.param({(f"{k:02d}", "front_left"): (0.2, 0.0, 0.0) for k in range(4, 8)}, marks=pytest.mark.slow),
        pytest.param({key: BAD[key] for key in list(BAD)[:2]}, marks=pytest.mark.slow),
        pytest.param({("03", name): (0.2, 0.0, 0.0) for name in PAIRS["front"]}, marks=pytest.mark.slow),
    ],
    ids=["its last", "half of its own", "two cameras' in two poses", "both of a pair"],
)
@pytest.mark.slow
def test_photographs_that_contradict_one_another_stay_a_refusal(moved_mm) -> None:
    assert spared(moved_mm, 8) is None


@pytest.mark.slow
def test_suspects_that_cannot_be_spared_are_named_without_a_promise() -> None:
    calibration = recalibrate(with_moved({("01", "front_left"): (0.2, 0.0, 0.0)}, 3))
    quality = assess(calibration)
    assert quality.verdict == "refuse"
    error = refusal(calibration, quality, recalibrate, QualitySettings())
    assert isinstance(error, CalibrationError)
    assert "Remove them" not in str(error)


@pytest.mark.slow
def test_photographs_copied_or_of_another_day_leave_the_right_number() -> None:
    clean = observe(CAMERAS, placements(7))
    views = {(seen.pose, seen.camera): seen for seen in clean.detections}
    copied = replace(views["02", "front_left"], pose="06")
    one_copied = replace(clean, detections=tuple({**views, ("06", "front_left"): copied}.values()))
    verdict, said, off = judged(one_copied)
    assert (verdict, abs(off) < 5e-4) == ("warn", True)
    assert "06/front_left" in said

    away = {name: tuple(np.random.default_rng(k).normal(0, 3, 3)) for k, name in enumerate(CAMERAS)}
    verdict, said, off = judged(with_moved({("03", name): shift for name, shift in away.items()}, 7))
    assert (verdict, abs(off) < 5e-4) == ("refuse", True)
    assert re.search(r"contradict the others: (\w+ in pose 03(, | and )?)+, expected", said)
