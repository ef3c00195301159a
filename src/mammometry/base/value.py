"""Frozen values: the inputs and outputs of stages."""

from __future__ import annotations

import copyreg
import dataclasses
import sys
from collections.abc import Callable
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, TypeVar, dataclass_transform, overload

if TYPE_CHECKING:
    import numpy as np

_T = TypeVar("_T")
_A = TypeVar("_A", bound="np.ndarray")


@overload
def value(cls: type[_T], /) -> type[_T]: ...
@overload
def value(*, eq: bool = True, slots: bool = True) -> Callable[[type[_T]], type[_T]]: ...
@dataclass_transform(kw_only_default=True, frozen_default=True, field_specifiers=(dataclasses.field,))
def value(cls: Any = None, /, *, eq: bool = True, slots: bool = True) -> Any:
    """Make a frozen, keyword-only dataclass whose arrays, dictionaries and lists cannot be changed.

    ``__post_init__`` of the class checks the values before they are frozen. Arrays are not copied. Use plain
    dataclasses for records into which compiled kernels write.

    Args:
        cls: the class, if the decorator is used without parentheses.
        eq: whether values with equal fields are equal. Set it to False for values that contain arrays.
        slots: set it to False if the class caches properties.
    """
    if cls is None:
        return lambda decorated: _frozen_class(decorated, eq=eq, slots=slots)
    return _frozen_class(cls, eq=eq, slots=slots)


def _frozen_class(cls: Any, *, eq: bool, slots: bool) -> Any:
    check = getattr(cls, "__post_init__", None)

    def __post_init__(self: Any) -> None:
        if check is not None:
            check(self)
        for name in self.__dataclass_fields__:
            given = getattr(self, name)
            frozen = freeze(given)
            if frozen is not given:
                object.__setattr__(self, name, frozen)

    cls.__post_init__ = __post_init__
    return dataclasses.dataclass(frozen=True, kw_only=True, eq=eq, slots=slots)(cls)


def freeze(content: Any) -> Any:
    """Make arrays read-only and dictionaries and lists immutable, to any depth."""
    numpy = sys.modules.get("numpy")  # not imported here, so that the command line starts quickly
    if numpy is not None and isinstance(content, numpy.ndarray):
        return read_only(content) if content.flags.writeable else content
    if type(content) is dict:
        return MappingProxyType({key: freeze(item) for key, item in content.items()})
    if type(content) in (list, tuple):
        items = [freeze(item) for item in content]
        same = type(content) is tuple and all(item is given for item, given in zip(items, content, strict=True))
        return content if same else tuple(items)
    return content


def _unchangeable(content: dict[Any, Any]) -> MappingProxyType[Any, Any]:
    return MappingProxyType(content)


copyreg.pickle(MappingProxyType, lambda mapping: (_unchangeable, (dict(mapping),)))  # for other processes


def read_only(array: _A) -> _A:
    """Return a read-only view of `array`. The data are not copied."""
    view = array.view()
    view.flags.writeable = False
    return view
