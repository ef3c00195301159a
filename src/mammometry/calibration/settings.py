"""Settings of the calibration: find the target, adjust, judge."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal


@dataclass(frozen=True, slots=True, kw_only=True)
class DetectSettings:
    """How the target is found and its points are measured."""

    search_width_px: int = 1100
    """Width of the reduced picture in which the target is searched. Only its scale matters for finding. The final
    measurement uses the original pixels.
    """
    window_squares: float = 0.48
    """Half-width of the fitted window around a corner, in sides of a square: nearly all of the four squares that meet
    there, without the neighbouring corners' blurred edges.
    """
    floor_px: float = 0.01
    """Standard deviation added to every point's own, px: what no fit of one point can show (print, pixel grid)."""
    min_points: int = 8
    """Fewest points of a usable view. Fewer show little and are more often wrong."""
    threads: int = 2
    """Photographs processed in parallel. Each needs about 200 MB at 13 megapixels."""


@dataclass(frozen=True, slots=True, kw_only=True)
class BundleSettings:
    """How the rig is adjusted to the detections."""

    model: Literal["brown", "paper"] = "brown"
    """Camera model. ``brown``: fx, fy, principal point, k1, k2, p1, p2. ``paper``: one focal length and two radial
    terms (paper 2.2), which leaves 0.03–0.17 px where real lenses are decentred."""
    k3: Literal["auto", "zero", "free"] = "auto"
    """Whether ``brown``'s sixth-order radial term is adjusted too. ``auto``: for cameras whose photographs agree that
    it is not zero. It adds nothing to ordinary lenses.
    """
    k3_sigma: float = 4.0
    """Standard deviations (for errors that a photograph's points share) above which ``auto`` accepts k3."""
    huber_mad: float = 3.0
    """Residuals up to this many robust standard deviations count in full, larger ones linearly."""
    reject_sigma: float = 10.0
    """Robust standard deviations beyond which points are left out of the last adjustment. Photographs of one capture
    differ twofold in noise, so ten of all photographs' are five of the worst one's. Nearer points do no harm, since
    they count linearly only.
    """
    view_ratio: float = 50.0
    """Ratio to all views' median residual above which a whole view is set aside and named. Only a picture of another
    pose, swapped cameras or a mirrored target reach it.
    """
    free_target: Literal["auto", "never", "always"] = "auto"
    """Whether a target's points are adjusted too, held by the priors below. No printed board is quite flat: a bow of .5
    mm costs .19 mm in 3D if it is ignored. ``auto``: boards with at least `free_target_poses` placements. Surveyed
    targets are never adjusted.
    """
    free_target_poses: int = 6
    """Placements from which ``auto`` adjusts a board: fewer hardly separate its shape from the cameras'."""
    target_prior_mm: tuple[float, float, float] = (0.1, 0.1, 0.3)
    """Standard deviation of the target's points in its own x, y, z, mm, if adjusted: print and bow."""
    max_initial_views: int = 15
    """Views for a camera's first intrinsics, for speed. The adjustment uses all."""
    max_iterations: int = 50
    """Levenberg–Marquardt steps of one adjustment. 5–15 are usual."""

    def __post_init__(self) -> None:
        for name in ("huber_mad", "reject_sigma", "view_ratio", "k3_sigma"):
            if not getattr(self, name) > 0:
                raise ValueError(f"{name} must be positive, found {getattr(self, name)}")
        if min(self.target_prior_mm) <= 0:
            raise ValueError(f"target_prior_mm must be positive, found {self.target_prior_mm}")
        if self.max_initial_views < 3 or self.max_iterations < 1:
            raise ValueError("max_initial_views must be at least 3 and max_iterations at least 1")
        if self.model == "paper" and self.k3 == "free":
            raise ValueError("k3 belongs to the model 'brown': the paper's has two radial terms")


