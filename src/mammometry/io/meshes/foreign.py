"""Meshes of other scanners: PLY, OBJ, STL, GLB and USDZ. The user or the file gives the unit."""

from __future__ import annotations

import codecs
import re
from pathlib import Path

import numpy as np

from mammometry.base.errors import SessionError
from mammometry.base.parse import require_file
from mammometry.base.sizes import subject_extent
from mammometry.base.value import value
from mammometry.geometry import Array, Float64, TriangleMesh, UInt8
from mammometry.geometry.mesh_files.mesh_file import KINDS, SUFFIXES, read_triangles
from mammometry.geometry.mesh_files.usdz import read_usdz

MM_PER_UNIT = {"mm": 1.0, "cm": 10.0, "m": 1000.0}
_BY_SIZE = "as the body's size shows"
_TORSO_MM = (230.0, 2300.0)
"""Longest side of a torso's front, at least, and of a whole body, arms raised or held out. Not more than ten times as
long, so that one unit alone fits."""
_COARSEST_STEP_MM = 0.1  # as the standard uncertainty of a scanner's surface (`api.mesh.SURFACE_STD_MM`)
_HEADER_BYTES = 65_536  # in which a file's comments may state its unit
_STATED = re.compile(
    rb"^(?:comment|#)\s*(?:units?\s*[:=]?\s*(?P<unit>mm|cm|m)\b|(?P<ours>mm), world frame)",
    re.MULTILINE | re.IGNORECASE,
)


@value(eq=False)
class ForeignMesh:
    """A mesh as its file has it, in mm."""

    mesh: TriangleMesh
    """mm, in the file's own frame. Corners in one place are one vertex."""
    colours: UInt8[Array, "n 3"]
    """sRGB of each vertex. Mid grey where the file has no colours."""
    units: str
    """Its unit, and who says so, in words."""
    mm_per_unit: float = 1.0
    """Its unit, mm."""

    @property
    def notes(self) -> tuple[str, ...]:
        """A sentence about a unit that nobody stated. Empty where somebody did."""
        if not self.units.endswith(_BY_SIZE):
            return ()
        return (f"The unit of the mesh is taken to be {self.units}. If it is another: --units.",)


def read_foreign(path: Path, units: str | None = None, *, of_torso: bool = False) -> ForeignMesh:
    """Read a mesh file.

    Args:
        path: a PLY, OBJ, STL, GLB or USDZ.
        units: ``mm``, ``cm`` or ``m``; None where the file states it: GLB by its standard (metres), USDZ
            (``metersPerUnit``), PLY and OBJ in a comment (``comment units: mm``).
        of_torso: whether it is known to be a torso, or a whole body. Its size then shows a unit that nobody states.

    Raises:
        SessionError: the file cannot be read or holds no triangles; nobody says its unit, or in that unit it is no
            thing to be measured here.
    """
    if path.suffix.lower() not in SUFFIXES:
        raise _refused(path, "another kind of file", f"a mesh as {KINDS}", "Export the mesh as one of them")
    unit, who = (units, "as stated") if units is not None else _stated_unit(path)
    if unit is not None and unit not in MM_PER_UNIT:
        raise _refused(path, f"the unit {unit!r}", f"one of {', '.join(MM_PER_UNIT)}", "Correct --units")
    vertices, faces, colours = read_triangles(path)
    if unit is None and of_torso:
        unit, who = _unit_of_torso(float(np.ptp(vertices, axis=0).max())), _BY_SIZE
    if unit is None:
        raise _refused(
            path, "no unit", "the unit of its coordinates, which such files do not state", "Add --units mm, cm or m"
        )
    step_mm = _step(vertices) * MM_PER_UNIT[unit]
    vertices = vertices * MM_PER_UNIT[unit]
    extent = subject_extent(float(np.ptp(vertices, axis=0).max()))
    if not extent.is_possible:
        others = {name: subject_extent(extent.mm / MM_PER_UNIT[unit] * mm) for name, mm in MM_PER_UNIT.items()}
        fits = [f"{name} ({size.mm:.0f} mm)" for name, size in others.items() if size.is_usual()]
        raise _refused(
            path,
            f"a mesh {extent.mm:.3g} mm long, its unit being {unit} ({who})",
            f"a cast or a torso, {extent.expected}",
            "Check --units" + (f": {' or '.join(fits)} would fit" if fits else ""),
        )
    if step_mm > _COARSEST_STEP_MM:
        raise _refused(
            path,
            f"coordinates in steps of {step_mm:.2g} mm, {np.abs(vertices).max() / 1000:.3g} m away from the origin",
            f"steps of at most {_COARSEST_STEP_MM:g} mm",
            "Move the mesh to its origin in the program that made it, and export it again",
        )
    mesh = TriangleMesh(vertices=vertices, faces=faces)
    return ForeignMesh(mesh=mesh, colours=colours, units=f"{unit}, {who}", mm_per_unit=MM_PER_UNIT[unit])


def _unit_of_torso(extent: float) -> str | None:
    """The one unit in which this is the length of a torso or of a whole body."""
    for unit, factor in MM_PER_UNIT.items():
        if _TORSO_MM[0] <= extent * factor < _TORSO_MM[1]:
            return unit
    return None


def _step(vertices: Float64[Array, "n 3"]) -> float:
    """Distance of neighbouring single-precision numbers at the farthest coordinate, in the file's unit.

    0 where the coordinates are no single-precision numbers, so that no digits were lost.
    """
    if not np.array_equal(vertices.astype(np.float32), vertices):
        return 0.0
    return float(np.spacing(np.float32(np.abs(vertices).max())))


def _stated_unit(path: Path) -> tuple[str | None, str]:
    """The unit that a file states, and in which way."""
    kind = path.suffix.lower()
    if kind == ".glb":
        return "m", "glTF's unit"
    if kind == ".usdz":
        metres = read_usdz(path, shape=False).metres_per_unit
        named = [name for name, mm in MM_PER_UNIT.items() if metres is not None and np.isclose(1000 * metres, mm)]
        if metres is not None and not named:
            expected = f"one of {', '.join(MM_PER_UNIT)}"
            raise _refused(path, f"a unit of {1000 * metres:g} mm", expected, "Give the unit: --units")
        return (named[0], "as the file says") if named else (None, "")
    if kind in (".ply", ".obj"):
        require_file(path, str(path), "a mesh file")
        try:
            with path.open("rb") as file:
                head = file.read(_HEADER_BYTES)
        except OSError as error:
            raise _refused(path, error.strerror or str(error), "a mesh file", "Check the path") from None
        if head.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
            head = head.decode("utf-16", "ignore").encode()
        stated = _STATED.search(head.removeprefix(codecs.BOM_UTF8).partition(b"end_header")[0])
        if stated is not None:
            return (stated["unit"] or stated["ours"]).decode().lower(), "as the file says"
    return None, ""


def _refused(path: Path, found: str, expected: str, remedy: str) -> SessionError:
    return SessionError(str(path), found=found, expected=expected, remedy=remedy)
