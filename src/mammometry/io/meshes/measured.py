"""The folder of a measured mesh, which every command can open.

``mesh.toml`` contains the path of the mesh and the options with which it was measured. Boundaries and landmarks are
copied into the folder, where they can be edited.
"""

from __future__ import annotations

import hashlib
import json
import os
from dataclasses import replace
from pathlib import Path
from typing import Any
from urllib.parse import quote, unquote_to_bytes

from mammometry.base.errors import SessionError, StorageError
from mammometry.base.parse import read_text, toml_table
from mammometry.base.shell import command_line
from mammometry.base.value import value
from mammometry.io.drawn import BOUNDARIES, LANDMARK_FILE
from mammometry.io.manifest import MANIFEST
from mammometry.io.meshes.scans import MESH, RESULTS, ScanFacts, is_scan, read_scan
from mammometry.io.outputs import write_output
from mammometry.io.session import Session
from mammometry.io.write import disk_errors, file_digest, write_text

ABOUT_MESH = "mesh.toml"
SCALE_STD = 0.001
"""Relative standard uncertainty of a scanner's lengths if none is given: 0.1 %, 1 mm in a metre."""
SURFACE_STD_MM = 0.1
"""Standard uncertainty of a scanner's whole surface along its normal if none is given, mm."""
_FORM = "the description of a measured mesh, as `mammometry measure` writes it"
_REMEDY = "Measure the mesh into this folder again: mammometry measure MESH --out FOLDER"
_DRAWN = {"boundary": BOUNDARIES, "landmarks": LANDMARK_FILE}
_TEXTS, _FLAGS = ("units", "head", "ahead", "subject", "posture"), ("automatic", "largest", "sides_checked")
_NUMBERS = ("scale_std", "surface_std_mm")
_MOST_COPIES = 8  # digests of earlier copies that are stored


@value
class MeshFiles:
    """Another scanner's mesh, with its files and options."""

    mesh: Path
    """PLY, OBJ, STL, GLB or USDZ."""
    units: str | None = None
    """``mm``, ``cm``, ``m``, ``in`` or ``ft``. None if the file states it."""
    boundary: Path | None = None
    """boundaries.json of the mesh, in mm or the mesh's unit. None: found by landmarks or automatically."""
    landmarks: Path | None = None
    """landmarks.json of the mesh, in mm, in the format of a session."""
    back: Path | None = None
    """Mesh of the measured wall behind the breast, in the same unit and frame."""
    automatic: bool = False
    """Whether a torso's boundaries are found automatically, as in a session."""
    head: str | None = None
    """The file's axis towards the head (``y``, ``-z`` …). None: ``y``, or ``z`` if ``y`` points ahead. Used with
    `automatic`, or if only one breast is drawn."""
    ahead: str | None = None
    """The axis straight ahead. None: the direction in which an open mesh faces."""
    largest: bool = False
    """Whether to measure only the largest of several pieces."""
    scale_std: float = SCALE_STD
    """Relative standard uncertainty of its lengths."""
    surface_std_mm: float = SURFACE_STD_MM
    """Standard uncertainty of its whole surface along its normal, mm."""
    subject: str | None = None
    """Pseudonym of the subject, written into every result. None: not given."""
    posture: str = ""
    """``standing``, ``leaning`` or ``lying``. Empty: that of the scan's folder."""
    sides_checked: bool = False
    """Whether a person has confirmed that left and right of the mesh are the patient's."""
    scan: ScanFacts | None = None
    """Description of an imported scan. None: the mesh was not imported."""
    also: tuple[Path, ...] = ()
    """Further scans of the same visit and posture, in the same unit, which are merged with `mesh`."""


def is_measured(folder: Path) -> bool:
    """Whether a mesh was measured into this folder, by a version that writes ``mesh.toml``."""
    return (folder / ABOUT_MESH).is_file()


def can_be_opened(folder: Path) -> bool:
    """Whether a folder is a session, an imported scan, or one into which a mesh was measured."""
    return (folder / MANIFEST).is_file() or is_scan(folder) or is_measured(folder)


def session_with_photographs(folder: Path) -> Session:
    """Open a session, which must have photographs.

    Raises:
        SessionError: it is a scan, or as `Session.open`.
    """
    if is_scan(folder) or is_measured(folder):
        raise without_photographs(folder)
    return Session.open(folder)


def without_photographs(folder: Path) -> SessionError:
    """Return the error for a command that needs photographs, if the folder is that of a scan."""
    return SessionError(
        str(folder), found="a scan, whose surface is given", expected="a session with photographs",
        remedy=f"Measure it: {command_line('mammometry', 'run', folder)}",
    )  # fmt: skip


def results_of(folder: Path) -> Path:
    """Folder of the results of such a folder."""
    return folder if is_measured(folder) else folder / RESULTS


def is_result(folder: Path, name: str) -> bool:
    """Whether a file, given by its path below such a folder, is a result."""
    return name not in (ABOUT_MESH, *_DRAWN.values()) if is_measured(folder) else name.startswith(f"{RESULTS}/")


def has_own_folder(files: MeshFiles, results: Path) -> bool:
    """Whether these results have a ``mesh.toml``. Results in an imported scan's folder have none."""
    return files.scan is None or results.resolve() != (files.mesh.parent / RESULTS).resolve()


def with_edits(files: MeshFiles, folder: Path) -> MeshFiles:
    """Replace drawings by those that were edited in the folder.

    Raises:
        StorageError: other drawings are given as well.
        SessionError: the folder's description is not as documented.
    """
    copies = _copies(folder)
    for field, name in _DRAWN.items():
        own, given = folder / name, getattr(files, field)
        if not own.is_file() or given == own or file_digest(own) in copies:
            continue
        if given is not None:
            raise StorageError(
                str(own), found=f"another drawing than {given}", expected="one of the two",
                remedy=f"Measure the folder as it is, mammometry measure {folder}, or choose another --out",
            )  # fmt: skip
        files = replace(files, boundary=own) if field == "boundary" else replace(files, landmarks=own)
    return files


