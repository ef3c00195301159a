"""Any value as .npz: arrays, and ``tree``, UTF-8 JSON with their structure."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from mammometry.io.results.formats.deflate import DeflatedArchive
from mammometry.io.results.formats.packed import packed, unpacked
from mammometry.io.results.formats.registry import Format
from mammometry.io.results.tree import from_tree, to_tree

_JSON_FORMAT = 1
"""Version of our JSON files. A reader may rely on their members."""


def write_arrays(path: Path, value: Any) -> None:
    """Write a whole value to an .npz, compressed.

    ``packed`` is UTF-8 JSON that says which arrays are laid out by `packed`.
    """
    arrays: dict[str, np.ndarray[Any, Any]] = {}
    tree = json.dumps(to_tree(value, arrays)).encode()
    laid_out: dict[str, dict[str, Any]] = {}
    with DeflatedArchive(path, "w") as archive:

        def write(name: str, array: np.ndarray[Any, Any]) -> None:
            with archive.member(f"{name}.npy") as member:
                np.lib.format.write_array(member, array, allow_pickle=False)

        write("tree", np.frombuffer(tree, dtype=np.uint8))
        for name, array in arrays.items():
            array = np.asanyarray(array)
            if (found := packed(array)) is not None:
                array, laid_out[name] = found
            write(name, array)
        if laid_out:
            write("packed", np.frombuffer(json.dumps(laid_out).encode(), dtype=np.uint8))


def read_arrays(path: Path) -> Any:
    """Read back what `write_arrays` wrote."""
    with path.open("rb") as file, np.load(file, allow_pickle=False) as stored:
        arrays = {name: stored[name] for name in stored.files if name not in ("tree", "packed")}
        for name, about in json.loads(stored["packed"].tobytes()).items() if "packed" in stored.files else ():
            arrays[name] = unpacked(arrays[name], about)
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
