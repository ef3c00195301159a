"""Sentences on what makes a torso's volumes doubtful, for report, first page and terminal."""

from __future__ import annotations

from collections.abc import Mapping

from mammometry.job.graph import Plan
from mammometry.job.stages import measure
from mammometry.measure.settings import NOT_TO_BE_COMPARED

_RARE_SIZE = "The body is {} for an adult. Check the unit, or the size of the printed board. See the warnings."
_COVERED = "Do not use this volume: something lies on the breast, such as a hand or an arm. See the warnings."


def body_doubts(plan: Plan) -> tuple[str, ...]:
    """Warnings about the body, the gravest first. They are made with the measurement, and empty before it."""
    size, overlaps = plan.value(measure.size), plan.value(measure.overlaps) or ()
    covered = (
        f"Something lies on the patient's {found.name} breast, such as a hand, an arm or a strap: "
        f"{found.groove_cm2:.0f} cm² of the skin inside its border is a groove, which a bare breast does not have. Its "
        "volume includes what lies on it. Capture the patient again with the breast bare."
        for found in overlaps
        if found.is_covered
    )
    return (*covered, *([] if size is None or not size.is_rare else [size.warning]))


def body_cautions(plan: Plan) -> Mapping[str, tuple[str, ...]]:
    """Breast → what to say of its volume on the first page."""
    size, overlaps = plan.value(measure.size), plan.value(measure.overlaps) or ()
    covered = {found.name for found in overlaps if found.is_covered}
    common = () if size is None or not size.is_rare else (_RARE_SIZE.format(size.words),)
    return {
        measured.name: (*((_COVERED,) if measured.name in covered else ()), *common)
        for measured in plan.value(measure.measurements) or ()
    }


def posture_note(posture: str) -> str:
    """The patient's posture as a line in the terminal."""
    return f"Posture: {posture or 'not given'}. {NOT_TO_BE_COMPARED}."
