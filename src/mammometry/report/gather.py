"""Collect the report from the job's plan, stage by stage. Stage by stage, little is held in memory."""

from __future__ import annotations

from dataclasses import replace
from datetime import datetime

from mammometry.base.identity import NAMELESS
from mammometry.base.progress import Progress, no_progress
from mammometry.calibration.judge.quality import assess
from mammometry.job.graph import Plan
from mammometry.job.inputs import Inputs
from mammometry.job.products import Stage
from mammometry.job.stages import calibrate, match, measure, surface
from mammometry.job.stages.report import PageInputs
from mammometry.measure.volume.measurement import VolumeMeasurement
from mammometry.report import content
from mammometry.report.content import ReportContent
from mammometry.report.figures.drawing.shading import front_of
from mammometry.report.figures.previews import draw_stage
from mammometry.report.models import viewer_scene, with_lengths
from mammometry.report.pictures import all_encoded
from mammometry.report.privacy import Privacy, guard, without_photographs
from mammometry.report.scene import ViewerScene, to_json
from mammometry.report.words import describe
from mammometry.report.words.anthropometry import (
    comparison,
    difference_number,
    dimension_tables,
    planning_lengths,
    symmetry_facts,
    without_nipple,
)
from mammometry.report.words.stage_facts import MatchingFacts, Shown, matching_facts, surface_facts
from mammometry.report.words.warnings import RunResults, run_cautions, run_concerns, warnings
from mammometry.surface.motion.motion_messages import concerns
from mammometry.surface.texture.texture import TexturedMesh

_COLOURED: tuple[Stage, ...] = ("surface", "measure")  # stages whose pictures show the surface in its colours


def gather(
    plan: Plan,
    inputs: Inputs,
    page: PageInputs,
    shown: Shown,
    *,
    created: datetime | None = None,
    privacy: Privacy = Privacy(),
    progress: Progress = no_progress,
) -> ReportContent:
    """Collect the report of a session. Products that are missing are made.

    Args:
        plan: the whole job.
        inputs: what the session brought; photographs are read one at a time.
        page: what the report shows beside products. All of it is part of the report's key.
        shown: previews, and what was found with them; the rest is found here. Previews of the surface are drawn again
            where colours are left out.
        created: moment of the report; now by default.
        privacy: what to leave out.
        progress: gets the fraction done.
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
        finished.textured,
        privacy,
        subject_kind=inputs.subject_kind,
        up_world=frame[1],
        landmarks=inputs.landmarks,
    )
    textured = guarded.textured
    if privacy.guarded:
        redrawn: dict[str, dict[str, bytes]] = {stage: draw_stage(stage, plan, inputs, textured) for stage in _COLOURED}
        pictures = without_photographs({**pictures, **redrawn})
    stillness = plan[surface.stillness]()
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

    run = RunResults(
        quality=quality,
        calibration=calibration,
        camera_doubts=cameras.reasons,
        shares=matched.shares,
        matching=matched.quality,
        foregrounds=matched.foregrounds,
        measurements=measurements,
        repaired=finished.repaired,
        blocked=plan[surface.occlusions](),
        moved=tuple(concerns(stillness)),
        absent=absent,
        body=body,
        doubtful=without_nipple(measurements, marks, settings.measure),
        unseparated={} if (subjects := plan.value(match.subjects)) is None else subjects.doubts,
    )
    beside = tuple(run_cautions(run))
    breasts = [describe.breast_report(measured, finished.repaired, beside) for measured in measurements]
    breasts += [describe.absent_report(side) for side in absent]
    changed, everything = describe.settings_facts(settings)
    return ReportContent(
        identity=page.identity,
        key=page.key(plan.products()).digest,
        created="" if privacy.deidentify else describe.created_words(created),
        subject=describe.SUBJECTS[inputs.subject_kind],
        world=plan[calibrate.cameras]().world,
        warnings=tuple(warnings(run)),
        concerns=tuple(run_concerns(run)),
        breasts=tuple(sorted(breasts, key=lambda breast: breast.name)),
        comparison=comparison(measurements, settings.measure, absent=absent, lacking=less) + symmetry_facts(sides),
        difference=difference_number(measurements, settings.measure),
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
    """What the 3D viewer of a session's own report shows.

    Nothing is left out. It needs no previews. Products that are missing are made.
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
        # Where colours are left out, so are the photographs themselves.
        atlas=plan[surface.model]() if textured is finished.textured else None,
    )
    sizes = plan.value(measure.dimensions) if measurements else None
    return scene if sizes is None else with_lengths(scene, sizes.lengths)
