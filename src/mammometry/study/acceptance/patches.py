"""Measured part of a sphere or a plane in a mesh.

Stands, tables and edges are excluded by their position alone, never because of a point's deviation.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from mammometry.base.value import value
from mammometry.geometry.arrays import Array, Float64, Int64
from mammometry.study.acceptance.fits import PlaneFit, SphereFit

LEAST_POINTS = 300  # fewest points of a patch
REFITS = 12  # iterations of the robust fit that finds a patch
MOSTLY = 0.6  # smallest share of a cell's area on the surface; with less, another object is next to it


class PatchError(ValueError):
    """The artefact is not in the mesh. The message is a phrase."""


@value(eq=False)
class ArtefactPatch:
    """Measured points of one artefact's surface."""

    points: Float64[Array, "n 3"]
    """Positions, mm, mesh's frame."""
    weights: Float64[Array, " n"]
    """Surface area that each point represents, mm²."""
    cells: tuple[Int64[Array, " n"], ...]
    """Index of the part of the surface that contains each point, for several sizes of parts."""
    share_seen: float
    """Share of a sphere's surface that was evaluated. 1 for a plane."""
    share_left_out: float
    """Share of the points in front of or behind this part of the surface that are too far from it to belong to it."""
    fit: SphereFit | PlaneFit
    """Fit to all points except the 0.3 % with the largest deviations."""

    @property
    def deviations_mm(self) -> Float64[Array, " n"]:
        """Distances of all points from the fit, mm. Positive outside a sphere, and in front of a plane."""
        return self.fit.deviations(self.points)


@value(eq=False)
class SpherePatch(ArtefactPatch):
    """Points of a sphere."""

    fit: SphereFit


@value(eq=False)
class PlanePatch(ArtefactPatch):
    """Points of a plane."""

    fit: PlaneFit


def numbered(cells: Any) -> Int64[Array, " n"]:
    """Renumber cells from 0 without gaps."""
    return np.unique(cells, return_inverse=True)[1].ravel().astype(np.int64)
