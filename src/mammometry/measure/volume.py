"""Volume of the closed breast, exact for its mesh by the divergence theorem."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

from mammometry.geometry.arrays import Array, Float64, read_only
from mammometry.geometry.mesh import TriangleMesh
from mammometry.measure.boundary import BreastName
from mammometry.measure.settings import WallKind


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class VolumeMeasurement:
    """One breast, measured."""

    name: BreastName
    """"model", or the patient's "left" or "right"."""
    volume_cc: float
    """Volume between the breast's surface and the wall, cc (1 cc = 1000 mm³)."""
    interval_cc: tuple[float, float] | None
    """95 % interval of the volume, cc; None where no honest one is known."""
    interval_terms_cc: Mapping[str, float]
    """Half-width at 95 % that each named source contributes, cc; empty without an interval."""
    interval_note: str
    """One sentence on what the interval covers and what it leaves out."""
    closed: TriangleMesh
    """The closed solid that was integrated, mm, world frame."""
    watertight: bool
    """Whether `closed` is closed, oriented and manifold in its edges."""
    wall_kind: WallKind
    """The wall that closes it."""
    wall_definition: str
    """What surface that wall is, one sentence."""
    boundary_world: Float64[Array, "n 3"]
    """The closed boundary curve on the surface, mm, world frame."""
    boundary_method: str
    """How the boundary was found, one sentence."""
    alternatives_cc: Mapping[str, float]
    """Volume with each other wall, cc; information, not an interval."""
    base_area_cm2: float
    """Area of the wall within the boundary, cm²."""
    projection_mm: float
    """Greatest distance of the breast's surface from the boundary's best plane, mm."""
    area_cm2: float
    """Area of the breast's skin (without the wall), cm²."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "boundary_world", read_only(self.boundary_world))
        object.__setattr__(self, "alternatives_cc", MappingProxyType(dict(self.alternatives_cc)))
        object.__setattr__(self, "interval_terms_cc", MappingProxyType(dict(self.interval_terms_cc)))