def describe(folder: Path, files: MeshFiles, drawn: dict[str, str]) -> None:
    """Write ``mesh.toml`` and copies of the drawings into a folder, if they differ.

    Args:
        folder: folder of the results, made by `io.outputs.take_folder`.
        files: the mesh with its files and options.
        drawn: name → content of a drawing, boundaries.json or landmarks.json, in mm.

    Raises:
        StorageError: the disk is full or reports an error.
    """
    before = _copies(folder)
    given = {name: getattr(files, field) for field, name in _DRAWN.items()}
    copied = {name: text for name, text in drawn.items() if given[name] != folder / name}
    digests = [_sha256(text) for text in copied.values()]
    text = _text(folder, files, tuple(dict.fromkeys([*digests, *before]))[:_MOST_COPIES])
    path = folder / ABOUT_MESH
    if not path.is_file() or path.read_bytes() != text.encode():
        write_output(path, text.encode(), command="measure")
    with disk_errors(folder):
        for name, path in ((name, folder / name) for name in given):
            if name in copied and (not path.is_file() or path.read_bytes() != copied[name].encode()):
                write_text(path, copied[name])
            elif given[name] is None and path.is_file():
                path.unlink()  # our own copy of an earlier drawing; `with_edits` uses any other


def read_measured(folder: Path, *, drawn: bool = True) -> MeshFiles:
    """Read which mesh was measured into a folder, with the drawings that the folder contains now.

    Args:
        folder: folder with ``mesh.toml``.
        drawn: whether to include drawn boundaries and landmarks.

    Raises:
        SessionError: the description is not as documented, or the mesh is missing.
    """
    table, sources = _read(folder), sources_of(folder)
    try:
        statements: dict[str, Any] = {name: str(table[name]) for name in _TEXTS if name in table}
        statements |= {name: bool(table[name]) for name in _FLAGS if name in table}
        statements |= {name: float(table[name]) for name in _NUMBERS}
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise _unreadable(folder, f"another content ({error})") from None
    back = sources.pop("back", None)
    mesh, *also = sources.values()
    for path in filter(None, (mesh, *also, back)):
        if not path.is_file():
            raise SessionError(
                str(path), found="no such file", expected=f"the mesh that was measured into {folder}",
                remedy="Put it back, or measure it where it is now: mammometry measure MESH --out FOLDER",
            )  # fmt: skip
    scan = read_scan(mesh.parent) if mesh.name == MESH and is_scan(mesh.parent) else None
    boundary, landmarks = (folder / name if drawn and (folder / name).is_file() else None for name in _DRAWN.values())
    statements["automatic"] = statements.get("automatic", False) or not drawn
    return MeshFiles(
        mesh=mesh, also=tuple(also), back=back, scan=scan, boundary=boundary, landmarks=landmarks, **statements
    )  # fmt: skip


def sources_of(folder: Path) -> dict[str, Path]:
    """``mesh``, ``also-1`` …, ``back`` → file that was measured into a folder. It may not exist any more.

    Raises:
        SessionError: the folder's description is not as documented.
    """
    table = _read(folder)
    try:
        texts = {"mesh": table["mesh"]} | {f"also-{n}": text for n, text in enumerate(table.get("also", []), 1)}
        texts |= {"back": table["back"]} if "back" in table else {}
        return {name: _path(folder, text) for name, text in texts.items()}
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise _unreadable(folder, f"another content ({error})") from None


def _text(folder: Path, files: MeshFiles, copies: tuple[str, ...]) -> str:
    here = folder.resolve()

    def address(path: Path) -> str:
        try:
            below = os.path.relpath(path.resolve(), here)
        except ValueError:  # on another drive
            below = str(path.resolve())
        return quote(os.fsencode(below), safe="/ ()+,:\\")

    made: dict[str, Any] = {"format": 1, "mesh": address(files.mesh)}
    made |= {"also": [address(path) for path in files.also]} if files.also else {}
    made |= {} if files.back is None else {"back": address(files.back)}
    made |= {name: text for name in _TEXTS if (text := getattr(files, name))}
    made |= {name: True for name in _FLAGS if getattr(files, name)}
    made |= {name: getattr(files, name) for name in _NUMBERS}
    made |= {"copies": list(copies)} if copies else {}
    lines = [f"{name} = {json.dumps(given, ensure_ascii=False)}" for name, given in made.items()]
    return "# What `mammometry measure` measured into this folder.\n" + "\n".join(lines) + "\n"


def _path(folder: Path, text: str) -> Path:
    return Path(os.path.normpath(folder.resolve() / os.fsdecode(unquote_to_bytes(text))))


def _read(folder: Path) -> dict[str, Any]:
    table = toml_table(read_text(folder / ABOUT_MESH, ABOUT_MESH, _FORM), ABOUT_MESH, _FORM)
    if table.get("format") != 1:
        raise _unreadable(folder, f"format {table.get('format')!r:.20}")
    return table


def _copies(folder: Path) -> tuple[str, ...]:
    """Digests of the drawings that were copied into a folder."""
    copies = _read(folder).get("copies", []) if is_measured(folder) else []
    return tuple(map(str, copies)) if isinstance(copies, list) else ()


def _sha256(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()


def _unreadable(folder: Path, found: str) -> SessionError:
    return SessionError(str(folder / ABOUT_MESH), found=found, expected=_FORM, remedy=_REMEDY)
