"""Check text from users' files: size, encoding, depth and numbers.

All readers of users' files use this module. Every fault of a file becomes an error that names the file.
"""

from __future__ import annotations

import codecs
import json
import math
import re
import stat
import tomllib
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float64

from mammometry.base.errors import MammometryError, SessionError

_OPENCV_MEGAPIXELS = 1000.0  # largest photograph that OpenCV decodes (16-bit photographs): 2³⁰ pixels


@dataclass(frozen=True, slots=True, kw_only=True)
class LimitSettings:
    """Largest sizes of files that are read. No result depends on them."""

    megapixels: float = 200.0
    """Largest photograph or mask, millions of pixels. The largest medium-format sensors have 151. 200 megapixels take
    0.6 GB with 8 bits per channel, 1.2 GB with 16."""

    def __post_init__(self) -> None:
        if not 0 < self.megapixels <= _OPENCV_MEGAPIXELS:
            raise ValueError(f"megapixels must be between 0 and {_OPENCV_MEGAPIXELS:g}, found {self.megapixels}")


LARGEST = 1e15
"""Largest number in a user's file. A double represents every integer up to it exactly, and its square is finite."""
DEEPEST = 32
"""Deepest nesting of tables. Our formats need at most eight levels."""
TEXT_MIB = 64
"""Largest text file that is read, MiB. A drawn curve or a table needs a few MiB."""

_MIB = 1 << 20  # bytes per MiB
_LONGEST = 160  # most characters of another library's error message
_VALUE = 60  # most characters of a value from a file
_NUMBER = re.compile(r"[+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]{1,4})?", re.ASCII)
_TOML_COMMA = re.compile(r"^[^#\n\"'\[]*=\s*([+-]?\d+,\d+)\s*(?:#|$)", re.MULTILINE)
# A dotted key of more than DEEPEST parts. tomllib takes quadratic time for these: hours for a file of 1 MB.
_LONG_KEY = re.compile(r"""(?<![\w"'-])(?:[\w"'-]++[ \t]*+\.[ \t]*+){%d}""" % DEEPEST)  # noqa: UP031  # braces


def require_file(path: Path, subject: str, expected: str, *, refusal: type[MammometryError] = SessionError) -> int:
    """Require an ordinary file and return its size, bytes.

    Pipes and devices are refused, because reading them may never end.

    Raises:
        MammometryError: of class `refusal`; the file does not exist, is not an ordinary file, or cannot be read.
    """
    try:
        status = path.stat()
    except (OSError, ValueError) as error:
        raise _unreadable(subject, _why(error), expected, refusal) from None
    if not stat.S_ISREG(status.st_mode):
        kind = "a folder" if stat.S_ISDIR(status.st_mode) else "a pipe or a device"
        raise refusal(subject, found=f"{kind}, not a file", expected=expected, remedy="Put an ordinary file there")
    return status.st_size


def read_bytes(
    path: Path, subject: str, expected: str, *, most_mib: int = TEXT_MIB, refusal: type[MammometryError] = SessionError
) -> bytes:
    """Read an ordinary file of limited size.

    Args:
        path: the file.
        subject: its name in messages.
        expected: what the file should be, for messages.
        most_mib: largest size, MiB.
        refusal: class of the error.

    Raises:
        MammometryError: of class `refusal`; the file cannot be read, is not an ordinary file, or is too large.
    """
    require_file(path, subject, expected, refusal=refusal)
    try:
        with path.open("rb") as file:
            content = file.read(most_mib * _MIB + 1)
    except OSError as error:
        raise _unreadable(subject, _why(error), expected, refusal) from None
    if len(content) > most_mib * _MIB:
        raise refusal(
            subject, found=f"more than {most_mib} MiB", expected=expected, remedy="Check that it is the right file"
        )
    return content