@dataclass(frozen=True, slots=True, kw_only=True)
class QualitySettings:
    """Limits above which a calibration gets a warning, or is refused."""

    bias_warn: float = 8.0
    """Bias of a view (its median residual in standard errors) that gives a warning. Clean ones reach 4–5, a camera
    moved by 0.01 mm 7–9 at a quarter of the size, 36–46 at full size.
    """
    bias_refuse: float = 20.0
    """Bias statistic above which the cameras cannot have stood still."""
    focal_std_warn: float = 2.5e-4
    """Relative standard deviation of a focal length that gives a warning: 0.2 mm of depth at 0.8 m."""
    focal_std_refuse: float = 5e-4
    """Relative standard deviation of a focal length that is refused: at its place, the camera's depths would be off by
    0.4 mm at 0.8 m. Three poses with corners measured to 0.05 px reach 3–5e-4, blurred ones (0.2 px) 7e-4 and more.
    Points of a photograph err together, so the focal length itself is then off by up to three times as much. Mostly the
    camera is also placed farther away by as much as its focal length is too long, and points stay in place. The
    expected error contains both effects.
    """
    geometry_warn_mm: float = 0.1
    """RMS of the target's points, reconstructed from a pair, about their nominal shape that gives a warning."""
    geometry_refuse_mm: float = 0.5
    """The paper's depth error on a flat plate (Results). With a larger one, measuring is not worthwhile."""
    scale_warn_ppm: float = 300.0
    """Scale error of a pair on the target that gives a warning, millionths of a length. Three times that in volume."""
    scale_refuse_ppm: float = 1500.0
    """Scale error of a pair above which volumes are off by half a percent from it alone."""
    expected_warn_mm: float = 0.1
    """Expected error of reconstructed points in the working volume, from the cameras' uncertainty, that gives a
    warning. Over the 300 cm² that a pair sees, 0.1 mm is 3 cc.
    """
    expected_refuse_mm: float = 0.5
    """Expected error no better than the paper's on a flat plate. Measuring is then not worthwhile."""
    coverage_warn: float = 0.4
    """Share of a photograph, in cells of an 8 × 6 grid, in which the target was seen. Below it the lens is untested."""
    volume_coverage_warn: float = 0.25
    """Share of the working volume near which the target was shown. Below it the volume is untested where skin will be.
    """
    moved_sigma: float = 8.0
    """Length of a movement between poses, in standard errors, above which it is named. Clean rigs reach 5."""
    moved_refuse_mm: float = 0.05
    """Displacement of measured points by a movement between poses above which the poses must not be used together."""
    residual_good_mm: float = 0.05
    """RMS residual at the target's distance up to which it is called good: a tenth of what the paper's plate allows."""
    residual_warn_mm: float = 0.2
    """RMS residual at the target's distance above which the pictures or the target are wrong."""
    left_out_warn: float = 1.2
    """Residuals of poses left out over those of the same poses fitted, corrected for the number of unknowns. Above it,
    the cameras are not trusted elsewhere. 1.0 if points err independently, 1.05–1.1 if a photograph's points err
    together, 1.25 and more with three such poses.
    """
    blurred_ratio: float = 5.0
    """RMS of a view over that of the others above which it is called blurred."""
    rejected_warn: float = 0.15
    """Share of a view's points left out as outliers that gives a warning. Clean views lose up to a tenth: corners at
    the board's rim, or out of focus, err more than their σ.
    """


@dataclass(frozen=True, slots=True, kw_only=True)
class CheckSettings:
    """Limits of the check whether a camera moved since the calibration."""

    chance: float = 1e-6
    """Probability, in a rig that did not move, below which a disagreement is called a motion. It is very small because
    real noise has longer tails than the normal distribution.
    """
    least_inflation: float = 1.5
    """Least factor on the exposure's noise: neighbouring corners have common errors. Larger if the calibration's own
    views show more.
    """
    refuse_mm: float = 0.1
    """RMS displacement of measured points above which the calibration must not be used. Over the 300 cm² that a pair
    sees, 0.1 mm is 3 cc.
    """
    lens_ratio: float = 3.0
    """A camera's residual over that of its calibration above which its lens, or the target, must have changed."""

    def __post_init__(self) -> None:
        if not 0 < self.chance < 1:
            raise ValueError(f"chance must lie between 0 and 1, found {self.chance}")
        for name in ("least_inflation", "refuse_mm", "lens_ratio"):
            if not getattr(self, name) > 0:
                raise ValueError(f"{name} must be positive, found {getattr(self, name)}")


@dataclass(frozen=True, slots=True, kw_only=True)
class CalibrateSettings:
    """All of the calibration's settings."""

    detect: DetectSettings = field(default_factory=DetectSettings)
    """Finding and measuring the target."""
    bundle: BundleSettings = field(default_factory=BundleSettings)
    """Adjusting the rig."""
    quality: QualitySettings = field(default_factory=QualitySettings)
    """Judging the result."""
    check: CheckSettings = field(default_factory=CheckSettings)
    """Comparing a later exposure with the result."""
