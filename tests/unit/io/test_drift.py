"""The history of a rig's checks: it only grows, and a bad line costs itself alone."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

from mammometry.base.errors import StorageError
from mammometry.io.drift import FOLDER, HISTORY, CameraDrift, DriftEntry, append_history, entry_table, read_history


def entry(number: int, image_set: str = "monday") -> DriftEntry:
    drift = CameraDrift(moved=False, shift_mm=0.5, turn_deg=0.0, shift_px=0.25, sigma=1.0)
    return DriftEntry(
        when=f"2026-11-{number:02}T10:00:00+01:00",
        image_set=image_set,
        calibration="abc",
        verdict="unmoved",
        effect_mm=0.0,
        reasons=("no camera moved",),
        cameras={"left": drift},
    )


def line(number: int) -> bytes:
    return json.dumps(entry_table(entry(number))).encode()


@pytest.mark.parametrize(
    "bad",
    [
        b"nothing",
        b"\xff\xfe\x00",
        b"[]",
        b"{}",
        b'{"format": 2}',
        b"[" * 100_000,
        line(2)[:60],
        line(2).replace(b"0.0", b'"much"'),
        line(2).replace(b'"effect_mm": 0.0', b'"effect_mm": 1e999'),
    ],
)
@pytest.mark.requirement("R-LOSS-13")
def test_a_bad_line_is_named_and_kept_and_the_others_are_read(tmp_path: Path, bad: bytes) -> None:
    (tmp_path / FOLDER).mkdir()
    path = tmp_path / FOLDER / HISTORY
    path.write_bytes(b"\n".join([line(1), bad, line(3), b""]))
    before = path.read_bytes()
    append_history(tmp_path, entry(4))
    found = read_history(tmp_path)
    assert found.entries == (entry(1), entry(3), entry(4))
    (notice,) = found.notices
    assert (notice.code, notice.values["file"], notice.values["line"]) == ("check-unreadable", f"{FOLDER}/{HISTORY}", 2)
    assert path.read_bytes().startswith(before)


def test_no_history_is_an_empty_one(tmp_path: Path) -> None:
    assert read_history(tmp_path).entries == ()
    assert read_history(tmp_path).notices == ()


@pytest.mark.parametrize("cut", [1, 40])
def test_a_torn_last_line_does_not_tear_the_next(tmp_path: Path, cut: int) -> None:
    append_history(tmp_path, entry(1))
    append_history(tmp_path, entry(2))
    path = tmp_path / FOLDER / HISTORY
    path.write_bytes(path.read_bytes()[:-cut])
    append_history(tmp_path, entry(3))
    found = read_history(tmp_path)
    whole = cut == 1  # only the end of the line was lost
    assert found.entries == ((entry(1), entry(2), entry(3)) if whole else (entry(1), entry(3)))
    assert len(found.notices) == (0 if whole else 1)


def test_names_with_any_letters_are_one_line(tmp_path: Path) -> None:
    odd = "a\u2028b\nc\udcffd"  # a line of its own for some readers; and a file name that is no UTF-8
    append_history(tmp_path, entry(1, odd))
    assert read_history(tmp_path).entries[0].image_set == odd


@pytest.mark.slow
@pytest.mark.requirement("R-LOSS-13")
def test_checks_at_the_same_time_all_stay(tmp_path: Path) -> None:
    code = """
import sys; sys.path.insert(0, sys.argv[2])
from pathlib import Path
from test_drift import entry
from mammometry.io.drift import append_history
for number in range(1, 9):
    append_history(Path(sys.argv[1]), entry(number, "x" * 20_000))
"""
    command = [sys.executable, "-c", code, str(tmp_path), str(Path(__file__).parent)]
    at_once = [subprocess.Popen(command) for _ in range(2)]
    assert [each.wait(timeout=60) for each in at_once] == [0, 0]
    found = read_history(tmp_path)
    assert (len(found.entries), found.notices) == (16, ())


def test_what_the_disk_refuses_is_a_sentence(tmp_path: Path) -> None:
    (tmp_path / FOLDER).write_text("a file")
    with pytest.raises(StorageError):
        append_history(tmp_path, entry(1))
