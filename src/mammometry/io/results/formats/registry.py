"""Formats of products that have their own.

A new format is one file in this folder and one line here. A kind of product without an entry is stored as
`arrays.ARRAYS`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mammometry.base.registry import Registry


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


_MODULES = ("boundaries", "cameras", "landmarks", "measurements", "model", "numbers", "rasters", "surfaces")
FORMATS: Registry[Format] = Registry(
    "format of a product", modules=tuple(f"mammometry.io.results.formats.{module}" for module in _MODULES)
)
"""Kind of product → its format."""
