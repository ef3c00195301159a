"""Removal of dented range data: what depth discontinuities smeared, seen at grazing angles (paper 2.6.2, Eq. 2–3)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from mammometry.geometry.arrays import Array, Float32, read_only
from mammometry.surface.range_image import RangeImage


@dataclass(frozen=True, slots=True, kw_only=True)
class DentSettings:
    """Which range data are held to be dented."""

    rule: Literal["element", "patch", "none"] = "element"
    """``patch``: Eq. 2–3 as written, a patch judged by its centre; ``element``: each datum by its own normal."""
    angle_deg: float = 70.0
    """Largest angle between normal and direction to the camera, degrees (the paper's patches: 60)."""
    neighbourhood_mm: float = 2.5
    """Radius of the points that give a normal, mm (the paper's patches: 5)."""
    drop_seen_through: bool = True
    """Also drop what another view looks through (IN_FRONT of its surface by more than `seen_through_mm`)."""
    seen_through_mm: float = 1.0
    """How far in front of another view's surface a datum must be to be dropped, mm."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ValidPatches:
    """The range data that survived, per view."""

    range_images: tuple[RangeImage, ...]
    """Same views in the same order, with reduced `valid`."""
    angles_rad: tuple[Float32[Array, "h w"], ...]
    """Per view and element: angle between local normal and direction to the camera, rad; NaN where unknown."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "angles_rad", tuple(read_only(angle) for angle in self.angles_rad))
