"""Imported scans as folders: the mesh in mm, its colours or textures, and the scanner's name and unit.

An OBJ is stored with its material file and pictures. Their names are replaced, because they may contain a patient's
name.
"""

from __future__ import annotations

import io
import json
import re
import tempfile
import unicodedata
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path, PurePosixPath
from types import MappingProxyType
from typing import Any

import numpy as np
from PIL import Image

from mammometry.base.errors import MeasureError, SessionError
from mammometry.base.identity import subject_id
from mammometry.base.notices import Notice, words_of
from mammometry.base.notices.words import maybe_words
from mammometry.base.parse import LimitSettings, read_bytes, read_text, toml_table
from mammometry.base.units import mm_of_unit
from mammometry.geometry import Array, Float64, TriangleMesh, UInt8
from mammometry.geometry.mesh_files.in_child import read_in_child
from mammometry.geometry.mesh_files.obj import parse_obj
from mammometry.geometry.mesh_files.ply import write_ply
from mammometry.io.meshes.foreign import ForeignMesh, read_foreign
from mammometry.io.meshes.merged import SOURCE, AlsoScan, also_in, also_text, merge_scans, sha256_of
from mammometry.io.meshes.own import read_ply
from mammometry.io.meshes.textures import CoveredObj, covered_parts, parse_covered_obj, texture_at
from mammometry.io.photographs.images import read_photograph, read_plain_picture
from mammometry.io.photographs.tags import without_tags
from mammometry.io.write import write_text
from mammometry.measure.settings import POSTURES

ABOUT, MESH = "scan.toml", "scan.ply"
RESULTS = "results"
"""Folder of a scan's results in its folder."""
OBJ, MTL = "scan.obj", "scan.mtl"
MOST_PICTURES = 16
"""Most pictures of a mesh. Scanners with several views write one picture per view, at most six so far."""
FILES = (ABOUT, MESH, OBJ, MTL, *(f"texture-{n}.{end}" for n in range(1, MOST_PICTURES + 1) for end in ("jpg", "png")))
"""All possible files of a scan's folder."""
AXES = ("y", "-y", "z", "-z", "x", "-x")
"""Axes of a file, one of which points to the head."""
_MOST_MTL_MIB = 1  # largest material file; real ones have a few hundred bytes
_MOST_OBJ_MIB = 1024  # largest OBJ
_ON_SKIN_MM = 1.0  # largest distance from the scanner's surface; seams are joined within 0.05 mm
_SAME_AREA = 1e-3  # largest relative difference of the written area: faces without area are removed
_LONGEST = 100  # most characters of a scanner's name
_KEYS = {"format", "scanner", "units", "head", "ahead", "subject", "posture", "sha256", "sides", "notices", "remarks",
    "also",
}  # fmt: skip
_CHECKED = "checked"
_MAP_OPTION = re.compile(r"-(?:blendu|blendv|cc|clamp|texres|bm|boost|type|imfchan|mm|o|s|t)(?=\s)", re.IGNORECASE)
"""Option before the name of a map's picture (specification of OBJ, "Texture map statements")."""
_OPTION_VALUE = re.compile(r"\s+(?:on|off|[-+]?[0-9.]+)(?=\s)")
_JPEG_MARK, _BMP_MARK = b"\xff\xd8", b"BM"
_MARK_BYTES = 4  # length of the longest mark


@dataclass(frozen=True, slots=True, kw_only=True)
class ScanFacts:
    """Metadata of a scan."""

    scanner: str
    """Name of the device, as entered."""
    units: str
    """Unit of the scanner's own file, and its source. The folder's mesh is in mm."""
    head: str = ""
    """The file's axis towards the head. Empty: unknown."""
    ahead: str = ""
    """The axis straight ahead. Empty: the direction in which an open mesh faces."""
    subject: str | None = None
    """Pseudonym. None: not given."""
    posture: str = ""
    """``standing``, ``leaning`` or ``lying``. Empty: unknown."""
    sha256: str = ""
    """SHA-256 of the scanner's own mesh file."""
    sides: str = ""
    """``checked``: a person confirmed that left and right are the patient's. Empty: not checked."""
    notices: tuple[Notice, ...] = ()
    """Notices about what was omitted or assumed when the scanner's file was read."""
    also: tuple[AlsoScan, ...] = ()
    """Further scans of the visit, merged into the folder's mesh."""


