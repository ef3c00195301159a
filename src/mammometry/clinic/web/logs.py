"""The log. What failed and where in the code, and nothing of a patient."""

from __future__ import annotations

import logging
import re
import traceback

_INVITATION = re.compile(r"(/invitation/).+")  # what follows sets a password


class Plain(logging.Formatter):
    """Time, level, where from, and what was said to be logged.

    Of an exception only its class and the lines of code are written: its message may hold what somebody typed, as
    PostgreSQL's do. Of a request only the path is written, which holds random keys and no search words.
    """

    def format(self, record: logging.LogRecord) -> str:
        """One record as text."""
        message = record.getMessage() if record.name.startswith("mammometry.") else str(record.msg)
        request = getattr(record, "request", None)
        if request is not None:
            path = _INVITATION.sub(r"\1…", request.path)
            message = f"{getattr(record, 'status_code', '')} {request.method} {path}"
        line = f"{self.formatTime(record)} {record.levelname} {record.name}: {_one_line(message)}"
        if record.exc_info and record.exc_info[1] is not None:
            error = record.exc_info[1]
            frames = traceback.extract_tb(error.__traceback__)
            line += f"\n  {type(error).__name__} in " + " < ".join(
                f"{frame.name} ({frame.filename}:{frame.lineno})" for frame in reversed(frames)
            )
        return line


def _one_line(text: str) -> str:
    return "".join(letter if letter.isprintable() else " " for letter in text)[:500]
