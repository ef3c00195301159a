"""Incoming scans of other devices.

A scan is a mesh with its material and pictures, or a ZIP of all of them.

Received files are read in a separate folder. Only what `io.meshes.scans` makes of them is kept.
"""

from __future__ import annotations

import tempfile
import threading
import zipfile
import zlib
from collections.abc import Sequence
from pathlib import Path, PurePosixPath
from typing import Any

from django.core.files.uploadedfile import UploadedFile

from mammometry.base.listing import is_hidden
from mammometry.base.parse import LimitSettings
from mammometry.capture.checks import NO_PHOTOGRAPH, not_only_a_photograph
from mammometry.clinic.intake.places import UploadError
from mammometry.clinic.site import the_clinic
from mammometry.geometry.mesh_files.mesh_file import KINDS, SUFFIXES
from mammometry.io.meshes.scans import ScanFacts, import_scan
from mammometry.io.write import disk_errors

_PICTURES = (".jpg", ".jpeg", ".png", ".tif", ".tiff")
_KINDS = (*SUFFIXES, ".mtl", *_PICTURES)
_MOST_FILES = 40  # files of one scan: a mesh, its material, at most sixteen pictures, and files that devices add
_CHUNK = 1 << 20  # bytes unpacked at a time
_AT_ONCE = threading.BoundedSemaphore(1)  # reading a scan of 200 MB takes about 2 GB
_MB = 10**6  # bytes


def taken_in(
    files: Sequence[UploadedFile[Any]],
    about: ScanFacts,
    *,
    units: str | None,
    texture: bool,
    second: Sequence[UploadedFile[Any]] = (),
) -> dict[str, bytes]:
    """Read the received files, and return the files of a scan's folder.

    Args:
        files: the mesh and its files, or one ZIP.
        second: another scan of the same visit to be merged with it, in the same form.
        about: scanner, axes and pseudonym.
        units: unit of the mesh. None: its file states it.
        texture: whether pictures are imported.

    Raises:
        UploadError: files of other kinds, no mesh or several, or too large.
        MammometryError: the scan cannot be read.
    """
    most = the_clinic().limits.scan_mb * _MB
    place = the_clinic().folder / "uploads"
    with (
        _AT_ONCE,
        tempfile.TemporaryDirectory(prefix="scan-", dir=place, ignore_cleanup_errors=True) as scratch,
        disk_errors(place),
    ):
        if sum(sent.size or 0 for sent in (*files, *second)) > most:
            raise _too_large(most)
        folders = [Path(scratch) / name for name in ("first", "second")][: 2 if second else 1]
        meshes = [_put(sent, folder, most) for sent, folder in zip((files, second), folders, strict=False)]
        limits = LimitSettings(megapixels=float(the_clinic().limits.photograph_megapixels))
        return import_scan(meshes[0], about, units=units, texture=texture, limits=limits, also=meshes[1:])


def _put(files: Sequence[UploadedFile[Any]], folder: Path, most: int) -> Path:
    """Write the files of one scan into a new folder, and return its mesh."""
    folder.mkdir()
    if len(files) == 1 and _suffix(files[0].name) == ".zip":
        _unpack(files[0], folder, most)
    else:
        for sent in (sent for sent in files if not is_hidden(sent.name or "")):
            with _new(folder, sent.name or "").open("xb") as file:
                for chunk in sent.chunks():
                    file.write(chunk)
    (mesh,) = _meshes(folder)
    _check_pictures(folder)
    return mesh


def _unpack(packed: UploadedFile[Any], folder: Path, most: int) -> None:
    """Unpack the files of known kinds. The sizes stated in a ZIP are not trusted."""
    left = most
    try:
        with zipfile.ZipFile(packed) as archive:
            members = [member for member in archive.infolist() if _is_wanted(member)]
            if len(archive.infolist()) > 50 * _MOST_FILES or len(members) > _MOST_FILES:
                raise UploadError(f"The ZIP contains too many files. A scan has at most {_MOST_FILES}.", 400)
            for member in members:
                if member.flag_bits & 1:
                    raise UploadError("The ZIP has a password. Pack it without one.", 400)
                with archive.open(member) as source, _new(folder, member.filename).open("xb") as file:
                    while chunk := source.read(_CHUNK):
                        left -= len(chunk)
                        if left < 0:
                            raise _too_large(most)
                        file.write(chunk)
    except (zipfile.BadZipFile, zlib.error, NotImplementedError, EOFError, ValueError, RuntimeError):
        raise UploadError("The ZIP cannot be read. Pack it again, or choose the files themselves.", 400) from None


def _is_wanted(member: zipfile.ZipInfo) -> bool:
    path = PurePosixPath(member.filename.replace("\\", "/"))
    hidden = any(is_hidden(part) for part in path.parts if part != "..")
    return not member.is_dir() and not hidden and path.suffix.lower() in _KINDS


def _new(folder: Path, name: str) -> Path:
    """Path for a file under its own name, by which an OBJ refers to its material and pictures."""
    plain = PurePosixPath(name.replace("\\", "/")).name
    if _suffix(plain) not in _KINDS or len(plain.encode()) > 200 or not plain.isprintable():
        ending = _suffix(plain)[:10] or "a file without an ending"
        raise UploadError(f"{ending} is not for a scan. Choose OBJ, MTL and JPEG or PNG, or one ZIP.", 400)
    path = folder / plain
    if path.exists():
        raise UploadError("Two files have the same name. Choose those of one scan.", 400)
    return path


def _meshes(folder: Path) -> list[Path]:
    meshes = [path for path in sorted(folder.iterdir()) if path.suffix.lower() in SUFFIXES]
    if len(meshes) != 1:
        raise UploadError(f"There are {len(meshes)} meshes. Choose one ({KINDS}) and its files.", 400)
    return meshes


def _check_pictures(folder: Path) -> None:
    for path in folder.iterdir():
        if path.suffix.lower() in _PICTURES and (other := not_only_a_photograph(path)) is not None:
            what = "no picture" if other is NO_PHOTOGRAPH else f"{other} as well as a picture"
            raise UploadError(f"A file with the ending {path.suffix} is {what}. Export the scan again.", 400)


def _suffix(name: str | None) -> str:
    return PurePosixPath((name or "").replace("\\", "/")).suffix.lower()


def _too_large(most: int) -> UploadError:
    return UploadError(f"That is more than {most // _MB} MB, unpacked. Export the scan with a coarser mesh.", 413)
