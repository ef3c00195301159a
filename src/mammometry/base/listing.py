"""List a user's folder without the files that operating systems put there.

macOS writes ``._name`` next to each file on other systems' disks, and ``__MACOSX`` into archives. Windows writes
``Thumbs.db`` and ``desktop.ini``. All code lists users' folders with this module.
"""

from __future__ import annotations

from pathlib import Path

_LEFT_BY_SYSTEMS = ("__macosx", "thumbs.db", "desktop.ini")


def is_hidden(name: str) -> bool:
    """Whether a name starts with a dot or is that of an operating system's file."""
    return name.startswith(".") or name.casefold() in _LEFT_BY_SYSTEMS


def visible(folder: Path) -> list[Path]:
    """Files and folders in a folder, by name. Empty if it is not a folder.

    Raises:
        OSError: the folder cannot be read.
    """
    return sorted(path for path in folder.iterdir() if not is_hidden(path.name)) if folder.is_dir() else []
