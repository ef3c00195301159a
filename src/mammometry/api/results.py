"""What a run came to."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from mammometry.measure.volume.measurement import VolumeDeficit, VolumeMeasurement


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Results:
    """What a run came to."""

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
    """Which frame the results are in, in words."""
    folder: Path
    """Where the results lie."""
    report: Path | None
    """The report's page. None if it was not wanted."""
    no_breast: Mapping[str, str] = field(default_factory=dict)
    """Side of a torso without a breast → the evidence for that."""
    notes: tuple[str, ...] = ()
    """What was changed in a scanner's mesh, and what was taken for granted, one sentence each."""
    lacking: Mapping[str, VolumeDeficit] = field(default_factory=dict)
    """Side of a torso → what it lacks compared with the mirrored other side."""
    made: tuple[str, ...] = ()
    """``stage/product`` of everything that this run made. Empty if everything existed already."""
    made_at: str | None = None
    """When the newest of the results was made, ISO 8601, UTC."""

    @property
    def volumes_cc(self) -> dict[str, float]:
        """Name → volume, cc."""
        return {name: measured.volume_cc for name, measured in self.measurements.items()}

    @property
    def intervals_cc(self) -> dict[str, tuple[float, float] | None]:
        """Name → 95 % interval, cc. None where none is known."""
        return {name: measured.interval_cc for name, measured in self.measurements.items()}

    def as_table(self) -> dict[str, Any]:
        """All of it as plain data for JSON, as ``--json`` prints it."""
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
            "no_breast": dict(self.no_breast),
            "notes": list(self.notes),
            "lacking_cc": {name: round(found.volume_cc, 3) for name, found in self.lacking.items()},
            "lacking_interval_cc": {
                name: None if found.interval_cc is None else [round(bound, 3) for bound in found.interval_cc]
                for name, found in self.lacking.items()
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
