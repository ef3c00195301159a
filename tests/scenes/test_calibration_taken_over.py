"""A visit takes its rig's calibration over: the same cameras, with their errors, and nothing is calibrated again."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from tests.later_exposure import later_exposure

from mammometry.api.job import open_session
from mammometry.capture.sessions import take_over
from mammometry.clinic.jobs import work
from mammometry.io.drift import read_history
from mammometry.job.stages import calibrate
from mammometry.settings import Settings


@pytest.mark.slow
def test_cameras_and_their_errors_are_taken_over(tiny_finished: Path, tiny_original: Path, tmp_path: Path) -> None:
    visit = Path(shutil.copytree(tiny_original, tmp_path / "visit"))
    manifest = visit / "session.toml"
    manifest.write_text(manifest.read_text().replace('kind = "model"', 'kind = "model"\nid = "P-ACD347"'))
    job, source = open_session(visit), open_session(tiny_finished)
    taken = take_over(job, source)
    assert taken == len(job.plan.products("calibrate"))
    assert take_over(job, source) == 0
    theirs, ours = source.calibrate(), job.calibrate()
    assert len(job.store.made) == taken + 1  # and the previews, which show this visit's pictures
    for name, camera in theirs.rig.cameras.items():
        assert np.array_equal(camera.matrix, ours.rig.cameras[name].matrix)
    assert ours.std == theirs.std
    record = job.store.record(job.plan[calibrate.cameras].key)
    assert record is not None
    assert record.subject == "P-ACD347"


def test_other_photographs_are_not_taken_for_the_same(tiny_finished: Path, tiny_original: Path, tmp_path: Path) -> None:
    tiny = Path(shutil.copytree(tiny_original, tmp_path / "visit"))
    photograph = next(tiny.glob("calibration/*/front_left.jpg"))
    photograph.write_bytes(photograph.read_bytes() + b"\x00")
    job = open_session(tiny, Settings())
    take_over(job, open_session(tiny_finished))  # what was seen in the others
    assert not job.store.has(job.plan[calibrate.cameras].key)


def test_what_a_calibrations_photographs_tell(tiny_original: Path) -> None:
    known = work.known_cameras(tiny_original)
    assert set(known) == {"front_left", "front_right"}
    assert {about.stored_wh for about in known.values()} == {(450, 300)}
    assert {about.clock_s for about in known.values()} == {None}  # the simulation writes no EXIF


def test_a_calibration_is_judged_in_figures_that_a_database_can_hold(tiny_finished: Path) -> None:
    answer = work.calibrate(lambda stage, fraction: None, str(tiny_finished), Settings().to_toml())
    figures = json.loads(json.dumps(answer["figures"], allow_nan=False))
    assert figures["verdict"] in ("pass", "warn")
    assert 0 < figures["rms_px"] < 1
    assert set(figures["cameras"]) == {"front_left", "front_right"}
    assert figures["poses"] == 8


@pytest.mark.slow
def test_a_check_that_is_begun_twice_is_entered_once(tiny_finished: Path, tmp_path: Path) -> None:
    """The board where one pose of the calibration had it: nothing has moved."""
    folder = later_exposure(tiny_finished / "calibration" / "00", tmp_path / "check")
    asked = (lambda stage, fraction: None, str(tiny_finished), str(folder), Settings().to_toml())
    first, second = work.check(*asked), work.check(*asked)
    assert first == second
    assert first["figures"]["verdict"] == "unmoved"
    assert len(read_history(tiny_finished).entries) == 1
