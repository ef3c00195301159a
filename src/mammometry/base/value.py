"""Frozen values: what stages take and hand on."""

from __future__ import annotations

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

    A ``__post_init__`` of the class checks what was given before it is frozen. Arrays are not copied. Records of
    arrays that compiled kernels write into remain plain dataclasses.

    Args:
        cls: the class, where the decorator stands without parentheses.
        eq: whether equal fields make two values equal. Values that hold arrays compare by identity: say False.
        slots: False where the class caches properties.
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
    """Arrays read-only, dictionaries and lists immutable, to any depth. Everything else as it is."""
    numpy = sys.modules.get("numpy")  # where it is not imported nothing is an array: the command line begins at once
    if numpy is not None and isinstance(content, numpy.ndarray):
        return read_only(content) if content.flags.writeable else content
    if type(content) is dict:
        return MappingProxyType({key: freeze(item) for key, item in content.items()})
    if type(content) in (list, tuple):
        items = [freeze(item) for item in content]
        same = type(content) is tuple and all(item is given for item, given in zip(items, content, strict=True))
        return content if same else tuple(items)
    return content


def read_only(array: _A) -> _A:
    """Return a view of `array` that cannot be written through. The data are not copied."""
    view = array.view()
    view.flags.writeable = False
    return view
