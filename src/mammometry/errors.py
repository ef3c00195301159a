"""Everything that can go wrong for a reason the user can act on.

Each error is one sentence that names the file, camera or pair, what was found, what was expected and what to do.
Anything else that escapes is a defect of ours. The command line turns each class into its own exit code.
"""


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
        self.subject = subject
        self.found = found
        self.expected = expected
        self.remedy = remedy
        super().__init__(f"{subject}: found {found}, expected {expected}. {remedy.rstrip('.')}.")


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
