"""Read mesh files of other programs in a child process with limits.

If the reader crashes, the error names the file.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Concatenate, ParamSpec, TypeVar

from mammometry.base.child_process import CallError
from mammometry.base.errors import SessionError
from mammometry.base.limited_call import limited_call
from mammometry.base.parse import require_file

_T = TypeVar("_T")
_P = ParamSpec("_P")
_LONGEST_S = 120.0  # a USDZ of a million faces takes 3 s
_S_PER_MIB = 1.0  # ten times the time for an OBJ, the slowest format
_MOST_MEMORY = 16 << 30  # bytes; compressed numbers may expand to any size


def read_in_child(read: Callable[Concatenate[Path, _P], _T], path: Path, *arguments: _P.args, **named: _P.kwargs) -> _T:
    """Call a reader in a child process.

    Args:
        read: function of a module. Its first argument is the path.
        path: path of the file.
        arguments: further arguments of the reader.
        named: keyword arguments of the reader.

    Raises:
        MammometryError: raised by the reader.
        SessionError: there is no such file, or the reader crashed, took too long or needed too much memory.
    """
    require_file(path, str(path), "a mesh file")
    longest_s = _LONGEST_S + _S_PER_MIB * path.stat().st_size / (1 << 20)
    try:
        return limited_call(read, (path, *arguments), named, longest_s=longest_s, most_bytes=_MOST_MEMORY)
    except CallError:
        raise SessionError(
            str(path), found="a file on which its reader fails", expected="a mesh file that can be read within limits",
            remedy="Export it again as plain meshes",
        ) from None  # fmt: skip
