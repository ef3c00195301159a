"""List a user's folder without the files that operating systems leave there.

macOS writes ``._name`` beside each file on disks of other systems, and ``__MACOSX`` into archives. Windows writes
``Thumbs.db`` and ``desktop.ini``. Every listing of a user's folder goes through here.
"""

from __future__ import annotations

from pathlib import Path

_LEFT_BY_SYSTEMS = ("__macosx", "thumbs.db", "desktop.ini")


def is_hidden(name: str) -> bool:
    """Whether the name of a file or folder begins with a dot, or is one that systems leave."""
    return name.startswith(".") or name.casefold() in _LEFT_BY_SYSTEMS


def visible(folder: Path) -> list[Path]:
    """Files and folders in a folder, by name. Empty if it is no folder.

    Raises:
        OSError: it cannot be read.
    """
    return sorted(path for path in folder.iterdir() if not is_hidden(path.name)) if folder.is_dir() else []
