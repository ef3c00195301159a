"""The breast's boundary on the surface: a closed curve that separates the breast from the rest of the body."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from mammometry.geometry.arrays import Array, Float64, read_only

BreastName = Literal["model", "left", "right"]
"""A cast is "model"; a torso has the patient's own left and right breast."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Boundary:
    """A closed curve on the surface around one breast.

    Raises:
        ValueError: fewer than three points, or a point that is not finite.
    """

    name: BreastName
    """"model", or the patient's "left" or "right"."""
    points_world: Float64[Array, "n 3"]
    """Ordered corners of the curve, mm, world frame; the last joins the first, which is not repeated."""
    method: str
    """One sentence on how it was found and on what that assumes."""
    evidence_world: Float64[Array, "k 3"] = field(default_factory=lambda: np.empty((0, 3)))
    """Points seen in the photographs that the curve follows (a cast's rim), mm, world frame; for figures."""
    sigma_mm: float | None = None
    """Standard uncertainty of the whole curve along the wall's normal, mm; None where it is not known."""

    def __post_init__(self) -> None:
        if len(self.points_world) < 3 or not np.isfinite(self.points_world).all():
            raise ValueError(f"boundary {self.name} needs three or more finite points, found {len(self.points_world)}")
        object.__setattr__(self, "points_world", read_only(self.points_world))
        object.__setattr__(self, "evidence_world", read_only(self.evidence_world))
