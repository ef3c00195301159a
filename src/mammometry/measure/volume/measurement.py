"""A measured breast, and what one side lacks to the other."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Literal

import numpy as np

from mammometry.base.value import value
from mammometry.geometry import Array, Float64, TriangleMesh
from mammometry.measure.volume.definitions import DefinedVolume

if TYPE_CHECKING:
    from mammometry.measure.boundary.boundary import BreastName


@value(eq=False)
class VolumeMeasurement:
    """One breast, measured."""

    name: BreastName
    """"model", or the patient's "left" or "right"."""
    volume_cc: float
    """Volume between the breast's surface and the wall, cc (1 cc = 1000 mm³)."""
    interval_cc: tuple[float, float] | None
    """95 % interval of the volume, cc. None if it is not known. Never below zero. A torso's interval is about what
    stands out of a flat chest, one that carries the layer found at the boundary behind the breast too."""
    as_defined_cc: tuple[float, float] | None = None
    """A torso's 95 % interval of what stands in front of the named wall, wherever the chest is, cc: by how much the
    number itself may be wrong."""
    interval_terms_cc: Mapping[str, float]
    """Half-width at 95 % that each named source contributes, cc. Empty without an interval."""
    interval_note: str
    """What the interval covers and what it leaves out, one sentence."""
    closed: TriangleMesh
    """The closed solid that was integrated, mm, world frame."""
    skin_faces: int
    """Number of leading faces of `closed` that are the breast's skin. The others are its wall."""
    watertight: bool
    """Whether `closed` is closed, oriented and manifold in its edges."""
    wall_kind: str
    """Name of the wall that closes it."""
    wall_definition: str
    """What surface the wall is, one sentence."""
    boundary_world: Float64[Array, "n 3"]
    """The closed boundary curve on the surface, mm, world frame."""
    boundary_method: str
    """How the boundary was found, one sentence."""
    alternatives_cc: Mapping[str, float]
    """Volume with other walls, by name, cc. Information, not an interval."""
    base_area_cm2: float
    """Area of the wall within the boundary, cm²."""
    projection_mm: float
    """Greatest distance of the breast's surface from the boundary's best plane, mm."""
    area_cm2: float
    """Area of the breast's skin (without the wall), cm²."""
    definitions: tuple[DefinedVolume, ...] = ()
    """The volume in every meaning of "the breast", each with an interval of its own. Empty for a cast."""

    @property
    def skin(self) -> TriangleMesh:
        """The breast's skin alone, open, mm, world frame."""
        return self.closed.submesh(np.arange(self.skin_faces))

    @property
    def wall(self) -> TriangleMesh:
        """The wall alone, open, mm, world frame."""
        return self.closed.submesh(np.arange(self.skin_faces, len(self.closed.faces)))

    def sunk(self, up: Float64[Array, 3]) -> float:
        """Height of the boundary's middle over the centre of mass.

        As a share of half the boundary's height. Breasts are fuller below: 25 virtual bodies, prone and leaning, had
        .05 to .6. Below 0 they hang upwards.
        """
        corners = self.closed.corners() - self.boundary_world[0]
        volumes = np.einsum("ij,ij->i", corners[:, 0], np.cross(corners[:, 1], corners[:, 2]))
        mass = float((corners.sum(axis=1) / 4 @ up) @ volumes / volumes.sum())
        rim = (self.boundary_world - self.boundary_world[0]) @ up
        return float((rim.max() + rim.min()) / 2 - mass) / (float(np.ptp(rim)) / 2)


@value(eq=False)
class VolumeDeficit:
    """What one side lacks to the mirrored other one."""

    name: Literal["left", "right"]
    """The side that lacks, the patient's own."""
    volume_cc: float
    """Volume between the mirrored skin of the other side and the skin of this one, cc."""
    interval_cc: tuple[float, float] | None
    """95 % interval, cc. None if the other side's volume has none."""
    terms_cc: Mapping[str, float]
    """Half-width at 95 % that each named source contributes, cc. Empty without an interval."""
    curves: int
    """How many sides bear a boundary: 1 or 2."""
    boundary_world: Float64[Array, "n 3"]
    """The other side's boundary, mirrored and laid onto the skin of this side, mm, world frame."""
    note: str
    """What the volume is and what its interval covers."""
