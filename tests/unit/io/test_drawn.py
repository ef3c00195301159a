"""Drawn files are read as documented, changed item by item, and every version of them is kept."""

import json
import re
import threading
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mammometry.base.errors import SessionError, StorageError
from mammometry.io.drawn import boundaries_in, read_boundaries, read_landmarks
from mammometry.io.drawn_changes import ItemChange, LateError, change_drawn, drawn_entries, drawn_entry, entry_digest
from mammometry.measure.volume.attribution import CurveConfirmation, curve_digest

LEFT, RIGHT, NOTCH = ("boundaries", "left"), ("boundaries", "right"), ("landmarks", "sternal_notch")
CURVE = [[0.1, 0.25, 1 / 3], [10.0, 0.0, 0.0], [10.0, 10.0, 1e-3], [0.0, 10.0, 0.0]]


def entry(shift: float = 0.0, author: str = "A. Test") -> Mapping[str, Any]:
    return drawn_entry(np.array(CURVE) + shift, method="drawn by hand", author=author)


def put(session: Path, name: str, table: object) -> Path:
    (session / name).write_text(json.dumps(table), encoding="utf-8")
    return session / name


def history(session: Path) -> list[Path]:
    return sorted((session / "history").glob("*.json"))


@pytest.mark.parametrize(
    ("table", "found"),
    [
        ({"landmarks": {"elbow": {"points": [[0, 0, 0]]}}}, "unknown name"),
        ({"landmarks": {"sternal_notch": {"points": [[0, 0, 0], [1, 1, 1]]}}}, "2 points"),
        ({"landmarks": {"sternal_notch": {"points": []}}}, "0 points"),
        ({"landmarks": {"midline": {"points": [[0, 0, 0]]}}}, "1 points"),
        ({"landmarks": {"midline": {"points": [["a", 0, 0]]}}}, r"not \[x, y, z\]"),
        ({"landmarks": {"midline": {"points": [[0, 0], [1, 1], [2, 2]]}}}, r"not \[x, y, z\]"),
        ({"landmarks": {"midline": {"points": [0, 0, 0, 1, 1, 1]}}}, r"not \[x, y, z\]"),
        ({"landmarks": {"midline": {"points": [[0, 0, float("nan")], [1, 1, 1]]}}}, "not a finite number"),
        ({"landmarks": {"midline": {"points": [[0, 0, 1e300], [1, 1, 1]]}}}, "outside"),
        ({"landmarks": {"midline": [[0, 0, 0]]}}, "not a table"),
        ({"units": "cm", "landmarks": {}}, "units 'cm'"),
        ([], "wrong content"),
    ],
)
def test_a_landmark_file_that_is_not_as_documented_is_named(tmp_path: Path, table: object, found: str) -> None:
    put(tmp_path, "landmarks.json", table)
    with pytest.raises(SessionError, match=found):
        read_landmarks(tmp_path, "torso")


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ('{"boundaries": {"left": {"points": []}, "left": {"points": []}}}', ".left"),
        ("[" * 100_000, "JSON"),
        ("{", "JSON"),
        ('{"boundaries": {"left": {"points": [[0,0,0],[1,0,0],[1,1,0]], "method": 3}}}', "text"),
        ('{"boundaries": {"left": {"automatic": true, "confirmed": {"by": "A"}}}}', "'at'"),
        ('{"boundaries": {"left": {}}}', "points"),
    ],
)
def test_a_boundary_file_that_is_not_as_documented_is_named(tmp_path: Path, text: str, found: str) -> None:
    (tmp_path / "boundaries.json").write_text(text)
    with pytest.raises(SessionError, match=found):
        read_boundaries(tmp_path, "torso")


def test_a_file_by_hand_is_read_with_its_byte_order_mark_exactly(tmp_path: Path) -> None:
    text = json.dumps({"boundaries": {"left": {"method": "traced in another program", "points": CURVE}}})
    (tmp_path / "boundaries.json").write_bytes(b"\xef\xbb\xbf" + text.encode())
    drawn = read_boundaries(tmp_path, "torso")
    assert drawn.curves["left"].tolist() == CURVE
    assert drawn.attributions["left"].method == "traced in another program"
    assert drawn.automatic == ()


