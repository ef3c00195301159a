"""Settings of matching."""

from dataclasses import dataclass, field
from typing import Literal

import numpy as np


@dataclass(frozen=True, slots=True, kw_only=True)
class ForegroundSettings:
    """Separation of the subject from the background."""

    mode: Literal["auto", "all"] = "auto"
    """auto: a pale subject in front of a darker background. all: every pixel may be the subject (cluttered scenes), and
    there is no silhouette. A given mask overrides both."""


@dataclass(frozen=True, slots=True, kw_only=True)
class MatchSettings:
    """Foreground, rectification and correlation (paper 2.3)."""

    foreground: ForegroundSettings = field(default_factory=ForegroundSettings)
    """Separation of the subject from the background, before matching."""
    window_px: float = 8.66
    """Side of a square window with the variance of the Gaussian correlation window (√12 σ), in pixels of its level. σ =
    2.5 gave the best results: larger ones flatten, smaller ones are noisier."""
    vertical: Literal["polynomial", "free"] = "polynomial"
    """Vertical disparity. polynomial: one quadratic polynomial per pair, zero with a correct calibration. free: a value
    at each pixel, solved together with the horizontal one, as in the paper's Eq. 1. Slower."""
    resolution: Literal["solved", "full"] = "solved"
    """solved: the map has the pixels of the finest matched level, every second one of a large image. full: those of the
    rectified pair, interpolated."""

    def __post_init__(self) -> None:
        if not self.window_px > 0:
            raise ValueError(f"window_px must be positive, found {self.window_px}")

    @property
    def window_sigma_px(self) -> float:
        """σ of the Gaussian correlation window, pixels of its level."""
        sigma: float = self.window_px / np.sqrt(12)
        return sigma
