"""Image points measured elsewhere, for targets that cannot be identified here."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mammometry.base.errors import CalibrationError
from mammometry.base.value import value
from mammometry.calibration.features.found_points import FoundPoints
from mammometry.calibration.targets.target import Target
from mammometry.geometry.arrays import Array, Float64, Int64


@value(eq=False)
class MeasuredPoints:
    """Image points of one photograph from a table, not yet checked. The check is against a target."""

    name: str
    """What to call the table in messages, e.g. ``calibration/00/front_left.csv``."""
    ids: Int64[Array, " n"]
    """Id of each point: its position in the target's list, from 0."""
    uv: Float64[Array, "n 2"]
    """Distorted pixels, integers at pixel centres."""


def points_from_table(
    name: str,
    ids: Int64[Array, " n"],
    uv: Float64[Array, "n 2"],
    target: Target,
    size_wh: tuple[int, int],
    *,
    std_px: float | Sequence[float] = 0.2,
) -> FoundPoints:
    """Check a table of measured points and bring it into order.

    Args:
        name: what to call the table in messages, e.g. ``calibration/00/front_left.csv``.
        ids: which points of the target: positions in its list, from 0.
        uv: distorted pixels, integers at pixel centres.
        target: the target.
        size_wh: the photograph's size, pixels.
        std_px: standard deviation of a coordinate, pixels, one for all or one for each point.

    Raises:
        CalibrationError: no points, an id that is unknown or there twice, a point outside the photograph, or a
            standard deviation that is not positive.
    """
    count = len(target.points_target)
    deviation = np.broadcast_to(np.asarray(std_px, np.float64), (len(ids),))
    if not len(ids):
        raise _error(name, "no points", f"ids from 0 to {count - 1} with their u and v", "Measure some, or remove it")
    for number in ids.tolist():
        if not 0 <= number < count:
            expected = f"0 to {count - 1}, positions in the target's list"
            raise _error(name, f"id {number}", expected, "Correct the id; the first point is 0")
    numbers, repeats = np.unique(ids, return_counts=True)
    if (repeats > 1).any():
        raise _error(name, f"id {numbers[repeats > 1][0]} twice", "each point once", "Remove one of the two")
    inside = ((uv >= -0.5) & (uv <= np.array(size_wh) - 0.5)).all(axis=1)
    if not inside.all():
        first = int(np.flatnonzero(~inside)[0])
        found = f"point {ids[first]} at u {uv[first, 0]:g}, v {uv[first, 1]:g}"
        expected = f"pixels inside the photograph of {size_wh[0]} × {size_wh[1]}"
        raise _error(name, found, expected, "Give u (column) and v (row) in pixels, 0 at the first pixel's centre")
    if not (np.isfinite(deviation) & (deviation > 0)).all():
        raise _error(name, "a standard deviation that is not positive", "pixels above 0", "Leave it out if unknown")
    order = np.argsort(ids)
    covariance = deviation[order, None, None] ** 2 * np.eye(2)
    return FoundPoints(ids=ids[order], uv=uv[order], covariance_px2=covariance)


def _error(name: str, found: str, expected: str, remedy: str) -> CalibrationError:
    return CalibrationError(name, found=found, expected=expected, remedy=remedy)
