"""Walls of a torso that know the trunk: heights over its cylindrical coordinates, from its axis outwards."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import LinearNDInterpolator, NearestNDInterpolator
from scipy.spatial import cKDTree

from mammometry.base.errors import MeasureError
from mammometry.geometry.arrays import Array, Float64
from mammometry.geometry.mesh import TriangleMesh
from mammometry.measure.solid.cut import OpenPart
from mammometry.measure.trunk.thorax import Skin, Thorax, Trunk, on_trunk
from mammometry.measure.wall.shapes import Chart, Height, Sewn, plate, through

_RING_MM = (12.0, 24.0)
_RING_KNOTS = 240
_NOT_BREAST = 0.8
_CELL_MM = 4.0
_LEAST_COVERED = 0.95
_NEAR_MM = 60.0


@dataclass(frozen=True, slots=True, kw_only=True)
class TrunkChart:
    """(half width × θ, y) and the distance from the trunk's axis."""

    trunk: Trunk

    def flatten(self, points_world: Float64[Array, "n 3"]) -> Float64[Array, "n 3"]:
        """Laid flat, mm."""
        return self.trunk.cylindrical(points_world)

    def world(self, places: Float64[Array, "n 3"]) -> Float64[Array, "n 3"]:
        """World points, mm."""
        return self.trunk.world(places)


def cylinder_membrane(part: OpenPart, trunk: Trunk) -> Sewn:
    """The radius from the trunk's axis, harmonic over (θ, y), equal to the skin's on the boundary."""
    return through(part, TrunkChart(trunk=trunk), subject="cylinder-membrane wall")


def thorax_fit(part: OpenPart, thorax: Thorax) -> Sewn:
    """The thorax fitted to the skin beside the breasts, plus its misfit on the boundary carried in harmonically."""
    return through(part, TrunkChart(trunk=thorax.trunk), thorax.radius_mm, subject="thorax-fit wall")


def tangent(part: OpenPart, trunk: Trunk, beside: Float64[Array, "n 3"]) -> Sewn:
    """A plate through the boundary and the skin 12 to 24 mm outside it, whose slope it so continues.

    Args:
        part: the breast's skin.
        trunk: its coordinates.
        beside: skin outside every breast, mm, world frame.

    Raises:
        MeasureError: no skin was seen there.
    """
    rim = part.mesh.vertices[np.concatenate(part.loops)]
    away = np.asarray(cKDTree(rim).query(beside, distance_upper_bound=_RING_MM[1])[0])
    near = (away > _RING_MM[0]) & (away < _RING_MM[1])
    beside, away = beside[near], away[near]
    off_breast = np.asarray(cKDTree(part.mesh.vertices).query(beside)[0]) > _NOT_BREAST * away  # which may hang over
    flat = trunk.cylindrical(beside)
    ring = flat[off_breast & on_trunk(flat, trunk)]
    if len(ring) < _RING_KNOTS:
        raise MeasureError(
            "tangent-continuous wall",
            found=f"{len(ring)} points of skin {_RING_MM[0]:.0f} to {_RING_MM[1]:.0f} mm outside the boundary",
            expected=f"{_RING_KNOTS} or more",
            remedy="Choose another wall with --set measure.wall=default",
        )
    around = np.argsort(np.arctan2(*(ring[:, :2] - trunk.cylindrical(rim)[:, :2].mean(axis=0)).T[::-1]))
    knots = [trunk.cylindrical(rim), ring[around]]
    even = [places[np.linspace(0, len(places) - 1, _RING_KNOTS // 2).astype(int)] for places in knots]
    return through(part, TrunkChart(trunk=trunk), plate(np.concatenate(even)), subject="tangent-continuous wall")


def mirrored(part: OpenPart, trunk: Trunk, thorax: Thorax, skin: Skin, *, breast_mm: float) -> Sewn:
    """The other side's skin, where no breast is, mirrored in the trunk's mid-sagittal plane.

    Args:
        part: the breast's skin.
        trunk: its coordinates; θ = 0 is the mirror.
        thorax: the trunk without breasts, to see whether one stands on the other side.
        skin: what was seen of the torso.
        breast_mm: skin that stands out this far is a breast.

    Raises:
        MeasureError: the other side bears a breast, or was not seen.
    """
    other = trunk.cylindrical(skin.points_world) * [-1.0, 1.0, 1.0]
    rim = trunk.cylindrical(part.mesh.vertices[np.concatenate(part.loops)])
    low, high = rim[:, :2].min(axis=0), rim[:, :2].max(axis=0)
    near = ((other[:, :2] > low - 10.0) & (other[:, :2] < high + 10.0)).all(axis=1)
    other = other[near & on_trunk(other, trunk)]
    core = np.linalg.norm((other[:, :2] - (low + high) / 2) / ((high - low) / 2), axis=1) < 0.7
    bulge = other[core, 2] - thorax.radius_mm(other[core, :2] * [-1.0, 1.0])
    if not core.any() or np.quantile(bulge, 0.95) > breast_mm:
        raise MeasureError(
            "mirrored wall",
            found="a breast on the other side" if core.any() else "no skin seen on the other side",
            expected="a flat other side, to be mirrored",
            remedy="Choose another wall with --set measure.wall=default",
        )
    return through(part, TrunkChart(trunk=trunk), layer(other, "mirrored wall"), subject="mirrored wall")


def measured_back(part: OpenPart, chart: Chart, back: TriangleMesh) -> Sewn:
    """A surface that was measured by itself (a second scan, a cast's back), as far as it lies behind the opening.

    Args:
        part: the skin to close.
        chart: coordinates in which the back is one layer.
        back: the measured surface, mm, in the session's world frame.

    Raises:
        MeasureError: it does not cover the opening.
    """
    places = chart.flatten(np.concatenate([back.vertices, back.corners().mean(axis=1)]))
    rim = chart.flatten(part.mesh.vertices[np.concatenate(part.loops)])
    within = (places > rim.min(axis=0) - _NEAR_MM) & (places < rim.max(axis=0) + _NEAR_MM)
    return through(part, chart, layer(places[within.all(axis=1)], "measured wall"), subject="measured wall")


def layer(places: Float64[Array, "n 3"], subject: str) -> Height:
    """A height between scattered places: the mean of each 4 mm cell, linear between them.

    Raises:
        MeasureError: when asked for places of which many lie beyond the scattered ones.
    """
    cell = np.round(places[:, :2] / _CELL_MM).astype(np.int64)
    _, number = np.unique(cell, axis=0, return_inverse=True)
    number = number.ravel()
    count = np.bincount(number)
    means = np.stack([np.bincount(number, places[:, axis]) / count for axis in range(3)], axis=1)

    def height(flat: Float64[Array, "n 2"]) -> Float64[Array, " n"]:
        found: Float64[Array, " n"] = np.full(len(flat), np.nan)
        if len(means) > 3:
            found = LinearNDInterpolator(means[:, :2], means[:, 2])(flat)
        known = np.isfinite(found)
        if known.mean() < _LEAST_COVERED:
            raise MeasureError(
                subject,
                found=f"a surface that covers {100 * known.mean():.0f} % of the breast's base",
                expected=f"at least {100 * _LEAST_COVERED:.0f} %",
                remedy="Check that it lies in the session's world frame, in mm, or choose --set measure.wall=default",
            )
        found[~known] = NearestNDInterpolator(flat[known], found[known])(flat[~known])
        return found

    return height
