"""Warnings of a report.

Those about the body, which are also shown in the terminal, are in `words.doubts`.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from mammometry.base.normal import COVERAGE_95
from mammometry.base.notices import Notice
from mammometry.base.sizes import subject_extent
from mammometry.calibration.adjust.calibrated import Calibration
from mammometry.calibration.judge.quality import CalibrationQuality
from mammometry.job.graph import Plan
from mammometry.job.inputs import Walk
from mammometry.job.stages import calibrate, match, measure, surface
from mammometry.matching import quality as match_quality
from mammometry.matching.foreground.foreground import Foreground
from mammometry.matching.foreground.outlines_first import without_outline
from mammometry.matching.quality import MatchQuality
from mammometry.measure.settings import MeasureSettings
from mammometry.measure.trunk.body import BodyDirections
from mammometry.measure.volume.measurement import VolumeMeasurement
from mammometry.report.words import describe
from mammometry.report.words.anthropometry import without_nipple
from mammometry.report.words.doubts import body_doubts
from mammometry.surface.motion.motion_detection import concerns
from mammometry.surface.occlusion import Occlusion
from mammometry.surface.repair.repair import Provenance, RepairedSurface
from mammometry.walk.motion import WalkMotion

_OF_PARTNER = "its partner's silhouette is not known"
_MATCHED = 0.6  # matched share of a silhouette below which there is a note; oblique flanks reduce it by up to a third
_BLOCKED = 0.005  # hidden share of the subject above which a photograph is reported; less is a strap or shadow
_SIZE_KNOWN = 0.004  # relative uncertainty of the board's size above which it contributes most to most intervals
_HUNG_UPWARDS = -0.04
"""Mean `inferior_shift` of both breasts below which they are fuller above than below. 25 virtual bodies had 0.05 to
0.6. Symmetric mounds have 0."""


def session_warnings(plan: Plan, settings: MeasureSettings) -> tuple[Notice, ...]:
    """Warnings about the volumes of a session, worst first."""
    return (*body_doubts(plan), *warnings(volume_doubts(plan, settings)))


def scan_warnings(plan: Plan, notices: Sequence[Notice]) -> tuple[Notice, ...]:
    """Warnings about the volumes of another scanner's mesh, worst first.

    Args:
        plan: plan of its measurement.
        notices: notices from reading the mesh.
    """
    of_file = (notice for notice in notices if notice.level == "warning")
    return (
        *body_doubts(plan),
        *of_file,
        *mesh_warnings(plan.value(measure.measurements) or (), plan.value(measure.body)),
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class VolumeDoubts:
    """Results of a run that may make its volumes doubtful."""

    measurements: Sequence[VolumeMeasurement]
    """One per breast."""
    moved: Sequence[Notice] = ()
    """Warnings about motion."""
    body: BodyDirections | None = None
    """Directions of the body."""
    doubtful: Sequence[str] = ()
    """Breasts whose nipple is not visible."""
    unseparated: Mapping[str, str] = field(default_factory=dict)
    """Camera → reason why its silhouette is not used."""
    without_outline: Mapping[str, Sequence[str]] = field(default_factory=dict)
    """Pair → its cameras without an outline."""


def volume_doubts(plan: Plan, settings: MeasureSettings) -> VolumeDoubts:
    """Collect these results from the products of a session's plan. Missing products are computed."""
    measurements = plan.value(measure.measurements) or ()
    unseparated = {} if (subjects := plan.value(match.subjects)) is None else subjects.doubts
    pairs = plan[calibrate.cameras]().rig.pair_names
    missing = {pair: without_outline(names, unseparated) for pair, names in pairs.items()}
    return VolumeDoubts(
        measurements=measurements,
        moved=tuple(concerns(plan[surface.stillness](), missing)),
        body=plan.value(measure.body),
        doubtful=without_nipple(measurements, plan.value(measure.landmarks) or (), settings),
        unseparated=unseparated,
        without_outline=missing,
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RunResults(VolumeDoubts):
    """Results of a run about which there may be warnings."""

    quality: CalibrationQuality | None
    """Assessment of the calibration. None for imported cameras."""
    calibration: Calibration | None
    """The calibration, without the photographs that were left out. None for imported cameras."""
    camera_doubts: Sequence[Notice] = ()
    """Warnings about imported cameras."""
    shares: Mapping[str, float]
    """Pair → matched share of the subject's silhouette. Only pairs with silhouettes."""
    matching: Mapping[str, MatchQuality]
    """Pair → quality of its matching."""
    foregrounds: Mapping[str, Foreground]
    """Camera → its silhouette."""
    repaired: RepairedSurface
    """The surface, world frame."""
    blocked: Mapping[str, Occlusion] = field(default_factory=dict)
    """Camera → where something hides the subject."""
    walk: Walk | None = None
    """Facts about the photographs of a walk. None for a rig."""
    walk_motion: WalkMotion | None = None
    """Motion of the body between the photographs of a walk."""


def captured(cameras: Iterable[str]) -> tuple[str, ...]:
    """File names of the cameras' photographs of the subject."""
    return tuple(f"capture/{camera}" for camera in cameras)


def warnings(run: VolumeDoubts) -> Iterator[Notice]:
    """Warnings about the volumes, worst first."""
    for measured in run.measurements:
        if not measured.watertight:
            yield Notice(code="solid-not-watertight", about=(measured.name,))
    if run.body is not None and run.body.plane is None:
        yield Notice(code="upright-from-breasts" if run.body.by_breasts else "upright-unknown")
    if run.doubtful:
        yield Notice(code="nipple-not-seen", about=tuple(run.doubtful))
    if run.unseparated:
        reasons = "; ".join(dict.fromkeys(reason or _OF_PARTNER for reason in run.unseparated.values()))
        drawn = [f"masks/{name}.png" for name, reason in run.unseparated.items() if reason]
        values = {"reasons": reasons, "masks": " and ".join(drawn)}
        cameras = tuple(run.unseparated)
        yield Notice(code="outline-not-used", about=cameras, photographs=captured(cameras), values=values)
    yield from run.moved
    headless = tuple(breast.name for breast in run.measurements if "head-not-shown" in breast.boundary_remarks)
    if headless:
        yield Notice(code="head-not-shown", about=headless)


def run_concerns(run: RunResults) -> Iterator[Notice]:
    """Yield notices about calibration, matching and coverage."""
    yield from rig_doubts(run.quality)[:1]
    if run.walk is not None and run.walk_motion is not None:
        yield from walk_concerns(run.walk, run.walk_motion)
    elif run.calibration is None:
        yield Notice(code="cameras-imported")
        yield from run.camera_doubts
    extent = subject_extent(float(np.ptp(run.repaired.mesh.vertices, axis=0).max()))
    if not extent.is_usual():
        yield Notice(code="size-unusual", values={"mm": extent.mm})
    for name, judged in run.matching.items() if run.walk is None else ():  # `walk.motion` tests a walk's pairs
        yield from match_quality.concerns(name, judged, run.without_outline.get(name, ()))
    for name, share in run.shares.items():
        if share < _MATCHED and run.walk is None:  # the masks of a walk show only where the body may be
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


def mesh_warnings(measurements: Sequence[VolumeMeasurement], body: BodyDirections | None) -> Iterator[Notice]:
    """Warnings of another scanner's mesh."""
    yield Notice(code="mesh-of-another-scanner")
    shifts = (
        []
        if body is None
        else [measurement.inferior_shift(body.up) for measurement in measurements if measurement.name != "model"]
    )
    if len(shifts) == 2 and sum(shifts) / 2 < _HUNG_UPWARDS:
        yield Notice(code="breasts-fuller-above")
    for measurement in measurements:
        if not measurement.watertight:
            yield Notice(code="solid-not-watertight", about=(measurement.name,))


def rig_doubts(quality: CalibrationQuality | None) -> list[Notice]:
    """Warnings about a calibration as a whole."""
    return [] if quality is None else [doubt for doubt in quality.doubts if not doubt.photographs]


def photograph_doubts(quality: CalibrationQuality | None) -> tuple[Notice, ...]:
    """Warnings about single photographs of a calibration, which a technician can leave out."""
    doubts = () if quality is None else quality.doubts
    return tuple(replace(doubt, level="note") for doubt in doubts if doubt.photographs)


def walk_concerns(walk: Walk, motion: WalkMotion) -> Iterator[Notice]:
    """Notices about the board's size, and about motion between the photographs.

    Args:
        walk: facts about the photographs.
        motion: motion of the body between them.
    """
    if walk.scale_std > _SIZE_KNOWN:
        share = 100 * COVERAGE_95 * 3 * walk.scale_std
        yield Notice(code="board-not-measured", values={"percent": float(share)})
    if walk.card_scale is not None:
        yield Notice(
            code="board-measured-by-card",
            level="note",
            values={
                "percent": float(100 * (walk.card_scale - 1.0)),
                "uncertain_percent": float(100 * COVERAGE_95 * walk.scale_std),
            },
        )
    if motion.moved:
        yield Notice(
            code="body-moved-against-board",
            values={"moved_mm": motion.size_mm, "after_mm": motion.rest_mm, "before_mm": motion.before_mm},
        )
    if motion.lens_px > 0.0:
        yield Notice(code="lens-changed-in-walk", level="note", values={"px": motion.lens_px})
