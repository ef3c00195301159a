"""Values that are made at every look-up are made once while somebody keeps them, as far as there is room."""

import threading
from concurrent.futures import ThreadPoolExecutor

import pytest

from mammometry.io import looked_up
from mammometry.io.looked_up import LazyMapping, SharedMapping, shared


def test_values_are_made_once_within_the_block_alone() -> None:
    made: list[str] = []

    def make(key: str, source: object) -> str:
        made.append(key)
        return f"{key}{source}"

    values = SharedMapping({"a": 1, "b": 2}, make, bytes_of=len)
    assert (values["a"], values["a"]) == ("a1", "a1")
    with shared(values):
        assert [values["a"], values["b"], values["a"], values["b"]] == ["a1", "b2", "a1", "b2"]
    assert values["b"] == "b2"
    assert made == ["a", "a", "a", "b", "b"]
    with shared(LazyMapping({"a": 1}, make)) as nothing:  # such a mapping stays as it is
        assert nothing is None


def test_what_has_no_room_is_made_again(monkeypatch: pytest.MonkeyPatch) -> None:
    made: list[str] = []
    monkeypatch.setattr(looked_up, "_ROOM_BYTES", 5)
    values = SharedMapping({"long": 1, "big": 2, "a": 3}, lambda key, _: made.append(key) or key, bytes_of=len)
    with shared(values):
        assert [values[key] for key in ("long", "big", "a", "long", "big", "a")] == ["long", "big", "a"] * 2
    assert made == ["long", "big", "a", "big"]


def test_two_that_need_a_value_at_once_wait_for_one_making() -> None:
    made: list[str] = []
    begun = threading.Event()

    def make(key: str, _: object) -> str:
        made.append(key)
        begun.set()
        threading.Event().wait(0.05)
        return key

    values = SharedMapping({"a": 1}, make, bytes_of=len)
    with shared(values), ThreadPoolExecutor(2) as pool:
        first = pool.submit(values.__getitem__, "a")
        assert begun.wait(5)
        assert (values["a"], first.result()) == ("a", "a")
    assert made == ["a"]
