"""Write and read products, each in the format of its kind (docs/session-folder.md).

====================  =========================================================================================
product               files
====================  =========================================================================================
cameras               cameras.json: per camera K, dist, R, t, image_size, std
foreground,           one float32 TIFF of several pages each, deflated (`formats.rasters`)
disparity, range,
valid
mesh                  mesh.ply: binary, mm, world; provenance, sigma_mm, pairs, red, green, blue a vertex
boundaries            boundaries.json, which a session may also bring; and .npz
model                 model.glb, model.obj (.mtl, .jpg): the viewing mesh; and .npz
landmarks,            landmarks.json, symmetry.json, dimensions.json; and .npz
symmetry, dimensions
measurement           measurement.json, NAME.ply (the closed solid); and .npz
all others            .npz, deflated: arrays, and ``tree``, UTF-8 JSON that says how they belong together; long ones
                      are laid out for it (`formats.packed`)
====================  =========================================================================================
"""

import struct
import zipfile
import zlib
from pathlib import Path
from typing import Any

from mammometry.base.errors import MammometryError, StorageError
from mammometry.io.results.arrays import ARRAYS, FORMATS, Format

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
