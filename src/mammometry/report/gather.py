"""Collect the report of a session, or of another scanner's mesh, stage by stage to save memory."""

from collections.abc import Callable, Mapping
from dataclasses import fields, replace
from datetime import datetime

from mammometry.base.identity import NAMELESS
from mammometry.base.progress import Progress, no_progress
from mammometry.calibration.judge.quality import assess
from mammometry.geometry import Array, UInt8
from mammometry.geometry.camera import Rig
from mammometry.job.graph import Plan
from mammometry.job.inputs import Inputs
from mammometry.job.products import Stage
from mammometry.job.stages import calibrate, measure, surface
from mammometry.job.stages.report import PageInputs
from mammometry.measure.volume.measurement import VolumeMeasurement
from mammometry.report import content
from mammometry.report.content import ReportContent, ReportPicture
from mammometry.report.figures import stage_results
from mammometry.report.figures.shading import front_of
from mammometry.report.figures.stage_results import MeasureResult, draw_stage
from mammometry.report.models import viewer_scene, with_lengths
from mammometry.report.pictures import all_encoded
from mammometry.report.privacy import Privacy, guard, without_photographs
from mammometry.report.scene import ViewerScene, to_json
from mammometry.report.warnings import (
    RunResults,
    photograph_doubts,
    run_concerns,
    scan_warnings,
    volume_doubts,
    warnings,
)
from mammometry.report.words import describe
from mammometry.report.words.anthropometry import (
    comparison,
    difference_number,
    dimension_tables,
    planning_lengths,
    symmetry_facts,
)
from mammometry.report.words.doubts import body_doubts
from mammometry.report.words.mesh_facts import MeshOrigin, mesh_facts
from mammometry.report.words.stage_facts import DrawnStages, MatchingFacts, matching_facts, surface_facts
from mammometry.surface.texture.texture import TexturedMesh

_COLOURED: tuple[Stage, ...] = ("surface", "measure")  # stages whose pictures show the surface in colour


def gather(
    plan: Plan,
    inputs: Inputs,
    page: PageInputs,
    shown: DrawnStages,
    *,
    created: datetime | None = None,
    privacy: Privacy = Privacy(),
    progress: Progress = no_progress,
) -> ReportContent:
    """Content of the report of a session. Missing products are computed.

    plan: the complete plan.
        inputs: inputs of the session; photographs are read one at a time.
        page: content that does not come from products. All of it affects the report's key.
        page: content other than products, all of it part of the report's key.
        shown: previews and their facts. Missing ones are made here. Previews of the surface are drawn again if colours
            are left out.
        created: time of the report. None: now.
        privacy: what to leave out.
        progress: called with the fraction done.
    """
    settings = page.settings
    page = replace(page, identity=NAMELESS) if privacy.deidentify else page
    cameras = plan[calibrate.cameras]()
    rig = cameras.rig
    calibration = plan.value(calibrate.calibration)
    quality = None if calibration is None else assess(calibration, settings.calibration.quality)
    stages = [describe.calibration_report(rig, calibration, quality)]
    progress(0.2)

    pictures = shown.pictures
    matched = shown.facts.get("match")
    if not isinstance(matched, MatchingFacts):
        matched = matching_facts(plan, rig)
    stages.append(describe.matching_report(matched.foregrounds, matched.quality, matched.shares))
    progress(0.4)

    finished = plan[surface.mesh]()
    measurements = plan.value(measure.measurements) or ()
    body = plan.value(measure.body)
    frame = front_of(rig, body)
    guarded = guard(
        finished.textured, privacy, subject_kind=inputs.subject_kind, up_world=frame[1], landmarks=inputs.landmarks
    )
    textured = guarded.textured
    if privacy.guarded:
        redrawn: dict[str, dict[str, bytes]] = {stage: draw_stage(stage, plan, inputs, textured) for stage in _COLOURED}
        pictures = without_photographs({**pictures, **redrawn})
    surfaced = shown.facts.get("surface")
    stages.append(surfaced if isinstance(surfaced, content.StageReport) else surface_facts(plan))
    progress(0.7)

    sides = plan.value(measure.symmetry)
    absent = plan.value(measure.absent) or ()
    less = plan.value(measure.lacking) or ()
    marks = plan.value(measure.landmarks) or ()
    sizes = None
    if measurements:
        sizes = plan.value(measure.dimensions)
        measured_words = describe.measure_report(measurements)
        if page.posture:
            facts = (describe.posture_fact(page.posture), *measured_words.facts)
            measured_words = replace(measured_words, facts=facts)
        stages.append(replace(measured_words, tables=measured_words.tables + dimension_tables(sizes, marks)))
    lengths, lengths_note = planning_lengths(sizes, marks)
    progress(0.9)

    known = volume_doubts(plan, settings.measure)
    run = RunResults(
        quality=quality,
        calibration=calibration,
        camera_doubts=cameras.notices,
        shares=matched.shares,
        matching=matched.quality,
        foregrounds=matched.foregrounds,
        repaired=finished.repaired,
        blocked=plan[surface.occlusions](),
        **{member.name: getattr(known, member.name) for member in fields(known)},
        walk=inputs.walk,
        walk_motion=plan.value(surface.walk_motion),
    )
    breasts = [describe.breast_report(measured, finished.repaired) for measured in measurements]
    breasts += [describe.absent_report(side) for side in absent]
    changed, everything = describe.settings_facts(settings)
    return ReportContent(
        identity=page.identity,
        key=page.key(plan.products()).digest,
        created="" if privacy.deidentify else describe.created_words(created),
        subject=describe.SUBJECTS[inputs.subject_kind],
        world=plan[calibrate.cameras]().world,
        warnings=(*body_doubts(plan), *warnings(run)),
        concerns=tuple(run_concerns(run)),
        calibration_doubts=photograph_doubts(quality),
        breasts=tuple(sorted(breasts, key=lambda breast: breast.name)),
        comparison=comparison(measurements, absent=absent, lacking=less) + symmetry_facts(sides),
        difference=difference_number(measurements),
        meanings=describe.meanings(measurements),
        lengths=lengths,
        lengths_note=lengths_note,
        stages=tuple(stages),
        timings=describe.timings(page.stage_seconds),
        changed_settings=changed,
        all_settings=everything,
        versions=describe.versions(),
        pictures=all_encoded(pictures),
        contains=guarded.contains,
        scene=to_json(shown.scene or _scene(plan, measurements, textured)),
    )


