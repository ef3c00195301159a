"""Names of the landmarks of anthropometry."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Literal, TypeAlias

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
    """For the reader: "left nipple". Left and right are the patient's."""
    kind: LandmarkKind
    """One point, or several along a line."""


def _of_torso() -> tuple[LandmarkName, ...]:
    middle = (
        LandmarkName(name="sternal_notch", title="sternal notch", kind="point"),
        LandmarkName(name="midline", title="midline", kind="line"),
        LandmarkName(name="umbilicus", title="umbilicus", kind="point"),
    )
    sided = (
        LandmarkName(name=f"{name}_{side}", title=f"{side} {title}", kind=kind)
        for name, (title, kind) in _SIDED.items()
        for side in ("left", "right")
    )
    return (*middle, *sided)


LANDMARKS: Mapping[str, tuple[LandmarkName, ...]] = MappingProxyType(
    {"torso": _of_torso(), "model": (LandmarkName(name="nipple_model", title="nipple", kind="point"),), "surface": ()}
)
"""Kind of subject → the landmarks that it may have."""
