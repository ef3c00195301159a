"""Results of a run, and the page of a refused run."""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mammometry.base.errors import MammometryError
from mammometry.base.identity import Identity
from mammometry.base.notices import Notice
from mammometry.base.parse import error_text
from mammometry.io.outputs import write_outputs
from mammometry.job.graph import Plan
from mammometry.job.inputs import Inputs
from mammometry.job.products import Stage
from mammometry.job.stages import calibrate, match, measure, surface

if TYPE_CHECKING:
    from mammometry.measure.volume.difference import VolumeDifference
    from mammometry.measure.volume.measurement import VolumeDeficit, VolumeMeasurement


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Results:
    """Results of a run."""

    measurements: Mapping[str, VolumeMeasurement]
    """``model``, or the patient's ``left`` and ``right`` → its volume measurement. Empty for a surface."""
    watertight: bool
    """Whether every measured solid is closed. False for an open surface."""
    seconds: float
    """Wall time, s."""
    stage_seconds: Mapping[str, float]
    """Stage → wall time, s. Almost 0 if its results existed already."""
    peak_memory_mb: float | None
    """Peak memory of the process or a child, MB. None if the system does not report it (Windows)."""
    world: str
    """Frame of the results, as text."""
    folder: Path
    """Folder of the results."""
    report: Path | None
    """The report's page. None if it was not requested."""
    no_breast: Mapping[str, str] = field(default_factory=dict)
    """Side of a torso without a volume → the reason."""
    notices: tuple[Notice, ...] = ()
    """Changes of a scanner's mesh, assumptions, warnings about a torso's volumes, and the posture."""
    lacking: Mapping[str, VolumeDeficit] = field(default_factory=dict)
    """Side of a torso → its volume deficit relative to the mirrored other side."""
    merged: tuple[Mapping[str, Any], ...] = ()
    """Further scans that were merged with the first one, as `AlsoScan.as_table`."""
    made: tuple[str, ...] = ()
    """``stage/product`` of all products that this run computed."""
    made_at: str | None = None
    """Time of the newest result, ISO 8601, UTC."""

    @property
    def notes(self) -> tuple[str, ...]:
        """The notices as text, one sentence each."""
        from mammometry.base.notices.words import words_of

        return tuple(map(words_of, self.notices))

    @property
    def volumes_cc(self) -> dict[str, float]:
        """Name → volume, cc."""
        return {name: measured.volume_cc for name, measured in self.measurements.items()}

    @property
    def words(self) -> dict[str, str]:
        """Name → rounded volume and interval as text: "284 ± 55 cc (95 %: 230 to 339 cc)"."""
        from mammometry.report.words.volumes import measured_words

        return {
            name: measured_words(measured.volume_cc, measured.interval_cc)
            for name, measured in self.measurements.items()
        }

    @property
    def intervals_cc(self) -> dict[str, tuple[float, float] | None]:
        """Name → 95 % interval, cc. None if unknown."""
        return {name: measured.interval_cc for name, measured in self.measurements.items()}

    @property
    def difference(self) -> VolumeDifference | None:
        """Volume of the left breast minus that of the right one, with its own interval. None without both."""
        from mammometry.measure.volume.difference import difference

        if not {"left", "right"} <= self.measurements.keys():
            return None
        return difference(self.measurements["left"], self.measurements["right"], "sides")

    def as_table(self) -> dict[str, Any]:
        """All results as JSON-ready data, as printed by ``--json``."""
        apart = self.difference
        interval_cc = None if apart is None else apart.difference_interval_cc
        return {
            "volumes_cc": {name: round(value, 3) for name, value in self.volumes_cc.items()},
            "intervals_cc": {
                name: None if interval is None else [round(bound, 3) for bound in interval]
                for name, interval in self.intervals_cc.items()
            },
            "as_defined_cc": {
                name: None if measured.as_defined_cc is None else [round(bound, 3) for bound in measured.as_defined_cc]
                for name, measured in self.measurements.items()
            },
            "definitions": {
                name: {
                    defined.meaning: {
                        "volume_cc": round(defined.volume_cc, 3),
                        "interval_cc": [round(bound, 3) for bound in defined.interval_cc],
                        "weight_g": round(defined.weight_g[0], 1),
                        "weight_half_g": round(defined.weight_g[1], 1),
                    }
                    for defined in measured.definitions
                }
                for name, measured in self.measurements.items()
            },
            "difference_cc": None if apart is None else round(apart.difference_cc, 3),
            "difference_interval_cc": None if interval_cc is None else [round(bound, 3) for bound in interval_cc],
            "no_breast": dict(self.no_breast),
            "notes": list(self.notes),
            "notices": [notice.as_table() for notice in self.notices],
            **({"merged_scans": [dict(scan) for scan in self.merged]} if self.merged else {}),
            "lacking_cc": {name: round(deficit.volume_cc, 3) for name, deficit in self.lacking.items()},
            "lacking_interval_cc": {
                name: None if deficit.interval_cc is None else [round(bound, 3) for bound in deficit.interval_cc]
                for name, deficit in self.lacking.items()
            },
            "watertight": self.watertight,
            "seconds": round(self.seconds, 3),
            "stage_seconds": {stage: round(value, 3) for stage, value in self.stage_seconds.items()},
            "peak_memory_mb": self.peak_memory_mb,
            "world": self.world,
            "results": str(self.folder),
            "report": None if self.report is None else str(self.report),
            "made": list(self.made),
            "made_at": self.made_at,
        }


