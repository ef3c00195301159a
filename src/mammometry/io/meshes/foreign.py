"""Meshes of other scanners: PLY, OBJ, STL, GLB and USDZ. The unit is from the user or the file."""

from __future__ import annotations

import codecs
import re
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType

import numpy as np

from mammometry.base.errors import SessionError
from mammometry.base.notices import Notice
from mammometry.base.notices.words import maybe_words
from mammometry.base.parse import require_file
from mammometry.base.sizes import subject_extent
from mammometry.base.units import (
    MM_PER_UNIT,
    UNIT_NAMES,
    UNIT_TITLES,
    mm_of_unit,
    unit_in_comment,
    unit_named,
    unit_of_size,
)
from mammometry.base.value import value
from mammometry.geometry import Array, Float64, TriangleMesh, UInt8
from mammometry.geometry.mesh_files.mesh_file import KINDS, SUFFIXES, read_mesh_file
from mammometry.geometry.mesh_files.usdz import read_usdz

_BY_SIZE = "as the body's size shows"
_TORSO_MM = (230.0, 2300.0)
"""Smallest length of a torso's front, and largest length of a body with raised arms. Their ratio is below ten, so that
only one unit of `_USUAL` fits."""
_USUAL = ("mm", "cm", "m")  # usual units of scanners; inches and feet are ambiguous with cm and m
_COARSEST_STEP_MM = 0.1  # equals the standard uncertainty of a scanner's surface (`api.mesh.SURFACE_STD_MM`)
_HEADER_BYTES = 65_536  # part of a file whose comments may state its unit
_COMMENT = re.compile(r"^(?:comment|obj_info|#+)(.*)")


@value(eq=False)
class ForeignMesh:
    """A mesh as in its file, converted to mm."""

    mesh: TriangleMesh
    """mm, in the file's own frame. Vertices at the same position are merged."""
    colours: UInt8[Array, "n 3"]
    """sRGB of each vertex. Medium grey if the file has no colours."""
    units: str
    """Unit of the file, and where it was stated, as text."""
    mm_per_unit: float = 1.0
    """Size of its unit, mm."""
    assumed: Notice | None = None
    """Notice about an assumed unit. None if it was stated."""
    remarks: tuple[Notice, ...] = ()
    """Notices about what the reader omitted or assumed."""

    @property
    def notices(self) -> tuple[Notice, ...]:
        """Notices about how the file was read."""
        return (*filter(None, [self.assumed]), *self.remarks)


def unit_notice(units: str, lengths: Mapping[str, float | str] = MappingProxyType({})) -> Notice | None:
    """Notice about an assumed unit. None if it was stated.

    Args:
        units: the unit and where it was stated, as in a `ForeignMesh`.
        lengths: values for a notice about its length, if other units are plausible too.
    """
    if not units.endswith(_BY_SIZE):
        return None
    values = {"unit": units.removesuffix(f", {_BY_SIZE}"), **lengths}
    return Notice(code="mesh-unit-doubtful" if lengths else "mesh-unit-assumed", level="note", values=values)


