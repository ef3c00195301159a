"""Settings of the calibration: how the rig is adjusted, and what is refused."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal


@dataclass(frozen=True, slots=True, kw_only=True)
class BundleSettings:
    """Choices of the bundle adjustment."""

    model: Literal["brown", "paper"] = "brown"
    """Camera model. ``brown``: fx, fy, principal point, k1, k2, p1, p2. ``paper``: one focal length and two radial
    terms (paper 2.2), which leaves 0.03–0.17 px for real lenses with decentring."""
    k3: Literal["auto", "zero", "free"] = "auto"
    """Whether ``brown``'s sixth-order radial term k3 is adjusted too. ``auto``: for cameras whose photographs agree
    that it is not zero. Ordinary lenses do not need it."""
    free_target: Literal["auto", "never", "always"] = "auto"
    """Whether a target's points are adjusted too, with the priors below. No printed board is quite flat: a bow of 0.5
    mm causes an error of 0.19 mm in 3D if it is ignored. ``auto``: boards with at least 6 placements. Surveyed targets
    are never adjusted."""
    target_prior_mm: tuple[float, float, float] = (0.1, 0.1, 0.3)
    """Standard deviation of the target's points in its own x, y, z, mm, if adjusted: print and bow."""

    def __post_init__(self) -> None:
        if min(self.target_prior_mm) <= 0:
            raise ValueError(f"target_prior_mm must be positive, found {self.target_prior_mm}")
        if self.model == "paper" and self.k3 == "free":
            raise ValueError("k3 needs the model 'brown': the paper's model has two radial terms")


@dataclass(frozen=True, slots=True, kw_only=True)
class QualitySettings:
    """Limit above which a calibration is refused, in addition to the constants of `judge.findings`."""

    focal_std_refuse: float = 5e-4
    """Largest relative standard deviation of a focal length. At this limit the camera's depths would be off by 0.4 mm
    at 0.8 m. Three poses with corners measured to 0.05 px reach 3–5e-4, blurred ones (0.2 px) 7e-4 and more. Errors of
    a photograph's points are correlated, so the true error is up to three times as large. Usually the camera is then
    also placed farther away in proportion, and points keep their positions. The expected error contains both
    effects."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CheckSettings:
    """Limits of the check whether a camera has moved since the calibration."""

    refuse_mm: float = 0.1
    """RMS displacement of measured points above which the calibration must not be used. Over the 300 cm² that a pair
    sees, 0.1 mm is 3 cc."""

    def __post_init__(self) -> None:
        if not self.refuse_mm > 0:
            raise ValueError(f"refuse_mm must be positive, found {self.refuse_mm}")


@dataclass(frozen=True, slots=True, kw_only=True)
class CalibrateSettings:
    """All of the calibration's settings."""

    bundle: BundleSettings = field(default_factory=BundleSettings)
    """Adjustment of the rig."""
    quality: QualitySettings = field(default_factory=QualitySettings)
    """Assessment of the result."""
    check: CheckSettings = field(default_factory=CheckSettings)
    """Comparison of a later exposure with the result."""
