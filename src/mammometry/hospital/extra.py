"""The libraries of the extra `hospital`, or one plain sentence."""

from __future__ import annotations

from importlib.util import find_spec

from mammometry.base.errors import StorageError


class MissingLibraryError(StorageError):
    """A library is not installed."""


def missing(*modules: str) -> list[str]:
    """Names of the modules that are not installed."""
    return [name for name in modules if not _is_installed(name)]


def require(*modules: str) -> None:
    """Refuse where a library is not installed.

    Raises:
        MissingLibraryError: names it, and how to install it.
    """
    absent = missing(*modules)
    if absent:
        raise MissingLibraryError(
            "mammometry export",
            found=f"no library {', '.join(absent)}",
            expected="the libraries for hospitals' systems",
            remedy="Install them: pip install 'mammometry[hospital]'",
        )


def _is_installed(module: str) -> bool:
    try:
        return find_spec(module) is not None
    except ModuleNotFoundError:  # the package that it would lie in
        return False
