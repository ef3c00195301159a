"""All settings of matching in one value."""

from dataclasses import dataclass, field
from typing import Literal

import numpy as np


@dataclass(frozen=True, slots=True, kw_only=True)
class ForegroundSettings:
    """How the subject is found before the background, see `segment` and `silhouette`."""

    mode: Literal["auto", "all"] = "auto"
    """auto: a pale subject in front of a darker background. all: every pixel may be surface (cluttered scenes), and the
    photograph gives no silhouette. A given mask overrides both.
    """
    contour_level: float = 0.4
    """Coverage at which the silhouette lies, 0…1. A rim is turned away from the light and darker than the skin beside
    it: .5 was .1 to .3 px inside the true one in eight views of three subjects, .4 within .1 px.
    """
    background_margin: float = 1.15
    """Factor by which a subject pixel's red (sRGB-encoded) exceeds the brightest backdrop. A pixel with the subject's
    colour also counts, in pictures where colour separates the two.
    """


@dataclass(frozen=True, slots=True, kw_only=True)
class RectifySettings:
    """How a pair is resampled."""

    margin_px: int = 16
    """Pixels kept around the subject's silhouette in either rectified image, for windows and filters."""


@dataclass(frozen=True, slots=True, kw_only=True)
class MatchSettings:
    """Foreground, rectification and correlation (paper 2.3)."""

    foreground: ForegroundSettings = field(default_factory=ForegroundSettings)
    """Subject against background, before anything is matched."""
    rectify: RectifySettings = field(default_factory=RectifySettings)
    """Resampling to common rows."""
    window_px: float = 8.66
    """Side of the square window with the variance of the Gaussian correlation window (√12 σ), in pixels of the level
    it is used on. σ = 2.5 measured best: larger ones flatten, smaller ones are noisier.
    """
    vertical: Literal["polynomial", "free"] = "polynomial"
    """Vertical disparity. polynomial: one quadratic polynomial a pair, zero where the calibration is right. free: one
    value at each pixel, solved together with the horizontal one, as the paper's Eq. 1 is printed. Slower.
    """
    start_span_px: float = 400.0
    """Subject size (root of its area, pixels) below which semi-global matching starts: the finest such level. At half
    of it, folds and arms are taken for one surface. Memory grows with its third power.
    """
    finest_span_px: float = 800.0
    """Subject size (root of its area, pixels) above which a level is not matched from both pictures: on the
    photograph's own pixels optics leave little. One level coarser only left matches are made, which coarser right ones
    check.
    """
    search_share: float = 0.25
    """Range of the search, as a share of the subject's width, to either side of the shift between both silhouettes."""
    erode_px: int = 2
    """Pixels taken off the silhouette before matching. They are mixed with the backdrop and would spoil the rim."""
    smoothing_px: tuple[float, ...] = (2.5, 4.0, 6.4, 10.2)
    """Gaussian σ of the final plane fits, pixels of the finest level, fine to coarse. Each pixel takes a finer one as
    far as noise allows.
    """
    agreement_px: float = 0.5
    """Largest disagreement between both matching directions, pixels of the finest level matched from both."""
    least_correlation: float = 0.3
    """Correlation below which a match is rejected (c of Eq. 1). It shows how much noise there is, not how far the match
    is off: accepted matches must still agree both ways and be certain enough.
    """
    largest_sigma_px: float = 1.0
    """Standard deviation of one window's match above which it is rejected, pixels of the finest level. Half of it where
    noise does not explain what gain and offset leave over.
    """
    resolution: Literal["solved", "full"] = "solved"
    """solved: the map has the pixels of the finest level matched, every second one of a large picture. full: those of
    the rectified pair, interpolated.
    """

    def __post_init__(self) -> None:
        for name in ("window_px", "start_span_px", "finest_span_px", "search_share", "agreement_px"):
            if not getattr(self, name) > 0:
                raise ValueError(f"{name} must be positive, found {getattr(self, name)}")
        if not self.smoothing_px or not all(sigma_px > 0 for sigma_px in self.smoothing_px):
            raise ValueError(f"smoothing_px must be one or more positive numbers, found {self.smoothing_px}")

    @property
    def window_sigma_px(self) -> float:
        """σ of the Gaussian correlation window, pixels of its level."""
        sigma: float = self.window_px / np.sqrt(12)
        return sigma
