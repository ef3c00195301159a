"""`value`: frozen in every field, checked before, and otherwise the dataclass that it replaces."""

import copy
import pickle
from collections.abc import Mapping
from dataclasses import FrozenInstanceError, replace
from functools import cached_property
from typing import Any

import numpy as np
import pytest

from mammometry.base.value import value


@value
class Plain:
    name: str
    size: int = 2


@value(eq=False)
class Arrays:
    points: np.ndarray
    named: Mapping[str, Any]
    parts: tuple[Any, ...] = ()


@value(eq=False, slots=False)
class Cached:
    points: np.ndarray

    @cached_property
    def sum(self) -> float:
        return float(self.points.sum())


@value
class Checked:
    sizes: tuple[int, ...]

    def __post_init__(self) -> None:
        if not all(size > 0 for size in self.sizes):
            raise ValueError("sizes are positive")


def test_values_with_equal_fields_are_equal_and_hash_alike() -> None:
    assert Plain(name="a") == Plain(name="a", size=2) != Plain(name="b")
    assert len({Plain(name="a"), Plain(name="a"), Plain(name="b")}) == 2
    assert pickle.loads(pickle.dumps(Plain(name="a"))) == Plain(name="a")
    with pytest.raises(FrozenInstanceError):
        Plain(name="a").name = "b"  # type: ignore[misc]
    with pytest.raises(TypeError):
        Plain("a")  # type: ignore[call-arg]


def test_arrays_dictionaries_and_lists_cannot_be_changed_at_any_depth() -> None:
    points, inner = np.zeros(3), np.ones(2)
    made = Arrays(points=points, named={"a": {"b": inner}}, parts=[inner, [1, 2]])  # type: ignore[arg-type]
    assert np.shares_memory(made.points, points), "arrays are not copied"
    for array in (made.points, made.named["a"]["b"], made.parts[0]):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 5.0
    with pytest.raises(TypeError):
        made.named["c"] = 1  # type: ignore[index]
    with pytest.raises(TypeError):
        made.named["a"]["c"] = 1
    assert made.parts[1] == (1, 2)
    points[0] = 7.0  # whoever owns the array may write to it


def test_values_of_arrays_compare_by_identity() -> None:
    made = Arrays(points=np.zeros(3), named={})
    again = replace(made, named={"a": 1})
    assert len({made, again}) == 2
    assert made != again
    assert copy.copy(Plain(name="a")) == Plain(name="a")


def test_what_was_given_is_checked_and_cached_properties_are_kept() -> None:
    assert Checked(sizes=(1, 2)).sizes == (1, 2)
    with pytest.raises(ValueError, match="positive"):
        Checked(sizes=(1, 0))
    with pytest.raises(ValueError, match="positive"):
        replace(Checked(sizes=(1,)), sizes=(0,))
    cached = Cached(points=np.ones(3))
    assert cached.sum == 3.0
    assert "sum" in vars(cached)
