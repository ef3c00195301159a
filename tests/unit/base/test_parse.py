"""Text from outside: what is refused before a reader sees it, and numbers against Python's own."""

import math
import os
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mammometry.base.errors import MammometryError, SessionError
from mammometry.base.parse import (
    DEEPEST,
    LARGEST,
    json_value,
    number,
    numbers,
    read_bytes,
    read_text,
    shown,
    toml_table,
    whole,
)

FINITE = st.floats(min_value=-LARGEST, max_value=LARGEST)


@given(FINITE)
def test_every_number_that_python_writes_is_read_back(value: float) -> None:
    assert number(repr(value)) == value


@given(st.text())
def test_any_other_text_is_read_as_python_does_or_refused(text: str) -> None:
    try:
        value = number(text)
    except ValueError:
        return
    assert value == float(text)
    assert text.isascii()
    assert "_" not in text
    assert math.isfinite(value)


@pytest.mark.parametrize(
    "text", ["", " 1", "1_0", "٣", "nan", "inf", "1e308", "-1e16", "1e9999", "0x10", "1,5", "1e", "."]
)
def test_what_is_no_number(text: str) -> None:
    with pytest.raises(ValueError, match="number"):
        number(text)


@given(st.lists(st.lists(FINITE, min_size=3, max_size=3)))
def test_rows_of_numbers_are_an_array(rows: list[list[float]]) -> None:
    np.testing.assert_array_equal(numbers(rows, -1, 3), np.array(rows).reshape(-1, 3))


@pytest.mark.parametrize(
    ("value", "shape"),
    [
        ([1, 2], (3,)),
        ([[1, 2], [3, 4], [5, 6]], (-1, 3)),  # six numbers, but no two points
        ([[1], [2, 3]], (3,)),
        (["1", "2", "3"], (3,)),
        ([True, 2, 3], (3,)),
        ([None, 2, 3], (3,)),
        ([math.nan, 2, 3], (3,)),
        ([math.inf, 2, 3], (3,)),
        ([1e16, 2, 3], (3,)),
        ([10**400, 2, 3], (3,)),
        ({"a": 1}, (1,)),
        ("123", (3,)),
        ([[1, 2, 3, 4, 5]], (-1, 3)),
    ],
)
def test_what_are_no_numbers(value: object, shape: tuple[int, ...]) -> None:
    with pytest.raises(ValueError, match=r"."):
        numbers(value, *shape)


@pytest.mark.parametrize("value", [1.5, "3", True, None, [1, 2], math.nan])
def test_what_is_no_whole_number(value: object) -> None:
    with pytest.raises(ValueError, match=r"."):
        whole(value)
    assert whole(3.0) == 3


DEEP = 100_000
HOSTILE: list[tuple[Callable[..., Any], str, str]] = [
    (json_value, "[" * DEEP, "nested more than"),
    (json_value, '{"a":' * DEEP, "nested more than"),
    (json_value, "[" * (DEEPEST + 2) + "]" * (DEEPEST + 2), "nested more than"),
    (json_value, "1" * 5000, "5000 digits"),
    (json_value, "[1e999]", "inf is not a finite number"),
    (json_value, "[NaN]", "nan is not a finite number"),
    (json_value, "1e15000", "inf"),
    (json_value, "[1e16]", "outside"),
    (json_value, '{"a": 1, "a": 2}', "two values of 'a'"),
    (json_value, '{"a": [1, }', "JSON that cannot be read"),
    (json_value, "", "JSON that cannot be read"),
    (toml_table, "a = " + "[" * DEEP, "nested more than"),
    (toml_table, "a = " + "{a=" * DEEP, "nested more than"),
    (toml_table, "a." * DEEP + "b = 1", "nested more than"),  # tomllib would take an hour
    (toml_table, "['a']\n" + '"a" . ' * DEEP + "b = 1", "nested more than"),
    (toml_table, "a = " + "1" * 5000, "invalid TOML"),
    (toml_table, "a = 0x" + "f" * 5000, "outside"),
    (toml_table, "a = inf", "inf is not a finite number"),
    (toml_table, "a = 1\na = 2", "invalid TOML"),
]


@pytest.mark.parametrize(("parse", "text", "said"), HOSTILE, ids=[f"{p.__name__}-{t[:12]}" for p, t, _ in HOSTILE])
def test_hostile_text_is_one_sentence(parse: Callable[..., Any], text: str, said: str) -> None:
    with pytest.raises(SessionError, match=re.escape(said)) as caught:
        parse(text, "some file", "a table")
    assert str(caught.value).startswith("some file: ")
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 400


@given(
    st.recursive(
        st.none() | st.booleans() | FINITE | st.text(),
        lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner),
    )
)
def test_sane_json_is_read_as_it_is(tree: Any) -> None:
    import json

    text = json.dumps(tree)
    assert json_value(text, "a", "b") == json.loads(text)


def test_files_that_are_none(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.json")
    with pytest.raises(SessionError, match="pipe"):  # and does not wait for a writer
        read_bytes(tmp_path / "pipe.json", "pipe.json", "JSON")
    with pytest.raises(SessionError, match="a folder"):
        read_bytes(tmp_path, "a", "JSON")
    with pytest.raises(SessionError, match=r"\(No such"):
        read_bytes(tmp_path / "none", "a", "JSON")
    with pytest.raises(SessionError, match="pipe"):
        read_bytes(Path("/dev/zero"), "a", "JSON")
    (tmp_path / "loop").symlink_to(tmp_path / "loop")
    with pytest.raises(SessionError, match=r"\(Too many"):
        read_bytes(tmp_path / "loop", "a", "JSON")


def test_size_and_encoding(tmp_path: Path) -> None:
    path = tmp_path / "a"
    path.write_bytes(b"\xef\xbb\xbf{}")
    assert read_text(path, "a", "JSON") == "{}"
    path.write_bytes("ö".encode("latin-1"))
    with pytest.raises(SessionError, match="not UTF-8"):
        read_text(path, "a", "JSON")
    with path.open("wb") as file:
        file.truncate((1 << 20) + 1)
    with pytest.raises(SessionError, match=r"\b1 MiB"):
        read_text(path, "a", "JSON", most_mib=1)


def test_values_and_messages_stay_on_one_line() -> None:
    assert shown("a" * 1000).endswith("…")
    assert shown(10**5000) == "a very large int"
    assert "\n" not in shown(np.eye(3))
    error = MammometryError("a\nb\x1b[31m", found="x" * 100_000, expected="y", remedy="z")
    assert "\n" not in str(error)
    assert "\x1b" not in str(error)
    assert len(str(error)) < 1000
