"""Numbers of some products as .json, with the whole value as .npz.

The products are sides, body, what a side lacks, symmetry and dimensions.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np

from mammometry.geometry.mesh import TriangleMesh
from mammometry.io.results.formats.arrays import with_json
from mammometry.io.results.formats.registry import FORMATS

_FEW = 36
"""Longest array written as readable numbers. Longer ones are only in the .npz. Chosen by eye."""


def _table(product: str, value: Any) -> dict[str, Any]:
    return {"units": "mm, cc, degrees", "frame": "world", product: _plain(value)}


def _plain(value: Any) -> Any:
    """Numbers and words of a value, JSON-ready, without meshes and long arrays."""
    if isinstance(value, np.ndarray):
        return value.tolist()
    if is_dataclass(value):
        members = {item.name: getattr(value, item.name) for item in fields(value) if item.init}
        return {name: _plain(member) for name, member in members.items() if not _is_long(member)}
    if isinstance(value, Mapping):
        return {name: _plain(member) for name, member in value.items()}
    return [_plain(member) for member in value] if isinstance(value, (tuple, list)) else value


def _is_long(value: Any) -> bool:
    return isinstance(value, TriangleMesh) or (isinstance(value, np.ndarray) and value.size > _FEW)


for _product in ("symmetry", "dimensions", "lacking", "body", "sides"):
    FORMATS.add(_product)(with_json(_table))
