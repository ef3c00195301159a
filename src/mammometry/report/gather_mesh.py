"""Report of a scanner's mesh, without cameras or photographs."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

from mammometry.base.identity import NAMELESS
from mammometry.base.progress import Progress, no_progress
from mammometry.geometry.camera import Rig
from mammometry.job.graph import Plan
from mammometry.job.inputs import FinishedSurface, SubjectKind
from mammometry.job.stages import measure
from mammometry.job.stages.report import PageInputs
from mammometry.measure.trunk.body import Body
from mammometry.measure.volume.measurement import VolumeMeasurement
from mammometry.report.content import Fact, ReportContent, StageReport
from mammometry.report.figures import stage_results
from mammometry.report.figures.drawing.shading import NAMES, front_of
from mammometry.report.figures.stage_results import MeasureResult
from mammometry.report.models import viewer_scene, with_lengths
from mammometry.report.pictures import all_encoded
from mammometry.report.privacy import Privacy, guard
from mammometry.report.scene import to_json
from mammometry.report.words import describe
from mammometry.report.words.anthropometry import (
    comparison,
    difference_number,
    dimension_tables,
    planning_lengths,
    symmetry_facts,
)
from mammometry.study.tables import thousands

_HUNG_UPWARDS = -0.04
"""Share of half the boundary's height by which both breasts' mass lies above its middle (with the sign of below). 25
virtual bodies had .05 to .6 below it; mounds, which are alike at both ends, have 0."""


@dataclass(frozen=True, slots=True, kw_only=True)
class MeshOrigin:
    """Facts about a mesh that the file's measurements do not tell."""

    kind: SubjectKind
    """A cast or a torso."""
    units: str
    """The file's unit and who says so."""
    world: str
    """What the frame is, one sentence."""
    scanner: str = ""
    """Name of the device. Empty: not given."""
    posture: str = ""
    """How the patient held herself, as was said. Empty: nobody said."""
    notes: tuple[str, ...] = ()
    """What was changed in the mesh, and what was taken for granted, one sentence each."""


def gather_mesh(
    plan: Plan,
    finished: FinishedSurface,
    viewer: Rig,
    page: PageInputs,
    origin: MeshOrigin,
    *,
    privacy: Privacy | None = None,
    progress: Progress = no_progress,
) -> ReportContent:
    """Collect the report of a measured mesh.

    Args:
        plan: of its measurement.
        finished: the mesh, with its colours where it has any.
        viewer: who looks at it in the pictures.
        page: what the report shows beside products, all of it part of the report's key.
        origin: what is known of the mesh beside its shape.
        privacy: what to leave out. None: nothing.
        progress: gets the fraction done.
    """
    measurements = plan.value(measure.measurements) or ()
    marks = plan.value(measure.landmarks) or ()
    sizes = plan.value(measure.dimensions)
    sides = plan.value(measure.symmetry)
    body = plan.value(measure.body)
    less = plan.value(measure.lacking) or ()
    absent = plan.value(measure.absent) or ()
    frame = front_of(viewer, body)
    textured, contains = finished.textured, "the shape of the subject, in the colours of the mesh file"
    if privacy is not None and privacy.guarded:
        places = {mark.name: mark.points_world for mark in marks}
        guarded = guard(textured, privacy, subject_kind=origin.kind, up_world=frame[1], landmarks=places)
        textured, contains = guarded.textured, guarded.contains
        page = replace(page, identity=NAMELESS) if privacy.deidentify else page
    shown = MeasureResult(
        rig=viewer,
        measurements=measurements,
        textured=textured,
        repaired=finished.repaired,
        body=body,
        absent=absent,
        lacking=less,
    )
    pictures = {"measure": stage_results.draw(shown)}
    progress(0.5)
    words = describe.measure_report(measurements)
    lengths, lengths_note = planning_lengths(sizes, marks)
    changed, everything = describe.settings_facts(page.settings)
    scene = viewer_scene(frame, finished.repaired, textured, measurements, symmetry=sides)
    scene = scene if sizes is None else with_lengths(scene, sizes.lengths)
    progress(0.9)
    return ReportContent(
        identity=page.identity,
        created="" if privacy is not None and privacy.deidentify else describe.created_words(None),
        subject=f"{describe.SUBJECTS[origin.kind]}; a mesh of another scanner",
        world=origin.world,
        warnings=(*_warnings(measurements, body), *origin.notes),
        breasts=tuple(
            sorted(
                [
                    *(describe.breast_report(measurement) for measurement in measurements),
                    *(describe.absent_report(side) for side in absent),
                ],
                key=lambda breast: breast.name,
            )
        ),
        comparison=comparison(measurements, absent=absent, lacking=less) + symmetry_facts(sides),
        difference=difference_number(measurements),
        meanings=describe.meanings(measurements),
        lengths=lengths,
        lengths_note=lengths_note,
        stages=(_mesh_facts(finished, origin), replace(words, tables=words.tables + dimension_tables(sizes, marks))),
        timings=(),
        changed_settings=changed,
        all_settings=everything,
        versions=describe.versions(),
        pictures=all_encoded(pictures),
        contains=contains,
        scene=to_json(scene),
    )


def _warnings(measurements: Sequence[VolumeMeasurement], body: Body | None) -> Iterator[str]:
    yield (
        "The mesh comes from another scanner, whose accuracy is not known here. The interval uses the uncertainty of "
        "scale and surface that was entered, or 0.1 % and 0.1 mm."
    )
    sunk = (
        []
        if body is None
        else [measurement.sunk(body.up) for measurement in measurements if measurement.name != "model"]
    )
    if len(sunk) == 2 and sum(sunk) / 2 < _HUNG_UPWARDS:
        yield (
            "The breasts are fuller towards the head than towards the feet. Check that left and right are not "
            "exchanged, and that the head is where it was said to be (--head)."
        )
    for measurement in measurements:
        if not measurement.watertight:
            yield f"The closed solid of the {NAMES[measurement.name]} is not watertight. Do not use its volume."


def _mesh_facts(finished: FinishedSurface, origin: MeshOrigin) -> StageReport:
    mesh = finished.repaired.mesh
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    facts = (
        *([Fact("Scanner", origin.scanner)] if origin.scanner else []),
        *([describe.posture_fact(origin.posture)] if origin.kind == "torso" else []),
        Fact("Unit in the file", origin.units),
        Fact(
            "Mesh",
            f"{thousands(len(mesh.vertices))} vertices, {thousands(len(mesh.faces))} triangles, "
            f"{mesh.area_mm2() / 100:.0f} cm²; edges near the boundary were split, which does not change the shape",
        ),
        Fact("Extent", " × ".join(f"{size:.0f}" for size in high - low) + " mm"),
        Fact("Topology", "watertight" if mesh.is_watertight() else "open"),
    )
    return StageReport(stage="surface", title="Mesh", facts=facts)