def test_a_drawing_of_another_subject_is_refused(tmp_path: Path) -> None:
    path = put(tmp_path, "boundaries.json", {"subject": "P-7", "boundaries": {}})
    for subject in (None, "P-7"):
        assert boundaries_in(path, ("left",), subject).curves == {}
    with pytest.raises(SessionError, match=r"'P-7', .*'P-8'"):
        boundaries_in(path, ("left",), "P-8")
    put(tmp_path, "boundaries.json", {"boundaries": {}})
    assert boundaries_in(path, ("left",), "P-8").curves == {}


@pytest.mark.requirement("R-LOSS-10")
def test_only_what_is_changed_changes_and_every_earlier_version_is_kept(tmp_path: Path) -> None:
    by_hand = {"note": "from the CT", "boundaries": {"left": {"points": CURVE, "key": "of theirs"}}}
    first = put(tmp_path, "boundaries.json", by_hand).read_bytes()
    mark = drawn_entry(np.array([[1.0, 2.0, 3.0]]), method="picked by hand", author="A. Test")
    (changed,) = change_drawn(tmp_path, "torso", {NOTCH: ItemChange(entry=mark, base=None)})
    assert changed.name == "landmarks.json"
    assert (tmp_path / "boundaries.json").read_bytes() == first
    assert history(tmp_path) == []

    change_drawn(tmp_path, "torso", {RIGHT: ItemChange(entry=entry(), base=None)})
    table = json.loads((tmp_path / "boundaries.json").read_text())
    assert table["note"] == "from the CT"
    assert table["boundaries"]["left"] == by_hand["boundaries"]["left"]  # type: ignore[index]
    assert read_boundaries(tmp_path, "torso").attributions["right"].method == "drawn by hand"
    (kept,) = history(tmp_path)
    assert kept.read_bytes() == first

    again = drawn_entries(tmp_path, "torso")[RIGHT]
    assert change_drawn(tmp_path, "torso", {RIGHT: ItemChange(entry=again, base="old")}) == ()  # nothing to be late for
    assert len(history(tmp_path)) == 1


def test_drawing_one_breast_leaves_the_other_automatic(tmp_path: Path) -> None:
    change_drawn(tmp_path, "torso", {LEFT: ItemChange(entry=entry(), base=None)})
    drawn = read_boundaries(tmp_path, "torso")
    assert set(drawn.curves) == {"left"}
    assert drawn.automatic == ("right",)
    there = drawn_entries(tmp_path, "torso")
    change_drawn(tmp_path, "torso", {LEFT: ItemChange(entry=None, base=entry_digest(there[LEFT]))})
    assert not (tmp_path / "boundaries.json").exists()
    (kept,) = history(tmp_path)
    assert set(json.loads(kept.read_text())["boundaries"]) == {"left", "right"}


def test_a_breast_that_the_file_leaves_out_stays_left_out(tmp_path: Path) -> None:
    put(tmp_path, "boundaries.json", {"boundaries": {"left": {"points": CURVE}}})
    base = entry_digest(drawn_entries(tmp_path, "torso")[LEFT])
    change_drawn(tmp_path, "torso", {LEFT: ItemChange(entry=entry(1.0), base=base)})
    assert set(json.loads((tmp_path / "boundaries.json").read_text())["boundaries"]) == {"left"}


