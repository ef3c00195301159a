"""The calibrated rig: cameras, residuals, uncertainty of each parameter."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from mammometry.base.value import value
from mammometry.calibration.adjust.left_out import LeftOut
from mammometry.calibration.detection.detect import Observations
from mammometry.geometry import Array, Float64, Rig, Transform


@value(eq=False)
class ParameterCovariance:
    """Joint covariance of all cameras and placements, including the effect of all other parameters."""

    names: tuple[str, ...]
    """Names such as ``front_left.fx_px``, ``front_left.centre_x_mm``, ``pose 01.rotation_x_rad``; px, mm and rad.
    Rotations are small and applied from the left: about the camera's axes, or the world's for poses. Held parameters,
    such as the first pose, are not included."""
    matrix: Float64[Array, "p p"]
    """Covariance for errors shared by the points of a photograph, estimated from the scatter between photographs."""
    independent: Float64[Array, "p p"]
    """Covariance for independent residuals: smaller, and usually too small."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SetAside:
    """A view that was excluded as a whole: an image of another pose, or a moved camera or target."""

    camera: str
    pose: str
    residual_px: float
    """Median reprojection error of its points with the estimate of the other views, px."""


@value(eq=False)
class Calibration:
    """The calibrated rig, its residuals and uncertainty."""

    rig: Rig
    world: str
    """Name of the world frame."""
    world_from_target: Mapping[str, Transform]
    """Pose → placement of the target. Read-only."""
    target_points: Float64[Array, "n 3"]
    """Target points in the target's frame, mm: the nominal ones unless adjusted."""
    observations: Observations
    """Observations of the rig's target, as given."""
    residuals_px: tuple[Float64[Array, "_ 2"], ...]
    """Projected − measured, px, in the order of ``observations.detections``. NaN for excluded points."""
    intrinsics_observations: Mapping[str, Observations]
    """Camera → its separate photographs, as given. Read-only, often empty."""
    intrinsics_residuals_px: Mapping[str, tuple[Float64[Array, "_ 2"], ...]]
    """As `residuals_px`, for the separate photographs."""
    rms_px: float
    """Root mean square length of the rig's `residuals_px`."""
    noise_factor: float
    """Standard deviation of the rig's residuals in units of the detections' own. 1 if those are right."""
    parameter_std: Mapping[str, Mapping[str, float]]
    """Camera → parameter (``fx_px`` … ``k3``, ``rotation_x_rad`` …, ``centre_x_mm`` …) → standard deviation, for errors
    shared by a photograph's points. Zero if held."""
    independent_std: Mapping[str, Mapping[str, float]]
    """The same for independent residuals: the effect of the geometry of cameras and poses alone."""
    covariance: ParameterCovariance
    scale_std: float | None
    """Relative standard uncertainty of every length, from the measured size of the target. Residuals do not show it,
    and the relative error of volumes is three times as large. None: the print was not measured."""
    left_out: LeftOut | None
    """Residuals of poses that were left out. None if no pose could be spared."""
    set_aside: tuple[SetAside, ...]
    """Views that were excluded as a whole."""
    iterations: int
    """Iterations of the last adjustment."""
    converged: bool
    """Whether the last adjustment converged."""
