"""Everything that can go wrong for a reason the user can act on.

Each error is one sentence that names the file, camera or pair, what was found, what was expected and what to do.
Anything else that escapes is a defect of ours. The command line turns each class into its own exit code.
"""

from pathlib import Path

_LONGEST = 500  # characters of one part; names and values out of damaged files may be longer


class MammometryError(Exception):
    """Base of all errors with a remedy.

    Args:
        subject: what it is about: a file, a camera, a pair, a setting ("capture/front_left.jpg").
        found: what was found there ("1126 × 750 pixels").
        expected: what was expected instead ("4504 × 3000 pixels, as in the calibration").
        remedy: what the user can do about it ("Export the photograph without cropping").
    """

    exit_code = 1

    def __init__(self, subject: str, *, found: str, expected: str, remedy: str) -> None:
        self.subject, self.found, self.expected, self.remedy = map(_on_one_line, (subject, found, expected, remedy))
        self.page: Path | None = None
        """Shows what was seen, where a page was written."""
        super().__init__(f"{self.subject}: found {self.found}, expected {self.expected}. {self.remedy.rstrip('.')}.")


def _on_one_line(text: str) -> str:
    """A part of a sentence without what would steer a terminal, which names out of a file may hold."""
    plain = "".join(
        letter if letter.isprintable() else " " if letter.isspace() else "�" for letter in text[: 2 * _LONGEST]
    )
    return plain if len(plain) <= _LONGEST else f"{plain[: _LONGEST // 2]} … {plain[-_LONGEST // 2 :]}"


class SessionError(MammometryError):
    """The session folder or its manifest is not as documented."""

    exit_code = 3


class SettingsError(MammometryError):
    """A setting has an unknown name or a value outside its range."""

    exit_code = 3


class TableError(MammometryError):
    """A table of measurements lacks a column, or a value is missing or no number."""

    exit_code = 3


class ImageError(MammometryError):
    """A photograph is missing, unreadable, truncated, or of the wrong size or orientation."""

    exit_code = 4


class CalibrationError(MammometryError):
    """The target was not found often enough, or the rig could not be calibrated from what was found."""

    exit_code = 5


class MatchingError(MammometryError):
    """A pair could not be rectified or matched."""

    exit_code = 6


class SurfaceError(MammometryError):
    """The range images do not make a surface."""

    exit_code = 7


class MeasureError(MammometryError):
    """No boundary, chest wall or volume could be found on the surface."""

    exit_code = 8


class CrossingError(MeasureError):
    """A boundary crosses itself or runs back along itself, as drawn or as it lies on the surface."""


class StorageError(MammometryError):
    """Results could not be written or read back (disk full, no permission, damaged result)."""

    exit_code = 9


class BatchError(MammometryError):
    """A batch cannot go on: its scheduler or its workers are not there, or not the same."""

    exit_code = 9
