"""The main job in Python: open a folder, run stages, read values.

::

    import mammometry as mm

    job = mm.open_session("SESSION")
    print(job.run().volumes_cc)
"""

from __future__ import annotations

from pathlib import Path

from mammometry.api.session_job import Job
from mammometry.base.errors import MeasureError, SessionError
from mammometry.io.drawn import BOUNDARIES, LANDMARK_FILE
from mammometry.io.meshes.measured import ABOUT_MESH, MeshFiles, can_be_opened, is_measured, read_measured
from mammometry.io.meshes.scans import MESH, RESULTS, is_scan, read_scan
from mammometry.io.results.records import RECORDS
from mammometry.io.results.store import Watch, unwatched
from mammometry.io.session import Session
from mammometry.job.graph import Method
from mammometry.job.method import method
from mammometry.job.products import NONE_GIVEN, Given
from mammometry.settings import Settings

__all__ = ["Job", "drawable", "folder_for", "open_session", "scan_files"]


def open_session(
    path: Path | str,
    settings: Settings | None = None,
    *,
    watch: Watch = unwatched,
    method: Method = method,
    given: Given = NONE_GIVEN,
) -> Job:
    """The main job on a folder: a session of photographs, or a scan.

    Args:
        path: folder of a session, of a scan imported by ``mammometry import mesh``, or of a mesh measured by
            ``mammometry measure``.
        settings: settings of all stages; None for the recommended ones.
        watch: called for each product that is computed; gives its progress callback.
        method: plans the products: `job.method.method`, or a function that calls it and plans more.
        given: product of the method → another function that computes it (`job.products.instead_of`).

    Raises:
        SessionError: the folder or its description is not as documented, or photographs are missing.
        ImageError: a photograph is unreadable, or differs in size from its camera's others.
        MeasureError: a scan's mesh cannot be measured.
    """
    folder = Path(path)
    if is_scan(folder) or is_measured(folder):
        return _scan(folder, settings, watch, method=method, given=given)
    if not can_be_opened(folder) and (folder / "measure" / RECORDS).is_file():
        raise SessionError(
            str(folder), found="the results of a mesh, without a record of where the mesh is", expected=ABOUT_MESH,
            remedy="Measure it into this folder again: mammometry measure MESH --out FOLDER. Current results are kept",
        )  # fmt: skip
    return Job(Session.open(folder), settings or Settings(), watch, method=method, given=given)


def drawable(folder: Path, settings: Settings | None = None, *, watch: Watch = unwatched) -> Job:
    """The job on a folder, for drawing on its surface.

    A drawing on a scan that the measurement refuses is ignored, so that it can be corrected.

    Raises:
        MammometryError: it cannot be opened.
    """
    try:
        return open_session(folder, settings, watch=watch)
    except MeasureError:
        if not (is_scan(folder) or is_measured(folder)):
            raise
        return _scan(folder, settings, watch, drawn=False)


def _scan(
    folder: Path,
    settings: Settings | None,
    watch: Watch,
    *,
    drawn: bool = True,
    method: Method = method,
    given: Given = NONE_GIVEN,
) -> Job:
    from mammometry.api.mesh import MeshJob

    imported = is_scan(folder)
    files = scan_files(folder, drawn=drawn) if imported else read_measured(folder, drawn=drawn)
    results, edited = (folder / RESULTS, True) if imported else (folder, drawn)
    return MeshJob(files, results, settings, watch=watch, edited=edited, method=method, given=given)


def scan_files(folder: Path, *, subject: str | None = None, drawn: bool = True) -> MeshFiles:
    """An imported scan's mesh with its drawings. Other boundaries are found automatically.

    Args:
        folder: a folder made by ``mammometry import mesh``, with the drawings as in a session.
        subject: a pseudonym. None: that of the folder.
        drawn: whether to include drawn boundaries and landmarks.

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


def folder_for(mesh: Path) -> Path:
    """Default folder for a mesh's results: an imported scan's own, else one next to the mesh."""
    if mesh.name == MESH and is_scan(mesh.parent):
        return mesh.parent / RESULTS
    return mesh.with_name(f"{mesh.stem}-measured")
