"""Commands that can be pasted into a shell."""

import os
import shlex
import subprocess
import sys
from pathlib import Path


def command_line(*words: str | Path) -> str:
    """A command on one line, with absolute paths and with quotes where needed.

    Args:
        words: text as typed. A `Path` becomes absolute, so that the command works in every folder.
    """
    typed = [os.path.abspath(word) if isinstance(word, Path) else word for word in words]
    return subprocess.list2cmdline(typed) if sys.platform == "win32" else shlex.join(typed)
