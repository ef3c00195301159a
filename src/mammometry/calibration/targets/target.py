"""Calibration targets of any kind, and the registry of the kinds.

A target lists its points in its own frame, mm. A detection's ids are indices in that list. Each kind is a file in
`kinds`.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Iterator
from typing import ClassVar

import numpy as np

from mammometry.base.errors import SettingsError
from mammometry.base.registry import Registry
from mammometry.calibration.targets.sheet import ConvexBody, PrintedSheet
from mammometry.geometry.arrays import Array, Float64

TARGETS: Registry[type[Target]] = Registry("calibration target", package="mammometry.calibration.targets.kinds")
"""Kind in ``[target] kind`` → class of the target."""
_MAX_PER_SIDE = 2000  # columns or rows: more than any image could resolve


class Target(ABC):
    """A calibration target: points, detection, print and appearance.

    Subclasses are frozen dataclasses. Their fields are the keys of session.toml's ``[target]``.
    """

    __slots__ = ()

    is_surveyed: ClassVar[bool] = False
    """Whether its points were surveyed, so that its frame is the world. For a board, the world is its first pose."""

    has_inverse: ClassVar[bool] = True
    """Whether the target printed white on black is another pattern. The inverse of a chessboard is a chessboard."""
    least_points: ClassVar[int] = 8
    """Fewest measured points of a usable view: fewer points of a spatial target may match by chance."""

    @property
    def kind(self) -> str:
        """Name of the kind in the registry."""
        return TARGETS.name_of(type(self))

    size_key: ClassVar[str] = "sizes"
    """Key of ``[target]`` that sets its size."""

    @property
    def stated_size(self) -> tuple[str, float]:
        """Key and value of the target's size, mm. For a list of points, their longest extent."""
        value = getattr(self, self.size_key, None)
        return self.size_key, value if isinstance(value, float) else float(np.ptp(self.points_target, axis=0).max())

    # --- for the adjustment ---

    @property
    @abstractmethod
    def points_target(self) -> Float64[Array, "n 3"]:
        """Points by id, target frame, mm. Read-only."""

    @property
    @abstractmethod
    def scale_std(self) -> float | None:
        """Relative standard uncertainty of all lengths. None: unknown."""

    @property
    def flatness_mm(self) -> float | None:
        """Measured standard deviation of the points from a plane, mm. None: not measured, or not flat."""
        return None

    def mistaken(self) -> Iterator[tuple[str, Target]]:
        """Yield targets that are commonly confused with this description, the likeliest first.

        Each comes with the keys of session.toml that describe it.
        """
        yield from ()

    # --- the print ---

    def caption(self) -> str:
        """Describe the print in one line."""
        return self.kind

    def sheet(self) -> PrintedSheet:
        """Return the printed sheet.

        Raises:
            SettingsError: the target is not printed, or cannot be.
            SessionError: unknown marker dictionary.
        """
        printed = [kind for kind, known in TARGETS.items() if known.sheet is not Target.sheet]
        raise SettingsError(
            "target",
            found=f"a target of kind {self.kind!r}",
            expected=f"one of {', '.join(map(repr, printed))}",
            remedy="Make and survey an object with points; it cannot be printed",
        )

    # --- the appearance ---

    @property
    @abstractmethod
    def body(self) -> ConvexBody:
        """The target as a solid object for the simulation."""


def require_grid(name: str, grid: tuple[int, int], least: int) -> None:
    """Refuse a grid with too few or too many columns or rows.

    Raises:
        ValueError: fewer than `least`, or more than any image could resolve.
    """
    if min(grid) < least or max(grid) > _MAX_PER_SIDE:
        raise ValueError(
            f"{name} must be at least {least} × {least} and at most {_MAX_PER_SIDE} × {_MAX_PER_SIDE}, "
            f"found {grid[0]} × {grid[1]}"
        )


def require_positive(**sizes_mm: float) -> None:
    """Refuse sizes that are not positive.

    Raises:
        ValueError: the first such size, by its name.
    """
    for name, size_mm in sizes_mm.items():
        if not (size_mm > 0 and math.isfinite(size_mm)):
            raise ValueError(f"{name} must be a positive number of millimetres, found {size_mm}")


def require_measured(**measured: float | None) -> None:
    """Refuse measured values unless None or positive.

    Raises:
        ValueError: the first such value, by its name.
    """
    for name, value in measured.items():
        if value is not None and not (value > 0 and math.isfinite(value)):
            raise ValueError(f"{name} must be a positive number, found {value}; omit it if it was not measured")
