"""Compile kernels and cache them on disk, for all common processors.

All kernels have the same options, so that numba compiles common functions, such as array creation, only once. None uses
``parallel=True``, which takes several times as long to compile: kernels release the GIL, and `cores.in_bands` runs them
in threads where that is worthwhile. Kernels copy parts of arrays element by element, because for a slice assignment
numba compiles the text of its error, which takes a second.

Numba's own cache is valid only for one processor and one modification time of the source, so a wheel could not contain
it, and every installation would compile for half a minute. Here, kernels are compiled for x86-64-v3 (AVX2 and FMA,
since 2013), and the cache is identified by the contents of the source and of all modules of this package that it
imports. On other processors, they are compiled for that processor. A cache that does not match or cannot be read is
ignored.
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
"""Processor for which kernels are compiled."""
_COMMON_FEATURES = ("avx2", "bmi", "bmi2", "f16c", "fma", "lzcnt", "movbe")
_PACKAGE = Path(__file__).parents[2]
_IMPORT = re.compile(r"^(?:from|import) mammometry(?:\.([\w.]+))?(?: import (\([^)]*\)|.+))?", re.MULTILINE)


def choose_cpu() -> None:
    """Make numba compile for the common processor, if this one supports its instructions.

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
    """Modules of this package that a module imports at the top level."""
    modules = []
    for name, what in _IMPORT.findall(text):
        folder = _PACKAGE.joinpath(*name.split(".")) if name else _PACKAGE
        names = [part.split(" as ")[0].strip(" ()\n") for part in what.split(",")]
        modules += [folder.with_suffix(".py"), *((folder / part).with_suffix(".py") for part in names if part)]
    return [module for module in modules if module.is_file()]


class _ByContent:
    """Location of a cache that is identified by the content of the source."""

    _py_file: str

    def get_source_stamp(self) -> str:
        return source_stamp(Path(self._py_file))


class _CacheLocators(CompileResultCacheImpl):
    _locator_classes = tuple(
        type(locator.__name__, (_ByContent, locator), {}) for locator in CompileResultCacheImpl._locator_classes
    )


class _CacheFiles(IndexDataCacheFile):
    """Cache files of a kernel. Unreadable ones count as missing."""

    def _load_index(self) -> Any:
        with suppress(Exception):  # unpickling may raise any exception
            return super()._load_index()
        return {}

    def load(self, key: Any) -> Any:
        with suppress(Exception):
            return super().load(key)
        return None

    def is_for(self, codegen: Any) -> bool:
        """Whether the cache has code for this processor."""
        return any(key[1] == codegen.magic_tuple() for key in self._load_index())


class _StampedCache(FunctionCache):
    _impl_class = _CacheLocators

    def __init__(self, function: Any) -> None:
        super().__init__(function)
        source = Path(function.__code__.co_filename)
        # A wheel's cache is next to the source. Numba would ignore it if that folder is read-only.
        beside = [] if config.CACHE_DIR else [str(source.parent / "__pycache__")]
        self._files = [
            _CacheFiles(cache_path=path, filename_base=self._impl.filename_base, source_stamp=source_stamp(source))
            for path in dict.fromkeys([self._cache_path, *beside])
        ]
        self._cache_file = self._files[0]

    def _load_overload(self, sig: Any, target_context: Any) -> Any:
        key = self._index_key(sig, target_context.codegen())
        for files in self._files:
            with suppress(Exception):  # the kernel was cached by another version and is compiled again
                if (data := files.load(key)) is not None:
                    return self._impl.rebuild(target_context, data)
        return None

    def is_loadable(self, codegen: Any) -> bool:
        """Whether a compiled form of the function for this processor can be loaded."""
        return any(files.is_for(codegen) for files in self._files)


def cached(dispatcher: Any) -> Any:
    """Make a numba dispatcher cache its compiled code, and return it."""
    dispatcher._cache = _StampedCache(dispatcher.py_func)
    return dispatcher


def is_cached(dispatcher: Any) -> bool:
    """Whether a kernel is in the cache, for this source and this processor."""
    return bool(dispatcher._cache.is_loadable(dispatcher.targetctx.codegen()))


choose_cpu()


def kernel(function: Callable[..., Any]) -> Any:
    """Compile in strict IEEE arithmetic: x / 0 is infinite or NaN."""
    return cached(njit(nogil=True, error_model="numpy")(function))


def fast_kernel(function: Callable[..., Any]) -> Any:
    """Compile with sums in any order. Neither infinity nor NaN may occur."""
    return cached(njit(nogil=True, error_model="numpy", fastmath=True)(function))


def small_kernel(function: Callable[..., Any]) -> Any:
    """Compile a function that other kernels call for every pixel.

    It is inlined, because a call costs more than its arithmetic. It rounds in the same way as `kernel`.
    """
    return cached(njit(nogil=True, error_model="numpy", forceinline=True)(function))
