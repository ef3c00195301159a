"""Fits of spheres and planes, widths, and their uncertainties, found by leaving cells out."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from scipy import special

from mammometry.base.value import value
from mammometry.geometry.arrays import Array, Bool, Float64, Int64

LEFT_OUT = 0.003
"""Share of the points, those with the largest deviations, that may be excluded from a fit (VDI/VDE 2634)."""
DISPERSION = 0.95
"""Share of the points that a form error must contain (ISO 10360-13)."""
_STEPS = 30  # most Gauss–Newton steps; four are usual
_CONVERGED = 1e-10  # change of the parameters, relative to the radius


@value(eq=False)
class SphereFit:
    """Least-squares sphere."""

    centre: Float64[Array, 3]
    """mm, frame of the points."""
    radius_mm: float

    def deviations(self, points: Float64[Array, "n 3"]) -> Float64[Array, " n"]:
        """Distances of points from the sphere, mm, positive outside."""
        return np.asarray(np.linalg.norm(points - self.centre, axis=1) - self.radius_mm)


@value(eq=False)
class PlaneFit:
    """Least-squares plane."""

    point: Float64[Array, 3]
    """Weighted mean of the points, mm."""
    normal: Float64[Array, 3]
    """Unit length, towards the front of the surface."""

    def deviations(self, points: Float64[Array, "n 3"]) -> Float64[Array, " n"]:
        """Distances of points from the plane, mm, positive on the side of the normal."""
        return np.asarray((points - self.point) @ self.normal)


def fit_sphere(
    points: Float64[Array, "n 3"], weights: Float64[Array, " n"], start: SphereFit | None = None
) -> SphereFit:
    """Fit the sphere with the smallest weighted sum of squared distances.

    Args:
        points: at least four points that are not in a plane, mm.
        weights: weights of the points, such as the area that each represents.
        start: sphere near the result; None: the algebraic fit.

    Raises:
        numpy.linalg.LinAlgError: the points do not determine a sphere.
    """
    middle = np.average(points, axis=0, weights=weights)
    moved = points - middle
    if start is None:
        unknowns = _solved(np.column_stack([2 * moved, np.ones(len(moved))]), (moved**2).sum(axis=1), weights)
        centre, radius = unknowns[:3], float(np.sqrt(max(unknowns[3] + unknowns[:3] @ unknowns[:3], 0.0)))
    else:
        centre, radius = start.centre - middle, start.radius_mm
    for _ in range(_STEPS):
        away = moved - centre
        distance = np.linalg.norm(away, axis=1)
        rows = np.column_stack([-away / np.maximum(distance, 1e-12)[:, None], -np.ones(len(away))])
        step = _solved(rows, radius - distance, weights)
        centre, radius = centre + step[:3], radius + float(step[3])
        if np.abs(step).max() <= _CONVERGED * abs(radius):
            break
    return SphereFit(centre=centre + middle, radius_mm=radius)


def _solved(
    rows: Float64[Array, "n k"], right: Float64[Array, " n"], weights: Float64[Array, " n"]
) -> Float64[Array, " k"]:
    weighted = rows * weights[:, None]
    return np.asarray(np.linalg.solve(rows.T @ weighted, weighted.T @ right))


def fit_plane(points: Float64[Array, "n 3"], weights: Float64[Array, " n"], front: Float64[Array, 3]) -> PlaneFit:
    """Fit the plane with the smallest weighted sum of squared distances.

    Args:
        points: at least three points that are not on a line, mm.
        weights: weights of the points.
        front: a direction on the side to which the normal points.
    """
    middle = np.average(points, axis=0, weights=weights)
    moved = points - middle
    _, axes = np.linalg.eigh(moved.T @ (moved * weights[:, None]))
    normal = axes[:, 0]
    return PlaneFit(point=middle, normal=normal if normal @ front >= 0 else -normal)


def narrowest_width(deviations: Float64[Array, " n"], weights: Float64[Array, " n"], share: float) -> float:
    """Width of the narrowest interval that contains a share of the weight, mm."""
    order = np.argsort(deviations)
    return _narrowest(deviations[order], weights[order], share)


def _narrowest(ordered: Float64[Array, " n"], weights: Float64[Array, " n"], share: float) -> float:
    below = np.concatenate([[0.0], np.cumsum(weights)])
    wanted = below[:-1] + share * below[-1]
    ends = np.searchsorted(below[1:], wanted * (1 - 1e-12))
    inside = ends < len(ordered)
    return float((ordered[ends[inside]] - ordered[inside]).min())


def within_rule(deviations: Float64[Array, " n"], share: float = LEFT_OUT) -> Bool[Array, " n"]:
    """Mask of the points used in a fit: all but the 0.3 % farthest from the median deviation."""
    few = int(share * len(deviations))
    kept = np.ones(len(deviations), dtype=bool)
    if few:
        distance = np.abs(deviations - np.median(deviations))
        kept[np.argpartition(distance, len(distance) - few)[len(distance) - few :]] = False
    return kept


def sphere_shifts(
    fit: SphereFit, points: Float64[Array, "n 3"], weights: Float64[Array, " n"], cells: Int64[Array, " n"]
) -> Float64[Array, "c 4"]:
    """Change of a sphere's centre and radius, mm, as each cell of points is left out in turn.

    One Gauss–Newton step from the fit to all points.

    Args:
        fit: fit to all points.
        points: mm.
        weights: weights of the points.
        cells: cell of each point, from 0.
    """
    away = points - fit.centre
    distance = np.linalg.norm(away, axis=1)
    rows = np.column_stack([away / np.maximum(distance, 1e-12)[:, None], np.ones(len(away))])
    right = (distance - fit.radius_mm) * weights
    count = int(cells.max()) + 1
    matrix, vector = np.empty((count, 4, 4)), np.empty((count, 4))
    for i in range(4):
        vector[:, i] = np.bincount(cells, rows[:, i] * right, minlength=count)
        for j in range(4):
            matrix[:, i, j] = np.bincount(cells, rows[:, i] * rows[:, j] * weights, minlength=count)
    full, rest = matrix.sum(axis=0), vector.sum(axis=0)
    return np.asarray(np.linalg.solve(full - matrix, (rest - vector)[..., None])[..., 0])


def width_shifts(
    deviations: Float64[Array, " n"], weights: Float64[Array, " n"], cells: Int64[Array, " n"], share: float
) -> Float64[Array, "c 1"]:
    """Width that contains a share of the points, mm, as each cell is left out in turn."""
    order = np.argsort(deviations)
    ordered, weights, cells = deviations[order], weights[order], cells[order]
    kept = (cells != cell for cell in range(int(cells.max()) + 1))
    return np.array([[_narrowest(ordered[used], weights[used], share)] for used in kept])


def jackknife_std(partitions: Iterable[Float64[Array, "c k"]]) -> Float64[Array, " k"]:
    """Standard uncertainties of estimates, from their values as each cell of points is left out in turn.

    Errors of neighbouring points are correlated, so cells instead of points are treated as independent. The range of
    the correlation is unknown, so the largest uncertainty over several sizes of cells is used. The scatter of few cells
    is uncertain, so each is multiplied by the ratio of the 97.5 % quantile of Student's t to that of the normal
    distribution.

    Args:
        partitions: for each size of cells, the estimates as each cell is left out in turn.
    """
    found = []
    for values in partitions:
        count = len(values)
        widened = special.stdtrit(count - 1, 0.975) / special.ndtri(0.975)
        found.append(widened**2 * (count - 1) / count * ((values - values.mean(axis=0)) ** 2).sum(axis=0))
    return np.asarray(np.sqrt(np.max(found, axis=0)))
