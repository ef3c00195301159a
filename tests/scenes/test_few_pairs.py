"""Casts that hang over their rim, before one pair of cameras: what no camera sees is in the interval."""

from pathlib import Path

import pytest

from mammometry.api import open_session
from mammometry.io.truth import read_volumes
from mammometry.settings import Settings
from mammometry.simulate.session import write_session


@pytest.mark.slow
@pytest.mark.parametrize(
    ("subject", "pair"), [("plaster_3", "front"), ("plaster_2", "front"), ("plaster_8", "left"), ("plaster_9", "front")]
)
def test_the_truth_lies_within_a_wide_interval(tmp_path: Path, tiny_settings: Path, subject: str, pair: str) -> None:
    """A tenth of the size. The front pair sees less than half of these rims, and nothing of the skin below the pole."""
    session = tmp_path / "session"
    write_session(session, rig=f"reference:{pair}", subject=subject, scale=0.1, seed=7, poses=4)
    found = open_session(session, Settings.load(tiny_settings)).measure()["model"]
    assert found.interval_cc is not None
    low_cc, high_cc = found.interval_cc
    assert low_cc <= read_volumes(session / "truth")["model"] <= high_cc
    assert high_cc - low_cc > 0.2 * found.volume_cc