def import_scan(
    mesh: Path,
    about: ScanFacts,
    *,
    units: str | None = None,
    texture: bool = True,
    limits: LimitSettings = LimitSettings(),
    also: Sequence[Path] = (),
) -> dict[str, bytes]:
    """Files of a scan's folder (name → content), from a scanner's files.

    Args:
        mesh: OBJ, PLY, STL, GLB or USDZ. The material file and the pictures of an OBJ are in the same folder.
        about: metadata; unit and digest are set here.
        units: ``mm``, ``cm`` or ``m``. None if the file states it.
        texture: whether to import the pictures of an OBJ, a GLB or a USDZ.
        limits: largest size of a picture.
        also: further scans of the same visit and posture, which are merged with the first. The merged mesh has the
            pictures' colours at its vertices, and no pictures.

    Raises:
        SessionError: a file is missing or unreadable, the unit is unknown, or the scanner has no name.
        ImageError: a picture cannot be read or is too large.
        MeasureError: the mesh cannot be measured, or a further scan cannot be registered to it.
    """
    _check(about)
    files, foreign = _read(mesh, units, limits, texture=texture)
    if also:
        others = [(path, _read(path, units, limits, texture=texture)[1]) for path in also]
        merged = merge_scans(foreign, others)
        foreign, about = merged.foreign, replace(about, also=merged.also)
        files = {MESH: _ply(foreign, {SOURCE: merged.sources})}
    _check_written(mesh, files, foreign)
    about = replace(about, units=foreign.units, sha256=sha256_of(mesh), notices=foreign.notices)
    files[ABOUT] = scan_text(about).encode()
    return files


def _read(
    mesh: Path, units: str | None, limits: LimitSettings, *, texture: bool
) -> tuple[dict[str, bytes], ForeignMesh]:
    """Files of a folder from a scanner's files, and the mesh with the colours of its pictures."""
    foreign = read_foreign(mesh, units, of_torso=True)
    files: dict[str, bytes] = {}
    with tempfile.TemporaryDirectory(prefix="mammometry-") as folder:
        source: Path | None = mesh
        if mesh.suffix.lower() in (".glb", ".usdz"):
            source = covered_parts(mesh, Path(folder), limits) if texture else None
        covered = None
        if source is not None and source.suffix.lower() == ".obj":
            covered = read_in_child(parse_covered_obj, source) if source is mesh else parse_covered_obj(source)
        if source is not None and covered is not None and texture and covered.libraries:
            files, colours = _covered(source, covered, foreign, limits)
            foreign = replace(foreign, colours=colours)
        elif covered is not None:
            files[OBJ] = covered.text(None).encode()
    files[MESH] = _ply(foreign)
    return files, foreign


def scan_text(scan: ScanFacts) -> str:
    """Content of scan.toml."""
    made = {
        "format": 1, "scanner": scan.scanner.strip(), "units": scan.units, "head": scan.head, "ahead": scan.ahead,
        **({} if scan.subject is None else {"subject": scan.subject}),
        **{name: value for name in ("posture", "sha256", "sides") if (value := getattr(scan, name))},
    }  # fmt: skip
    lines = [f"{name} = {json.dumps(value, ensure_ascii=False)}" for name, value in made.items()]
    for notice in scan.notices:
        values = ", ".join(f"{name} = {json.dumps(value, ensure_ascii=False)}" for name, value in notice.values.items())
        lines += ["", "[[notices]]", f'code = "{notice.code}"', f"values = {{ {values} }}"]
    return "# A scan of another device. scan.ply is in mm.\n" + "\n".join(lines) + "\n" + also_text(scan.also)


