"""The independent renderer's captures as sessions."""

from pathlib import Path

import pytest
from benchmarks.rendered import make_session

import mammometry as mm


@pytest.mark.data
def test_every_capture_with_truth_becomes_a_session(shared_data: Path, tmp_path: Path) -> None:
    """Also those that the folder's session.json does not list: disturbed captures of a listed body."""
    captures = sorted(shared_data.glob("rendered*/*/truth/truth.json"))
    assert {path.parent.parent.name for path in captures} >= {"plaster_c", "torso", "torso_rail", "torso_one_side"}
    for path in captures:
        subject = path.parent.parent.name
        session = mm.open_session(make_session(path.parents[2], subject, tmp_path / subject)).session
        assert len(session.cameras) == 8


def test_an_unknown_capture_is_refused(tmp_path: Path) -> None:
    (tmp_path / "session.json").write_text('{"subjects": {}}', encoding="utf-8")
    with pytest.raises(SystemExit):
        make_session(tmp_path, "nobody", tmp_path / "out")
    assert not (tmp_path / "out").exists()
