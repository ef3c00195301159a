"""Any value as .npz: arrays, and ``tree``, UTF-8 JSON with their structure."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from mammometry.io.results.formats.deflate import DeflatedArchive
from mammometry.io.results.formats.registry import Format
from mammometry.io.results.tree import from_tree, to_tree

_JSON_FORMAT = 1
"""Version of our JSON files. A reader may rely on their members."""


def write_arrays(path: Path, value: Any) -> None:
    """Write a whole value to an .npz, compressed."""
    arrays: dict[str, np.ndarray[Any, Any]] = {}
    tree = json.dumps(to_tree(value, arrays)).encode()
    with DeflatedArchive(path, "w") as archive:
        for name, array in {"tree": np.frombuffer(tree, dtype=np.uint8), **arrays}.items():
            with archive.member(f"{name}.npy") as member:
                np.lib.format.write_array(member, np.asanyarray(array), allow_pickle=False)


def read_arrays(path: Path) -> Any:
    """Read back what `write_arrays` wrote."""
    with path.open("rb") as file, np.load(file, allow_pickle=False) as stored:
        arrays = {name: stored[name] for name in stored.files if name != "tree"}
        return from_tree(json.loads(stored["tree"].tobytes()), arrays)


def write_json(path: Path, table: Mapping[str, Any]) -> None:
    """Write a table that other programs read."""
    path.write_text(
        json.dumps({"format": _JSON_FORMAT, **table}, indent=1, ensure_ascii=False) + "\n", encoding="utf-8"
    )


def with_json(table: Callable[[str, Any], Mapping[str, Any]]) -> Format:
    """Return a format with value in .npz and table in .json.

    The table is for other programs. The table is for other programs.

    Args:
        table: makes the table from the product's name and its value.
    """

    def write(path: Path, value: Any) -> None:
        write_arrays(path.with_suffix(".npz"), value)
        write_json(path, table(path.stem, value))

    return Format(write=write, read=read_arrays, ending=".json", read_ending=".npz")


ARRAYS = Format(write=write_arrays, read=read_arrays, ending=".npz")
"""The format of every product that has none of its own."""
