"""The libraries of the extra `hospital`, or one plain sentence."""

from __future__ import annotations

from importlib.util import find_spec

from mammometry.base.errors import StorageError


def require(*modules: str) -> None:
    """Refuse where a library is not installed.

    Raises:
        StorageError: names it, and how to install it.
    """
    missing = [name for name in modules if find_spec(name) is None]
    if missing:
        raise StorageError(
            "mammometry export",
            found=f"no library {', '.join(missing)}",
            expected="the libraries for hospitals' systems",
            remedy="Install them: pip install 'mammometry[hospital]'",
        )
