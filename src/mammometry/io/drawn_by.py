"""Which person drew which curves on which surface.

A table, or a folder of boundary files beside one mesh.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from mammometry.base.errors import SessionError, TableError
from mammometry.io.parsing.csv_tables import read_table

_SUFFIX = ".json"
_COLUMNS = "columns mesh, boundary and observer, and repeat where somebody drew twice"


@dataclass(frozen=True, slots=True, kw_only=True)
class DrawnBy:
    """One file of boundaries that one person drew."""

    mesh: Path
    """The surface that it was drawn on."""
    boundary: Path
    """The boundaries.json."""
    observer: str
    """Who drew."""
    repeat: str
    """Which of that person's drawings of this surface."""


def read_drawn_by(curves: Path, mesh: Path | None = None) -> tuple[DrawnBy, ...]:
    """Read a table, or list a folder's drawings of one mesh.

    In a folder, ``anna-2.json`` is Anna's second drawing, and ``ben.json`` Ben's first. A table's paths are relative to
    it; without a mesh column all drawings are of `mesh`.

    Raises:
        SessionError: the folder holds fewer than two drawings, or nobody says the mesh.
        TableError: the table cannot be read, has no such columns, an empty cell, or one drawing twice.
    """
    drawn = _of_folder(curves, mesh) if curves.is_dir() else _of_table(curves, mesh)
    if len(drawn) < 2:
        raise SessionError(
            str(curves),
            found=f"{len(drawn)} drawings",
            expected="two or more of one surface",
            remedy="Let another person draw, or draw again",
        )
    return drawn


def _of_folder(folder: Path, mesh: Path | None) -> tuple[DrawnBy, ...]:
    if mesh is None:
        raise _no_mesh(folder)
    drawn = []
    for path in sorted(folder.glob(f"*{_SUFFIX}")):
        name, _, number = path.stem.rpartition("-")
        named = (name, number) if name and number.isdecimal() else (path.stem, "1")
        drawn.append(DrawnBy(mesh=mesh, boundary=path, observer=named[0], repeat=named[1]))
    return tuple(drawn)


def _of_table(path: Path, mesh: Path | None) -> tuple[DrawnBy, ...]:
    table = read_table(path, str(path), _COLUMNS, refusal=TableError)
    if "mesh" not in table.columns and mesh is None:
        raise _no_mesh(path)
    count = len(table.rows)
    meshes = table.texts("mesh") if "mesh" in table.columns else (str(mesh and mesh.resolve()),) * count
    repeats = table.texts("repeat") if "repeat" in table.columns else ("1",) * count
    drawn: list[DrawnBy] = []
    for line, *cells in zip(
        table.lines, meshes, table.texts("boundary"), table.texts("observer"), repeats, strict=True
    ):
        if not all(cells):
            raise TableError(
                f"{path}, row {line}",
                found="an empty cell",
                expected=_COLUMNS,
                remedy="Fill it in, or leave the row out",
            )
        on, boundary, observer, repeat = cells
        drawing = DrawnBy(mesh=path.parent / on, boundary=path.parent / boundary, observer=observer, repeat=repeat)
        if any((drawing.mesh, observer, repeat) == (other.mesh, other.observer, other.repeat) for other in drawn):
            raise TableError(
                f"{path}, row {line}",
                found=f"a second drawing {repeat} of {on} by {observer}",
                expected="each drawing once",
                remedy="Number the drawings of one person in the column repeat",
            )
        drawn.append(drawing)
    return tuple(drawn)


def _no_mesh(curves: Path) -> SessionError:
    return SessionError(
        str(curves),
        found="drawings without a surface",
        expected="the mesh that they were drawn on",
        remedy="Add --mesh front.ply, or a column mesh to the table",
    )
