"""Write the subject's identifier into files whose formats allow it.

The store does this for all files of a stage, so that writers need not. Pages and documents have the subject in their
headings.
"""

import json
import re
import struct
import zipfile
import zlib
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np

_HEAD = 4096  # bytes at the start of a mesh file that contain the line with the subject
_LINE = re.compile(rb"^(?:comment|#) subject ([^\r\n]+)", re.MULTILINE)


def stamp_folder(folder: Path, subject: str | None) -> None:
    """Stamp every file below a folder. Does nothing without a subject.

    Raises:
        OSError: the disk reports an error.
    """
    for path in sorted(folder.rglob("*")) if subject is not None else ():
        assert subject is not None
        if path.suffix in _IN_PLACE:
            _IN_PLACE[path.suffix](path, subject)
        elif path.suffix in _INSIDE:
            path.write_bytes(stamped(path.name, path.read_bytes(), subject))


def stamped(name: str, data: bytes, subject: str | None) -> bytes:
    """Add the subject to a small file's content. Unchanged without a subject or a place for it."""
    inside = _INSIDE.get(Path(name).suffix)
    return data if subject is None or inside is None else inside(data, subject)


def subject_of_mesh(path: Path) -> str | None:
    """Subject in one of our PLY, OBJ or GLB files. None if there is none, or if the file cannot be read."""
    try:
        with path.open("rb") as file:
            head = file.read(_HEAD)
            if head[:4] == b"glTF":
                (length,) = struct.unpack_from("<I", head, 12)
                file.seek(20)
                subject = json.loads(file.read(length))["asset"]["extras"]["subject"]
                return subject if isinstance(subject, str) else None
    except (OSError, ValueError, KeyError, TypeError, RecursionError, struct.error):
        return None
    line = _LINE.search(head.partition(b"end_header")[0])
    return None if line is None else line[1].decode(errors="replace")


def _json(data: bytes, subject: str) -> bytes:
    table = json.loads(data)
    if not isinstance(table, dict):  # a plain list has no place for it
        return data
    first = {name: table[name] for name in ("format",) if name in table}
    text = json.dumps({**first, "subject": subject, **table, **{"subject": subject}}, indent=1, ensure_ascii=False)
    return f"{text}\n".encode()


def _ply(data: bytes, subject: str) -> bytes:
    """Add a comment after the format line."""
    at = data.index(b"\n", data.index(b"\nformat ") + 1) + 1
    return data[:at] + f"comment subject {subject}\n".encode() + data[at:]


def _lines(data: bytes, subject: str) -> bytes:
    return f"# subject {subject}\n".encode() + data


def _glb(data: bytes, subject: str) -> bytes:
    """Set ``asset.extras.subject`` in a GLB's JSON chunk, its first, padded with spaces to four bytes."""
    (length,) = struct.unpack_from("<I", data, 12)
    table = json.loads(data[20 : 20 + length])
    table["asset"]["extras"] = {**table["asset"].get("extras", {}), "subject": subject}
    chunk = json.dumps(table, separators=(",", ":"), ensure_ascii=False).encode()
    chunk += b" " * (-len(chunk) % 4)
    rest = data[20 + length :]
    return data[:8] + struct.pack("<II", 20 + len(chunk) + len(rest), len(chunk)) + data[16:20] + chunk + rest


def _png(data: bytes, subject: str) -> bytes:
    """Add an iTXt chunk named Subject after the header chunk. The pixels are unchanged."""
    chunk = b"iTXt" + b"Subject\0\0\0\0\0" + subject.encode()
    whole = struct.pack(">I", len(chunk) - 4) + chunk + struct.pack(">I", zlib.crc32(chunk))
    at = 8 + 25  # signature, IHDR
    return data[:at] + whole + data[at:]


def _jpeg(data: bytes, subject: str) -> bytes:
    """Add a comment segment after JFIF's."""
    at = 4 + int.from_bytes(data[4:6], "big") if data[2:4] == b"\xff\xe0" else 2
    text = f"subject {subject}".encode()
    return data[:at] + b"\xff\xfe" + (len(text) + 2).to_bytes(2, "big") + text + data[at:]


def _tiff(path: Path, subject: str) -> None:
    """Add a member to the JSON in the first page's ImageDescription."""
    import tifffile

    with tifffile.TiffFile(path) as tiff:
        about = json.loads(tiff.pages.first.description)
    tifffile.tiffcomment(path, json.dumps({**about, "subject": subject}))


def _npz(path: Path, subject: str) -> None:
    """Add an array named subject: the identifier in UTF-8."""
    with zipfile.ZipFile(path, "a") as archive, archive.open("subject.npy", "w") as member:
        np.lib.format.write_array(member, np.frombuffer(subject.encode(), dtype=np.uint8), allow_pickle=False)


_INSIDE: Mapping[str, Callable[[bytes, str], bytes]] = {
    ".json": _json,
    ".ply": _ply,
    ".obj": _lines,
    ".mtl": _lines,
    ".glb": _glb,
    ".md": lambda data, subject: f"Subject: {subject}\n\n".encode() + data,
    ".png": _png,
    ".jpg": _jpeg,
}
_IN_PLACE: Mapping[str, Callable[[Path, str], None]] = {".tif": _tiff, ".npz": _npz}
"""Formats of large files, to which the identifier is added without reading them completely."""
