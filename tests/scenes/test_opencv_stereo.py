"""OpenCV's own stereo sample: thirteen real pairs of a chessboard, calibrated from the photographs on."""

from pathlib import Path

import pytest

from mammometry.calibration.adjust.bundle import calibrate
from mammometry.calibration.adjust.calibrated import Calibration
from mammometry.calibration.detection.detect import detect
from mammometry.calibration.judge.quality import assess
from mammometry.calibration.targets.kinds.chessboard import ChessboardTarget
from mammometry.io.photographs.images import read_photograph

BOARD = ChessboardTarget(squares=(10, 7), square_mm=25.0)


@pytest.fixture(scope="module")
def calibration(shared_data: Path) -> Calibration:
    folder = shared_data / "opencv_samples"
    names = sorted(path.stem for path in folder.glob("*[01][0-9].jpg"))
    shots = {
        (name[-2:], name[:-2]): read_photograph(folder / f"{name}.jpg", name)
        for name in names
        if name[:-2] in ("left", "right")
    }
    return calibrate(detect(shots, BOARD), {"pair": ("left", "right")}, "sample")


@pytest.mark.slow
@pytest.mark.data
@pytest.mark.xdist_group("thirteen real pairs")
def test_as_good_as_its_own_calibration(calibration: Calibration) -> None:
    """OpenCV's stereo calibration of its own corners leaves 0.444 px; its lens has fx 535.9."""
    assert len(calibration.observations.detections) == 26
    assert calibration.rms_px <= 0.444
    assert calibration.rig.cameras["left"].matrix[0, 0] == pytest.approx(535.9, rel=5e-3)


@pytest.mark.slow
@pytest.mark.data
@pytest.mark.xdist_group("thirteen real pairs")
def test_poses_left_out_fit_nearly_as_well(calibration: Calibration) -> None:
    """The goal of 1.05 is missed by the plain ratio (decision 18): 162 unknowns of the board for 2800 coordinates."""
    left_out = calibration.left_out
    assert left_out is not None
    assert left_out.poses == 13
    assert left_out.left_out_px < 0.1  # a board taken as printed leaves 0.19 px
    assert left_out.ratio < 1.14
    assert 1.04 < left_out.chance_ratio < 1.08  # 1.054 and 1.076 by drawn noise, weighted as the corners or equally
    assert left_out.excess < 1.075


@pytest.mark.slow
@pytest.mark.data
@pytest.mark.xdist_group("thirteen real pairs")
def test_answers_whether_so_many_pixels_are_many(calibration: Calibration) -> None:
    quality = assess(calibration)
    assert "residuals" in {notice.code for notice in quality.notices}
    assert quality.verdict == "warn"  # one photograph was taken aside from the others, by 0.2 px
