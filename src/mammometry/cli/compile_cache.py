"""Compile the kernels on a second core during an installation's first run.

Numba compiles a kernel when it is first called, and keeps it on disk. ``kernels.txt`` lists the argument types of each
kernel. A second process compiles them in the order of the stages while the first stage runs. The job reads them from
disk, and compiles any that are missing.
"""

import importlib
import subprocess
import sys
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from importlib.resources import files
from pathlib import Path
from typing import Any

from mammometry.base.machine.cores import available_cores


def listed() -> list[tuple[str, str]]:
    """Name and argument types of each kernel, in order of use. The types are in numba's notation."""
    lines = files("mammometry.cli").joinpath("kernels.txt").read_text(encoding="utf-8").splitlines()
    return [(name, types) for name, _, types in (line.partition(" ") for line in lines)]


def kernel_named(name: str) -> Any:
    """The compiled function with that full name."""
    module, _, function = name.rpartition(".")
    return getattr(importlib.import_module(module), function)


def argument_types(text: str) -> tuple[Any, ...]:
    """Numba's types from their notation."""
    from numba.core import sigutils

    arguments, _ = sigutils.normalize_signature(text)  # type: ignore[no-untyped-call]
    return tuple(arguments)


@contextmanager
def compiled_ahead(*, wanted: bool = True) -> Iterator[None]:
    """Compile missing kernels in a second process while the block runs.

    Args:
        wanted: whether anything is to be computed. Checking for missing kernels takes half a second.
    """
    if not wanted or available_cores() < 2 or _is_on_disk():
        yield
        return
    command = [sys.executable, "-P", "-m", "mammometry.cli.compile_cache"]
    with subprocess.Popen(command, stdin=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as process:
        try:
            yield
        finally:
            process.terminate()


def _is_on_disk() -> bool:
    """Whether the last kernel of the list is compiled from current source."""
    from mammometry.base.machine.compiled import is_cached

    return is_cached(kernel_named(listed()[-1][0]))


def main() -> None:
    """Compile all kernels that are not on disk.

    Returns at once if another process is compiling.
    """
    from filelock import FileLock, Timeout

    name, _ = listed()[-1]
    folder = Path(kernel_named(name).stats.cache_path)
    folder.mkdir(parents=True, exist_ok=True)
    try:
        with FileLock(folder / "compiling.lock", timeout=0):
            compile_kernels(listed())
    except Timeout:
        return


def compile_kernels(kernels: Iterable[tuple[str, str]]) -> None:
    """Compile kernels, given by name and argument types, that are not on disk."""
    for name, types in kernels:
        # Types, not text: numba would store the kernel under the text.
        kernel_named(name).compile(argument_types(types))


if __name__ == "__main__":
    main()
