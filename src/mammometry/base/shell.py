"""Commands as they can be pasted into a shell."""

import os
import shlex
import subprocess
import sys
from pathlib import Path


def command_line(*words: str | Path) -> str:
    """A command of one line: words are quoted where needed, and paths are whole.

    Args:
        words: text as it is typed; a `Path` is written from the root, so that the command works in every folder.
    """
    typed = [os.path.abspath(word) if isinstance(word, Path) else word for word in words]
    return subprocess.list2cmdline(typed) if sys.platform == "win32" else shlex.join(typed)