def read_text(
    path: Path, subject: str, expected: str, *, most_mib: int = TEXT_MIB, refusal: type[MammometryError] = SessionError
) -> str:
    """Read text in UTF-8, with or without a byte-order mark.

    All line endings become LF. For arguments and errors see `read_bytes`.
    """
    content = read_bytes(path, subject, expected, most_mib=most_mib, refusal=refusal)
    why = ""
    if content.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        why = "it is UTF-16"
    elif (place := content.find(0)) >= 0:
        why = f"byte {place} is a NUL, as in UTF-16"
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        why, text = why or f"byte {error.start} is not UTF-8", ""
    if why:
        found = f"a file that cannot be read ({why})"
        raise refusal(subject, found=found, expected=f"{expected} in UTF-8", remedy="Save it as UTF-8 text")
    return text.replace("\r\n", "\n").replace("\r", "\n")


@contextmanager
def parsing(what: str, subject: str, expected: str, refusal: type[MammometryError] = SessionError) -> Iterator[None]:
    """Turn a parser's exception into a `MammometryError`.

    It contains `what` (such as ``not TOML``) and the first line of the parser's message.
    """
    try:
        yield
    except MammometryError:
        raise
    except (ValueError, LookupError, TypeError, AttributeError, ArithmeticError) as error:
        raise refusal(subject, found=f"{what} ({error_text(error)})", expected=expected, remedy="Correct it") from None
    except RecursionError:
        found = f"{what} (nested more than {DEEPEST} deep)"
        raise refusal(subject, found=found, expected=expected, remedy="Correct it") from None


def json_value(
    text: str, subject: str, expected: str, *, finite: bool = True, refusal: type[MammometryError] = SessionError
) -> Any:
    """Parse JSON with unique keys, numbers within ±`LARGEST` and limited depth.

    Args:
        text: the JSON.
        subject: its name in messages.
        expected: what it should be, for messages.
        finite: whether NaN and infinity are refused.
        refusal: class of the error.

    Raises:
        MammometryError: of class `refusal`.
    """
    with parsing("JSON that cannot be read", subject, expected, refusal):
        tree = json.loads(text, object_pairs_hook=_without_duplicates, parse_int=_integer)
        require_sane(tree, finite=finite)
    return tree


def toml_table(
    text: str, subject: str, expected: str, *, finite: bool = True, refusal: type[MammometryError] = SessionError
) -> dict[str, Any]:
    """Parse TOML. For arguments and errors see `json_value`."""
    with parsing("invalid TOML", subject, expected, refusal):
        if _LONG_KEY.search(text):
            raise ValueError(f"nested more than {DEEPEST} deep")
        try:
            table = tomllib.loads(text)
        except tomllib.TOMLDecodeError as error:
            comma = _TOML_COMMA.search(text)
            raise ValueError(f"{comma[1]}, which has a decimal comma" if comma else error) from None
        require_sane(table, finite=finite)
    return table


def require_sane(tree: object, *, finite: bool = True) -> None:
    """Require numbers within ±`LARGEST` and at most `DEEPEST` levels.

    Raises:
        ValueError: names the rule that is broken.
    """
    waiting: list[tuple[object, tuple[object, ...]]] = [(tree, ())]
    while waiting:
        value, place = waiting.pop()
        if len(place) > DEEPEST:
            raise ValueError(f"nested more than {DEEPEST} deep")
        if isinstance(value, dict):
            waiting += [(item, (*place, key)) for key, item in value.items()]
        elif isinstance(value, list):
            waiting += [(item, (*place, index)) for index, item in enumerate(value)]
        elif isinstance(value, float) and not math.isfinite(value):
            if finite:
                raise ValueError(f"{_dotted(place)}{value} is not a finite number")
        elif isinstance(value, int | float) and abs(value) > LARGEST:
            raise ValueError(f"{_dotted(place)}a number outside ±{LARGEST:g}")


def _dotted(place: tuple[object, ...]) -> str:
    """Path of a value, for the beginning of a message, such as ``pairs[0].along[2]: ``."""
    path = "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in place).lstrip(".")
    return f"{path[-_VALUE:]}: " if path else ""


