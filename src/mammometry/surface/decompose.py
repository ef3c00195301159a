"""Decomposition of range images into labelled patches, per ordered pair of views (paper 2.6.1)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

from mammometry.geometry.arrays import Array, Int32, UInt8, read_only


@dataclass(frozen=True, slots=True, kw_only=True)
class DecomposeSettings:
    """How range images are compared with one another."""

    epsilon_mm: float = 0.5
    """Half-width of the overlapping zone, mm (ε of 2.6.1; the paper's Results use 0.1)."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Patches:
    """Every range image labelled against every other one."""

    labels: Mapping[tuple[str, str], UInt8[Array, "h w"]]
    """(A, B) → label of each of A's elements against B (`visibility.Label`); OUTSIDE where A has no datum."""
    patches: Mapping[tuple[str, str], Int32[Array, "h w"]]
    """(A, B) → patch number of each of A's elements, 1 upwards: connected elements of one label; 0 without datum."""
    epsilon_mm: float
    """Half-width of the overlapping zone used, mm."""

    def __post_init__(self) -> None:
        for field in ("labels", "patches"):
            frozen = {key: read_only(array) for key, array in getattr(self, field).items()}
            object.__setattr__(self, field, MappingProxyType(frozen))
