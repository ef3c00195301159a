"""Any of our frozen values as a JSON tree and arrays, and back: how results without a format of their own are kept.

Dataclasses of this package, mappings, tuples, enumerations and scalars become JSON; arrays larger than a handful of
numbers are set aside under a number, for the caller to store.
"""

from __future__ import annotations

import importlib
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from enum import Enum
from typing import Any

import numpy as np

from mammometry.errors import StorageError

_PACKAGE = __name__.partition(".")[0]


def to_tree(value: object, arrays: dict[str, np.ndarray[Any, Any]]) -> Any:
    """Turn a value into JSON-ready data; its arrays go into `arrays` by name.

    Raises:
        TypeError: a type that no result should have.
    """
    if isinstance(value, np.ndarray):
        name = f"a{len(arrays)}"
        arrays[name] = value
        return {"$array": name}
    if isinstance(value, Enum):
        return {"$enum": _label(type(value)), "value": value.value}
    if value is None or isinstance(value, (bool, int, str)):
        return value
    if isinstance(value, float):
        return value if np.isfinite(value) else {"$float": repr(value)}
    if isinstance(value, np.generic):
        return to_tree(value.item(), arrays)
    if is_dataclass(value) and not isinstance(value, type):
        members = {item.name: to_tree(getattr(value, item.name), arrays) for item in fields(value) if item.init}
        return {"$value": _label(type(value)), **members}
    if isinstance(value, Mapping):
        return {"$map": [[to_tree(key, arrays), to_tree(item, arrays)] for key, item in value.items()]}
    if isinstance(value, tuple):
        return {"$tuple": [to_tree(item, arrays) for item in value]}
    if isinstance(value, list):
        return [to_tree(item, arrays) for item in value]
    raise TypeError(f"a result holds a {type(value).__name__}, which cannot be kept")


def from_tree(tree: Any, arrays: Mapping[str, np.ndarray[Any, Any]]) -> Any:
    """Rebuild what `to_tree` took apart.

    Raises:
        StorageError: it names a type that is not one of ours, or lacks a member.
    """
    if isinstance(tree, list):
        return [from_tree(item, arrays) for item in tree]
    if not isinstance(tree, dict):
        return tree
    try:
        if "$array" in tree:
            return arrays[tree["$array"]]
        if "$float" in tree:
            return float(tree["$float"])
        if "$tuple" in tree:
            return tuple(from_tree(item, arrays) for item in tree["$tuple"])
        if "$map" in tree:
            return {from_tree(key, arrays): from_tree(item, arrays) for key, item in tree["$map"]}
        if "$enum" in tree:
            return _type(tree["$enum"])(tree["value"])
        members = {name: from_tree(item, arrays) for name, item in tree.items() if name != "$value"}
        return _type(tree["$value"])(**members)
    except (KeyError, TypeError, ValueError, AttributeError, ImportError) as error:
        raise StorageError(
            "a stored result",
            found=f"one that cannot be rebuilt ({error})",
            expected="a result of this version",
            remedy="Delete the results folder and run again",
        ) from None


def _label(kind: type) -> str:
    if not kind.__module__.startswith(f"{_PACKAGE}."):
        raise TypeError(f"a result holds a {kind.__module__}.{kind.__qualname__}, which cannot be kept")
    return f"{kind.__module__.removeprefix(f'{_PACKAGE}.')}:{kind.__qualname__}"


def _type(label: str) -> Any:
    module, _, name = label.partition(":")
    kind = getattr(importlib.import_module(f"{_PACKAGE}.{module}"), name)
    if not (isinstance(kind, type) and (is_dataclass(kind) or issubclass(kind, Enum))):
        raise ValueError(f"{label} is no type of result")
    return kind
