"""Notices on doubtful volumes of a torso, for report, first page and terminal."""

from __future__ import annotations

from collections.abc import Iterator

from mammometry.base.notices import Notice
from mammometry.job.graph import Plan
from mammometry.job.stages import measure
from mammometry.measure.shape.body_size import BodySize


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
    return (*covered, *hidden, *(() if size is None else _size_notices(size)))


def _size_notices(size: BodySize) -> Iterator[Notice]:
    if not size.lengths_mm:
        yield Notice(code="body-size-unknown")
    elif size.is_rare:
        yield Notice(code="body-size-rare", values={"text": size.warning, "size": size.words})


def torso_notices(plan: Plan, posture: str | None) -> tuple[Notice, ...]:
    """Notices on a measured torso.

    Args:
        plan: of its measurement.
        posture: empty if not given; None: no torso.
    """
    if posture is None:
        return ()
    return (*body_doubts(plan), Notice(code="posture", level="note", values={"posture": posture or "not given"}))