@pytest.mark.requirement("R-LOSS-12")
def test_who_comes_late_is_told_and_loses_nothing(tmp_path: Path) -> None:
    change_drawn(tmp_path, "torso", {LEFT: ItemChange(entry=entry(), base=None)})
    before = (tmp_path / "boundaries.json").read_bytes()
    mine = entry(2.0, author="B. Late")
    mark = drawn_entry(np.array([[1.0, 2.0, 3.0]]), method="picked by hand", author="B. Late")
    changes = {LEFT: ItemChange(entry=mine, base=None), NOTCH: ItemChange(entry=mark, base=None)}
    with pytest.raises(LateError, match=r"left: .*A\. Test"):
        change_drawn(tmp_path, "torso", changes)
    assert (tmp_path / "boundaries.json").read_bytes() == before
    assert not (tmp_path / "landmarks.json").exists()  # all or nothing
    (kept,) = history(tmp_path)
    assert kept.name.startswith("late-")
    assert json.loads(kept.read_text())["boundaries"]["left"] == mine
    assert json.loads(kept.read_text())["landmarks"]["sternal_notch"] == mark


def test_changes_of_two_at_once_never_lose_one(tmp_path: Path) -> None:
    names = [f"{name}_{side}" for name in ("nipple", "medial", "lateral") for side in ("left", "right")]
    start = threading.Barrier(len(names))

    def save(name: str) -> None:
        mark = drawn_entry(np.array([[1.0, 2.0, 3.0]]), method="picked by hand", author=name)
        start.wait()
        change_drawn(tmp_path, "torso", {("landmarks", name): ItemChange(entry=mark, base=None)})

    threads = [threading.Thread(target=save, args=(name,)) for name in names]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert set(read_landmarks(tmp_path, "torso")) == set(names)
    assert len(history(tmp_path)) == len(names) - 1


def test_a_file_that_cannot_be_read_is_never_replaced(tmp_path: Path) -> None:
    (tmp_path / "boundaries.json").write_text("{")
    with pytest.raises(SessionError, match=r"boundaries.json: .*JSON"):
        change_drawn(tmp_path, "torso", {LEFT: ItemChange(entry=entry(), base=None)})
    assert (tmp_path / "boundaries.json").read_text() == "{"


def test_how_a_curve_came_to_be_is_told_from_the_last_hand_to_the_first(tmp_path: Path) -> None:
    earlier = (
        {"method": "the automatic boundary"},
        {"method": "edited by hand", "author": "A. First", "drawn": "2026-01-02T03:04:05Z"},
    )
    edited = drawn_entry(np.array(CURVE), method="edited by hand", author="B. Second", earlier=earlier)
    change_drawn(tmp_path, "model", {("boundaries", "model"): ItemChange(entry=edited, base=None)})
    of_model = read_boundaries(tmp_path, "model").attributions["model"]
    assert of_model.method.split(", from ") == ["edited by hand", "edited by hand", "the automatic boundary"]
    assert of_model.origin is not None
    last, first, automatic = of_model.origin.split(", from ")
    assert re.search(r"B\. Second .*\b20\d\d-", last)
    assert re.search(r"A\. First .*\b2026-01-02", first)
    assert automatic == "the automatic boundary"


@pytest.mark.requirement("R-WHO-5")
def test_a_confirmation_holds_for_the_curve_that_was_looked_at(tmp_path: Path) -> None:
    curve = np.array(CURVE)
    seen = {"by": "C. Eye", "at": "2026-11-22T10:00:00Z", "curve": curve_digest(curve)}
    put(tmp_path, "boundaries.json", {"boundaries": {"left": {"automatic": True, "confirmed": seen}}})
    drawn = read_boundaries(tmp_path, "torso")
    assert drawn.curves == {}
    confirmation = drawn.attributions["left"].confirmation
    assert confirmation == CurveConfirmation(by="C. Eye", at="2026-11-22T10:00:00Z", curve=curve_digest(curve))
    assert confirmation.holds(curve + 1e-9)
    assert not confirmation.holds(curve + 0.01)
    assert not confirmation.holds(curve[::-1])


def test_a_session_that_cannot_be_written_to_is_an_error_in_words(tmp_path: Path) -> None:
    with pytest.raises(StorageError, match="disk"):
        change_drawn(tmp_path / "missing", "torso", {LEFT: ItemChange(entry=entry(), base=None)})
