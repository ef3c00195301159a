"""Facts about another scanner's mesh, for the technician's page."""

from __future__ import annotations

from dataclasses import dataclass

from mammometry.base.notices import Notice
from mammometry.geometry import Array, UInt8
from mammometry.job.inputs import FinishedSurface, SubjectKind
from mammometry.report.content import Fact, StageReport
from mammometry.report.words import describe
from mammometry.study.tables import thousands


@dataclass(frozen=True, slots=True, kw_only=True)
class MeshOrigin:
    """Facts about a mesh that are not in its measurements."""

    kind: SubjectKind
    """A cast or a torso."""
    units: str
    """The file's unit, and where it was stated."""
    world: str
    """Definition of the frame, in one sentence."""
    scanner: str = ""
    """Name of the device. Empty: not stated."""
    posture: str = ""
    """The patient's posture. Empty if unknown."""
    notices: tuple[Notice, ...] = ()
    """Changes to the mesh, and assumptions."""
    sides_doubtful: bool = False
    """Whether left and right may be swapped. The notices have the reason."""
    sources: UInt8[Array, " n"] | None = None
    """Scans that show each vertex, as bits, if several were merged."""
    also: tuple[str, ...] = ()
    """Alignment of each further scan with the first one, one line each."""


def mesh_facts(finished: FinishedSurface, origin: MeshOrigin) -> StageReport:
    """Facts about a mesh for the technician's page."""
    mesh = finished.repaired.mesh
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    facts = (
        *([Fact("Scanner", origin.scanner)] if origin.scanner else []),
        *([describe.posture_fact(origin.posture)] if origin.kind == "torso" else []),
        Fact("Unit in the file", origin.units),
        *(Fact(f"Merged scan {number}", words) for number, words in enumerate(origin.also, 2)),
        Fact(
            "Mesh",
            f"{thousands(len(mesh.vertices))} vertices, {thousands(len(mesh.faces))} triangles, "
            f"{mesh.area_mm2() / 100:.0f} cm²; edges near the boundary were split, which does not change the shape",
        ),
        Fact("Extent", " × ".join(f"{size:.0f}" for size in high - low) + " mm"),
        Fact("Topology", "watertight" if mesh.is_watertight() else "open"),
    )
    return StageReport(stage="surface", title="Mesh", facts=facts)
