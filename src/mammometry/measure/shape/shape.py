"""Shape of one breast: extent of its base, distribution of its volume."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from mammometry.base.value import value
from mammometry.geometry.arrays import Array, Float64
from mammometry.geometry.nearest import point_tree
from mammometry.measure.boundary.boundary import BreastName
from mammometry.measure.landmarks.landmarks import Landmark
from mammometry.measure.solid.clip import volume_within_mm3
from mammometry.measure.volume.measurement import VolumeMeasurement


@value
class BreastShape:
    """Extent of one breast and the distribution of its volume, in the patient's directions."""

    name: BreastName
    """"model", or the patient's "left" or "right"."""
    skin_cm2: float
    """Area of the skin within the boundary, cm²."""
    base_width_mm: float
    """Extent of the boundary from side to side, straight, mm."""
    base_height_mm: float
    """Extent of the boundary from its lowest to its highest point, mm."""
    base_sigma_mm: float
    """Standard uncertainty of base width and height, from the boundary curve's, mm."""
    projection_mm: float
    """Greatest distance of the skin from the boundary's best plane, mm."""
    projection_sigma_mm: float
    """Standard uncertainty of the projection, from the boundary curve's, mm."""
    quadrants_cc: Mapping[str, float]
    """Volume of each quadrant about the nipple, cc: upper or lower, and medial or lateral (for a model: left or right,
    as for a patient facing the cameras). They add up to the volume. Empty without a nipple."""
    above_nipple_cc: float | None
    """Volume above the level of the nipple, cc: the upper pole."""
    below_nipple_cc: float | None
    """Volume below the level of the nipple, cc: the lower pole."""
    pole_sigma_cc: float | None
    """Standard uncertainty of either pole from that of the nipple's height, cc."""


def shape_of(
    measured: VolumeMeasurement, frame: Float64[Array, "3 3"], nipple: Landmark | None, *, boundary_sigma_mm: float
) -> BreastShape:
    """Measure the shape of one breast.

    Args:
        measured: the closed solid and its boundary.
        frame: rows: the patient's left, the head, straight ahead; world frame.
        nipple: the quadrants' common corner; None: no quadrants.
        boundary_sigma_mm: standard uncertainty of the boundary curve, mm.
    """
    extent = np.ptp(measured.boundary_world @ frame.T, axis=0)
    quadrants: dict[str, float] = {}
    above = below = sigma = None
    if nipple is not None:
        place, left, up = nipple.points_world[0], frame[0], frame[1]
        sides = {"model": ("left", "right"), "left": ("lateral", "medial"), "right": ("medial", "lateral")}
        for level, upwards in (("upper", up), ("lower", -up)):
            for side, sideways in zip(sides[measured.name], (left, -left), strict=True):
                quadrants[f"{level} {side}"] = _cc(measured, place, upwards, sideways)
        above, below = _cc(measured, place, up), _cc(measured, place, -up)
        step = up * nipple.sigma_mm
        sigma = abs(_cc(measured, place - step, up) - _cc(measured, place + step, up)) / 2
    return BreastShape(
        name=measured.name,
        skin_cm2=measured.area_cm2,
        base_width_mm=float(extent[0]),
        base_height_mm=float(extent[1]),
        base_sigma_mm=float(np.sqrt(2.0) * boundary_sigma_mm),
        projection_mm=measured.projection_mm,
        projection_sigma_mm=_projection_sigma_mm(measured, boundary_sigma_mm),
        quadrants_cc=quadrants,
        above_nipple_cc=above,
        below_nipple_cc=below,
        pole_sigma_cc=sigma,
    )


def _projection_sigma_mm(measured: VolumeMeasurement, boundary_sigma_mm: float) -> float:
    """How far the boundary's best plane moves when the whole boundary lies one sigma further out on the skin, mm.

    An observer who draws wider does so all around: errors along the curve are taken as one.
    """
    points, skin = measured.boundary_world, measured.skin
    plane_normal = np.linalg.svd(points - points.mean(axis=0), full_matrices=False)[2][2]
    skin_normals = skin.vertex_normals()[point_tree(skin.vertices).query(points)[1]]
    along = np.roll(points, -1, axis=0) - np.roll(points, 1, axis=0)
    outward = np.cross(along, skin_normals)
    length = np.linalg.norm(outward, axis=1)
    rise = np.divide(outward @ plane_normal, length, out=np.zeros_like(length), where=length > 0)  # 0: no way outwards
    return float(abs(np.average(rise, weights=np.linalg.norm(along, axis=1))) * boundary_sigma_mm)


def _cc(measured: VolumeMeasurement, place: Float64[Array, 3], *normals: Float64[Array, 3]) -> float:
    return volume_within_mm3(measured.closed, place, normals) / 1000
