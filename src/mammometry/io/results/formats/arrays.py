"""Any value as .npz: arrays, and ``tree``, UTF-8 JSON with their structure."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from mammometry.geometry.arrays import Array, UInt8
from mammometry.io.results.formats.deflate import DeflatedArchive
from mammometry.io.results.formats.registry import Format
from mammometry.io.results.tree import from_tree, to_tree

_LEAST = 1 << 12  # numbers of an array that is worth it
_PER_UNIT = 1024.0  # steps of positions, 1/mm
_LARGEST = 2.0**30  # whole number whose differences fit 32 bits


def packed(array: Array) -> tuple[UInt8[Array, "4 n"], dict[str, Any]] | None:
    """Lay an array out, and say what `unpacked` needs.

    None where nothing is gained, or where it would come back with other bits.
    """
    if array.size < _LEAST or array.dtype not in (np.int32, np.float64) or not array.flags.c_contiguous:
        return None
    per_unit = _PER_UNIT if array.dtype == np.float64 else 1.0
    scaled = array * per_unit
    if not (np.abs(scaled) < _LARGEST).all():  # not where NaN either
        return None
    whole = scaled.astype(np.int32)
    if per_unit != 1.0 and (whole.astype(np.float64) / per_unit).tobytes() != array.tobytes():
        return None
    steps = whole.copy()
    steps[1:] -= whole[:-1]
    folded = ((steps << 1) ^ (steps >> 31)).astype("<i4")  # 0, −1, 1, −2 … become 0, 1, 2, 3 …
    planes = np.ascontiguousarray(folded.reshape(-1).view(np.uint8).reshape(-1, 4).T)
    return planes, {"dtype": array.dtype.str, "shape": list(array.shape), "per_unit": per_unit}


def unpacked(planes: UInt8[Array, "4 n"], about: Mapping[str, Any]) -> Array:
    """Bring back what `packed` laid out.

    Raises:
        ValueError: the bytes do not fit what is said of them.
    """
    folded = np.ascontiguousarray(planes.T).view("<u4").reshape(about["shape"])
    steps = (folded >> np.uint32(1)).astype(np.int32) ^ -(folded & np.uint32(1)).astype(np.int32)
    whole = np.add.accumulate(steps, axis=0, dtype=np.int32)
    per_unit = float(about["per_unit"])
    values = whole if per_unit == 1.0 else whole / per_unit
    return values.astype(about["dtype"], copy=False)


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
