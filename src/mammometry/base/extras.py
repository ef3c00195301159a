"""Check that the optional libraries of an extra are installed."""

from __future__ import annotations

from importlib.util import find_spec

from mammometry.base.errors import StorageError

WEB = ("uvicorn",)
"""Libraries that serve pages (extra `edit`)."""


class MissingLibraryError(StorageError):
    """A library is not installed."""

    code = "missing-library"


def missing(*modules: str) -> list[str]:
    """Names of the modules that are not installed."""
    return [name for name in modules if not _is_installed(name)]


def require(extra: str, *modules: str) -> None:
    """Require that libraries are installed.

    Args:
        extra: the extra of the package that installs them.
        modules: the modules that are needed.

    Raises:
        MissingLibraryError: names the library and how to install it.
    """
    if absent := missing(*modules):
        raise MissingLibraryError(
            "this command", found=f"no library {', '.join(absent)}", expected=f"mammometry's extra {extra}",
            remedy=f"Run pip install 'mammometry[{extra}]'",
        )  # fmt: skip


def _is_installed(module: str) -> bool:
    try:
        return find_spec(module) is not None
    except ModuleNotFoundError:  # its parent package is missing
        return False
