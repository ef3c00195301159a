"""Results of calibrations and daily checks, as stored in the database."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from mammometry.io.drift import CameraDrift, DriftEntry, entry_table

if TYPE_CHECKING:
    from mammometry.capture.camera_checks import KnownCamera

_MOTION = ("shift_mm", "turn_deg", "shift_px", "sigma")


@dataclass(frozen=True, slots=True, kw_only=True)
class CalibrationDoubt:
    """A warning of a calibration that may name photographs."""

    sentence: str
    photographs: tuple[str, ...] | None
    """Pose and camera of each. None: version 1.0 named them only in the sentence."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CalibrationResult:
    """Verdict of a calibration, with its reasons."""

    verdict: str | None
    """``pass`` or ``warn``. None: the cameras were calibrated elsewhere."""
    reasons: tuple[str, ...] = ()
    doubts: tuple[CalibrationDoubt, ...] = ()
    """Worst first."""
    cameras: Mapping[str, KnownCamera] = field(default_factory=dict)

    @classmethod
    def from_table(cls, table: Mapping[str, Any]) -> CalibrationResult:
        """Build the result from its row. Version 1.0 stored doubts as reasons."""
        from mammometry.capture.camera_checks import KnownCamera

        verdict, reasons = table.get("verdict"), tuple(table.get("reasons") or ())
        return cls(
            verdict=verdict,
            reasons=reasons,
            doubts=tuple(map(_doubt, table.get("doubts", reasons[:1] if verdict == "warn" else ()))),
            cameras={name: KnownCamera.from_table(about) for name, about in table.get("cameras", {}).items()},
        )


def _doubt(stored: str | Mapping[str, Any]) -> CalibrationDoubt:
    if isinstance(stored, str):
        return CalibrationDoubt(sentence=stored, photographs=None)
    return CalibrationDoubt(sentence=stored["sentence"], photographs=tuple(stored["photographs"]))


@dataclass(frozen=True, slots=True, kw_only=True)
class CheckResult:
    """Verdict of a daily check, with its reasons."""

    verdict: str
    """``unmoved``, ``moved`` or ``refuse``."""
    effect_mm: float = 0.0
    """RMS displacement of the points that the worst pair measures."""
    reasons: tuple[str, ...] = ()
    unseen: tuple[str, ...] = ()
    """Cameras that did not see the board."""
    exchanged: tuple[str, ...] = ()
    """The two cameras whose photographs are swapped, so that the check shows no motion. Empty if none are."""
    calibration: str = ""
    """Digest of the calibration's cameras."""
    cameras: Mapping[str, CameraDrift] = field(default_factory=dict)

    @classmethod
    def from_table(cls, table: Mapping[str, Any]) -> CheckResult:
        """Build the result from its row. Version 1.0 stored neither unseen nor exchanged cameras."""
        return cls(
            verdict=str(table.get("verdict")),
            effect_mm=float(table.get("effect_mm") or 0.0),
            reasons=tuple(table.get("reasons") or ()),
            unseen=tuple(table.get("unseen") or ()),
            exchanged=tuple(table.get("exchanged") or ()),
            calibration=str(table.get("calibration") or ""),
            cameras={
                name: CameraDrift(
                    moved=bool(drift.get("moved")), **{key: float(drift.get(key) or 0.0) for key in _MOTION}
                )
                for name, drift in table.get("cameras", {}).items()
            },
        )


def check_table(
    entry: DriftEntry, *, image_set: str, unseen: list[str], exchanged: list[str], limit_mm: float
) -> dict[str, Any]:
    """Database row of a check.

    Args:
        entry: entry in the rig's history.
        image_set: name of its photographs' folder.
        unseen: cameras that did not see the board.
        exchanged: the two cameras whose photographs are exchanged.
        limit_mm: largest allowed effect.
    """
    found = {"image_set": image_set, "unseen": unseen, "exchanged": exchanged, "limit_mm": limit_mm}
    return {**entry_table(entry), **found}
