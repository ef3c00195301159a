"""Values on a pixel grid as one TIFF.

Each array is a page. The rest is JSON in the first page's description.
"""

from __future__ import annotations

import json
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np

from mammometry.base.errors import MammometryError
from mammometry.base.parse import said
from mammometry.io.results.formats.registry import FORMATS, Format
from mammometry.io.results.tree import from_tree, to_tree

_DEFLATE = {"level": 1}  # a third of the length; a higher level takes several times as long for a tenth more
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
            tiff.write(
                array.astype(np.uint8) if array.dtype == bool else array,
                photometric="minisblack",
                description=json.dumps(about) if index == 0 else None,
                extratags=[(_PAGE_NAME, 2, None, page, True)],
                metadata=None,
                compression="zlib",
                compressionargs=_DEFLATE,
                contiguous=False,
            )


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
                page["array"]: tiff.pages[index].asarray().astype(page["dtype"], copy=False)
                for index, page in enumerate(about["pages"])
            }
        arrays |= {name: np.array(small["values"], dtype=small["dtype"]) for name, small in about["small"].items()}
        return from_tree(about["value"], arrays)
    except (MammometryError, OSError, MemoryError):
        raise
    except Exception as error:  # of a damaged file tifffile raises anything
        raise ValueError(said(error)) from None


for _product in ("foreground", "disparity", "range"):
    FORMATS.add(_product)(Format(write=write_raster, read=read_raster, ending=".tif"))
