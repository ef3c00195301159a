"""The power goes at any moment of a run: every product is there whole, as it was before or as it was made."""

import random
from pathlib import Path

import pytest
from recorded_disk import Recording, recorded
from small_products import NAMES, contents, key, make

from mammometry.io.results.store import Store

LOST = (1.0, 0.5, 0.0)
"""Chance that a step which may be undone is: all are, half of them, none (which is what kill -9 leaves)."""


def filled(folder: Path, version: int) -> Path:
    store = Store(folder)
    with store.taken():
        for name in NAMES:
            make(store, name, version)
    return folder


def check_whole(results: Path, wanted: dict[str, bytes]) -> None:
    """Every product is current in one of its two versions; made again, all bytes are those of the second."""
    store = Store(results)
    with store.taken():
        states = {name: (store.state(key(name, 1)), store.state(key(name, 2))) for name in NAMES}
        assert all("current" in both for both in states.values()), states
        for name in NAMES:
            make(store, name, 2)
    assert {f"{made.partition('/')[2]}" for made in store.made} == {
        n for n, (old, _) in states.items() if old == "current"
    }
    assert contents(results) == wanted
    assert not [path.name for path in results.iterdir() if path.name.startswith((".ready", ".writing", ".set-aside"))]


def run_recorded(tmp_path: Path) -> tuple[Recording, dict[str, bytes]]:
    results = filled(tmp_path / "results", 1)
    with recorded(results) as recording:
        filled(results, 2)
    return recording, contents(results)


@pytest.mark.slow
@pytest.mark.usefixtures("quick")
@pytest.mark.parametrize("lost", [LOST[0], *(pytest.param(lost, marks=pytest.mark.slow) for lost in LOST[1:])])
@pytest.mark.requirement("R-LOSS-2")
def test_a_power_cut_at_any_moment_of_a_run(tmp_path: Path, lost: float) -> None:
    recording, wanted = run_recorded(tmp_path)
    assert len(recording.steps) > 100
    for moment in range(len(recording.steps) + 1):
        left = tmp_path / "left" / f"{moment}"
        recording.after_power_cut(moment, left, random.Random(moment), lost)
        check_whole(left, wanted)


@pytest.mark.slow
@pytest.mark.usefixtures("quick")
@pytest.mark.parametrize("moments", [pytest.param(8, id="8"), pytest.param(100, id="100", marks=pytest.mark.slow)])
@pytest.mark.requirement("R-LOSS-2")
def test_a_second_power_cut_while_the_first_is_tidied_up(tmp_path: Path, moments: int) -> None:
    recording, wanted = run_recorded(tmp_path)
    ready = [at for at, step in enumerate(recording.steps) if step.target[1].startswith(".ready")]
    chance = random.Random(7)
    for number in range(moments):
        first = chance.choice(ready) + chance.randint(2, 12)
        left = tmp_path / "left" / f"{number}"
        recording.after_power_cut(first, left, chance, 0.5)
        with recorded(left) as tidying, Store(left).taken():
            pass
        for moment in range(0, len(tidying.steps) + 1, 2):
            again = tmp_path / "again" / f"{number}-{moment}"
            tidying.after_power_cut(moment, again, chance, 0.5)
            check_whole(again, wanted)


@pytest.mark.usefixtures("quick")
def test_the_first_results_of_all(tmp_path: Path) -> None:
    session = tmp_path / "session"
    session.mkdir()
    with recorded(session) as recording:
        filled(session / "results", 1)
    there: set[str] = set()
    for moment in range(len(recording.steps) + 1):
        left = tmp_path / "left" / f"{moment}"
        recording.after_power_cut(moment, left, random.Random(moment), 1.0)
        store = Store(left / "results")
        with store.taken():
            before, there = there, {name for name in NAMES if store.has(key(name, 1))}
        assert there >= before  # what survived a power cut earlier survives this one
        if not moment % 5:
            assert contents(filled(left / "results", 1)) == contents(session / "results")
    assert there == set(NAMES)
