"""The answer to whether a rig may be used today. With its reasons and what to do."""

from __future__ import annotations

import datetime
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal, TypeAlias

Answer: TypeAlias = Literal["yes", "care", "no"]
_OLD_DAYS = 90
"""Days after which a calibration is called old: screws settle and rooms change; chosen, not measured. Whether a camera
moved, the daily check tells."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Today:
    """Whether a rig may be measured with today."""

    verdict: Answer
    """``care``: yes, and somebody should read the reasons."""
    sentence: str
    reasons: tuple[str, ...] = ()
    remedy: str = ""
    """What to do first; empty where nothing is to be done."""

    def as_table(self) -> dict[str, Any]:
        """As JSON."""
        return {
            "verdict": self.verdict, "sentence": self.sentence, "reasons": list(self.reasons), "remedy": self.remedy,
        }  # fmt: skip


@dataclass(frozen=True, slots=True, kw_only=True)
class Calibrated:
    """The calibration that is in use."""

    on: datetime.date
    verdict: str | None
    """``pass`` or ``warn``; None for cameras that were calibrated elsewhere."""
    reasons: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class Checked:
    """The newest daily check against that calibration."""

    on: datetime.date
    verdict: str | None
    """``unmoved``, ``moved``, ``refuse``; None while it is not judged."""
    effect_mm: float = 0.0
    """RMS displacement of measured points by the worst pair."""
    reasons: tuple[str, ...] = ()
    unseen: tuple[str, ...] = ()
    """Cameras that did not see the board."""

    @classmethod
    def of(cls, on: datetime.date, figures: Mapping[str, Any]) -> Checked:
        """Of a check's stored figures."""
        return cls(
            on=on,
            verdict=figures.get("verdict"),
            effect_mm=float(figures.get("effect_mm") or 0.0),
            reasons=tuple(figures.get("reasons", ())),
            unseen=tuple(figures.get("unseen", ())),
        )


def judge(day: datetime.date, calibrated: Calibrated | None, checked: Checked | None) -> Today:
    """Decide.

    Args:
        day: today, where the clinic is.
        calibrated: the calibration in use; None: there is none.
        checked: the newest check against it; None: there was none.
    """
    if calibrated is None:
        return Today(
            verdict="no",
            sentence="No: this rig is not calibrated.",
            remedy="Photograph the board in several poses and calibrate.",
        )
    if checked is not None and checked.verdict == "refuse":
        return Today(
            verdict="no",
            sentence="No: a camera has moved since the calibration.",
            reasons=checked.reasons,
            remedy="Calibrate the rig again. If the board was bent or not still, repeat the check first.",
        )
    reasons: list[str] = []
    remedy = "Calibrate the rig again when there is time."
    fresh = calibrated.on == day  # a calibration is a check of its own day
    if not fresh and (checked is None or checked.on != day or checked.verdict is None):
        last = "was never checked" if checked is None else f"was last checked on {checked.on.isoformat()}"
        if checked is not None and checked.verdict is None:
            last = "has a check that has not been judged yet"
        return Today(
            verdict="care",
            sentence="Not checked today.",
            reasons=(f"The rig {last}. A camera may have been touched since.",),
            remedy="Take one photograph of the board with every camera.",
        )
    if checked is not None and checked.verdict == "moved":
        reasons.append(f"A camera moved a little: measured points are off by {checked.effect_mm:.2f} mm.")
        reasons += checked.reasons
    if calibrated.verdict == "warn":
        reasons += calibrated.reasons[:1]
    if (age := (day - calibrated.on).days) > _OLD_DAYS:
        reasons.append(f"The calibration is {age} days old.")
    if checked is not None and checked.unseen and checked.on == day:
        if not reasons:
            remedy = "Photograph the board again, where these cameras see it."
        reasons.insert(0, f"Not checked, as they saw no board: {', '.join(checked.unseen)}.")
        if not fresh:
            return Today(verdict="care", sentence="Not all cameras are checked.", reasons=tuple(reasons), remedy=remedy)
    if reasons:
        return Today(verdict="care", sentence="Yes, with care: read why.", reasons=tuple(reasons), remedy=remedy)
    how = "it was calibrated today" if fresh else "no camera has moved"
    return Today(verdict="yes", sentence=f"Yes: {how}.")
