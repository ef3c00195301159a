"""Values on a pixel grid as one TIFF.

Each array is a page. The rest is JSON in the first page's description.
"""

from __future__ import annotations

import json
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np

from mammometry.base.cores import each_at_once
from mammometry.base.errors import MammometryError
from mammometry.base.parse import said
from mammometry.io.results.formats.deflate import deflated, inflated
from mammometry.io.results.formats.registry import FORMATS, Format
from mammometry.io.results.tree import from_tree, to_tree

_STRIP_ROWS = 64  # rows compressed together: half a megabyte or so, enough of them to share among the cores
_ADOBE_DEFLATE, _NO_PREDICTOR = 8, 1  # TIFF's numbers of what we write
_FLAT = 2  # dimensions of an image of one channel
_PAGE_NAME = 285  # TIFF 6.0's tag of that name


def write_raster(path: Path, value: object) -> None:
    """Write a dataclass whose arrays are images of one shape.

    Compressed without loss. Pages in the order of its fields, named by them (PageName, tag 285): float32 as they are,
    masks as 8 bit 0 and 1. The first page's ImageDescription is JSON: the pages' names and the value's other members,
    cameras among them.
    """
    import tifffile

    arrays: dict[str, np.ndarray[Any, Any]] = {}
    tree = to_tree(value, arrays)
    pages = [
        (tree[item.name]["$array"], item.name)
        for item in fields(value)  # type: ignore[arg-type]  # a dataclass by contract
        if isinstance(tree[item.name], dict) and "$array" in tree[item.name]
    ]
    about = {
        "pages": [{"array": name, "name": page, "dtype": arrays[name].dtype.str} for name, page in pages],
        "small": {
            name: {"dtype": array.dtype.str, "values": array.tolist()}
            for name, array in arrays.items()
            if name not in dict(pages)
        },
        "value": tree,
    }
    with tifffile.TiffWriter(path) as tiff:
        for index, (name, page) in enumerate(pages):
            array = arrays[name]
            array = array.astype(np.uint8) if array.dtype == bool else array
            tiff.write(
                iter(_strips(array)),
                shape=array.shape,
                dtype=array.dtype,
                rowsperstrip=_STRIP_ROWS,
                photometric="minisblack",
                description=json.dumps(about) if index == 0 else None,
                extratags=[(_PAGE_NAME, 2, None, page, True)],
                metadata=None,
                compression="zlib",
                contiguous=False,
            )


def _strips(array: np.ndarray[Any, Any]) -> list[bytes]:
    """Rows by rows, each deflated by itself."""
    starts = range(0, len(array), _STRIP_ROWS)
    return each_at_once(lambda start: deflated(np.ascontiguousarray(array[start : start + _STRIP_ROWS])), starts)


def read_raster(path: Path) -> Any:
    """Read back what `write_raster` wrote.

    Raises:
        ValueError: it is not such a file.
    """
    import tifffile

    try:
        with tifffile.TiffFile(path) as tiff:
            about = json.loads(tiff.pages.first.description)
            arrays = {
                page["array"]: _page(tiff, index).astype(page["dtype"], copy=False)
                for index, page in enumerate(about["pages"])
            }
        arrays |= {name: np.array(small["values"], dtype=small["dtype"]) for name, small in about["small"].items()}
        return from_tree(about["value"], arrays)
    except (MammometryError, OSError, MemoryError):
        raise
    except Exception as error:  # of a damaged file tifffile raises anything
        raise ValueError(said(error)) from None


def _page(tiff: Any, index: int) -> np.ndarray[Any, Any]:
    """One page's array, inflated by all cores."""
    page = tiff.pages[index]
    if page.compression != _ADOBE_DEFLATE or page.predictor != _NO_PREDICTOR or page.is_tiled or page.ndim != _FLAT:
        return np.asarray(page.asarray())
    height, width = page.shape
    row_bytes = width * page.dtype.itemsize
    streams = []
    for offset, count in zip(page.dataoffsets, page.databytecounts, strict=True):
        tiff.filehandle.seek(offset)
        streams.append(tiff.filehandle.read(count))
    rows = [min(page.rowsperstrip, height - start) for start in range(0, height, page.rowsperstrip)]
    strips = each_at_once(lambda number: inflated(streams[number], rows[number] * row_bytes), range(len(rows)))
    return np.frombuffer(b"".join(strips), dtype=page.dtype.newbyteorder(tiff.byteorder)).reshape(height, width)


for _product in ("foreground", "disparity", "range"):
    FORMATS.add(_product)(Format(write=write_raster, read=read_raster, ending=".tif"))
