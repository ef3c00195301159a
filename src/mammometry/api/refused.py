"""Page of a refused run, written beside the other results.

It is removed once the session has been measured.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping
from pathlib import Path

from mammometry.base.errors import MammometryError
from mammometry.base.identity import Identity
from mammometry.base.parse import error_text
from mammometry.io.outputs import write_outputs
from mammometry.job.graph import Plan
from mammometry.job.inputs import Inputs
from mammometry.job.products import Stage
from mammometry.job.stages import calibrate, match, measure, surface

_LOG = logging.getLogger(__name__)
FOLDER, PAGE = "refused", "refused.html"
"""Where the page lies, in the results. Its pictures lie beside it, for the clinic."""
Pictures = Mapping[str, bytes]
"""Name → PNG with its caption."""


def show_refusal(results: Path, identity: Identity, error: MammometryError, draw: Callable[[], Pictures]) -> None:
    """Write a page of what was seen and its pictures, and set `error.page`.

    If the page fails, the refusal itself is still reported.

    Args:
        results: folder of the session's results.
        identity: whose photographs they are.
        error: the refusal; its `page` is set.
        draw: makes the pictures.
    """
    from mammometry.report.documents.refusal_page import refusal_page

    try:
        pictures = draw()
        files = {PAGE: refusal_page(identity, error, pictures).encode()}
        write_outputs(results / FOLDER, files | {f"{name}.png": png for name, png in pictures.items()}, command="run")
        error.page = results / FOLDER / PAGE
    except Exception as trouble:  # whatever hinders the page must not hide why there is no volume
        _LOG.warning("what was seen could not be drawn: %s", error_text(trouble))


def withdraw_refusal(results: Path) -> None:
    """Remove the page of an earlier refusal after a successful measurement."""
    if (results / FOLDER / PAGE).is_file():
        write_outputs(results / FOLDER, {}, command="run")


def seen(
    stage: Stage,
    error: MammometryError,
    plan: Plan,
    inputs: Inputs,
    previews: Callable[[Stage], Pictures],
) -> Pictures:
    """Pictures of a refused stage: its inputs and what it found.

    Args:
        stage: that refused: calibrate, match, surface or measure.
        error: the refusal.
        plan: the whole job.
        inputs: what the session brought.
        previews: pictures of a stage that was made.
    """
    from mammometry.calibration.judge.suspects import SuspectPhotographsError
    from mammometry.report.figures import refused
    from mammometry.report.figures.drawing.shading import front_frame

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