def _check_written(mesh: Path, files: Mapping[str, bytes], foreign: ForeignMesh) -> None:
    """Read the written files and check them in the same way as a measurement.

    Raises:
        SessionError: the files contain another surface than the one that was read.
        MeasureError: the surface cannot be measured.
    """
    # Imported here, so that sessions can be opened without importing algorithms.
    from mammometry.measure.scan_repair import repair_scan
    from mammometry.measure.scanned import check_mesh

    try:
        check_mesh(repair_scan(foreign.mesh).mesh)
    except MeasureError as error:
        raise error.of_mesh().with_remark(maybe_words(foreign.assumed)) from None
    with tempfile.TemporaryDirectory(prefix="mammometry-") as folder:
        path = Path(folder) / MESH
        path.write_bytes(files[MESH])
        surfaces = [read_ply(path)[0]]
    if OBJ in files:
        obj = parse_obj(files[OBJ], OBJ)
        surfaces.append(TriangleMesh(vertices=obj.points * foreign.mm_per_unit, faces=obj.faces.astype(np.int32)))
    expected_mm2 = foreign.mesh.area_mm2()
    for surface in surfaces:
        if abs(surface.area_mm2() - expected_mm2) > _SAME_AREA * expected_mm2:
            raise _refused(
                mesh, f"{surface.area_mm2() / 100:.1f} cm² in the imported files",
                f"{expected_mm2 / 100:.1f} cm², as in the scanner's file", "Export it as PLY and import that",
            )  # fmt: skip


def skin_colours(
    folder: Path, scan: ScanFacts, points_mm: Float64[Array, "n 3"], otherwise: UInt8[Array, "n 3"]
) -> UInt8[Array, "n 3"]:
    """Colours of a scan's pictures at points of its skin, more detailed than those of its vertices.

    Args:
        folder: folder of the scan.
        scan: metadata of the scan.
        points_mm: points on its mesh, mm.
        otherwise: colours of points without a picture.
    """
    factor = mm_of_unit(scan.units.partition(",")[0])
    if factor is None or not (folder / OBJ).is_file() or not (folder / MTL).is_file():
        return otherwise
    names = {material: name for material, name in _materials(folder / MTL).items() if (folder / name).is_file()}
    pictures = {material: _texture(folder / name, name, LimitSettings()) for material, name in names.items()}
    obj = parse_obj(read_bytes(folder / OBJ, OBJ, "an OBJ", most_mib=_MOST_OBJ_MIB), OBJ)
    if not len(obj.uv) or not len(obj.faces):
        return otherwise
    return texture_at(obj, pictures, points_mm / factor, otherwise, _ON_SKIN_MM / factor)


def is_scan(folder: Path) -> bool:
    """Whether a folder is that of a scan."""
    return (folder / ABOUT).is_file() and (folder / MESH).is_file()


def read_scan(folder: Path) -> ScanFacts:
    """Read the metadata in a scan's folder.

    Raises:
        SessionError: scan.toml is missing or not as documented.
    """
    path = folder / ABOUT
    table = toml_table(read_text(path, ABOUT, "a scan's description"), ABOUT, "a scan's description")
    unknown = sorted(set(table) - _KEYS)
    if unknown or table.get("format") != 1 or not all(isinstance(table.get(k), str) for k in ("scanner", "units")):
        raise SessionError(
            str(path), found=f"the key {unknown[0]!r}" if unknown else "no format, scanner or units",
            expected=f"format = 1, scanner, units and {', '.join(sorted(_KEYS - {'format', 'scanner', 'units'}))}",
            remedy="Import the mesh again: mammometry import mesh",
        )  # fmt: skip
    read = {name: value for name, value in table.items() if name != "format" and isinstance(value, str)}
    also = also_in(table.get("also", []))
    if also is None:
        raise SessionError(
            str(path), found="invalid tables under also", expected="a table for each further scan, as import writes it",
            remedy="Import the meshes again: mammometry import mesh --also",
        )  # fmt: skip
    made = ScanFacts(**read, notices=tuple(_notices_in(table)), also=also)
    _check(made)
    return made


def _notices_in(table: Mapping[str, Any]) -> Iterator[Notice]:
    """Notices in scan.toml. In version 1.0, they were sentences under ``remarks``."""
    notices, remarks = table.get("notices"), table.get("remarks")
    for stored in notices if isinstance(notices, list) else ():
        with suppress(AttributeError, KeyError, TypeError, ValueError):  # edited by hand, or from a later version
            notice = Notice(code=stored["code"], level="note", values=stored.get("values", {}))
            words_of(notice)
            yield notice
    for words in remarks if isinstance(remarks, list) else ():
        yield Notice(code="sentence", level="note", values={"text": str(words)})


