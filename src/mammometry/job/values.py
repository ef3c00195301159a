"""What stages hand on to one another beyond each stage's own values."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

from mammometry.geometry.camera import Rig

if TYPE_CHECKING:  # The stages bring compilers and image libraries, which a plan alone need not wait for.
    from mammometry.calibration.adjust.calibrated import Calibration
    from mammometry.measure.volume.uncertainty import EarlierErrors
    from mammometry.surface.repair.repair import RepairedSurface
    from mammometry.surface.texture.texture import TexturedMesh


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CameraSet:
    """A rig calibrated here or read from a file, with its quality."""

    rig: Rig
    std: Mapping[str, Mapping[str, float]]
    """Camera → parameter → standard deviation. Empty where the cameras came ready-made."""
    world: str
    """One sentence that says what the world frame is."""
    rms_px: float | None
    """Root mean square reprojection error, pixels. None where the cameras came ready-made."""
    verdict: str | None = None
    """``pass`` or ``warn``, by `judge.quality`. None for a given rig. A refused calibration makes no cameras."""
    reasons: tuple[str, ...] = ()
    """Why, one sentence each, the gravest first. For a given rig, what makes its lengths doubtful."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FinishedSurface:
    """The repaired surface with its photographic colours."""

    repaired: RepairedSurface
    textured: TexturedMesh


def earlier_errors(calibration: Calibration | None) -> EarlierErrors:
    """A calibration's own errors. Empty if there is none."""
    import numpy as np

    from mammometry.calibration.judge.expected_error import expected_error
    from mammometry.measure.volume.uncertainty import EarlierErrors

    if calibration is None:
        return EarlierErrors()
    expected = np.concatenate(list(expected_error(calibration).std_mm.values()))
    seen = np.isfinite(expected)
    point_std_mm = float(np.sqrt(np.mean(expected[seen] ** 2))) if seen.any() else None
    return EarlierErrors(scale_std=calibration.scale_std, point_std_mm=point_std_mm)
