"""Collect the report of a session's job, or of a scanner's mesh, stage by stage.

So little is held in memory.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import datetime

import numpy as np

from mammometry.base.identity import NAMELESS
from mammometry.base.notices import Notice
from mammometry.base.progress import Progress, no_progress
from mammometry.base.sizes import subject_extent
from mammometry.calibration.adjust.calibrated import Calibration
from mammometry.calibration.judge.quality import CalibrationQuality, assess
from mammometry.geometry import Array, UInt8
from mammometry.geometry.camera import Rig
from mammometry.job.graph import Plan
from mammometry.job.inputs import Inputs, Walk
from mammometry.job.products import Stage
from mammometry.job.stages import calibrate, match, measure, surface
from mammometry.job.stages.report import PageInputs
from mammometry.matching import quality as match_quality
from mammometry.matching.foreground.foreground import Foreground
from mammometry.matching.foreground.outlines_first import OF_PARTNER, without_outline
from mammometry.matching.quality import MatchQuality
from mammometry.measure.boundary.breasts import NoBreast
from mammometry.measure.trunk.body import Body
from mammometry.measure.volume.measurement import VolumeMeasurement
from mammometry.report import content
from mammometry.report.content import Picture, ReportContent, sentence
from mammometry.report.figures import stage_results
from mammometry.report.figures.shading import front_of
from mammometry.report.figures.stage_results import MeasureResult, draw_stage
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
from mammometry.report.words.doubts import body_cautions, body_doubts
from mammometry.report.words.mesh_facts import MeshOrigin, mesh_facts
from mammometry.report.words.photographs import photograph_doubts, rig_doubts
from mammometry.report.words.stage_facts import MatchingFacts, Shown, matching_facts, surface_facts
from mammometry.report.words.walk import walk_concerns
from mammometry.surface.motion.motion_test import concerns
from mammometry.surface.occlusion import Occlusion
from mammometry.surface.repair.repair import Provenance, RepairedSurface
from mammometry.surface.texture.texture import TexturedMesh
from mammometry.walk.motion import WalkMotion

_MATCHED = 0.6  # of a silhouette that a pair should match; flanks seen obliquely cost up to a third
_BLOCKED = 0.005  # of the subject in a photograph, hidden: less is a strap or a shadow; chosen by eye


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RunResults:
    """Results of a run that may call for a warning."""

    quality: CalibrationQuality | None
    """Verdict on the calibration. None for imported cameras."""
    calibration: Calibration | None
    """With what was left out of it. None for imported cameras."""
    camera_doubts: Sequence[str] = ()
    """Sentences on what makes imported cameras doubtful."""
    shares: Mapping[str, float]
    """Pair → share of the subject's silhouette that was matched. It lacks pairs without silhouettes."""
    matching: Mapping[str, MatchQuality]
    """Pair → how well it was matched."""
    foregrounds: Mapping[str, Foreground]
    """Camera → its silhouette."""
    measurements: Sequence[VolumeMeasurement]
    """One a breast."""
    repaired: RepairedSurface
    """The surface, world frame."""
    blocked: Mapping[str, Occlusion] = field(default_factory=dict)
    """Camera → where something stands before the subject."""
    moved: Sequence[Notice] = ()
    """What moved."""
    absent: Sequence[NoBreast] = ()
    """Sides of a torso without a measurement."""
    body: Body | None = None
    """The body's frame."""
    doubtful: Sequence[str] = ()
    """Breasts on which no nipple was seen."""
    unseparated: Mapping[str, str] = field(default_factory=dict)
    """Camera → why its silhouette was sought and is not used."""
    without_outline: Mapping[str, Sequence[str]] = field(default_factory=dict)
    """Pair → its cameras whose outlines are not known."""
    walk: Walk | None = None
    """What is known of one telephone's photographs. None for a rig's."""
    walk_motion: WalkMotion | None = None
    """Motion of the body between one telephone's photographs."""


def captured(cameras: Iterable[str]) -> tuple[str, ...]:
    """Names of the cameras' photographs of the subject."""
    return tuple(f"capture/{camera}" for camera in cameras)


def warnings(run: RunResults) -> Iterator[Notice]:
    """Warn of what the volumes rest on, the gravest first."""
    for measured in run.measurements:
        if not measured.watertight:
            yield Notice(code="solid-not-watertight", about=(measured.name,))
    if run.body is not None and run.body.plane is None:
        yield Notice(code="upright-unknown", values={"text": sentence(run.body.how)})
    if run.doubtful:
        yield Notice(code="nipple-not-seen", about=tuple(run.doubtful))
    if run.unseparated:
        reasons = "; ".join(dict.fromkeys(run.unseparated.values()))
        drawn = [f"masks/{name}.png" for name, reason in run.unseparated.items() if reason != OF_PARTNER]
        values = {"reasons": reasons, "masks": " and ".join(drawn)}
        cameras = tuple(run.unseparated)
        yield Notice(code="outline-not-used", about=cameras, photographs=captured(cameras), values=values)
    yield from run.moved
    if any("head-not-shown" in measured.boundary_remarks for measured in run.measurements):
        yield Notice(code="head-not-shown")