def read_foreign(path: Path, units: str | None = None, *, of_torso: bool = False) -> ForeignMesh:
    """Read a mesh in mm.

    Args:
        path: a PLY, OBJ, STL, GLB or USDZ.
        units: a name or spelling of `base.units`. None if the file states it: GLB by its standard (metres), USDZ
            (``metersPerUnit``), PLY and OBJ in a comment (``comment units: mm``).
        of_torso: whether it is known to be a torso or a whole body, so that its size shows the unit.

    Raises:
        SessionError: the file cannot be read or has no triangles; its unit is unknown, or its size in that unit is
            impossible.
    """
    if path.suffix.lower() not in SUFFIXES:
        raise _refused(path, "another file type", f"a mesh as {KINDS}", "Export the mesh as one of them")
    if units is not None and unit_named(units) is None:
        raise _refused(path, f"the unit {units!r}", f"one of {UNIT_NAMES}", "Correct --units")
    unit, who = (unit_named(units), "as stated") if units is not None else _stated_unit(path)
    content = read_mesh_file(path)
    extent_units = float(np.ptp(content.points, axis=0).max())
    lengths: dict[str, float | str] = {}
    if unit is None and of_torso:
        unit, lengths = _unit_of_torso(extent_units)
        who = _BY_SIZE
    mm_per_unit = None if unit is None else mm_of_unit(unit)
    if unit is None or mm_per_unit is None:
        expected = "the unit of its coordinates, which such files do not state"
        raise _refused(path, "no unit", expected, f"Add --units {UNIT_NAMES}")
    step_mm = _step(content.points) * mm_per_unit
    vertices = content.points * mm_per_unit
    extent = subject_extent(extent_units * mm_per_unit)
    if not extent.is_possible:
        others = {name: subject_extent(extent_units * mm) for name, mm in MM_PER_UNIT.items()}
        fits = [f"{name} ({size.mm:.0f} mm)" for name, size in others.items() if size.is_usual()]
        raise _refused(
            path,
            f"a mesh {extent.mm:.3g} mm long, in the unit {unit} ({who})",
            f"a cast or a torso, {extent.expected}",
            "Check --units" + (f": {' or '.join(fits)} would fit" if fits else ""),
        )
    if step_mm > _COARSEST_STEP_MM:
        raise _refused(
            path,
            f"coordinates in steps of {step_mm:.2g} mm, {np.abs(vertices).max() / 1000:.3g} m from the origin",
            f"steps of at most {_COARSEST_STEP_MM:g} mm",
            "Move the mesh to its origin in the program that made it, and export it again",
        ).with_remark(maybe_words(unit_notice(f"{unit}, {who}")))
    return ForeignMesh(
        mesh=TriangleMesh(vertices=vertices, faces=content.faces),
        colours=content.colours,
        units=f"{unit}, {who}",
        mm_per_unit=mm_per_unit,
        assumed=unit_notice(f"{unit}, {who}", lengths),
        remarks=tuple(Notice(code=code, level="note") for code in content.remarks),
    )


def _unit_of_torso(extent: float) -> tuple[str | None, dict[str, float | str]]:
    """Unit in which a length is that of a torso or whole body, and the lengths in other fitting units."""
    fits = {unit: extent * mm for unit, mm in MM_PER_UNIT.items() if _TORSO_MM[0] <= extent * mm < _TORSO_MM[1]}
    unit = next((unit for unit in _USUAL if unit in fits), None)
    if unit is None:
        return None, {}
    others = [f"{mm:.0f} mm in {UNIT_TITLES[name]}" for name, mm in fits.items() if name not in _USUAL]
    return unit, {"mm": fits[unit], "others": " or ".join(others)} if others else {}


def _step(vertices: Float64[Array, "n 3"]) -> float:
    """Spacing of single-precision numbers at the farthest coordinate, in the file's unit.

    0 if the coordinates are not single-precision numbers, so that no digits were lost.
    """
    if not np.array_equal(vertices.astype(np.float32), vertices):
        return 0.0
    return float(np.spacing(np.float32(np.abs(vertices).max())))


def _stated_unit(path: Path) -> tuple[str | None, str]:
    """The unit that a file states, and where it states it."""
    kind = path.suffix.lower()
    if kind == ".glb":
        return "m", "glTF's unit"
    if kind == ".usdz":
        metres = read_usdz(path, shape=False).metres_per_unit
        if metres is None:
            return None, ""
        if not 0 < metres < np.inf:
            raise _refused(path, f"a unit of {metres:g} m", "one above 0", "Give the unit: --units")
        return unit_of_size(1000 * metres), "as the file says"
    if kind in (".ply", ".obj"):
        require_file(path, str(path), "a mesh file")
        try:
            with path.open("rb") as file:
                head = file.read(_HEADER_BYTES)
        except OSError as error:
            raise _refused(path, error.strerror or str(error), "a mesh file", "Check the path") from None
        return _unit_in_comments(path, head)
    return None, ""


def _unit_in_comments(path: Path, head: bytes) -> tuple[str | None, str]:
    """The unit in comments at the beginning of a PLY or OBJ.

    Raises:
        SessionError: they state different units.
    """
    if head.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        head = head.decode("utf-16", "ignore").encode()
    units: list[str] = []
    for line in head.removeprefix(codecs.BOM_UTF8).decode("latin-1").splitlines():
        if line.strip() == "end_header":
            break
        comment = _COMMENT.match(line)
        unit = None if comment is None else unit_in_comment(comment[1])
        units += [unit] if unit is not None and unit not in units else []
    if len(units) > 1:
        raise _refused(path, f"comments that state the units {' and '.join(units)}", "one", "Give the unit: --units")
    return (units[0], "as the file says") if units else (None, "")


def _refused(path: Path, found: str, expected: str, remedy: str) -> SessionError:
    return SessionError(str(path), found=found, expected=expected, remedy=remedy)
