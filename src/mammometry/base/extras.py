"""Libraries that an extra of the package brings, or one plain sentence."""

from __future__ import annotations

from importlib.util import find_spec

from mammometry.base.errors import StorageError

WEB = ("django", "uvicorn")
"""What pages are served by: extra `edit`."""


class MissingLibraryError(StorageError):
    """A library is not installed."""

    code = "missing-library"


def missing(*modules: str) -> list[str]:
    """Names of the modules that are not installed."""
    return [name for name in modules if not _is_installed(name)]


def require(extra: str, *modules: str) -> None:
    """Refuse where a library is not installed.

    Args:
        extra: what brings them.
        modules: that are needed now.

    Raises:
        MissingLibraryError: names it, and how to install it.
    """
    if absent := missing(*modules):
        raise MissingLibraryError(
            "this command", found=f"no library {', '.join(absent)}", expected=f"mammometry's extra {extra}",
            remedy=f"Run pip install 'mammometry[{extra}]'",
        )  # fmt: skip


def _is_installed(module: str) -> bool:
    try:
        return find_spec(module) is not None
    except ModuleNotFoundError:  # the package that it would lie in
        return False
