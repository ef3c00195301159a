"""The main job on captures that are not ours: an independent renderer's sessions, and a real two-camera capture."""

from pathlib import Path

import numpy as np
import pytest
from benchmarks.accuracy.multidic import SETTINGS, fit_cylinder, speckled, target_error_mm
from benchmarks.rendered import make_session, read_truth

import mammometry as mm
from mammometry.surface.range_image import triangulate

pytestmark = [pytest.mark.slow, pytest.mark.data]


@pytest.mark.parametrize("subject", ["plaster_a", "plaster_b"])
def test_a_casts_volume_is_within_half_a_percent_and_its_interval(
    shared_data: Path, tmp_path: Path, subject: str
) -> None:
    session = make_session(shared_data / "rendered", subject, tmp_path / subject)
    results = mm.open_session(session).run()
    true_cc = read_truth(shared_data / "rendered", subject).volumes_cc["model"]
    assert results.volumes_cc["model"] == pytest.approx(true_cc, rel=0.005)  # what its rim's black strip leaves
    interval = results.intervals_cc["model"]
    assert interval is not None
    assert interval[0] <= true_cc <= interval[1]
    assert results.watertight
    assert results.report is not None
    assert results.report.is_file()


def test_a_torsos_breasts_lie_within_their_intervals(shared_data: Path, tmp_path: Path) -> None:
    session = make_session(shared_data / "rendered", "torso", tmp_path / "torso")
    results = mm.open_session(session).run()
    truth = read_truth(shared_data / "rendered", "torso").volumes_cc
    assert set(results.volumes_cc) == {"left", "right"}
    for name, true_cc in truth.items():
        interval = results.intervals_cc[name]
        assert interval is not None
        assert interval[0] <= true_cc <= interval[1]


def test_a_real_cylinder_comes_out_round_and_of_its_size(shared_data: Path, tmp_path: Path, repository: Path) -> None:
    """Tolerances are the project's: the tube's own radius is not documented, 57.0 mm is the target's."""
    import runpy
    import sys

    sample_data = shared_data / "multidic" / "sample_data"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, "argv", ["make_sessions.py", str(sample_data), str(tmp_path)])
        runpy.run_path(str(repository / "examples" / "multidic" / "make_sessions.py"), run_name="__main__")
    job = mm.open_session(tmp_path / "1", mm.Settings().overridden([SETTINGS]))
    rig = job.calibrate().rig
    calibration = job.calibration()
    assert calibration is not None
    assert calibration.rms_px <= 0.55
    assert target_error_mm(calibration.observations, rig) <= 0.07
    share, points = speckled(sample_data, rig, triangulate(job.match()["front"]))
    fitted = fit_cylinder(points, np.array([0.0, 0.0, 1.0]), 57.0)
    assert share >= 0.95
    assert abs(fitted.radius_mm - 57.15) <= 0.15
    assert fitted.rms_mm <= 0.1
    assert fitted.kept > 0.99
