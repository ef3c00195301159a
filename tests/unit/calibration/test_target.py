"""Targets as numbers, and the manifest's table that describes them."""

import cv2
import numpy as np
import pytest

from mammometry.base.errors import SessionError
from mammometry.calibration.targets.kinds.charuco import CharucoTarget
from mammometry.calibration.targets.kinds.chessboard import ChessboardTarget
from mammometry.calibration.targets.kinds.circles import CirclesTarget
from mammometry.calibration.targets.kinds.cylinder import DottedCylinderTarget
from mammometry.calibration.targets.kinds.points import PointsTarget
from mammometry.calibration.targets.table import target_from_table

CHARUCO = {"kind": "charuco", "squares": [14, 10], "square_mm": 25.0, "marker_mm": 18.0, "dictionary": "DICT_5X5_250"}
CYLINDER = {
    "kind": "dotted-cylinder",
    "dots": [20, 14],
    "radius_mm": 57.0,
    "row_pitch_mm": 12.0,
    "column_pitch_mm": 12.0,
}
POINTS = [[0.0, 0.0, 0.0], [100.0, 0.0, 1.0], [0.0, 100.0, 2.0], [3, 4, 5]]


def test_charuco_points_are_opencvs():
    target = target_from_table(CHARUCO)
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_5X5_250)
    board = cv2.aruco.CharucoBoard((14, 10), 25.0, 18.0, dictionary)
    np.testing.assert_allclose(target.points_target, np.asarray(board.getChessboardCorners()).reshape(-1, 3), atol=1e-5)
    assert not target.is_surveyed


def test_chessboard_points_count_inner_corners():
    target = target_from_table({"kind": "chessboard", "squares": [4, 3], "square_mm": 10})
    expected = [[10, 10, 0], [20, 10, 0], [30, 10, 0], [10, 20, 0], [20, 20, 0], [30, 20, 0]]
    np.testing.assert_array_equal(target.points_target, np.array(expected, float))


def test_asymmetric_circles_are_laid_as_in_opencvs_example():
    target = CirclesTarget(grid=(4, 11), pitch_mm=20.0, diameter_mm=15.0, asymmetric=True)
    expected = [((2 * j + i % 2) * 20.0, i * 20.0, 0.0) for i in range(11) for j in range(4)]
    np.testing.assert_array_equal(target.points_target, expected)


def test_cylinder_points_lie_on_it_at_their_pitches():
    target = target_from_table(CYLINDER)
    points = target.points_target.reshape(20, 14, 3)
    np.testing.assert_allclose(np.hypot(points[..., 0], points[..., 1]), 57.0)
    np.testing.assert_allclose(np.diff(points[..., 2], axis=0), 12.0)
    angles = np.unwrap(np.arctan2(points[0, :, 1], points[0, :, 0]))
    np.testing.assert_allclose(np.diff(angles) * 57.0, 12.0)
    assert target.is_surveyed
    assert not target.closes
    assert DottedCylinderTarget(dots=(20, 30), radius_mm=57.2957795, row_pitch_mm=12.0, column_pitch_mm=12.0).closes


def test_surveyed_points_are_kept_in_order():
    target = target_from_table({"kind": "points", "points_mm": POINTS})
    np.testing.assert_array_equal(target.points_target, np.array(POINTS, float))
    assert target.is_surveyed


