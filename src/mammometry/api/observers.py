"""Several observers' drawings of the same breasts, measured in the same way.

::

    from mammometry.api.observers import measure_drawings
    from mammometry.api.observers import read_drawn_by
    from mammometry.study.observers import observer_study

    drawn = measure_drawings(read_drawn_by(Path("curves"), Path("front.ply")), units="mm")
    print(observer_study(drawn.drawings).between)
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from mammometry.base.errors import SessionError, TableError
from mammometry.base.identity import folded, shown_name
from mammometry.base.listing import visible
from mammometry.base.progress import Progress, no_progress
from mammometry.geometry.arrays import Array, Float64
from mammometry.io.csv_tables import read_table
from mammometry.io.drawn import boundaries_in
from mammometry.io.meshes.foreign import read_foreign
from mammometry.measure import scanned
from mammometry.measure.boundary.boundary import Boundary
from mammometry.measure.boundary.trace import check_curve
from mammometry.measure.scan_repair import repair_scan
from mammometry.measure.settings import MeasureSettings
from mammometry.measure.trunk.body import find_body
from mammometry.measure.wall import chest_wall
from mammometry.measure.wall.open_breast import open_breasts
from mammometry.study.observers import DrawnSurface, ObservedCurve
from mammometry.surface.repair.repair import RepairedSurface

_SUFFIX = ".json"
_NOT_NAMES = frozenset(
    ("rater", "observer", "reader", "person", "surgeon", "doctor", "expert", "user", "drawer", "technician", "nurse",
     "operator", "investigator", "student", "annotator", "clinician", "resident", "registrar", "consultant", "trainee",
     "participant", "beobachter", "untersucher", "auswerter", "dr", "obs", "r", "o", "p")
)  # fmt: skip
"""Words after which a number identifies a person: ``rater-2`` and ``rater-1`` are different people."""
_NUMBERED = re.compile(r"(.*[^\W\d_])[ _]?(\d{1,3})")
"""A name and a number without a hyphen."""
_COPY = re.compile(r"\(\d+\)$|[\s_-](copy|kopie|copie|copia)([\s_-]?\(?\d+\)?)?$|^(copy of|kopie von) ", re.IGNORECASE)
"""Names of copies by browsers and desktops: ``anna-1 (1)``, ``anna-1 copy 2``, ``Copy of anna-1``."""
_SAME_MM = 1e-3  # curves nearer than this are copies: files have a resolution of 0.001 mm, which no person repeats
_COLUMNS = "columns mesh, boundary and observer, and repeat if a person drew twice"


@dataclass(frozen=True, slots=True, kw_only=True)
class DrawnBy:
    """One file of boundaries by one person."""

    mesh: Path
    """The surface of the drawing."""
    boundary: Path
    """The boundaries.json."""
    observer: str
    """Who drew."""
    repeat: str
    """Number of that person's drawing of this surface."""


def read_drawn_by(curves: Path, mesh: Path | None = None) -> tuple[DrawnBy, ...]:
    """Drawings in a table, or in a folder for one mesh.

    In a folder, ``anna-2.json`` is Anna's second drawing, and ``ben.json`` Ben's first. ``rater-2.json`` is the first
    drawing of another rater. Case and the forms of accented letters are ignored. A table's paths are relative to it;
    without a mesh column all drawings are of `mesh`.

    Raises:
        SessionError: the folder contains fewer than two drawings, a copy, one drawing twice, or ``anna_1`` and
            ``anna_2``, which may be one person or two; or the mesh is unknown.
        TableError: the table cannot be read, has no such columns, an empty cell, or one drawing twice.
    """
    drawn = _of_folder(curves, mesh) if curves.is_dir() else _of_table(curves, mesh)
    if len(drawn) < 2:
        remedy = "Ask another person to draw, or draw again"
        expected = "two or more of one surface"
        raise SessionError(str(curves), found=f"{len(drawn)} drawings", expected=expected, remedy=remedy)
    return drawn


def _of_folder(folder: Path, mesh: Path | None) -> tuple[DrawnBy, ...]:
    if mesh is None:
        raise _no_mesh(folder)
    persons: dict[str, str] = {}
    drawn: dict[tuple[str, str], DrawnBy] = {}
    paths = [path for path in visible(folder) if path.suffix.casefold() == _SUFFIX]
    _require_hyphens(paths)
    for path in paths:
        if _COPY.search(path.stem):
            remedy = "Remove it, or rename it if the person drew again: anna-2.json"
            raise SessionError(str(path), found="a copy, by its name", expected="a drawing", remedy=remedy)
        name, repeat = _person(path.stem)
        observer, repeat = persons.setdefault(folded(name), name), str(int(repeat))
        if (observer, repeat) in drawn:
            raise SessionError(
                str(path),
                found=f"drawing {repeat} by {observer}, as {shown_name(drawn[observer, repeat].boundary)}",
                expected="each drawing once",
                remedy="Number the drawings of one person, and give two persons different names",
            )
        drawn[observer, repeat] = DrawnBy(mesh=mesh, boundary=path, observer=observer, repeat=repeat)
    return tuple(drawn.values())