def confirm_sides(folder: Path) -> None:
    """Record in a scan's folder that left and right of its mesh are confirmed to be the patient's.

    Raises:
        SessionError: scan.toml is missing or not as documented.
        StorageError: it cannot be written.
    """
    write_text(folder / ABOUT, scan_text(replace(read_scan(folder), sides=_CHECKED)))


def _check(about: ScanFacts) -> None:
    name = about.scanner.strip()
    if not name or len(name) > _LONGEST or not name.isprintable():
        raise SessionError(
            "the scanner's name", found=f"{about.scanner[:_LONGEST]!r}", expected=f"1 to {_LONGEST} letters",
            remedy="Give the device's name, such as --scanner 'Vectra M5'",
        )  # fmt: skip
    try:
        if about.subject is not None:
            subject_id(about.subject)
    except ValueError as error:
        raise SessionError(
            "the scan's subject", found=f"{about.subject!r:.40}", expected=str(error), remedy="Correct --id"
        ) from None  # fmt: skip
    if about.posture not in ("", *POSTURES):
        remedy = "Correct --posture"
        expected = f"one of {', '.join(POSTURES)}"
        raise SessionError("the scan's posture", found=f"{about.posture[:20]!r}", expected=expected, remedy=remedy)
    if about.sides not in ("", _CHECKED):
        expected, remedy = f"{_CHECKED!r}, or nothing", "Correct sides"
        raise SessionError("the scan's sides", found=f"{about.sides[:20]!r}", expected=expected, remedy=remedy)
    for axis, given in (("head", about.head), ("ahead", about.ahead)):
        if given not in ("", *AXES):
            raise SessionError(
                f"the axis {'towards the head' if axis == 'head' else 'straight ahead'}", found=f"{given[:20]!r}",
                expected=f"one of {', '.join(AXES)}", remedy=f"Correct --{axis}",
            )  # fmt: skip


def _covered(
    mesh: Path, covered: CoveredObj, foreign: ForeignMesh, limits: LimitSettings
) -> tuple[dict[str, bytes], UInt8[Array, "n 3"]]:
    """Files of the textured surface with neutral names, and a colour for each vertex."""
    from scipy.spatial import cKDTree

    materials: dict[str, str] = {}
    for path in _libraries(mesh, covered.libraries):
        materials = _materials(path) | materials
    names = sorted({picture for picture in materials.values() if picture})
    if len(names) > MOST_PICTURES:
        raise _refused(mesh, f"{len(names)} pictures", f"{MOST_PICTURES} at most", "Export the scan with fewer")
    files: dict[str, bytes] = {}
    kept: dict[str, str] = {}
    pixels: dict[str, UInt8[Array, "h w 3"]] = {}
    for number, name in enumerate(names, 1):
        path = _beside(mesh, name, "picture")
        pixels[name] = _texture(path, f"the picture of {mesh.name}", limits)
        content = path.read_bytes()
        jpeg = without_tags(content) if content.startswith(_JPEG_MARK) else None
        kept[name] = f"texture-{number}.{'png' if jpeg is None else 'jpg'}"
        files[kept[name]] = _png(pixels[name]) if jpeg is None else jpeg.content  # without dates, places and names
    lines = []
    for number, material in enumerate(covered.materials, 1):
        picture = materials.get(material, "")
        lines += [f"newmtl m{number}", "Kd 1 1 1", *([f"map_Kd {kept[picture]}"] if picture else [])]
    files[MTL] = ("\n".join(lines) + "\n").encode()
    files[OBJ] = covered.text(MTL).encode()
    shown = {material: pixels[name] for material, name in materials.items() if name}
    points, colours = covered.colours(shown)
    nearest = cKDTree(points * foreign.mm_per_unit).query(foreign.mesh.vertices)[1]
    return files, np.ascontiguousarray(colours[nearest])


