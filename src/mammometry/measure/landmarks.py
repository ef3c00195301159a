"""Landmarks of anthropometry: which there are, what they are called, and where they lie on one surface."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Literal, TypeAlias

import numpy as np

from mammometry.geometry.arrays import Array, Float64, read_only

LandmarkKind: TypeAlias = Literal["point", "line"]

_SIDED: Mapping[str, tuple[str, LandmarkKind]] = {
    "nipple": ("nipple", "point"),
    "inframammary_fold": ("lowest point of the inframammary fold", "point"),
    "medial": ("medial end of the breast", "point"),
    "lateral": ("lateral end of the breast", "point"),
    "anterior_axillary_line": ("anterior axillary line", "line"),
}


@dataclass(frozen=True, slots=True, kw_only=True)
class LandmarkName:
    """One landmark of the protocol."""

    name: str
    """In files: ``nipple_left``."""
    title: str
    """For the reader: "left nipple"; left and right are the patient's."""
    kind: LandmarkKind
    """One point, or several along a line."""


def _of_torso() -> tuple[LandmarkName, ...]:
    middle = (
        LandmarkName(name="sternal_notch", title="sternal notch", kind="point"),
        LandmarkName(name="midline", title="midline", kind="line"),
    )
    sided = (
        LandmarkName(name=f"{name}_{side}", title=f"{side} {title}", kind=kind)
        for name, (title, kind) in _SIDED.items()
        for side in ("left", "right")
    )
    return (*middle, *sided)


LANDMARKS: Mapping[str, tuple[LandmarkName, ...]] = MappingProxyType(
    {
        "torso": _of_torso(),
        "model": (LandmarkName(name="nipple_model", title="nipple", kind="point"),),
        "surface": (),
    }
)
"""Kind of subject → the landmarks that it may have."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Landmark:
    """Where a landmark lies.

    Raises:
        ValueError: no point, or one that is not finite.
    """

    name: str
    """One of `LANDMARKS`."""
    points_world: Float64[Array, "k 3"]
    """One point, or the corners of a line in order; mm, world frame."""
    method: str
    """One sentence on who or what found it."""
    sigma_mm: float
    """Standard uncertainty of its place along the skin, mm."""

    def __post_init__(self) -> None:
        if not len(self.points_world) or not np.isfinite(self.points_world).all():
            raise ValueError(f"landmark {self.name} needs finite points, found {len(self.points_world)}")
        object.__setattr__(self, "points_world", read_only(self.points_world))