def whole_scene(plan: Plan) -> ViewerScene:
    """Scene of a session's own report in the 3D viewer.

    Nothing is left out. Previews are not needed. Missing products are computed.
    """
    return _scene(plan, plan.value(measure.measurements) or (), plan[surface.mesh]().textured)


def _scene(plan: Plan, measurements: tuple[VolumeMeasurement, ...], textured: TexturedMesh) -> ViewerScene:
    finished = plan[surface.mesh]()
    body = plan.value(measure.body)
    scene = viewer_scene(
        front_of(plan[calibrate.cameras]().rig, body),
        finished.repaired,
        textured,
        measurements,
        symmetry=plan.value(measure.symmetry),
        # If colours are left out, the photographs are left out, too.
        atlas=plan[surface.model]() if textured is finished.textured else None,
    )
    sizes = plan.value(measure.dimensions) if measurements else None
    return scene if sizes is None else with_lengths(scene, sizes.lengths)


def gather_mesh(
    plan: Plan,
    viewer: Rig,
    page: PageInputs,
    origin: MeshOrigin,
    *,
    drawn: Callable[[], Mapping[str, ReportPicture]] | None = None,
    privacy: Privacy | None = None,
    progress: Progress = no_progress,
) -> ReportContent:
    """Collect the report of a measured mesh.

    Args:
        plan: plan of its measurement.
        viewer: camera of the pictures.
        page: content that does not come from products. All of it affects the report's key.
        origin: facts about the mesh, apart from its shape.
        drawn: waits for pictures, in all colours, that another process draws.
        privacy: what to leave out. None: nothing.
        progress: called with the fraction done.
    """
    finished = plan[surface.mesh]()
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
    words = describe.measure_report(measurements)
    lengths, lengths_note = planning_lengths(sizes, marks)
    changed, everything = describe.settings_facts(page.settings)
    scene = viewer_scene(frame, finished.repaired, textured, measurements, symmetry=sides)
    scene = scene if sizes is None else with_lengths(scene, sizes.lengths)
    packed = to_json(scene)
    progress(0.5)
    pictures = drawn_mesh(mesh_result(plan, viewer, textured, origin.sources)) if drawn is None else drawn()
    progress(0.9)
    return ReportContent(
        identity=page.identity,
        created="" if privacy is not None and privacy.deidentify else describe.created_words(None),
        subject=f"{describe.SUBJECTS[origin.kind]}; a mesh of another scanner",
        world=origin.world,
        warnings=(
            *scan_warnings(plan, origin.notices),
            *(notice for notice in origin.notices if notice.level == "note"),
        ),
        breasts=tuple(
            sorted(
                [
                    *map(describe.breast_report, measurements),
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
        stages=(mesh_facts(finished, origin), replace(words, tables=words.tables + dimension_tables(sizes, marks))),
        timings=(),
        changed_settings=changed,
        all_settings=everything,
        versions=describe.versions(),
        pictures={"measure": pictures},
        contains=contains,
        scene=packed,
    )


def mesh_result(
    plan: Plan, viewer: Rig, textured: TexturedMesh, sources: UInt8[Array, " n"] | None = None
) -> MeasureResult:
    """Result from which the pictures of a measured mesh are drawn.

    Args:
        plan: plan of its measurement.
        viewer: camera of the pictures.
        textured: the mesh in the colours to be shown.
        sources: scans that show each vertex, as bits, if several were merged.
    """
    return MeasureResult(
        rig=viewer,
        measurements=plan.value(measure.measurements) or (),
        textured=textured,
        repaired=plan[surface.mesh]().repaired,
        symmetry=plan.value(measure.symmetry),
        body=plan.value(measure.body),
        absent=plan.value(measure.absent) or (),
        lacking=plan.value(measure.lacking) or (),
        sources=sources,
    )


def drawn_mesh(result: MeasureResult) -> Mapping[str, ReportPicture]:
    """Pictures of a measured mesh."""
    return all_encoded({"measure": stage_results.draw(result)})["measure"]