def _libraries(mesh: Path, lines: tuple[str, ...]) -> list[Path]:
    """Material files of an OBJ. A line names one file, or several separated by spaces."""
    paths = []
    for line in lines:
        whole = _found_beside(mesh, line)
        paths += [whole] if whole is not None else [_beside(mesh, name, "material file") for name in line.split()]
    return list(dict.fromkeys(paths))


def _materials(path: Path) -> dict[str, str]:
    """Material → file name of its picture. Empty for a plain colour."""
    content = read_bytes(path, path.name, "a material file", most_mib=_MOST_MTL_MIB)
    pictures: dict[str, str] = {}
    current = ""
    for line in re.split("\r\n|\r|\n", content.decode("utf-8-sig", "surrogateescape")):
        word, _, rest = line.strip().replace("\t", " ").partition(" ")
        if word == "newmtl":
            current = rest.strip()
            pictures.setdefault(current, "")
        elif word.lower() == "map_kd" and current in pictures:
            pictures[current] = _picture(rest)
    if not pictures:
        raise _refused(path, "no materials", "a material file (MTL)", "Export the scan again as OBJ with its texture")
    return pictures


def _picture(rest: str) -> str:
    """File name after the options of a map, such as ``-s 1 1 1 skin.jpg``."""
    rest = rest.strip()
    while option := _MAP_OPTION.match(rest):
        at = option.end()
        while value := _OPTION_VALUE.match(rest, at):
            at = value.end()
        rest = rest[at:].strip()
    return rest


def _beside(mesh: Path, name: str, what: str) -> Path:
    path = _found_beside(mesh, name)
    if path is not None:
        return path
    plain = _plain_name(name)
    raise _refused(
        mesh, f"no {what} {plain[:80]!r} beside it, which it needs", "OBJ, MTL and picture together",
        "Add it, or import the mesh without its texture",
    )  # fmt: skip


def _found_beside(mesh: Path, name: str) -> Path | None:
    """File with this name in the mesh's folder, or None.

    Folders in the name, and the case of letters, are ignored. If a name is not UTF-8, code page 1252 is tried, too.
    """
    plain = _plain_name(name)
    wanted = {_compared(plain), _compared(plain.encode("utf-8", "surrogateescape").decode("cp1252", "replace"))}
    for path in sorted(mesh.parent.iterdir()):
        if plain and _compared(path.name) in wanted and path.is_file():
            return path
    return None


def _plain_name(name: str) -> str:
    return PurePosixPath(name.replace("\\", "/")).name


def _compared(name: str) -> str:
    return unicodedata.normalize("NFC", name).casefold()


def _texture(path: Path, name: str, limits: LimitSettings) -> UInt8[Array, "h w 3"]:
    """Pixels of a picture as stored: texture coordinates ignore its orientation tag.

    Raises:
        ImageError: it cannot be read or is too large.
    """
    with path.open("rb") as file:
        head = file.read(_MARK_BYTES)
    if head.startswith(_BMP_MARK) or path.suffix.lower() == ".tga":
        return read_plain_picture(path, name, ("BMP", "TGA"), limits)
    pixels = read_photograph(path, name, limits, as_stored=True).pixels
    if pixels.dtype == np.uint16:
        pixels = (pixels >> 8).astype(np.uint8)
    return np.repeat(pixels[..., None], 3, axis=2) if pixels.ndim == 2 else pixels


def _png(pixels: UInt8[Array, "h w 3"]) -> bytes:
    buffer = io.BytesIO()
    Image.fromarray(pixels).save(buffer, "PNG")
    return buffer.getvalue()


def _ply(foreign: ForeignMesh, others: Mapping[str, Array] = MappingProxyType({})) -> bytes:
    properties: Mapping[str, Any] = {
        **{name: np.ascontiguousarray(foreign.colours[:, k]) for k, name in enumerate(("red", "green", "blue"))},
        **others,
    }
    with tempfile.TemporaryDirectory(prefix="mammometry-") as folder:
        path = Path(folder) / MESH
        write_ply(path, foreign.mesh, properties, comments=("units: mm",))
        return path.read_bytes()


def _refused(path: Path, found: str, expected: str, remedy: str) -> SessionError:
    return SessionError(path.name, found=found, expected=expected, remedy=remedy)
