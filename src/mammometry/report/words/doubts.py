"""Sentences on what makes a torso's volumes doubtful, for report, first page and terminal."""

from __future__ import annotations

from collections.abc import Mapping

from mammometry.job.graph import Plan
from mammometry.job.stages import measure
from mammometry.measure.settings import NOT_TO_BE_COMPARED

_FOLD_NOT_SEEN = (
    "The fold is not seen because the breast hangs over it. The interval is therefore wider, and no ptosis is "
    "stated. Lift the breast, let the patient lean forward, or scan from below as well."
)
_RARE_SIZE = "The body is {} for an adult. Check the unit, or the size of the printed board. See the warnings."


def body_doubts(plan: Plan) -> tuple[str, ...]:
    """Warnings about the body, the gravest first. They are made with the measurement, and empty before it."""
    size, overlaps = plan.value(measure.size), plan.value(measure.overlaps) or ()
    measured = {measurement.name for measurement in plan.value(measure.measurements) or ()}
    covered = (
        f"{found.groove_cm2:.0f} cm² of the skin inside the border of the patient's {found.name} breast is a groove, "
        "as a hand or a strap on it leaves. It is measured because measure.bare_confirmed is set."
        for found in overlaps
        if found.is_covered and found.name in measured
    )
    hidden = (
        f"The patient's {curve.name} breast: {_FOLD_NOT_SEEN}"
        for curve in plan.value(measure.boundaries) or ()
        if curve.hidden_fold_cm2 and curve.name in measured
    )
    return (*covered, *hidden, *([] if size is None or not size.warning else [size.warning]))


def body_cautions(plan: Plan) -> Mapping[str, tuple[str, ...]]:
    """Breast → what to say of its volume on the first page."""
    size = plan.value(measure.size)
    common = () if size is None or not size.is_rare else (_RARE_SIZE.format(size.words),)
    hidden = {curve.name for curve in plan.value(measure.boundaries) or () if curve.hidden_fold_cm2}
    return {
        measured.name: (*common, *([_FOLD_NOT_SEEN] if measured.name in hidden else []))
        for measured in plan.value(measure.measurements) or ()
    }


def posture_note(posture: str) -> str:
    """The patient's posture as a line in the terminal."""
    return f"Posture: {posture or 'not given'}. {NOT_TO_BE_COMPARED}."
