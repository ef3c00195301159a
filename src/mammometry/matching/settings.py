"""All settings of matching in one value."""

from dataclasses import dataclass, field
from typing import Literal

import numpy as np


@dataclass(frozen=True, slots=True, kw_only=True)
class ForegroundSettings:
    """Choice of how the subject is separated from the background."""

    mode: Literal["auto", "all"] = "auto"
    """auto: a pale subject in front of a darker background. all: every pixel may be surface (cluttered scenes), and the
    photograph gives no silhouette. A given mask overrides both."""


@dataclass(frozen=True, slots=True, kw_only=True)
class MatchSettings:
    """Foreground, rectification and correlation (paper 2.3)."""

    foreground: ForegroundSettings = field(default_factory=ForegroundSettings)
    """Subject against background, before anything is matched."""
    window_px: float = 8.66
    """Side of the square window with the variance of the Gaussian correlation window (√12 σ), in pixels of the level it
    is used on. σ = 2.5 measured best: larger ones flatten, smaller ones are noisier."""
    vertical: Literal["polynomial", "free"] = "polynomial"
    """Vertical disparity. polynomial: one quadratic polynomial a pair, zero where the calibration is right. free: one
    value at each pixel, solved together with the horizontal one, as the paper's Eq. 1 is printed. Slower."""
    resolution: Literal["solved", "full"] = "solved"
    """solved: the map has the pixels of the finest level matched, every second one of a large picture. full: those of
    the rectified pair, interpolated."""

    def __post_init__(self) -> None:
        if not self.window_px > 0:
            raise ValueError(f"window_px must be positive, found {self.window_px}")

    @property
    def window_sigma_px(self) -> float:
        """σ of the Gaussian correlation window, pixels of its level."""
        sigma: float = self.window_px / np.sqrt(12)
        return sigma
