"""Compilation of kernels, kept on disk, valid on any common processor.

All kernels share their options, so that numba compiles once what they have in common, such as the making of arrays.
None is compiled with ``parallel=True``, which takes several times as long: kernels hold no lock, and where it is worth
it `cores.in_bands` divides their work among threads. A kernel copies parts of arrays element by element: an assignment
of slices makes numba compile the text of the error that it would raise, which takes a second.

Numba keeps what it compiled, but for one processor and for source files with their times of change. So a wheel could
not ship it, and every installation compiled for half a minute. Here kernels are compiled for all processors with
x86-64-v3 (AVX2 and FMA, since 2013), and what is kept is stamped with the contents of the source and of all that it
imports of this package. Elsewhere they are compiled for the processor itself. A cache that does not fit, or cannot be
read, is passed over: the kernel is compiled.
"""

from __future__ import annotations

# mypy: disable-error-code="no-untyped-call, no-untyped-def, attr-defined, misc, assignment, unused-ignore"
import hashlib
import re
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any

import llvmlite.binding as llvm
from numba import njit
from numba.core import config
from numba.core.caching import CompileResultCacheImpl, FunctionCache, IndexDataCacheFile

COMMON_CPU = "x86-64-v3"
"""The processor that kernels are compiled for."""
_COMMON_FEATURES = ("avx2", "bmi", "bmi2", "f16c", "fma", "lzcnt", "movbe")
_PACKAGE = Path(__file__).parents[2]
_IMPORT = re.compile(r"^(?:from|import) mammometry(?:\.([\w.]+))?(?: import (\([^)]*\)|.+))?", re.MULTILINE)


def choose_cpu() -> None:
    """Have numba compile for the common processor. Only where this one can do what that can.

    ``NUMBA_CPU_NAME`` and ``NUMBA_CPU_FEATURES`` override it.
    """
    features = llvm.get_host_cpu_features()
    fits = llvm.get_process_triple().startswith("x86_64") and all(features.get(name) for name in _COMMON_FEATURES)
    if fits and config.CPU_NAME is None and config.CPU_FEATURES is None:
        config.CPU_NAME, config.CPU_FEATURES = COMMON_CPU, ""


@cache
def source_stamp(path: Path) -> str:
    """Digest of a module's text and of the modules of this package that it imports."""
    found: dict[Path, bytes] = {}
    waiting = [path]
    while waiting:
        here = waiting.pop()
        if here not in found:
            found[here] = here.read_bytes()
            waiting += _imported(found[here].decode())
    texts = sorted(hashlib.sha256(text).hexdigest() for text in found.values())
    return hashlib.sha256("".join(texts).encode()).hexdigest()


def _imported(text: str) -> list[Path]:
    """Modules of this package that a module's text imports at its beginning of lines."""
    modules = []
    for name, what in _IMPORT.findall(text):
        folder = _PACKAGE.joinpath(*name.split(".")) if name else _PACKAGE
        names = [part.split(" as ")[0].strip(" ()\n") for part in what.split(",")]
        modules += [folder.with_suffix(".py"), *((folder / part).with_suffix(".py") for part in names if part)]
    return [module for module in modules if module.is_file()]


class _ByContent:
    """Place where kernels are kept, stamped with what their source says."""

    _py_file: str

    def get_source_stamp(self) -> str:
        return source_stamp(Path(self._py_file))


class _Places(CompileResultCacheImpl):
    _locator_classes = tuple(
        type(locator.__name__, (_ByContent, locator), {}) for locator in CompileResultCacheImpl._locator_classes
    )


class _Files(IndexDataCacheFile):
    """A kernel's files, where what cannot be read counts as missing."""

    def _load_index(self) -> Any:
        with suppress(Exception):  # pickle raises anything
            return super()._load_index()
        return {}

    def load(self, key: Any) -> Any:
        with suppress(Exception):
            return super().load(key)
        return None

    def is_for(self, codegen: Any) -> bool:
        """Whether there is code for this processor."""
        return any(key[1] == codegen.magic_tuple() for key in self._load_index())


class _Kept(FunctionCache):
    _impl_class = _Places

    def __init__(self, function: Any) -> None:
        super().__init__(function)
        source = Path(function.__code__.co_filename)
        # Beside the source lies what a wheel brought. Numba would not look there if it may not write there.
        beside = [] if config.CACHE_DIR else [str(source.parent / "__pycache__")]
        self._files = [
            _Files(cache_path=path, filename_base=self._impl.filename_base, source_stamp=source_stamp(source))
            for path in dict.fromkeys([self._cache_path, *beside])
        ]
        self._cache_file = self._files[0]

    def _load_overload(self, sig: Any, target_context: Any) -> Any:
        key = self._index_key(sig, target_context.codegen())
        for files in self._files:
            with suppress(Exception):  # of another version: it is compiled
                if (data := files.load(key)) is not None:
                    return self._impl.rebuild(target_context, data)
        return None

    def is_there(self, codegen: Any) -> bool:
        """Whether any compilation of the function for this processor can be loaded."""
        return any(files.is_for(codegen) for files in self._files)


def keep(dispatcher: Any) -> Any:
    """Have a dispatcher of numba's keep what it compiles, and return it."""
    dispatcher._cache = _Kept(dispatcher.py_func)
    return dispatcher


def is_kept(dispatcher: Any) -> bool:
    """Whether a kernel was compiled before. From this source and for this processor."""
    return bool(dispatcher._cache.is_there(dispatcher.targetctx.codegen()))


choose_cpu()


def kernel(function: Callable[..., Any]) -> Any:
    """Compile in strict IEEE arithmetic: x / 0 is infinite or NaN."""
    return keep(njit(nogil=True, error_model="numpy")(function))


def fast_kernel(function: Callable[..., Any]) -> Any:
    """Compile so that sums may be taken in any order. Neither infinity nor NaN may occur."""
    return keep(njit(nogil=True, error_model="numpy", fastmath=True)(function))


def small_kernel(function: Callable[..., Any]) -> Any:
    """Compile what other kernels call for every pixel.

    It is copied into them, since calls cost more than the little that it computes, and rounds as `kernel` does.
    """
    return keep(njit(nogil=True, error_model="numpy", forceinline=True)(function))
