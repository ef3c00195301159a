"""Scans of one visit merged into one mesh, and the registrations stored in a scan's folder."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from mammometry.base.errors import MeasureError
from mammometry.base.notices import Notice
from mammometry.base.value import value
from mammometry.geometry import Array, Float64, Int64, UInt8
from mammometry.io.meshes.foreign import ForeignMesh
from mammometry.io.meshes.own import read_ply

SOURCE = "source"
"""Vertex property of a merged PLY: scans that show the vertex, as bits (`FusedScans.sources`)."""
MOST_ALSO = 4
"""Most further scans of one visit."""
_NUMBERS = ("overlap", "within_mm", "sigma_mm", "scale")
_KEYS = {"sha256", "first_from_this", *_NUMBERS}


@dataclass(frozen=True, slots=True, kw_only=True)
class AlsoScan:
    """A further scan of the visit, and its registration to the first one."""

    sha256: str
    """SHA-256 of its file."""
    overlap: float
    """Share of the smaller scan's skin that both scans show, 0 to 1."""
    within_mm: float
    """95 % of the skin in both scans is within this distance of the first scan, mm."""
    sigma_mm: float
    """Standard uncertainty of one scan relative to the other, along the skin's normal, mm."""
    scale: float
    """Relative difference of lengths: this scan divided by the first one, minus 1."""
    first_from_this: tuple[float, ...]
    """Rigid motion from its frame to the first scan's, mm: the 4 × 4 matrix, row by row."""

    @property
    def words(self) -> str:
        """The registration in one line."""
        longer = round(100 * self.scale, 1) + 0.0
        return (
            f"{100 * self.overlap:.0f} % of its skin is in the first scan too; 95 % of that within "
            f"{self.within_mm:.1f} mm; lengths {longer:+.1f} %; standard uncertainty {self.sigma_mm:.2f} mm"
        )

    def as_table(self) -> dict[str, Any]:
        """The registration as data for scan.toml and ``--json``."""
        return {
            "sha256": self.sha256,
            **{name: round(getattr(self, name), 6) for name in _NUMBERS},
            "first_from_this": [round(number, 9) for number in self.first_from_this],
        }


@value(eq=False)
class MergedScans:
    """Scans of one visit as one mesh."""

    foreign: ForeignMesh
    """The merged mesh, in the first scan's frame and unit."""
    sources: UInt8[Array, " n"]
    """Scans that show each vertex, as bits: 1 the first, 2 the second, 3 both, 4 the third."""
    also: tuple[AlsoScan, ...]
    """The further scans."""

    def sources_at(self, points: Float64[Array, "m 3"]) -> UInt8[Array, " m"]:
        """Values of `sources` at the nearest vertices, for points on or near the merged mesh, mm."""
        return np.asarray(self.sources[_nearest(points, self.foreign.mesh.vertices)])


def sha256_of(path: Path) -> str:
    """SHA-256 of a file, hexadecimal."""
    return hashlib.sha256(path.read_bytes()).hexdigest()


def sigma_mm(also: Sequence[AlsoScan]) -> float:
    """Standard uncertainty due to merging, along the surface's normal, mm. 0 for a single scan."""
    return max((scan.sigma_mm for scan in also), default=0.0)


