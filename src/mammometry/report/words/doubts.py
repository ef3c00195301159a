"""Sentences on what makes a torso's volumes doubtful, for report, first page and terminal."""

from __future__ import annotations

from collections.abc import Mapping

from mammometry.base.notices import Notice
from mammometry.job.graph import Plan
from mammometry.job.stages import measure
from mammometry.report.words.notices import FOLD_NOT_SEEN

_RARE_SIZE = "The body is {} for an adult. Check the unit, or the size of the printed board. See the warnings."


def body_doubts(plan: Plan) -> tuple[Notice, ...]:
    """Warnings about the body, the gravest first. They are made with the measurement, and empty before it."""
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
    rare = [] if size is None or not size.warning else [Notice(code="body-size", values={"text": size.warning})]
    return (*covered, *hidden, *rare)


def body_cautions(plan: Plan) -> Mapping[str, tuple[str, ...]]:
    """Breast → what to say of its volume on the first page."""
    size = plan.value(measure.size)
    common = () if size is None or not size.is_rare else (_RARE_SIZE.format(size.words),)
    hidden = {curve.name for curve in plan.value(measure.boundaries) or () if curve.hidden_fold_cm2}
    return {
        measured.name: (*common, *([FOLD_NOT_SEEN] if measured.name in hidden else []))
        for measured in plan.value(measure.measurements) or ()
    }


def torso_notices(plan: Plan, posture: str | None) -> tuple[Notice, ...]:
    """Notices on a measured torso.

    Args:
        plan: of its measurement.
        posture: empty where it was not given; None: no torso.
    """
    if posture is None:
        return ()
    return (*body_doubts(plan), Notice(code="posture", level="note", values={"posture": posture or "not given"}))
