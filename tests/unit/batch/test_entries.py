"""Which sessions a command line asks for."""

import pytest

from mammometry.base.errors import SessionError, TableError
from mammometry.batch.entries import find_entries


@pytest.fixture
def archive(tmp_path):
    for name in ("a-1", "a-2", "b-1"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "session.toml").write_text("")
    (tmp_path / "notes").mkdir()
    (tmp_path / ".hidden").mkdir()
    (tmp_path / ".hidden" / "session.toml").write_text("")
    return tmp_path


def names(entries):
    return [entry.name for entry in entries]


def test_a_folder_of_sessions_a_session_and_a_pattern(archive):
    assert names(find_entries([str(archive)])) == ["a-1", "a-2", "b-1"]
    assert names(find_entries([str(archive / "b-1")])) == ["b-1"]
    assert names(find_entries([str(archive / "a-*")])) == ["a-1", "a-2"]


def test_each_session_once_in_the_order_asked_for(archive, monkeypatch):
    monkeypatch.chdir(archive)
    (archive / "link").symlink_to(archive / "a-1")
    assert names(find_entries(["b-1", "link", "a-*", str(archive)])) == ["b-1", "a-1", "a-2"]


@pytest.mark.parametrize(("asked", "found"), [("none", "no such folder"), ("notes", "no session"), ("c-*", "no such")])
def test_where_there_is_none_is_said(archive, asked, found):
    with pytest.raises(SessionError, match=f"{asked.replace('*', '.')}: found {found}"):
        find_entries([str(archive / asked)])


def test_a_table_names_sessions_settings_and_references(archive):
    table = archive / "study.csv"
    table.write_text(
        "session;set;reference_left_cc;reference_right_cc\n"
        "a-1;measure.wall=plane matching.window_px=11;512,5;\n"
        "b-1;;;498\n"
    )
    first, second = find_entries([str(table)])
    assert first.address == str(archive / "a-1")
    assert first.assignments == ("measure.wall=plane", "matching.window_px=11")
    assert first.reference_cc == {"left": 512.5}
    assert (second.assignments, second.reference_cc) == ((), {"right": 498.0})


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("name\na-1\n", "column"),
        ("session\nnone\n", r"row 2.*session\.toml|row 2: .*'none'"),
        ("session,reference_cc\na-1,much\n", r"reference_cc: .*'much'"),
        ("session,reference_cc\na-1,-5\n", "column reference_cc: found -5"),
        ("session,reference_cc\na-1,nan\n", r"reference_cc: .*'nan'"),
        ("session,reference_leg_cc\na-1,5\n", "a column reference_leg_cc, expected reference_cc"),
        ("session,set\na-1,\na-1,measure.wall=plane\n", "twice"),
        ("", "empty"),
    ],
)
def test_a_table_that_is_not_as_said_is_refused(archive, text, said):
    table = archive / "study.csv"
    table.write_text(text)
    with pytest.raises((TableError, SessionError), match=said):
        find_entries([str(table)])


def test_results_go_into_a_folder_each(archive, tmp_path):
    entries = find_entries([str(archive)], str(tmp_path / "out"))
    assert [entry.results for entry in entries] == [str(tmp_path / "out" / name) for name in ("a-1", "a-2", "b-1")]
    assert all(entry.remote for entry in entries)
    other = archive / "notes" / "a-1"
    other.mkdir()
    (other / "session.toml").write_text("")
    with pytest.raises(SessionError, match="same name"):
        find_entries([str(archive), str(other)], "s3://bucket/out")
