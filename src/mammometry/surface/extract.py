"""First surface from range images: signed distances on a voxel grid, then marching cubes (paper 2.5)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True, slots=True, kw_only=True)
class ExtractSettings:
    """The voxel grid and the rule by which views are merged on it."""

    cube_mm: float = 0.5
    """Edge of a cube, mm (the paper's)."""
    rule: Literal["default", "nearest", "furthest"] = "default"
    """How disagreeing views are settled; ``nearest`` and ``furthest`` are the paper's two failing rules (Fig. 3)."""
