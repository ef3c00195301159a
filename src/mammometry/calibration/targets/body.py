"""A target as a solid object for the simulation: held, seen, rendered.

Nothing here knows of cameras or light. A ray is an origin and a direction in the target's frame, mm.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar, Literal

from mammometry.calibration.targets.sheet import Pattern
from mammometry.geometry.arrays import Array, Bool, Float64


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Hits:
    """Where rays first meet a target. Target frame."""

    points: Float64[Array, "n 3"]
    normals: Float64[Array, "n 3"]
    """Outward unit normals of the surface there."""
    white: Float64[Array, " n"]
    """1 on paper, 0 on ink, NaN if the ray misses the target."""


class Body(ABC):
    """A convex body with the target's points on its surface."""

    __slots__ = ()

    attitude: ClassVar[Literal["facing", "upright", "any"]]
    """How it is held: printed side towards the cameras, z axis up in all pictures, or turned at random."""
    comes_measured: ClassVar[bool] = False
    """Whether each virtual photograph comes with a table of its measured image points."""

    @property
    @abstractmethod
    def normals_target(self) -> Float64[Array, "n 3"]:
        """Outward unit normals of the surface at the target's points."""

    @property
    @abstractmethod
    def middle_mm(self) -> Float64[Array, 3]:
        """Middle of the target, mm, held in the middle of the rig."""

    @property
    @abstractmethod
    def hull_target(self) -> Float64[Array, "n 3"]:
        """Points whose pictures enclose the target's, mm."""

    @property
    def looks_alike_turned(self) -> bool:
        """Whether half a turn gives the same picture. Then only its direction in the picture decides."""
        return False

    @property
    def pattern(self) -> Pattern | None:
        """What a flat body shows, where that is a regular pattern."""
        return None

    @abstractmethod
    def is_whole(
        self, seen: Bool[Array, " n"], in_picture: Callable[[Float64[Array, "m 3"]], Bool[Array, " m"]]
    ) -> bool:
        """Whether enough of the target is in the picture to identify points.

        Args:
            seen: which of the target's points are in the picture and face the camera.
            in_picture: tells which points, target frame, are in the picture.
        """

    @abstractmethod
    def meet(self, origins: Float64[Array, "n 3"], directions: Float64[Array, "n 3"]) -> Hits:
        """Find where rays first meet the surface, and what is printed there."""
