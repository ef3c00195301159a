"""Register the trunks of two dates, without breasts and arms.

Breasts may have changed between the dates, and arms may have moved. The thorax between and beside them is assumed to
be the same body. The fit tests this: another patient's trunk does not fit.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from mammometry.base.errors import MeasureError
from mammometry.base.value import value
from mammometry.geometry import Array, Float64, Transform
from mammometry.geometry.nearest import point_tree
from mammometry.measure.shape.symmetry import trunk_skin
from mammometry.measure.trunk.mirror_plane import Registration, register
from mammometry.measure.trunk.thorax import HEIGHT_WINDOW_MM, WIDEST_DEG, Trunk, find_trunk, on_trunk, seen_skin
from mammometry.surface.repair.repair import RepairedSurface

_FIXED = 60_000  # points of the earlier trunk; chosen for speed
_JUDGED = 20_000  # points of the later trunk whose distance is judged; chosen for speed
_STARTS_MM = (0.0, -25.0, 25.0)  # along the axis, along which a trunk slides; six starts in all (decision 22)
_BEYOND_MM = 20.0  # later skin this far beyond the earlier one's edge is not compared; 1.4 mm off on a round trunk
_SHARE = 0.8  # four fifths: the robust scatter does not tell bodies apart (decision 22)


@value(eq=False)
class TrunkSkin:
    """The part of a torso that a registration may trust."""

    points_world: Float64[Array, "n 3"]
    """Visible vertices outside the breasts and the arms, mm, world frame."""
    normals_world: Float64[Array, "n 3"]
    """Their unit outward normals."""
    trunk: Trunk
    """Its axis and frame."""
    frame: Float64[Array, "3 3"]
    """Rows: the patient's left, the head, straight ahead, roughly, as in the photographs. World frame."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TrunkFit:
    """One date's trunk laid onto the other's."""

    before_from_after: Transform
    """World frame of the later date to that of the earlier one."""
    scatter_mm: float
    """Robust standard deviation of the distances between both trunks, along the normal, mm."""
    within_mm: float
    """Distance from the earlier trunk within which four fifths of the later one lie, along the normal, mm."""
    weakest_mm: float
    """Standard uncertainty of the least certain motion (`register.Registration.weakest_mm`), mm."""
    turned_deg: float
    """Difference in the trunk's lean: angle between the photographs' upright at both dates, degrees."""


def trunk_of(
    surface: RepairedSurface, boundaries: Sequence[Float64[Array, "_ 3"]], frame: Float64[Array, "3 3"]
) -> TrunkSkin:
    """Cut the trunk's skin out of a torso.

    Args:
        surface: the whole torso, world frame, mm.
        boundaries: around the breasts.
        frame: rows: the patient's left, the head, straight ahead, roughly, as the photographs stand.

    Raises:
        MeasureError: no skin was seen at the patient's sides.
    """
    middle = np.mean([boundary.mean(axis=0) for boundary in boundaries], axis=0)
    trunk = find_trunk(seen_skin(surface), frame, height_of=middle)
    if trunk.assumed:
        raise MeasureError(
            "torso",
            found="no skin seen at both of the patient's sides",
            expected="skin beside the breasts, by which two dates are laid onto one another",
            remedy="Add views from the sides",
        )
    points, normals = trunk_skin(surface, boundaries)
    flat = trunk.cylindrical(points)
    keep = on_trunk(flat, trunk) & (np.abs(flat[:, 1]) < HEIGHT_WINDOW_MM)
    keep &= np.abs(flat[:, 0]) < np.deg2rad(WIDEST_DEG) * trunk.half_width_mm
    return TrunkSkin(points_world=points[keep], normals_world=normals[keep], trunk=trunk, frame=frame)


def fit_trunks(before: TrunkSkin, after: TrunkSkin) -> TrunkFit:
    """Lay the later trunk onto the earlier one.

    The search starts at several places along the axis, along which a trunk slides: with axis on axis, and as the
    photographs stand in case one of the axes was not found.

    Raises:
        MeasureError: the trunks do not lie on one another from any start.
    """
    fixed = _every(before, _FIXED)
    found: list[tuple[float, Registration]] = []
    refused: list[MeasureError] = []
    turns = before.trunk.frame.T @ after.trunk.frame, before.frame.T @ after.frame
    for rotation, along_mm in product(turns, _STARTS_MM):
        origin = before.trunk.origin + along_mm * before.trunk.frame[1]
        start = Transform(rotation=rotation, translation_mm=origin - rotation @ after.trunk.origin)
        try:
            laid = register(
                (after.points_world, after.normals_world), fixed, start=start, subject="the trunks of both dates"
            )
        except MeasureError as error:
            refused.append(error)
        else:
            found.append((_within_mm(laid.fixed_from_moving, after, fixed), laid))
    if not found:
        raise refused[0]
    within_mm, best = min(found, key=lambda scored: scored[0])
    upright = best.fixed_from_moving.rotate(after.frame[1:2])[0]
    return TrunkFit(
        before_from_after=best.fixed_from_moving,
        scatter_mm=best.scatter_mm,
        within_mm=within_mm,
        weakest_mm=best.weakest_mm,
        turned_deg=float(np.rad2deg(np.arccos(np.clip(upright @ before.frame[1], -1.0, 1.0)))),
    )


def _within_mm(
    motion: Transform, after: TrunkSkin, fixed: tuple[Float64[Array, "m 3"], Float64[Array, "m 3"]]
) -> float:
    """Distance along the normal that holds four fifths of the moved trunk, where the earlier date shows it too."""
    moved = motion.apply(_every(after, _JUDGED)[0])
    fixed_points, outward = fixed
    nearest = np.asarray(point_tree(fixed_points).query(moved)[1])
    offset, normals = moved - fixed_points[nearest], outward[nearest]
    away = (offset * normals).sum(axis=1)
    shared = np.linalg.norm(offset - away[:, None] * normals, axis=1) < _BEYOND_MM
    return float(np.quantile(np.abs(away[shared]), _SHARE))


def _every(skin: TrunkSkin, at_most: int) -> tuple[Float64[Array, "m 3"], Float64[Array, "m 3"]]:
    chosen = slice(None, None, max(1, len(skin.points_world) // at_most))
    return skin.points_world[chosen], skin.normals_world[chosen]