def _require_hyphens(paths: Sequence[Path]) -> None:
    """Raise an error for ``anna_1`` and ``anna_2``, which may be one person or two."""
    numbered: dict[str, Path] = {}
    for path in paths:
        match = _NUMBERED.fullmatch(path.stem)
        if match is None or folded(match[1]) in _NOT_NAMES:
            continue
        other = numbered.setdefault(folded(match[1]), path)
        if other != path:
            raise SessionError(
                str(path),
                found=f"a number without a hyphen, as in {shown_name(other)}",
                expected=f"{match[1]}-{match[2]}{_SUFFIX} for drawing {match[2]} by {match[1]}",
                remedy="Rename the files of one person so, and give two persons different names",
            )


def _person(stem: str) -> tuple[str, str]:
    """Name and number of a drawing's file."""
    name, _, number = stem.rpartition("-")
    if not name or not number.isdecimal() or folded(name) in _NOT_NAMES:
        return stem, "1"
    return name, number


def _of_table(path: Path, mesh: Path | None) -> tuple[DrawnBy, ...]:
    table = read_table(path, str(path), _COLUMNS, refusal=TableError)
    if "mesh" not in table.columns and mesh is None:
        raise _no_mesh(path)
    count = len(table.rows)
    meshes = table.texts("mesh") if "mesh" in table.columns else (str(mesh and mesh.resolve()),) * count
    repeats = table.texts("repeat") if "repeat" in table.columns else ("1",) * count
    persons: dict[str, str] = {}
    drawn: dict[tuple[Path, str, str], DrawnBy] = {}
    for line, *cells in zip(
        table.lines, meshes, table.texts("boundary"), table.texts("observer"), repeats, strict=True
    ):
        if not all(cells):
            remedy = "Fill it in, or leave the row out"
            raise TableError(f"{path}, row {line}", found="an empty cell", expected=_COLUMNS, remedy=remedy)
        on, boundary, name, repeat = cells
        observer = persons.setdefault(folded(name), name)
        drawing = DrawnBy(mesh=path.parent / on, boundary=path.parent / boundary, observer=observer, repeat=repeat)
        key = (drawing.mesh, observer, folded(repeat))
        if key in drawn:
            raise TableError(
                f"{path}, row {line}",
                found=f"a second drawing {repeat} of {on} by {observer}",
                expected="each drawing once",
                remedy="Number the drawings of one person in the column repeat",
            )
        drawn[key] = drawing
    return tuple(drawn.values())


def _no_mesh(curves: Path) -> SessionError:
    remedy = "Add --mesh front.ply, or a column mesh to the table"
    expected = "the mesh that they were drawn on"
    return SessionError(str(curves), found="drawings without a surface", expected=expected, remedy=remedy)


_SIDES = ("left", "right")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MeasuredDrawings:
    """All drawings, and their surfaces."""

    surfaces: tuple[DrawnSurface, ...]
    drawings: tuple[ObservedCurve, ...]


def measure_drawings(
    drawn: Sequence[DrawnBy],
    *,
    units: str | None = None,
    head: str | None = None,
    ahead: str | None = None,
    settings: MeasureSettings | None = None,
    progress: Progress = no_progress,
) -> MeasuredDrawings:
    """Volumes of all drawings, with the same wall on the same mesh.

    Args:
        drawn: files with their observers.
        units: unit of the meshes: ``mm``, ``cm``, ``m``; None if the files state it.
        head: the meshes' axis towards the head; None: from the curves of both sides, else ``y``, or ``z`` if ``y`` is
            straight ahead.
        ahead: the axis straight ahead; None: the direction in which an open mesh faces.
        settings: settings of the measurement, such as the selected wall.
        progress: called with the fraction done.

    Raises:
        SessionError: a file is missing or not as documented, has no curve, or the same curve as another.
        MeasureError: a mesh cannot be measured, or a curve is not on it or cannot be followed.
    """
    surfaces: list[DrawnSurface] = []
    drawings: list[ObservedCurve] = []
    done = 0
    for mesh in dict.fromkeys(drawing.mesh for drawing in drawn):
        own = [drawing for drawing in drawn if drawing.mesh == mesh]

        def part(fraction: float, done: int = done, count: int = len(own)) -> None:
            progress((done + count * fraction) / len(drawn))

        surface, alike = _on_one(mesh, own, units, (head, ahead), settings or MeasureSettings(), part)
        surfaces.append(surface)
        drawings += alike
        done += len(own)
    return MeasuredDrawings(surfaces=tuple(surfaces), drawings=tuple(drawings))


