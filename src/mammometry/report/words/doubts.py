"""Notices about doubtful volumes of a torso, for the report, the first page and the terminal."""

from __future__ import annotations

from mammometry.base.notices import Notice
from mammometry.job.graph import Plan
from mammometry.job.stages import measure


def body_doubts(plan: Plan) -> tuple[Notice, ...]:
    """Warnings about the body, worst first. Empty before the measurement."""
    size, overlaps = plan.value(measure.size), plan.value(measure.overlaps) or ()
    measured = {measurement.name for measurement in plan.value(measure.measurements) or ()}
    covered = (
        Notice(code="skin-covered", about=(found.name,), values={"cm2": found.groove_cm2})
        for found in overlaps
        if found.is_covered and found.name in measured
    )
    hidden = (
        Notice(code="fold-not-seen", about=(curve.name,))
        for curve in plan.value(measure.boundaries) or ()
        if curve.hidden_fold_cm2 and curve.name in measured
    )
    sized = None if size is None else size.notice
    return (*covered, *hidden, *filter(None, [sized]))


def torso_notices(plan: Plan, posture: str | None) -> tuple[Notice, ...]:
    """Notices about a measured torso.

    Args:
        plan: plan of its measurement.
        posture: empty if not stated; None: not a torso.
    """
    if posture is None:
        return ()
    return (*body_doubts(plan), Notice(code="posture", level="note", values={"posture": posture or "not given"}))
