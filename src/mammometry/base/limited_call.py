"""Call a function in a child process with limits on time and memory.

A damaged or hostile file may end its reader, keep it busy for ever or fill the memory. It then ends the child.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any, TypeVar

from mammometry.base.child_process import ChildProcess
from mammometry.base.errors import MammometryError
from mammometry.base.machine.system import limit_memory

_T = TypeVar("_T")
_NONE: Mapping[str, Any] = MappingProxyType({})


def limited_call(
    function: Callable[..., _T],
    arguments: tuple[object, ...],
    named: Mapping[str, object] = _NONE,
    *,
    longest_s: float,
    most_bytes: int,
) -> _T:
    """Call a function of a module in a child process.

    Args:
        function: it and its arguments and result can be pickled.
        arguments: of the function.
        named: arguments by name.
        longest_s: seconds after which the child is killed.
        most_bytes: largest address space of the child.

    Raises:
        MammometryError: the function raised it.
        CallError: the function raised another error, took too long, needed too much memory, or ended the child.
    """
    with ChildProcess() as child:
        late = threading.Timer(longest_s, child.process.kill)
        late.start()
        try:
            found = child.call(_call, function, arguments, dict(named), most_bytes)
        finally:
            late.cancel()
    if isinstance(found, MammometryError):
        raise found
    return found


def _call(
    function: Callable[..., _T], arguments: tuple[object, ...], named: dict[str, object], most_bytes: int
) -> _T | MammometryError:
    limit_memory(most_bytes)
    try:
        return function(*arguments, **named)
    except MammometryError as error:
        return error