def number(text: str) -> float:
    """Parse a finite decimal number such as ``-1.5e3``, but not ``1_000``, ``nan``, ``٣`` or ``1,5``.

    Raises:
        ValueError: it is not a number, or is outside ±`LARGEST`.
    """
    if not _NUMBER.fullmatch(text) or not abs(value := float(text)) <= LARGEST:
        raise ValueError(f"{shown(text)}, which is not a number within ±{LARGEST:g}")
    return value


def numbers(value: object, *shape: int) -> Float64[np.ndarray, "*shape"]:
    """Convert nested lists to an array of finite numbers. Strings and booleans are not numbers.

    Args:
        value: lists of equal length, or an array.
        shape: shape of the result. -1: any number of rows, each of the given length. Otherwise only the number of
            values must match, because programs nest nine numbers in different ways.

    Raises:
        ValueError: the number of values or their type is wrong.
    """
    for item in _leaves(value):
        if isinstance(item, bool | np.bool_) or not isinstance(item, int | float | np.number):
            raise ValueError(f"{shown(item)} where a number is expected")
        magnitude: Any = abs(item)
        if not magnitude <= LARGEST:
            raise ValueError(f"{shown(item)}, which is not a number within ±{LARGEST:g}")
    try:
        array = np.array(value, dtype=np.float64)
    except ValueError:
        raise ValueError("rows of different lengths") from None
    if len(shape) > 1 and -1 in shape and array.size and array.shape[1:] != shape[1:]:
        raise ValueError(f"rows of {array.shape[1:]} numbers, not {shape[1:]}")
    if array.size % abs(math.prod(shape)) or (-1 not in shape and array.size != math.prod(shape)):
        raise ValueError(f"{array.size} numbers, not {abs(math.prod(shape))}")
    return array.reshape(shape)


def _leaves(value: object) -> list[Any]:
    """All items of nested lists that are not lists themselves."""
    flat: list[Any] = [value]
    while any(isinstance(item, list | tuple | np.ndarray) for item in flat):
        flat = [part for item in flat for part in (item if isinstance(item, list | tuple | np.ndarray) else [item])]
    return flat


def whole(value: object) -> int:
    """Return a value such as 3.0 as an integer.

    Raises:
        ValueError: it is not a whole number.
    """
    (found,) = numbers(value, 1)
    if found != round(found):
        raise ValueError(f"{shown(value)} where a whole number is expected")
    return int(found)


def shown(value: object) -> str:
    """A value for a message, shortened and on one line."""
    try:
        text = " ".join(repr(value).split())
    except (ValueError, RecursionError):  # Python refuses to print very long integers
        text = f"a very large {type(value).__name__}"
    return text if len(text) <= _VALUE else f"{text[:_VALUE]}…"


def error_text(error: BaseException) -> str:
    """Message of another library's error, on one line."""
    text = f"no {error}" if isinstance(error, KeyError) else str(error)
    line = (text.splitlines() or [""])[0].strip() or type(error).__name__
    return line if len(line) <= _LONGEST else f"{line[:_LONGEST]}…"


def _without_duplicates(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    table = dict(pairs)
    if len(table) < len(pairs):
        names = [name for name, _ in pairs]
        double = next(name for name in names if names.count(name) > 1)
        raise ValueError(f"two values of {shown(double)}")
    return table


def _integer(digits: str) -> int:
    if len(digits) > len(f"{LARGEST:.0f}") + 1:
        raise ValueError(f"a whole number of {len(digits)} digits")
    return int(digits)


def _why(error: BaseException) -> str:
    return (isinstance(error, OSError) and error.strerror) or error_text(error)


def _unreadable(subject: str, why: str, expected: str, refusal: type[MammometryError]) -> MammometryError:
    found = f"a file that cannot be read ({why})"
    return refusal(subject, found=found, expected=expected, remedy="Check the path and the file's permissions")