def _on_one(
    path: Path,
    drawn: Sequence[DrawnBy],
    units: str | None,
    axes: tuple[str | None, str | None],
    settings: MeasureSettings,
    progress: Progress,
) -> tuple[DrawnSurface, list[ObservedCurve]]:
    foreign = read_foreign(path, units)
    scan = repair_scan(foreign.mesh, skin_alone=True)
    files = []
    for drawing in drawn:
        curves = boundaries_in(drawing.boundary, _SIDES).curves
        if not curves:
            remedy = "Ask this person to draw, or remove the file"
            expected = "a curve around a breast, left or right"
            raise SessionError(str(drawing.boundary), found="no points", expected=expected, remedy=remedy)
        files.append({name: scanned.in_mesh_unit(one, scan.mesh, foreign.mm_per_unit) for name, one in curves.items()})
    _require_no_copies(drawn, files)
    scan = scanned.finer_scan(scan, [one for curves in files for one in curves.values()])
    surface, fine = scanned.as_scanned(scan.mesh, scan.invented, scan.at_fold), scan.mesh
    frame = _frame(surface, files, axes)
    drawings = []
    for number, (drawing, curves) in enumerate(zip(drawn, files, strict=True)):
        for name, one in curves.items():
            check_curve(f"{name} of {shown_name(drawing.boundary)}", one, fine)
            scanned.check_cut(name, one, fine)
        boundaries = [Boundary(name=name, points_world=one, method="drawn") for name, one in curves.items()]  # type: ignore[arg-type]
        for breast in open_breasts(boundaries, surface, settings, frame=frame):
            side = breast.boundary.name
            wall = chest_wall.fit(breast)
            axes_world = np.stack([frame[0] if side == "left" else -frame[0], frame[1], frame[2]])
            drawings.append(
                ObservedCurve(
                    breast=f"{shown_name(path.with_suffix(''))}, {side}",
                    observer=drawing.observer,
                    repeat=drawing.repeat,
                    volume_cc=wall.closed.volume_mm3() / 1000,
                    base_cm2=wall.mesh.area_mm2() / 100,
                    lateral_up_mm=breast.boundary.points_world @ axes_world.T,
                )
            )
        progress((number + 1) / len(drawn))
    flat = [(drawing.observer, one) for drawing, curves in zip(drawn, files, strict=True) for one in curves.values()]
    name = shown_name(path.with_suffix(""))
    return DrawnSurface(name=name, mesh=foreign.mesh, frame=frame, curves=tuple(flat)), drawings


def _require_no_copies(drawn: Sequence[DrawnBy], files: Sequence[Mapping[str, Float64[Array, "n 3"]]]) -> None:
    """Raise an error if two files contain the same curve to 0.001 mm, from any start in any direction."""
    seen: list[tuple[DrawnBy, str, Float64[Array, "n 3"]]] = []
    for drawing, curves in zip(drawn, files, strict=True):
        for side, curve in curves.items():
            for other, other_side, earlier in seen:
                same = side == other_side and len(curve) == len(earlier)
                if same and float(np.max(cKDTree(earlier).query(curve)[0])) < _SAME_MM:
                    raise SessionError(
                        str(drawing.boundary),
                        found=f"the {side} curve of {shown_name(other.boundary)}",
                        expected="curves that were drawn independently",
                        remedy="Remove the copy, or the side that was copied and not drawn",
                    )
            seen.append((drawing, side, curve))


def _frame(
    surface: RepairedSurface, files: Sequence[dict[str, Float64[Array, "n 3"]]], axes: tuple[str | None, str | None]
) -> Float64[Array, "3 3"]:
    """Body frame of all drawings, from the first one with both sides, else from the mesh file's axes."""
    both = next((curves for curves in files if len(curves) == len(_SIDES)), None)
    if both is not None and axes == (None, None):
        rough = scanned.viewing_frame(surface, both, {})
    else:
        rough = scanned.frame_from_axes(surface.mesh, *axes)
    return np.asarray(find_body(surface, rough, boundaries=list((both or files[0]).values())).frame)
