"""An object in front of, behind or on the subject. A mesh of plain colours, lit like the skin."""

from __future__ import annotations

from dataclasses import dataclass

from mammometry.geometry.arrays import Array, Float64
from mammometry.simulate.rendering.objects.props import Props


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Thing:
    """A rail, a wall, a towel. Rig frame, mm."""

    props: Props
    colours: Float64[Array, "k 3"]
    """Reflectance of each material of `props`, RGB."""
    smooth: float = 0.5
    """Evenness of its colours: 0 as mottled as cloth, 1 uniform."""
    curved: bool = False
    """Whether its faces are one smooth surface, and not flat sides with edges."""
    moves: bool = False
    """Whether it moves with the subject."""
    glow: float = 0.0
    """Emitted light, relative to its brightness by the surroundings."""