def merge_scans(
    first: ForeignMesh, others: Sequence[tuple[Path, ForeignMesh]], *, largest: bool = False, of_torso: bool = True
) -> MergedScans:
    """Scans of one visit, registered to the first one and fused.

    Args:
        first: the scan that determines frame and unit.
        others: file and mesh of each further scan.
        of_torso: whether to remove planes, which are lids added by other programs.
        largest: whether to use only the largest piece of each scan, regardless of the size of the others.

    Raises:
        MeasureError: a scan cannot be registered, or is not a surface. It names the file.
    """
    from mammometry.measure.merging.fusion import ColouredMesh, fuse_scans
    from mammometry.measure.merging.registration import fit_scans
    from mammometry.measure.scan_repair import repair_scan
    from mammometry.measure.scanned import check_mesh

    def repaired(scan: ForeignMesh) -> tuple[ColouredMesh, tuple[Notice, ...], bool]:
        made = repair_scan(scan.mesh, largest=largest, skin_alone=of_torso, holes=False)
        check_mesh(made.mesh)
        return (
            ColouredMesh(mesh=made.mesh, colours=scan.colours[_nearest(made.mesh.vertices, scan.mesh.vertices)]),
            made.notices,
            made.inside_out,
        )

    own, of_repair, inside_out = repaired(first)
    remarks = [*first.remarks, *(_of_scan(1, notice) for notice in of_repair if not inside_out)]
    scans, also = [own], []
    for path, foreign in others:
        try:
            scan, own_notices, _ = repaired(foreign)
            fit = fit_scans(own.mesh, scan.mesh)
        except MeasureError as error:
            raise MeasureError(str(path), found=error.found, expected=error.expected, remedy=error.remedy) from None
        scans.append(replace(scan, mesh=scan.mesh.transformed(fit.first_from_second)))
        also.append(
            AlsoScan(
                sha256=sha256_of(path),
                overlap=fit.overlap,
                within_mm=fit.within_mm,
                sigma_mm=fit.sigma_mm,
                scale=fit.scale,
                first_from_this=tuple(fit.first_from_second.matrix.ravel().tolist()),
            )
        )
        number = len(scans)
        remarks += [_of_scan(number, notice) for notice in (*foreign.remarks, *own_notices)]
        values = {
            "number": number,
            "overlap_percent": 100 * fit.overlap,
            "within_mm": fit.within_mm,
            "scale_percent": round(100 * fit.scale, 1) + 0.0,
            "std_mm": fit.sigma_mm,
        }
        remarks.append(Notice(code="scan-merged", level="note", values=values))
        if fit.doubtful:
            remarks.append(Notice(code="scan-fits-badly", level="note", values={"number": number}))
    fused = fuse_scans(scans)
    mesh = fused.mesh.turned_over() if inside_out else fused.mesh  # mirroring is tested later
    merged = replace(first, mesh=mesh, colours=fused.colours, remarks=tuple(remarks))
    return MergedScans(foreign=merged, sources=fused.sources, also=tuple(also))


def _of_scan(number: int, notice: Notice) -> Notice:
    return replace(notice, values={**notice.values, "scan": number})


def stored_sources(path: Path, points: Float64[Array, "m 3"]) -> UInt8[Array, " m"] | None:
    """Scans that show points on an imported, merged mesh, as bits. None if the file does not contain them.

    Args:
        path: the folder's scan.ply.
        points: points on or near its mesh, mm.
    """
    mesh, properties, _ = read_ply(path)
    if SOURCE not in properties or not len(mesh.vertices):
        return None
    return properties[SOURCE][_nearest(points, mesh.vertices)].astype(np.uint8)


def _nearest(points: Float64[Array, "m 3"], vertices: Float64[Array, "n 3"]) -> Int64[Array, " m"]:
    from mammometry.geometry.nearest import point_tree

    return np.asarray(point_tree(vertices).query(points)[1])


def also_text(also: Sequence[AlsoScan]) -> str:
    """The further scans as tables of scan.toml."""
    lines = []
    for scan in also:
        lines += ["", "[[also]]", *(f"{name} = {json.dumps(made)}" for name, made in scan.as_table().items())]
    return "".join(f"{line}\n" for line in lines)


def also_in(tables: object) -> tuple[AlsoScan, ...] | None:
    """The further scans of a scan.toml. None if they are not as documented."""
    if not isinstance(tables, list) or len(tables) > MOST_ALSO:
        return None
    read = [_also_in(table) for table in tables]
    return tuple(scan for scan in read if scan is not None) if None not in read else None


def _also_in(table: object) -> AlsoScan | None:
    if not isinstance(table, Mapping) or set(table) != _KEYS or not isinstance(table["sha256"], str):
        return None
    matrix = table["first_from_this"]
    if not isinstance(matrix, list) or len(matrix) != 16:
        return None
    numbers = [table[name] for name in _NUMBERS]
    if not all(isinstance(n, int | float) and not isinstance(n, bool) and np.isfinite(n) for n in (*numbers, *matrix)):
        return None
    return AlsoScan(
        sha256=table["sha256"],
        first_from_this=tuple(float(n) for n in matrix),
        **{name: float(number) for name, number in zip(_NUMBERS, numbers, strict=True)},
    )
