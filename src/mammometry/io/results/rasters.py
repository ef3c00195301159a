"""Values on a pixel grid as one TIFF."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from mammometry.base.errors import MammometryError
from mammometry.base.machine.cores import each_at_once
from mammometry.base.parse import error_text
from mammometry.io.results.codecs import FORMATS, Format, deflated, inflated
from mammometry.io.results.tree import from_tree, to_tree

_STRIP_ROWS = 64  # rows compressed together: half a megabyte or so, enough of them to share among the cores
_ADOBE_DEFLATE, _NO_PREDICTOR, _HORIZONTAL = 8, 1, 2  # TIFF's numbers of what we write
_FLAT = 2  # dimensions of an image of one channel
_PAGE_NAME, _SAMPLE_FORMAT = 285, 339  # TIFF 6.0's tags of those names
_IEEE_FLOAT = 3  # sample format


def write_raster(path: Path, value: object) -> None:
    """Write a dataclass that holds images.

    Compressed without loss. Float32 images and masks are pages, in the order of its fields, named by them (PageName,
    tag 285); of a value inside it with that value's place before the name. Float32 as they are, as differences of
    their bits along a row (Predictor 2); masks as 8 bit 0 and 1. The first page's ImageDescription is JSON: the pages'
    names and the value's other members, cameras among them.

    Raises:
        ValueError: it holds no image.
    """
    import tifffile

    arrays: dict[str, np.ndarray[Any, Any]] = {}
    tree = to_tree(value, arrays)
    pages = [(name, page) for name, page in _places(tree, "") if _is_image(arrays[name])]
    if not pages:
        raise ValueError("a raster without images")
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
            floats = array.dtype == np.float32
            # tifffile reads floats predicted by row, but does not write them: it is told of whole numbers.
            tiff.write(
                iter(_strips(array)),
                shape=array.shape,
                dtype=np.int32 if floats else np.uint8,
                rowsperstrip=_STRIP_ROWS,
                photometric="minisblack",
                description=json.dumps(about) if index == 0 else None,
                extratags=[(_PAGE_NAME, 2, None, page, True)],
                metadata=None,
                compression="zlib",
                predictor=_HORIZONTAL if floats else None,
                contiguous=False,
            )
    with tifffile.TiffFile(path, mode="r+") as written:
        image: Any
        for image in written.pages:
            if image.dtype == np.int32:
                image.tags[_SAMPLE_FORMAT].overwrite(_IEEE_FLOAT)


def _places(tree: Any, place: str) -> Iterator[tuple[str, str]]:
    """Every array's name and where it stands in the value: ``keep.0``."""
    if isinstance(tree, dict) and "$array" in tree:
        yield tree["$array"], place
    elif isinstance(tree, dict) and "$tuple" in tree:
        yield from _places(dict(enumerate(tree["$tuple"])), place)
    elif isinstance(tree, dict):
        for name, member in tree.items():
            yield from _places(member, f"{place}.{name}" if place else str(name))


def _is_image(array: np.ndarray[Any, Any]) -> bool:
    return array.ndim == _FLAT and array.dtype in (np.float32, np.bool_)


def _strips(array: np.ndarray[Any, Any]) -> list[bytes]:
    """Rows by rows, each deflated by itself."""

    def strip(start: int) -> bytes:
        rows: np.ndarray[Any, Any] = np.ascontiguousarray(array[start : start + _STRIP_ROWS])
        if rows.dtype == np.float32:
            bits = rows.view(np.uint32)
            differences = bits.copy()
            differences[:, 1:] -= bits[:, :-1]
            return deflated(differences)
        return deflated(rows)

    return each_at_once(strip, range(0, len(array), _STRIP_ROWS))


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
        raise ValueError(error_text(error)) from None


def _page(tiff: Any, index: int) -> np.ndarray[Any, Any]:
    """One page's array, inflated by all cores."""
    page = tiff.pages[index]
    predicted = page.predictor == _HORIZONTAL and page.dtype == np.float32 and tiff.byteorder == "<"
    plain = page.predictor == _NO_PREDICTOR or predicted
    if page.compression != _ADOBE_DEFLATE or not plain or page.is_tiled or page.ndim != _FLAT:
        return np.asarray(page.asarray())
    height, width = page.shape
    streams = []
    for offset, count in zip(page.dataoffsets, page.databytecounts, strict=True):
        tiff.filehandle.seek(offset)
        streams.append(tiff.filehandle.read(count))
    whole = np.empty((height, width), dtype=page.dtype.newbyteorder(tiff.byteorder))

    def inflate(number: int) -> None:
        rows = whole[number * page.rowsperstrip : (number + 1) * page.rowsperstrip]
        data = np.frombuffer(inflated(streams[number], rows.nbytes), dtype=rows.dtype).reshape(rows.shape)
        if predicted:
            np.add.accumulate(data.view(np.uint32), axis=1, out=rows.view(np.uint32))
        else:
            rows[:] = data

    strips = -(-height // page.rowsperstrip)
    if len(streams) != strips:
        raise ValueError(f"{len(streams)} strips where {strips} were expected")
    each_at_once(inflate, range(strips))
    return whole


for _product in ("foreground", "disparity", "range", "valid"):
    FORMATS.add(_product)(Format(write=write_raster, read=read_raster, ending=".tif"))
