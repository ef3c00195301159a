"""A placed subject and the objects around it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from mammometry.geometry.transform import Transform
from mammometry.simulate.disturbances.surfaces import Outside
from mammometry.simulate.rendering.props import Props
from mammometry.simulate.rendering.scene import Prop
from mammometry.simulate.rendering.skin import SkinReflectance
from mammometry.simulate.subjects.solid import SubjectSolid

Colour = tuple[float, float, float]


@dataclass(frozen=True, kw_only=True, eq=False)
class Surroundings:
    """A placed subject and the objects around it."""

    solid: SubjectSolid
    """The subject, in its own frame."""
    rig_from_solid: Transform
    skin: SkinReflectance
    """Appearance of its skin."""
    things: tuple[Prop, ...] = ()
    """Rig frame, mm."""

    @cached_property
    def outside(self) -> Outside:
        """The subject's skin, in the solid's frame."""
        return Outside(self.solid.mesh)

    @property
    def half_width_mm(self) -> float:
        """Half of the chest's width."""
        known = self.solid.facts.get("chest_width_mm")
        return 0.5 * (float(known) if isinstance(known, float) else float(np.ptp(self.solid.mesh.vertices[:, 0])))

    def front_mm(self, low_y: float, high_y: float, reach_x: float) -> float:
        """Coordinate z of the foremost skin between two heights, solid's frame, mm."""
        x, y, z = self.solid.mesh.vertices.T
        near = (y > low_y) & (y < high_y) & (np.abs(x) < reach_x)
        return float(z[near].max() if near.any() else z.max())

    def plus(
        self, found: Props, *colours: Colour, smooth: float = 0.5, curved: bool = False, glow: float = 0.0
    ) -> Surroundings:
        """Add a fixed object, with its mesh in the rig's frame."""
        thing = Prop(props=found, colours=np.array(colours), smooth=smooth, curved=curved, glow=glow)
        return replace(self, things=(*self.things, thing))

    def plus_at_body(self, found: Props, *colours: Colour, smooth: float, moves: bool = True) -> Surroundings:
        """Add a curved object with its mesh in the solid's frame."""
        at, turned = self.rig_from_solid.apply(found.vertices), self.rig_from_solid.rotate(found.normals)
        props = replace(found, vertices=at, normals=turned)
        thing = Prop(props=props, colours=np.array(colours), smooth=smooth, curved=True, moves=moves)
        return replace(self, things=(*self.things, thing))
