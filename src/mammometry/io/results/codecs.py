"""Write and read products, each in the format of its kind (docs/session-folder.md).

====================  =========================================================================================
product               files
====================  =========================================================================================
cameras               cameras.json: per camera K, dist, R, t, image_size, std
foreground,           one float32 TIFF of several pages each, deflated (`rasters`)
disparity, range,
valid
mesh                  mesh.ply: binary, mm, world; provenance, sigma_mm, pairs, red, green, blue a vertex
boundaries            boundaries.json, which a session may also bring; and .npz
model                 model.glb, model.obj (.mtl, .jpg): the viewing mesh; and .npz
landmarks,            landmarks.json, symmetry.json, dimensions.json; and .npz
symmetry, dimensions
measurement           measurement.json, NAME.ply (the closed solid); and .npz
all others            .npz, deflated: arrays, and ``tree``, UTF-8 JSON that says how they belong together; long ones
                      are laid out for it (`packed`)
====================  =========================================================================================
"""

from __future__ import annotations

import json
import struct
import zipfile
import zlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

import numpy as np

from mammometry.base.errors import MammometryError, StorageError
from mammometry.base.registry import Registry
from mammometry.geometry.arrays import Array, UInt8
from mammometry.io.results.tree import from_tree, to_tree

_LEVEL = 1  # ISA-L takes a tenth of zlib's time; 1: a third of a raster's length; higher ones gain little
_RAW = -15  # window bits of a stream without header, as archives hold it


def deflated(data: Any) -> bytes:
    """Compress a buffer to a zlib stream."""
    from isal import isal_zlib

    return isal_zlib.compress(data, _LEVEL)


def inflated(stream: bytes, length: int) -> bytes:
    """Inflate a zlib stream that holds so many bytes.

    Raises:
        ValueError: it holds another number, or is none.
    """
    from isal import isal_zlib

    try:
        data = isal_zlib.decompressobj().decompress(stream, length)
    except isal_zlib.IsalError as error:  # type: ignore[misc]  # its stubs call the class an instance
        raise ValueError(f"a damaged stream ({error})") from None
    if len(data) != length:
        raise ValueError(f"{len(data)} bytes where {length} were expected")
    return data


class DeflatedArchive(zipfile.ZipFile):
    """A new ZIP archive whose members are deflated by ISA-L."""

    def member(self, name: str) -> IO[bytes]:
        """Open a new member for writing, of any length."""
        from isal import isal_zlib

        about = zipfile.ZipInfo(name)
        about.compress_type = zipfile.ZIP_DEFLATED
        opened = self.open(about, "w", force_zip64=True)
        # The standard library lets nobody choose who compresses: a member asks this of its own.
        opened._compressor = isal_zlib.compressobj(_LEVEL, isal_zlib.DEFLATED, _RAW)  # type: ignore[attr-defined]
        return opened


@dataclass(frozen=True, slots=True, kw_only=True)
class Format:
    """How one kind of product lies on disk."""

    write: Callable[[Path, Any], None]
    """Writes the value to a path with `ending`, and the format's other files beside it with the same stem."""
    read: Callable[[Path], Any]
    """Reads the value back from the path with `read_ending`. Any error means a damaged file."""
    ending: str
    """Of the file that the product is known by, with its dot."""
    read_ending: str | None = None
    """Ending of the file that the value is read from. None: the same as `ending`."""


FORMATS: Registry[Format] = Registry(
    "format of a product", modules=("mammometry.io.results.formats", "mammometry.io.results.rasters")
)
"""Kind of product → its format. A kind without an entry is stored as `ARRAYS`."""


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
            if (tight := packed(array)) is not None:
                array, laid_out[name] = tight
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


_DAMAGED = (
    OSError, ValueError, LookupError, TypeError, AttributeError, ArithmeticError, EOFError, RecursionError,
    zipfile.BadZipFile, zlib.error, struct.error,
)  # fmt: skip
"""Errors that the standard library and NumPy raise for a file that is not as written."""


def encode(value: Any, folder: Path, product: str) -> None:
    """Write a product's files into `folder`, named after the product.

    ``disparity/front`` becomes disparity/front.tif.

    Raises:
        OSError: the disk refuses.
        TypeError: a value that cannot be kept.
    """
    stem = folder / product
    stem.parent.mkdir(parents=True, exist_ok=True)
    format_ = _format(product)
    format_.write(stem.with_name(stem.name + format_.ending), value)


def decode(folder: Path, product: str) -> Any:
    """Read a product back.

    Raises:
        StorageError: its files are missing or damaged.
    """
    stem = folder / product
    format_ = _format(product)
    path = stem.with_name(stem.name + (format_.read_ending or format_.ending))
    try:
        return format_.read(path)
    except MammometryError:
        raise
    except _DAMAGED as error:
        remedy = "Run the command again: it will be made again"
        expected = "the file as it was written"
        raise StorageError(
            path.name, found=f"a result that cannot be read back ({error})", expected=expected, remedy=remedy
        ) from None


def _format(product: str) -> Format:
    """Format of a product by its kind: that of ``disparity/front`` is ``disparity``."""
    return FORMATS.get(product.partition("/")[0], ARRAYS)