@pytest.mark.parametrize(
    ("table", "words"),
    [
        ({}, "kind:"),
        ({"kind": "chess"}, "'chess'"),
        ({**CHARUCO, "sqaure_mm": 3}, "sqaure_mm:"),
        ({key: value for key, value in CHARUCO.items() if key != "marker_mm"}, "marker_mm:"),
        ({**CHARUCO, "squares": [14, "10"]}, "squares"),
        ({**CHARUCO, "squares": [14, 10, 3]}, "squares"),
        ({**CHARUCO, "square_mm": "25"}, "square_mm"),
        ({**CHARUCO, "marker_mm": 25.0}, "marker_mm"),
        ({"kind": "chessboard", "squares": [2, 9], "square_mm": 10.0}, "3 × 3"),
        ({"kind": "chessboard", "squares": [8, 9], "square_mm": -1.0}, "positive"),
        ({"kind": "circles", "grid": [4, 5], "pitch_mm": 10.0, "diameter_mm": 10.0}, "touch"),
        ({**CYLINDER, "dots": [20, 40]}, "circumference"),
        ({**CYLINDER, "dot_mm": 12.0}, "dot_mm"),
        ({"kind": "points", "points_mm": POINTS[:3]}, "4 points"),
        ({**CHARUCO, "edge_mm": 350.4}, "edge_std_mm:"),
        ({**CHARUCO, "edge_mm": "350", "edge_std_mm": 0.1}, "edge_mm: found '350'"),
        ({**CHARUCO, "edge_mm": 250.0, "edge_std_mm": 0.1}, "350 mm"),
        ({**CHARUCO, "edge_mm": float("nan"), "edge_std_mm": 0.1}, "edge_mm"),
        ({**CHARUCO, "edge_std_mm": 0.0}, "edge_std_mm"),
        ({**CHARUCO, "flatness_mm": -0.1}, "flatness_mm"),
        ({**CYLINDER, "edge_mm": 100.0}, "edge_mm:"),
        ({**CYLINDER, "scale_std": float("inf")}, "scale_std"),
        ({"kind": "points", "points_mm": [*POINTS, [1.0, float("nan"), 2.0]]}, "finite"),
    ],
)
def test_a_wrong_table_is_one_clear_sentence(table, words):
    with pytest.raises(SessionError) as caught:
        target_from_table(table)
    assert words in str(caught.value)
    assert str(caught.value).startswith("[target]")


@pytest.mark.parametrize(
    ("table", "edge_mm"),
    [
        (CHARUCO, 350.0),
        ({"kind": "chessboard", "squares": [10, 7], "square_mm": 20.0}, 200.0),
        ({"kind": "circles", "grid": [5, 4], "pitch_mm": 10.0, "diameter_mm": 5.0}, 40.0),
        ({"kind": "circles", "grid": [4, 9], "pitch_mm": 10.0, "diameter_mm": 5.0, "asymmetric": True}, 70.0),
    ],
)
def test_a_measured_edge_scales_the_whole_board_and_says_how_surely(table, edge_mm):
    nominal = target_from_table(table)
    assert nominal.edge_mm == pytest.approx(edge_mm)
    assert nominal.scale_std is None
    measured = target_from_table({**table, "edge_mm": 1.002 * edge_mm, "edge_std_mm": 0.05, "flatness_mm": 0.2})
    np.testing.assert_allclose(measured.points_target, 1.002 * nominal.points_target)
    assert measured.edge_mm == pytest.approx(1.002 * edge_mm)
    assert measured.scale_std == pytest.approx(0.05 / (1.002 * edge_mm))
    assert measured.flatness_mm == 0.2
    for name in {"square_mm", "marker_mm", "diameter_mm"} & table.keys():
        assert getattr(measured, name) == pytest.approx(1.002 * table[name])


def test_a_survey_brings_its_own_uncertainty():
    assert target_from_table(CYLINDER).scale_std is None
    assert target_from_table({**CYLINDER, "scale_std": 1e-4}).scale_std == 1e-4
    assert target_from_table({"kind": "points", "points_mm": POINTS, "scale_std": 2e-4}).scale_std == 2e-4


def test_values_cannot_be_written_through():
    for target in (
        target_from_table(CHARUCO),
        ChessboardTarget(squares=(4, 3), square_mm=1.0),
        CirclesTarget(grid=(3, 3), pitch_mm=10.0, diameter_mm=5.0),
        target_from_table(CYLINDER),
        PointsTarget(points_mm=tuple(map(tuple, np.eye(4, 3).tolist()))),
    ):
        assert not target.points_target.flags.writeable


def test_a_legacy_charuco_board_has_the_same_corners():
    old = CharucoTarget(**{**target_kwargs(), "legacy_pattern": True})
    np.testing.assert_array_equal(old.points_target, CharucoTarget(**target_kwargs()).points_target)


def target_kwargs():
    return {"squares": (14, 10), "square_mm": 25.0, "marker_mm": 18.0, "dictionary": "DICT_5X5_250"}
