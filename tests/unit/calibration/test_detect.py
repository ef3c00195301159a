"""What detection promises whatever the target: order, sizes, progress, and what it refuses."""

import json
import time

import cv2
import numpy as np
import pytest
from printed import camera, centred, chessboard, photograph_of_board

from mammometry.base.errors import CalibrationError, ImageError
from mammometry.base.photograph import Photograph
from mammometry.calibration.detection.detect import (
    Detection,
    MeasuredPoints,
    Observations,
    detect,
    detect_in,
    merged,
    points_from_table,
)
from mammometry.calibration.targets.kinds.chessboard import ChessboardTarget
from mammometry.calibration.targets.kinds.points import PointsTarget
from mammometry.io.results.codecs import to_tree

BOARD = ChessboardTarget(squares=(6, 5), square_mm=30.0)
POINTS = PointsTarget(points_mm=((0.0, 0.0, 0.0), (50.0, 0.0, 5.0), (0.0, 50.0, 9.0), (50.0, 50.0, 1.0)))
BLANK = Photograph(name="calibration/01/a.png", pixels=np.full((180, 240), 90, np.uint8))


def to_bytes(value):
    arrays = {}
    tree = json.dumps(to_tree(value, arrays))
    return tree, {name: array.tobytes() for name, array in arrays.items()}


@pytest.fixture(scope="module")
def photograph():
    pattern, shift = chessboard(BOARD), centred(BOARD.points_target).translation_mm
    view = camera(size_wh=(240, 180), focal_px=400.0, turn_deg=(10.0, 20.0, 5.0))
    return photograph_of_board(view, lambda x, y: pattern(x - shift[0], y - shift[1]))


def test_detections_come_in_order_and_blank_views_are_left_out(photograph):
    fractions = []
    seen = {("02", "b"): photograph, ("01", "b"): photograph, ("01", "a"): BLANK, ("02", "a"): photograph}
    observations = detect(seen, BOARD, progress=fractions.append)
    assert [(found.pose, found.camera) for found in observations.detections] == [("01", "b"), ("02", "a"), ("02", "b")]
    assert observations.cameras == ("a", "b")
    assert observations.poses == ("01", "02")
    assert observations.sizes_wh == {"a": (240, 180), "b": (240, 180)}
    assert fractions == sorted(fractions)
    assert fractions[-1] == 1.0


def test_photographs_are_loaded_when_they_are_asked_for(photograph):
    loaded = []

    class Lazy(dict):
        def __getitem__(self, key):
            loaded.append(key)
            return photograph

    detect(Lazy.fromkeys([("00", "a"), ("00", "b")]), BOARD)
    assert set(loaded) == {("00", "a"), ("00", "b")}


def test_a_photograph_without_the_target_has_no_detection():
    seen = detect({("00", "a"): BLANK}, BOARD)
    assert seen.detections == ()
    assert seen.sizes_wh == {"a": BLANK.size_wh}


def test_photographs_of_one_camera_must_agree_in_size(photograph):
    cropped = Photograph(name="calibration/01/a.png", pixels=photograph.pixels[:170])
    with pytest.raises(ImageError, match=r"calibration/01/a\.png: found 240 × 170 pixels"):
        detect({("00", "a"): photograph, ("01", "a"): cropped}, BOARD)


def test_poses_detected_apart_are_merged_and_must_agree_in_size(photograph):
    first = detect({("01", "a"): photograph, ("01", "b"): BLANK}, BOARD)
    second = detect({("00", "a"): photograph}, BOARD)
    both = merged((first, second))
    assert [(seen.pose, seen.camera) for seen in both.detections] == [("00", "a"), ("01", "a")]
    assert [(view.pose, view.camera) for view in both.missed] == [("01", "b")]
    assert both.sizes_wh == {"a": (240, 180), "b": (240, 180)}
    cropped = Photograph(name="calibration/02/a.png", pixels=np.ascontiguousarray(photograph.pixels[:170]))
    third = detect({("02", "a"): cropped}, BOARD)
    with pytest.raises(ImageError, match=r"pose 02 of a: .*240 × 170 pixels, .*240 × 180"):
        merged((first, second, third))


def test_fewer_points_than_asked_for_do_not_count(photograph, monkeypatch):
    assert len(detect_in(photograph, BOARD, camera="a", pose="00").ids) == 20
    monkeypatch.setattr(ChessboardTarget, "least_points", 21)
    assert detect_in(photograph, BOARD, camera="a", pose="00") is None


