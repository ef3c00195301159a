"""Boards to print: the page's size and every dark shape at true scale, read back from the PDF itself."""

import re
import shutil
import subprocess

import cv2
import numpy as np
import pytest

from mammometry.base.errors import SettingsError
from mammometry.calibration.targets.kinds.charuco import CharucoTarget, charuco_board
from mammometry.calibration.targets.kinds.chessboard import ChessboardTarget
from mammometry.calibration.targets.kinds.circles import CirclesTarget
from mammometry.calibration.targets.kinds.cylinder import DottedCylinderTarget, column_labels
from mammometry.calibration.targets.kinds.points import PointsTarget
from mammometry.calibration.targets.pdf import speckle_pdf, speckles, target_pdf

MM_PER_POINT = 25.4 / 72
CHARUCO = CharucoTarget(squares=(8, 6), square_mm=25.0, marker_mm=18.0, dictionary="DICT_5X5_250")


def page_mm(pdf: bytes) -> np.ndarray:
    box = re.search(rb"/MediaBox \[ 0 0 ([\d.]+) ([\d.]+) \]", pdf)
    return np.array([float(side) for side in box.groups()]) * MM_PER_POINT


def path_points_mm(pdf: bytes) -> np.ndarray:
    """All path vertices of the page, mm from its lower left corner."""
    pairs = re.findall(rb"(?m)^(-?[\d.]+) (-?[\d.]+) [ml]$", pdf)
    return np.array(pairs, dtype=float) * MM_PER_POINT


@pytest.mark.parametrize("target", [CHARUCO, ChessboardTarget(squares=(8, 6), square_mm=25.0)])
@pytest.mark.requirement("R-UNIT-2")
def test_the_board_is_printed_at_true_scale(target):
    pdf = target_pdf(target, page="A4")
    np.testing.assert_allclose(page_mm(pdf), [297.0, 210.0], atol=1e-3)
    points = path_points_mm(pdf)
    board = points[: 4 * len(target.sheet().rectangles)]
    np.testing.assert_allclose(np.ptp(board, axis=0), [200.0, 150.0], atol=1e-3)
    # The ruler's line is 100 mm.
    rest = points[len(board) :]
    assert np.ptp(rest[:, 0]) == pytest.approx(100.0, abs=1e-3)


@pytest.mark.slow
def test_a_fitting_page_leaves_the_margins():
    np.testing.assert_allclose(page_mm(target_pdf(CHARUCO, margin_mm=12.0)), [224.0, 150.0 + 24.0 + 16.0], atol=1e-3)


def test_circles_have_their_diameter():
    target = CirclesTarget(grid=(4, 11), pitch_mm=12.0, diameter_mm=9.0, asymmetric=True)
    pdf = target_pdf(target, page="letter")
    np.testing.assert_allclose(page_mm(pdf), [215.9, 279.4], atol=1e-3)
    curves = re.findall(rb"(?m)^(?:-?[\d.]+ ){4}(-?[\d.]+) (-?[\d.]+) c$", pdf)
    ends = np.array(curves, dtype=float)[: 8 * 44] * MM_PER_POINT
    np.testing.assert_allclose(np.ptp(ends, axis=0), target.points_target[:, :2].max(axis=0) + 9.0, atol=2e-3)


@pytest.mark.parametrize("legacy_pattern", [False, True])
def test_what_is_printed_is_opencvs_board(legacy_pattern):
    target = CharucoTarget(
        squares=(5, 4), square_mm=28.0, marker_mm=21.0, dictionary="DICT_5X5_250", legacy_pattern=legacy_pattern
    )
    scale = 2  # pixels per mm: 56 a square, 42 a marker, 6 a cell of 7
    picture = np.full((4 * 56, 5 * 56), 255, np.uint8)
    for x, y, width, height in target.sheet().rectangles * scale:
        cv2.rectangle(picture, (round(x), round(y)), (round(x + width) - 1, round(y + height) - 1), 0, cv2.FILLED)
    expected = charuco_board(target).generateImage((5 * 56, 4 * 56), marginSize=0, borderBits=1)
    assert (picture != expected).mean() < 1e-3


CYLINDER = DottedCylinderTarget(dots=(9, 18), radius_mm=34.3775, row_pitch_mm=12.0, column_pitch_mm=12.0, dot_mm=5.0)
CIRCLES = CirclesTarget(grid=(7, 5), pitch_mm=24.0, diameter_mm=12.0)
STAGGERED = CirclesTarget(grid=(4, 9), pitch_mm=18.0, diameter_mm=13.0, asymmetric=True)


