"""Call a function in a child process with limits on time and memory.

A damaged or malicious file may crash its reader, keep it busy forever or exhaust the memory. Then only the child ends.
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
        function: the function. It, its arguments and its result can be pickled.
        arguments: positional arguments.
        named: keyword arguments.
        longest_s: seconds after which the child is killed.
        most_bytes: largest address space of the child.

    Raises:
        MammometryError: raised by the function.
        CallError: the function raised another error, took too long, needed too much memory, or crashed the child.
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
