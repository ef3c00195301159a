"""Which pixels show the subject: a smooth, sub-pixel coverage map of each photograph."""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from mammometry.geometry.arrays import Array, Bool, Float32, read_only
from mammometry.photograph import Photograph


@dataclass(frozen=True, slots=True, kw_only=True)
class ForegroundSettings:
    """How the subject is told from the background."""

    mode: Literal["auto", "all"] = "auto"
    """auto: a pale subject before a darker background. all: every pixel may be surface (cluttered scenes); the
    photograph then says nothing about silhouettes. A mask that is given overrules both."""
    contour_level: float = 0.2
    """Coverage at which the silhouette lies, 0…1. A rim is turned away from the light and dark: .5 lies inside it."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Foreground:
    """Share of each pixel that the subject covers, in the original, distorted photograph."""

    camera: str
    coverage: Float32[Array, "h w"]
    """0 background … 1 subject; smooth near the contour, so that its `contour_level` is a sub-pixel silhouette."""
    contour_level: float
    """Coverage on the silhouette."""
    everything: bool
    """True: no silhouette is known, every pixel may be surface; nothing may be carved with it."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "coverage", read_only(self.coverage))

    @property
    def mask(self) -> Bool[Array, "h w"]:
        """Pixels whose centre lies inside the silhouette."""
        return self.coverage >= self.contour_level


def estimate_foreground(
    photograph: Photograph,
    camera_name: str,
    settings: ForegroundSettings = ForegroundSettings(),
    *,
    given: Bool[Array, "h w"] | None = None,
) -> Foreground:
    """Find the subject in a photograph, or take the mask that is given."""
    raise NotImplementedError