@pytest.mark.skipif(shutil.which("pdftoppm") is None, reason="no pdftoppm to draw the page with")
@pytest.mark.parametrize(
    "target",
    [
        *(CHARUCO, CYLINDER),
        pytest.param(STAGGERED, marks=pytest.mark.slow),
        pytest.param(ChessboardTarget(squares=(8, 6), square_mm=25.0), marks=pytest.mark.slow),
        pytest.param(CIRCLES, marks=pytest.mark.slow),
    ],
)
def test_what_another_program_draws_has_its_size(target, tmp_path):
    """Every dark shape's place and size on the page as poppler rasterises it, 10 pixels a millimetre."""
    (tmp_path / "page.pdf").write_bytes(target_pdf(target, page="A4"))
    command = ["pdftoppm", "-r", "254", "-gray", "-singlefile", str(tmp_path / "page.pdf"), str(tmp_path / "page")]
    subprocess.run(command, check=True)
    page = cv2.imread(str(tmp_path / "page.pgm"), cv2.IMREAD_GRAYSCALE)
    np.testing.assert_allclose(page.shape[::-1], 10 * page_mm((tmp_path / "page.pdf").read_bytes()), atol=1.5)
    _, _, stats, centroids = cv2.connectedComponentsWithStats((page < 128).astype(np.uint8))
    if isinstance(target, CirclesTarget):
        expected = target.points_target[:, :2]
        area_mm2 = np.pi * target.diameter_mm**2 / 4
    elif isinstance(target, DottedCylinderTarget):
        # Row 0 is the lowest, column 0 the leftmost.
        row, column = np.divmod(np.arange(9 * 18), 18)
        expected = np.column_stack([column, -row]) * 12.0
        area_mm2 = 25.0
    else:
        # What is dark of the whole board, square by square and marker cell by marker cell.
        dark = np.argwhere(page[:-300] < 128) / 10
        np.testing.assert_allclose(
            np.ptp(dark, axis=0) + 0.1, np.array(target.squares)[::-1] * target.square_mm, atol=0.11
        )
        rectangles = target.sheet().rectangles
        assert len(dark) / 100 == pytest.approx(float((rectangles[:, 2] * rectangles[:, 3]).sum()), rel=0.002)
        return
    dots = np.abs(stats[:, cv2.CC_STAT_AREA] / 100 - area_mm2) < 0.02 * area_mm2 + 0.1
    boxes = stats[:, cv2.CC_STAT_WIDTH] * stats[:, cv2.CC_STAT_HEIGHT]
    dots &= boxes * (np.pi / 4 if isinstance(target, CirclesTarget) else 1.0) < 105 * area_mm2  # labels have holes
    assert dots.sum() == len(expected)
    found = centroids[dots] / 10
    found = found[np.lexsort(np.rint(found).T)]
    expected = expected[np.lexsort(np.rint(expected).T)]
    np.testing.assert_allclose(found - found[0], expected - expected[0], atol=0.03)


def test_no_two_columns_of_a_cylinder_have_labels_that_are_alike():
    labels = column_labels(60).reshape(60, -1).astype(float)
    # The strips of two photographs must correlate by 0.5 to be the same, and by 0.1 more than at any other place.
    assert (np.corrcoef(labels) - np.eye(60)).max() < 0.55


def test_more_columns_than_labels_are_said():
    many = DottedCylinderTarget(dots=(3, 1001), radius_mm=200.0, row_pitch_mm=2.0, column_pitch_mm=1.0)
    with pytest.raises(SettingsError, match="1001 columns"):
        target_pdf(many)


@pytest.mark.parametrize(
    ("target", "page", "words"),
    [
        (CHARUCO, "A5", "'A5'"),
        (CharucoTarget(squares=(14, 10), square_mm=25.0, marker_mm=18.0, dictionary="DICT_5X5_250"), "A4", "least"),
        (PointsTarget(points_mm=tuple(map(tuple, np.eye(4, 3).tolist()))), "A4", "'points'"),
    ],
)
def test_what_cannot_be_printed_is_said(target, page, words):
    with pytest.raises(SettingsError, match=words):
        target_pdf(target, page=page)


def test_speckles_do_not_touch_and_fill_the_page() -> None:
    sheet = speckles((60.0, 80.0), 1.5, seed=3)
    places, radii = sheet.discs[:, :2], sheet.discs[:, 2]
    gaps = np.linalg.norm(places[:, None] - places[None], axis=2) - radii[:, None] - radii[None]
    assert gaps[~np.eye(len(places), dtype=bool)].min() >= 0.0
    assert np.all(places - radii[:, None] >= 0.0)
    assert np.all(places + radii[:, None] <= [60.0, 80.0])
    assert 0.25 < np.pi * (radii**2).sum() / (60.0 * 80.0) < 0.5


@pytest.mark.slow
def test_the_speckled_page_has_its_size_and_is_small() -> None:
    pdf = speckle_pdf(page="A4")
    np.testing.assert_allclose(page_mm(pdf), [210.0, 297.0], atol=1e-3)
    assert len(pdf) < 3_000_000
    with pytest.raises(SettingsError):
        speckle_pdf(page="A9")