_LOG = logging.getLogger(__name__)
FOLDER, PAGE = "refused", "refused.html"
"""Folder in the results that contains the page of a refusal and its pictures, and the page."""
Pictures = Mapping[str, bytes]
"""Name → PNG that contains its caption."""


def show_refusal(results: Path, identity: Identity, error: MammometryError, draw: Callable[[], Pictures]) -> None:
    """Write a page with pictures of a refusal, and set `error.page`. Failures are only logged.

    Args:
        results: folder of the session's results.
        identity: identity of the subject.
        error: the refusal; its `page` is set.
        draw: function that draws the pictures.
    """
    from mammometry.report.documents.pages import refusal_page

    try:
        pictures = draw()
        files = {PAGE: refusal_page(identity, error, pictures).encode()}
        write_outputs(results / FOLDER, files | {f"{name}.png": png for name, png in pictures.items()}, command="run")
        error.page = results / FOLDER / PAGE
    except Exception as trouble:  # the refusal itself must be reported
        _LOG.warning("the page of the refusal could not be drawn: %s", error_text(trouble))


def is_refusal_shown(results: Path) -> bool:
    """Whether there is a page of a refusal."""
    return (results / FOLDER / PAGE).is_file()


def withdraw_refusal(results: Path) -> None:
    """Remove the page of an earlier refusal, after a successful measurement."""
    if is_refusal_shown(results):
        write_outputs(results / FOLDER, {}, command="run")


def seen(
    stage: Stage, error: MammometryError, plan: Plan, inputs: Inputs, previews: Callable[[Stage], Pictures]
) -> Pictures:
    """Pictures of a refused stage: its inputs and results.

    Args:
        stage: calibrate, match, surface or measure.
        error: the refusal.
        plan: the whole job.
        inputs: inputs of the session.
        previews: function that gives the pictures of a completed stage.
    """
    from mammometry.calibration.judge.suspects import SuspectPhotographsError
    from mammometry.report.figures import refused
    from mammometry.report.figures.shading import front_frame

    if stage == "calibrate":
        looked = {pose: made() for pose, made in plan[calibrate.observation].items() if not made.missing}
        suspects = error.suspects.reasons if isinstance(error, SuspectPhotographsError) else ()
        return {"targets": refused.targets_seen(inputs.calibration_photographs, looked, suspects)} if looked else {}
    if stage == "match":
        subjects = plan.current(match.subjects)
        outlines = None if subjects is None else subjects.blocks
        return {"photographs": refused.photographs_seen(inputs.photographs, outlines)}
    if stage == "surface":
        return previews("match")
    body, boundaries = plan.current(measure.body), plan.current(measure.boundaries)
    drawn = refused.surface_seen(
        plan[surface.mesh](),
        front_frame(plan[calibrate.cameras]().rig, mounting=inputs.mounting) if body is None else body.frame,
        boundaries or (),
        of_patient=inputs.subject_kind == "torso",
    )
    return {"surface": drawn, **{name: png for name, png in previews("match").items() if name == "foreground"}}
