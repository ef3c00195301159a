"""All settings of matching in one value."""

from dataclasses import dataclass, field
from typing import Literal

from mammometry.matching.foreground import ForegroundSettings
from mammometry.matching.rectify import RectifySettings


@dataclass(frozen=True, slots=True, kw_only=True)
class MatchSettings:
    """Foreground, rectification and correlation (paper 2.3)."""

    foreground: ForegroundSettings = field(default_factory=ForegroundSettings)
    rectify: RectifySettings = field(default_factory=RectifySettings)
    window_px: float = 8.7
    """Side of the square window with the same variance as the Gaussian correlation window (√12 σ), in pixels of the
    level it is used on; σ = 2.5 measured best."""
    resolution: Literal["full", "solved"] = "full"
    """full: the map has the rectified pair's pixels; solved: those of the finest level matched."""
