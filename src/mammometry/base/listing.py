"""List a user's folder without the files that operating systems put there.

macOS writes ``._name`` next to each file on other systems' disks, and ``__MACOSX`` into archives. Windows writes
``Thumbs.db`` and ``desktop.ini``. All code lists users' folders with this module.
"""

from __future__ import annotations

import re
from pathlib import Path

_LEFT_BY_SYSTEMS = ("__macosx", "thumbs.db", "desktop.ini")


def is_hidden(name: str) -> bool:
    """Whether a name starts with a dot or is that of an operating system's file."""
    return name.startswith(".") or name.casefold() in _LEFT_BY_SYSTEMS


def by_number(path: Path) -> tuple[tuple[str | int, ...], str]:
    """Sort key of a file's name in which numbers count as numbers: IMG_9 is before IMG_10."""
    parts = re.split(r"([0-9]+)", path.name)
    return tuple(int(part) if place % 2 else part for place, part in enumerate(parts)), path.name


def visible(folder: Path) -> list[Path]:
    """Files and folders in a folder, by name. Empty if it is not a folder.

    Raises:
        OSError: the folder cannot be read.
    """
    return sorted(path for path in folder.iterdir() if not is_hidden(path.name)) if folder.is_dir() else []