def run_concerns(run: RunResults) -> Iterator[Notice]:
    """Warn of what went less well in calibration and matching."""
    of_rig = rig_doubts(run.quality)
    if of_rig:
        yield Notice(code="calibration-doubtful", values={"text": sentence(of_rig[0])})
    if run.walk is not None and run.walk_motion is not None:
        yield from walk_concerns(run.walk, run.walk_motion)
    elif run.calibration is None:
        yield Notice(code="cameras-imported")
        for doubt in run.camera_doubts:
            yield Notice(code="imported-camera-doubtful", values={"text": sentence(doubt)})
    extent = subject_extent(float(np.ptp(run.repaired.mesh.vertices, axis=0).max()))
    if not extent.is_usual():
        yield Notice(code="size-unusual", values={"text": str(extent)})
    for name, judged in run.matching.items() if run.walk is None else ():  # a walk's pairs are tested by `walk.motion`
        yield from match_quality.concerns(name, judged, run.without_outline.get(name, ()))
    for name, share in run.shares.items():
        if share < _MATCHED and run.walk is None:  # a walk's masks show where the body may be
            yield Notice(code="pair-little-matched", level="note", about=(name,), values={"percent": 100 * share})
    hidden = {name: occlusion.share for name, occlusion in run.blocked.items() if occlusion.share > _BLOCKED}
    if hidden:
        shares = ", ".join(f"{name} ({100 * share:.0f} %)" for name, share in hidden.items())
        yield Notice(
            code="subject-hidden",
            level="note",
            about=tuple(hidden),
            photographs=captured(hidden),
            values={"shares": shares},
        )
    blind = [name for name, known in run.foregrounds.items() if known.everything and name not in run.unseparated]
    if blind:
        yield Notice(code="subject-not-separated", level="note", about=tuple(blind), photographs=captured(blind))
    for measured in run.measurements:
        share = describe.skin_shares(measured, run.repaired)[Provenance.MEASURED]
        if share < describe.SKIN_MEASURED:
            yield Notice(code="skin-not-measured", about=(measured.name,), values={"percent": float(100 * share)})


def run_cautions(run: RunResults) -> Iterator[str]:
    """Warn of what changes every volume of a run."""
    if run.moved:
        yield "Cameras or body moved: see the warnings."
    if run.calibration is None and run.walk is None:
        yield "The interval does not cover the cameras' errors."


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
        finished.textured, privacy, subject_kind=inputs.subject_kind, up_world=frame[1], landmarks=inputs.landmarks
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

    unseparated = {} if (subjects := plan.value(match.subjects)) is None else subjects.doubts
    missing = {pair: without_outline(names, unseparated) for pair, names in rig.pair_names.items()}
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
        moved=tuple(concerns(stillness, missing)),
        absent=absent,
        body=body,
        doubtful=without_nipple(measurements, marks, settings.measure),
        unseparated=unseparated,
        without_outline=missing,
        walk=inputs.walk,
        walk_motion=plan.value(surface.walk_motion),
    )
    beside, of_body = tuple(run_cautions(run)), body_cautions(plan)
    breasts = [
        describe.breast_report(measured, finished.repaired, (*of_body[measured.name], *beside))
        for measured in measurements
    ]
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
        calibration_doubts=photograph_doubts(quality, calibration),
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


_HUNG_UPWARDS = -0.04
"""Share of half the boundary's height by which both breasts' mass lies above its middle (with the sign of below). 25
virtual bodies had .05 to .6 below it; mounds, which are alike at both ends, have 0."""


_SIDES_DOUBTFUL = "Left and right may be exchanged: compare a mole or the operated side. See the warnings."


def gather_mesh(
    plan: Plan,
    viewer: Rig,
    page: PageInputs,
    origin: MeshOrigin,
    *,
    drawn: Callable[[], Mapping[str, Picture]] | None = None,
    privacy: Privacy | None = None,
    progress: Progress = no_progress,
) -> ReportContent:
    """Collect the report of a measured mesh.

    Args:
        plan: of its measurement.
        viewer: who looks at it in the pictures.
        page: what the report shows beside products, all of it part of the report's key.
        origin: what is known of the mesh beside its shape.
        drawn: waits for the pictures where they are drawn elsewhere, in all colours.
        privacy: what to leave out. None: nothing.
        progress: gets the fraction done.
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
    cautions, of_body = (_SIDES_DOUBTFUL,) if origin.sides_doubtful else (), body_cautions(plan)
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
            *body_doubts(plan),
            *(notice for notice in origin.notices if notice.level == "warning"),
            *_warnings(measurements, body),
            *(notice for notice in origin.notices if notice.level == "note"),
        ),
        breasts=tuple(
            sorted(
                [
                    *(
                        describe.breast_report(measured, cautions=(*of_body[measured.name], *cautions))
                        for measured in measurements
                    ),
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
    """Result that the pictures of a measured mesh are drawn from.

    Args:
        plan: of its measurement.
        viewer: who looks at it in the pictures.
        textured: the mesh in the colours to be shown.
        sources: scans that show each vertex, as bits, where several were merged.
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


def drawn_mesh(result: MeasureResult) -> Mapping[str, Picture]:
    """Pictures of a measured mesh."""
    return all_encoded({"measure": stage_results.draw(result)})["measure"]


def _warnings(measurements: Sequence[VolumeMeasurement], body: Body | None) -> Iterator[Notice]:
    yield Notice(code="mesh-of-another-scanner")
    sunk = (
        []
        if body is None
        else [measurement.sunk(body.up) for measurement in measurements if measurement.name != "model"]
    )
    if len(sunk) == 2 and sum(sunk) / 2 < _HUNG_UPWARDS:
        yield Notice(code="breasts-fuller-above")
    for measurement in measurements:
        if not measurement.watertight:
            yield Notice(code="solid-not-watertight", about=(measurement.name,))
