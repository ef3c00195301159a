"""Motion of the subject between the pairs' exposures: sway and breath."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mammometry.geometry.arrays import Array, Float64


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Motion:
    """Velocities, rig frame. Over a fifth of a second neither sway nor breath reverses."""

    sway_mm_s: Float64[Array, 3]
    """Of the whole body."""
    turn_rad_s: Float64[Array, 3]
    """Of the whole body about the rig's middle, axis times angle."""
    breath_mm_s: Float64[Array, 3]
    """Of the front of the chest, beside the body's own."""
    chest: Float64[Array, 3]
    """Where the breath moves most, mm."""
    reach_mm: float = 130.0
    """Standard deviation of the breath's motion around its centre: that of a chest, chosen by eye."""

    def at(self, points: Float64[Array, "n 3"], seconds: float) -> Float64[Array, "n 3"]:
        """Where points are after so many seconds.

        Turns are small: the second order, a micrometre, is left out.
        """
        share = np.exp(-0.5 * ((points - self.chest) ** 2).sum(axis=1) / self.reach_mm**2)
        speed = self.sway_mm_s + np.cross(self.turn_rad_s, points) + share[:, None] * self.breath_mm_s
        moved: Float64[Array, "n 3"] = points + seconds * speed
        return moved
