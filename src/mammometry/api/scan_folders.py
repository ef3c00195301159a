"""Imported scans as folders: their mesh, and what was drawn on it."""

from __future__ import annotations

from pathlib import Path

from mammometry.api.mesh import MeshFiles, MeshJob
from mammometry.base.errors import MeasureError
from mammometry.io.drawn import BOUNDARIES, LANDMARK_FILE
from mammometry.io.meshes.scans import MESH, RESULTS, is_scan, read_scan
from mammometry.io.results.store import Watch, unwatched
from mammometry.settings import Settings


def scan_files(folder: Path, *, subject: str | None = None, drawn: bool = True) -> MeshFiles:
    """An imported scan's mesh, with what was drawn on it. Other boundaries are found automatically.

    Args:
        folder: made by ``mammometry import mesh``. What was drawn lies in it, as in a session.
        subject: a pseudonym. None: the one that the folder names.
        drawn: whether drawn boundaries and landmarks count.

    Raises:
        SessionError: the folder's description is not as documented.
    """
    scan = read_scan(folder)
    boundary, landmarks = (
        path if drawn and path.is_file() else None for path in (folder / BOUNDARIES, folder / LANDMARK_FILE)
    )
    return MeshFiles(
        mesh=folder / MESH, units="mm", boundary=boundary, landmarks=landmarks, automatic=True,
        head=scan.head or None, ahead=scan.ahead or None, subject=subject or scan.subject, scan=scan,
    )  # fmt: skip


def open_scan(folder: Path, settings: Settings | None = None, *, watch: Watch = unwatched) -> MeshJob:
    """Open an imported scan.

    Args:
        folder: made by ``mammometry import mesh``.
        settings: of the measurement; None for the recommended ones.
        watch: called for every product that is made.

    Raises:
        MammometryError: the scan cannot be opened.
    """
    return MeshJob(scan_files(folder), folder / RESULTS, settings, watch=watch)


def drawable_scan(folder: Path, settings: Settings | None = None) -> MeshJob:
    """Open an imported scan for drawing on it.

    A drawing that the measurement refuses does not count. It can so be corrected.

    Raises:
        MammometryError: the scan cannot be opened.
    """
    try:
        return open_scan(folder, settings)
    except MeasureError:
        return MeshJob(scan_files(folder, drawn=False), folder / RESULTS, settings)


def folder_for(mesh: Path) -> Path:
    """Default folder for a mesh's results: an imported scan's own, else beside the mesh with its name."""
    if mesh.name == MESH and is_scan(mesh.parent):
        return mesh.parent / RESULTS
    return mesh.with_name(f"{mesh.stem}-measured")
