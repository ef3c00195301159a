"""Where `photos` puts its session."""

import pytest

from mammometry.base.errors import SessionError
from mammometry.cli.main import run


@pytest.mark.parametrize("given", [".", "../anna", "below/..", "{}"])
def test_the_session_is_next_to_the_folder_however_it_is_named(tmp_path, monkeypatch, given):
    folder = tmp_path / "anna"
    (folder / "below").mkdir(parents=True)
    monkeypatch.chdir(folder)
    found = []

    def prepare(of, out, **_):
        found.append((of.resolve(), out.resolve()))
        raise SessionError("x", found="x", expected="x", remedy="x")

    monkeypatch.setattr("mammometry.api.photos.prepare_walk", prepare)
    assert run(["photos", given.format(folder)]) == SessionError.exit_code
    assert found == [(folder, tmp_path / "anna-session")]
