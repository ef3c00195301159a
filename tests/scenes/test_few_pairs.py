"""Casts before one pair of cameras: what no camera sees is in the interval, and too little of a rim is refused."""

from pathlib import Path

import pytest

from mammometry.api.job import Job, open_session
from mammometry.base.errors import MeasureError
from mammometry.io.truth import read_volumes
from mammometry.settings import Settings
from mammometry.simulate.recipe import SessionRecipe
from mammometry.simulate.session import write_session


def _before_one_pair(folder: Path, settings: Path, subject: str, pair: str) -> Job:
    """A tenth of the size."""
    write_session(folder, SessionRecipe(rig=f"reference:{pair}", subject=subject, scale=0.1, seed=7, poses=8))
    return open_session(folder, Settings.load(settings).overridden(["measure.base_rim.minimum_sectors=36"]))


@pytest.mark.slow
@pytest.mark.parametrize(("subject", "pair"), [("plaster_3", "front"), ("plaster_8", "left")])
@pytest.mark.requirement("R-VOL-6")
def test_a_base_of_which_too_little_is_seen_is_refused(
    tmp_path: Path, tiny_settings: Path, subject: str, pair: str
) -> None:
    """On such rims several bases agree with the photographs, tens of cubic centimetres apart."""
    job = _before_one_pair(tmp_path / "session", tiny_settings, subject, pair)
    with pytest.raises(MeasureError, match=r"model: .*\d+ of 72"):
        job.measure()


@pytest.mark.slow
def test_the_truth_lies_within_a_wide_interval(tmp_path: Path, tiny_settings: Path) -> None:
    """The pair sees a good half of this rim, and nothing of the skin below the pole."""
    job = _before_one_pair(tmp_path / "session", tiny_settings, "plaster_2", "front")
    found = job.measure()["model"]
    assert found.interval_cc is not None
    low_cc, high_cc = found.interval_cc
    assert low_cc <= read_volumes(tmp_path / "session" / "truth")["model"] <= high_cc
    assert high_cc - low_cc > 0.2 * found.volume_cc
