"""The calibrated rig as a value: cameras, residuals, and the uncertainty of each parameter."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

from mammometry.calibration.adjust.left_out import LeftOut
from mammometry.calibration.detection.detect import Observations
from mammometry.geometry.arrays import Array, Float64, read_only
from mammometry.geometry.camera import Rig
from mammometry.geometry.transform import Transform


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ParameterCovariance:
    """Joint covariance of all cameras and placements, whatever else was adjusted."""

    names: tuple[str, ...]
    """One a parameter: ``front_left.fx_px``, ``front_left.centre_x_mm``, ``pose 01.rotation_x_rad``. px, mm and rad.
    Rotations are small ones applied from the left: about the camera's axes, or the world's for poses. What was held,
    as the first pose, has none.
    """
    matrix: Float64[Array, "p p"]
    """Of errors that the points of a photograph share, estimated from the photographs' own pulls."""
    independent: Float64[Array, "p p"]
    """The same if all residuals were independent of each other: the smaller, and usually wrong."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "matrix", read_only(self.matrix))
        object.__setattr__(self, "independent", read_only(self.independent))


@dataclass(frozen=True, slots=True, kw_only=True)
class SetAside:
    """A view left out as a whole: a picture of another pose, or a camera or target that moved."""

    camera: str
    pose: str
    residual_px: float
    """Median reprojection error of its points by what the other views say, px."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Calibration:
    """The calibrated rig, its residuals and uncertainty."""

    rig: Rig
    world: str
    """Which frame the world is, in words."""
    world_from_target: Mapping[str, Transform]
    """Pose → placement of the target. Read-only."""
    target_points: Float64[Array, "n 3"]
    """The target's points in its own frame, mm: the nominal ones unless they were adjusted too."""
    observations: Observations
    """Observations of the rig's target, as given."""
    residuals_px: tuple[Float64[Array, "_ 2"], ...]
    """Projected − measured, px, in the order of ``observations.detections``. NaN for points that were left out."""
    intrinsics_observations: Mapping[str, Observations]
    """Camera → its separate photographs, as given. Read-only, often empty."""
    intrinsics_residuals_px: Mapping[str, tuple[Float64[Array, "_ 2"], ...]]
    """As `residuals_px`, for the separate photographs."""
    rms_px: float
    """Root mean square length of the rig's `residuals_px`."""
    noise_factor: float
    """Standard deviation of the rig's residuals in units of the detections' own: 1 where those are honest."""
    parameter_std: Mapping[str, Mapping[str, float]]
    """Camera → parameter (``fx_px`` … ``k3``, ``rotation_x_rad`` …, ``centre_x_mm`` …) → standard deviation, of errors
    that a photograph's points share. Zero for what was held.
    """
    independent_std: Mapping[str, Mapping[str, float]]
    """The same if all residuals were independent: what the arrangement of cameras and poses alone makes of them."""
    covariance: ParameterCovariance
    scale_std: float | None
    """Relative standard uncertainty of every length, from the target's as it was measured: no residual shows it, and
    three times as much of every volume hangs on it. None: nobody measured the print."""
    left_out: LeftOut | None
    """How well poses fit that took no part. None where no pose could be spared."""
    set_aside: tuple[SetAside, ...]
    """Views that were left out as a whole."""
    iterations: int
    """Steps of the last adjustment."""
    converged: bool
    """Whether the last adjustment reached its minimum."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "target_points", read_only(self.target_points))
        object.__setattr__(self, "residuals_px", tuple(read_only(part) for part in self.residuals_px))
        for name in ("world_from_target", "intrinsics_observations", "intrinsics_residuals_px"):
            object.__setattr__(self, name, MappingProxyType(dict(getattr(self, name))))
        for name in ("parameter_std", "independent_std"):
            std = {camera: MappingProxyType(dict(values)) for camera, values in getattr(self, name).items()}
            object.__setattr__(self, name, MappingProxyType(std))