def test_a_surveyed_list_of_points_that_is_not_seen_says_what_helps():
    (missed,) = detect({("00", "a"): BLANK}, POINTS).missed
    assert ".csv" in missed.remedy


def test_a_table_of_points_becomes_a_detection():
    ids, uv = np.array([3, 0, 1]), np.array([[30.0, 40.0], [10.0, 20.0], [50.5, 20.0]])
    table = MeasuredPoints(name="00/a.csv", ids=ids, uv=uv)
    seen = detect({("00", "a"): BLANK}, POINTS, measured={("00", "a"): table})
    (found,) = seen.detections
    assert (found.pose, found.camera) == ("00", "a")
    np.testing.assert_array_equal(found.ids, [0, 1, 3])
    np.testing.assert_array_equal(found.uv, [[10.0, 20.0], [50.5, 20.0], [30.0, 40.0]])
    np.testing.assert_allclose(found.covariance_px2, np.tile((0.2**2 + 0.01**2) * np.eye(2), (3, 1, 1)))


@pytest.mark.parametrize(
    ("ids", "uv", "std_px", "words"),
    [
        ([], [], 0.2, "points"),
        ([0, 4], [[1, 1], [2, 2]], 0.2, "id 4"),
        ([0, -1], [[1, 1], [2, 2]], 0.2, "id -1"),
        ([2, 2], [[1, 1], [2, 2]], 0.2, "id 2 twice"),
        ([0, 1], [[1, 1], [240, 2]], 0.2, "point 1 at u 240, v 2"),
        ([0, 1], [[1, float("nan")], [24, 2]], 0.2, "point 0"),
        ([0, 1], [[1, 1], [24, 2]], [0.2, 0.0], "positive"),
    ],
)
def test_a_wrong_table_is_one_clear_sentence(ids, uv, std_px, words):
    with pytest.raises(CalibrationError, match=r"00/a\.csv") as caught:
        points_from_table(
            "00/a.csv",
            np.array(ids, np.int64),
            np.array(uv, np.float64).reshape(-1, 2),
            POINTS,
            (240, 180),
            std_px=std_px,
        )
    assert words in str(caught.value)


def test_values_that_contradict_themselves_are_refused():
    ids, uv, covariance = np.array([0, 2]), np.zeros((2, 2)), np.tile(np.eye(2), (2, 1, 1))
    with pytest.raises(ValueError, match="ascend"):
        Detection(camera="a", pose="00", ids=ids[::-1], uv=uv, covariance_px2=covariance)
    with pytest.raises(ValueError, match="finite"):
        Detection(camera="a", pose="00", ids=ids, uv=uv + np.nan, covariance_px2=covariance)
    good = Detection(camera="a", pose="00", ids=ids, uv=uv, covariance_px2=covariance)
    with pytest.raises(ValueError, match="size"):
        Observations(target=POINTS, sizes_wh={"b": (1, 1)}, detections=(good,))
    outside = Detection(camera="a", pose="00", ids=np.array([0, 4]), uv=uv, covariance_px2=covariance)
    with pytest.raises(ValueError, match="outside 0…3"):
        Observations(target=POINTS, sizes_wh={"a": (1, 1)}, detections=(outside,))


def test_every_photograph_is_searched_with_the_same_random_numbers():
    """OpenCV's search for a chessboard draws them: in a noisy picture it finds the board with some, not with others."""

    def drawn_next(seed):
        cv2.setRNGSeed(seed)  # as other photographs would have left it, searched before in the same thread
        detect_in(BLANK, BOARD, camera="a", pose="01")
        return cv2.randu(np.zeros(4), 0.0, 1.0).tolist()

    assert drawn_next(1) == drawn_next(2)


@pytest.mark.slow
def test_photographs_that_come_late_are_put_where_they_belong(photograph):
    """The first ones are read last, so that the threads finish in another order than they began."""

    class Slow(dict):
        def __getitem__(self, key):
            time.sleep(0.05 * (3 - int(key[0])))
            return super().__getitem__(key)

    seen = Slow({(f"{pose:02d}", "a"): photograph for pose in range(4)})
    alone, together = (detect(seen, BOARD, threads=threads) for threads in (1, 4))
    assert [view.pose for view in together.detections] == ["00", "01", "02", "03"]
    assert to_bytes(alone) == to_bytes(together)
