"""A thing that stands before or behind the subject, or lies on its skin: a mesh of plain colours, lit like the skin."""

from __future__ import annotations

from dataclasses import dataclass

from mammometry.geometry.arrays import Array, Float64
from mammometry.simulate.rendering.props import Props


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Thing:
    """A rail, a wall, a towel. Rig frame, mm."""

    props: Props
    colours: Float64[Array, "k 3"]
    """Reflectance of each material of `props`, RGB."""
    smooth: float = 0.5
    """How even its colours are: 0 as mottled as cloth, 1 not at all."""
    curved: bool = False
    """Whether its faces are one smooth surface, rather than flat sides with edges between them."""
    moves: bool = False
    """Whether it moves with the subject."""
    glow: float = 0.0
    """Light of its own: how many times brighter than the surroundings make it."""
