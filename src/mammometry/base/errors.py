"""Errors for problems that the user can act on.

Each error is one sentence that states the file, camera or pair, what was found, what was expected, and what to do. Any
other exception is a defect of the program. The command line turns each class into its own exit code.
"""

from __future__ import annotations

import copy
from pathlib import Path
from typing import Any, ClassVar, Self

_LONGEST = 500  # most characters of one part; names and values from damaged files may be longer


class MammometryError(Exception):
    """Base of all errors with a remedy.

    Args:
        subject: file, camera, pair or setting concerned ("capture/front_left.jpg").
        found: what was found there ("1126 × 750 pixels").
        expected: what was expected instead ("4504 × 3000 pixels, as in the calibration").
        remedy: what the user can do about it ("Export the photograph without cropping").
    """

    exit_code = 1
    code: ClassVar[str] = "error"
    """Identifies the kind of error for programs. It never changes, even if the wording does."""
    kind: ClassVar[str] = "MammometryError"
    """Name of the class in version 1.0, which ``--json`` still prints."""

    def __init_subclass__(cls, **facts: Any) -> None:
        super().__init_subclass__(**facts)
        if "kind" not in vars(cls):
            cls.kind = cls.__name__

    def __init__(self, subject: str, *, found: str, expected: str, remedy: str) -> None:
        self.subject, self.found, self.expected, self.remedy = map(_on_one_line, (subject, found, expected, remedy))
        self.details: tuple[str, ...] = ()
        """Individual cases of the error, such as the photographs that were not used. Pages list them."""
        self.page: Path | None = None
        """Page that shows the problem, if one was written."""
        super().__init__(self._sentence())

    def _sentence(self) -> str:
        return f"{self.subject}: found {self.found}, expected {self.expected}. {self.remedy.rstrip('.')}."

    def with_remark(self, remark: str) -> Self:
        """Return a copy with one more sentence after the remedy.

        An empty sentence, or one that the remedy already contains, changes nothing.
        """
        if not remark or remark in self.remedy:
            return self
        made = copy.copy(self)
        made.remedy = f"{self.remedy.rstrip('.')}. {_on_one_line(remark)}"
        made.args = (made._sentence(),)
        return made

    def __reduce__(self) -> tuple[Any, ...]:
        """Return the arguments for pickling, so that the error survives a process pool."""
        return _copied, (type(self), self.args), self.__dict__


def _copied(kind: type[MammometryError], arguments: tuple[Any, ...]) -> MammometryError:
    return kind.__new__(kind, *arguments)


def _on_one_line(text: str) -> str:
    """Put text on one line, without control characters, which file names may contain."""
    text = text if len(text) <= 2 * _LONGEST else text[:_LONGEST] + text[-_LONGEST:]
    plain = "".join(letter if letter.isprintable() else " " if letter.isspace() else "�" for letter in text)
    if len(plain) <= _LONGEST:
        return plain
    first, last = plain[: _LONGEST // 2], plain[-_LONGEST // 2 :]
    words = " " in first and " " in last  # values from damaged files may have no spaces
    return f"{first.rpartition(' ')[0]} … {last.partition(' ')[2]}" if words else f"{first} … {last}"


class SessionError(MammometryError):
    """The session folder or its manifest is not as documented."""

    exit_code = 3
    code = "session"


class SettingsError(MammometryError):
    """A setting has an unknown name or a value outside its range."""

    exit_code = 3
    code = "settings"


class TableError(MammometryError):
    """A table of measurements lacks a column or a valid number."""

    exit_code = 3
    code = "table"


class ImageError(MammometryError):
    """A photograph is missing, unreadable or truncated, or has the wrong size or orientation."""

    exit_code = 4
    code = "photograph"


class CalibrationError(MammometryError):
    """Too few views of the target were found, or the calibration failed."""

    exit_code = 5
    code = "calibration"


class BoardSizeError(CalibrationError):
    """The size of a printed board, measured with a bank card, contradicts the one that was entered."""

    code = "board-size"
    kind = "CalibrationError"


class MatchingError(MammometryError):
    """A pair could not be rectified or matched."""

    exit_code = 6
    code = "matching"


class SurfaceError(MammometryError):
    """The range images do not form a surface."""

    exit_code = 7
    code = "surface"


class MeasureError(MammometryError):
    """No boundary, chest wall or volume could be found on the surface.

    Args:
        subject: see `MammometryError`.
        found: see `MammometryError`.
        expected: see `MammometryError`.
        remedy: what the user can do about it. If `mesh_remedy` is given, this one applies to photographs only.
        mesh_remedy: what the user can do if another scanner's mesh is measured. None: the same.
    """

    exit_code = 8
    code = "measurement"

    def __init__(self, subject: str, *, found: str, expected: str, remedy: str, mesh_remedy: str | None = None) -> None:
        super().__init__(subject, found=found, expected=expected, remedy=remedy)
        self._mesh_remedy = mesh_remedy or remedy

    def with_remark(self, remark: str) -> Self:
        """See `MammometryError.with_remark`. The remark is added to both remedies."""
        made = super().with_remark(remark)
        if made is not self:
            made._mesh_remedy = f"{self._mesh_remedy.rstrip('.')}. {_on_one_line(remark)}"
        return made

    def of_mesh(self) -> MeasureError:
        """Return the error worded for a mesh, without session and cameras."""
        made = copy.copy(self)
        made.remedy = _on_one_line(self._mesh_remedy)
        made.args = (made._sentence(),)
        return made


class CrossingError(MeasureError):
    """A boundary crosses itself or runs back along itself, as drawn or as projected onto the surface."""

    code = "boundary-crosses-itself"


class StorageError(MammometryError):
    """Results could not be written (full disk, missing permission) or read (damaged)."""

    exit_code = 9
    code = "storage"


class FullDiskError(StorageError):
    """The disk is full. Finished results are kept."""

    code = "disk-full"
    kind = "StorageError"


class BusyError(StorageError):
    """Another run is using the session. The command works again when that run has ended."""

    code = "busy"
    kind = "StorageError"


class BatchError(MammometryError):
    """A batch cannot continue: its scheduler or workers are missing or of another version."""

    exit_code = 9
    code = "batch"


class CaptureError(MammometryError):
    """A camera failed, or its photograph must not be measured."""

    exit_code = 12
    code = "capture"


class ArchiveError(MammometryError):
    """Another system does not answer, refuses, or drops the connection."""

    exit_code = 9
    code = "archive"


class NotOfferedError(ArchiveError):
    """Another system answers but offers none of the requested services."""

    code = "not-offered"
    kind = "ArchiveError"


class UnknownWordError(ValueError):
    """A word or number that is not allowed. Raised by functions that do not know where it was written.

    Args:
        rule: what is allowed ("skins are pale, dark").
        found: the word.
    """

    def __init__(self, rule: str, found: object) -> None:
        super().__init__(f"{rule}, found {found}")
        self.rule, self.found = rule, str(found)

    def __reduce__(self) -> tuple[Any, ...]:
        """Return the parts for pickling."""
        return type(self), (self.rule, self.found)
