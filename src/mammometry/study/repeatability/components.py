"""Variance components of a table with random effects, balanced or not.

Estimates by restricted maximum likelihood (REML) with Fisher scoring and components of 0 or more: Searle, Casella and
McCulloch, Variance Components, 1992, chapter 6. The analysis of variance (Henderson's method 3, chapter 5) is the
closed form for balanced tables, where both give the same unless a component is negative, so each checks the other.
Intervals are by Graybill and Wang for sums of mean squares (Journal of the American Statistical Association 75 (1980)
869). They are valid with two or three raters, where Satterthwaite's are too short.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import scipy  # scipy.stats, which takes half a second to import, is imported on first use

from mammometry.base.value import value
from mammometry.geometry.arrays import Array, Float64, Int64

MOST_ROWS = 1500
"""Most rows of a table: time grows with the third power, and 1,500 rows take about a minute."""
_STEPS = 200  # most scoring steps; balanced tables need fewer than 20
_CONVERGED = 1e-9  # relative change of all components
_LEAST_SHARE = 1e-9  # share of the total variance below which a component is 0
_SINGULAR = 1e-9  # least reciprocal condition number of the equations: below it, components cannot be separated
_ROUNDING = 1e-10  # weights of mean squares below this are 0
_TAIL = 0.025  # probability on each side of a 95 % interval


@value(eq=False)
class Components:
    """Variances of the random effects, and last of the residual, in the square of the values' unit."""

    variances: Float64[Array, " k"]
    """Estimates by REML, 0 or more."""
    moments: Float64[Array, " k"]
    """Estimates by the analysis of variance, which may be negative."""
    mean_squares: Float64[Array, " k"]
    """Mean squares of the analysis of variance, each adjusted for the effects that are not finer."""
    degrees: Float64[Array, " k"]
    """Their degrees of freedom."""
    expected: Float64[Array, "k k"]
    """Row → coefficients of the variances in the expectation of that mean square."""

    def sum_of(self, places: Sequence[int]) -> float:
        """Sum of some variances, estimated by REML."""
        return float(self.variances[list(places)].sum())

    def interval_of(self, places: Sequence[int]) -> tuple[float, float]:
        """95 % interval of a sum of variances. It includes the estimate by REML."""
        terms = self._weights(places) * self.mean_squares
        low, high = (np.array([bounds[side] for bounds in map(chi_square_bounds, self.degrees)]) for side in (0, 1))
        below, above = 1 - low, high - 1
        centre, own = float(terms.sum()), self.sum_of(places)
        bounds = (
            centre - float(np.linalg.norm(terms * np.where(terms > 0, below, above))),
            centre + float(np.linalg.norm(terms * np.where(terms > 0, above, below))),
        )
        return max(min(bounds[0], own), 0.0), max(bounds[1], own)

    def degrees_of(self, places: Sequence[int]) -> float:
        """Satterthwaite's degrees of freedom for a sum of variances. 0 if the sum is not positive."""
        terms = self._weights(places) * self.mean_squares
        total = float(terms.sum())
        return total**2 / float((terms**2 / self.degrees).sum()) if total > 0 else 0.0

    def deviation(self, places: Sequence[int]) -> tuple[float, tuple[float, float], float]:
        """Square root of a sum of variances, its 95 % interval, and degrees of freedom."""
        low, high = self.interval_of(places)
        return self.sum_of(places) ** 0.5, (low**0.5, high**0.5), self.degrees_of(places)

    def _weights(self, places: Sequence[int]) -> Float64[Array, " k"]:
        """Weights with which the mean squares' expectations add up to the sum of these variances."""
        chosen = np.zeros(len(self.variances))
        chosen[list(places)] = 1.0
        found = np.linalg.solve(self.expected.T, chosen)
        return np.where(np.abs(found) < _ROUNDING, 0.0, found)


def chi_square_bounds(df: float) -> tuple[float, float]:
    """Factors for the 95 % interval of a variance with these degrees of freedom."""
    with np.errstate(divide="ignore", over="ignore"):
        low, high = (float(df / scipy.stats.chi2.ppf(q, df)) for q in (1 - _TAIL, _TAIL))
    return low, high


def components(values: Float64[Array, " n"], groups: Sequence[Int64[Array, " n"]]) -> Components:
    """Estimate the components of variance.

    Args:
        values: one value per row.
        groups: for each random effect, the group of each row, from 0.

    Raises:
        ValueError: there are more than `MOST_ROWS` rows, or effects cannot be separated.
    """
    n = len(values)
    if n > MOST_ROWS:
        raise ValueError(f"{n} rows; {MOST_ROWS} at most")
    scale = float(values.std()) or 1.0
    centred = (values - values.mean()) / scale
    kernels = [np.asarray(group[:, None] == group[None, :], dtype=np.float64) for group in groups] + [np.eye(n)]
    squares, degrees, expected = _analysis(centred, groups, kernels)
    moments = np.linalg.solve(expected, squares)
    return Components(
        variances=_scored(centred, kernels, moments) * scale**2,
        moments=moments * scale**2,
        mean_squares=squares * scale**2,
        degrees=degrees,
        expected=expected,
    )


def _analysis(
    y: Float64[Array, " n"], groups: Sequence[Int64[Array, " n"]], kernels: Sequence[Float64[Array, "n n"]]
) -> tuple[Float64[Array, " k"], Float64[Array, " k"], Float64[Array, "k k"]]:
    """Mean squares, their degrees of freedom and expectations.

    Each effect is adjusted for all effects that are not finer, so that differences between women do not affect the mean
    squares of other effects.
    """
    n, k = len(y), len(kernels)
    squares, degrees, expected = np.zeros(k), np.zeros(k), np.zeros((k, k))
    indicators = [np.eye(int(group.max()) + 1)[group] for group in groups] + [np.eye(n)]
    for place in range(k):
        others = [indicators[other] for other in range(k - 1) if other != place and not _finer(kernels, other, place)]
        basis = _range(np.hstack([np.full((n, 1), n**-0.5), *others]))
        added = _range(indicators[place] - basis @ (basis.T @ indicators[place]))
        if not added.shape[1]:
            raise ValueError("effects that cannot be separated")
        degrees[place] = added.shape[1]
        squares[place] = float(((added.T @ y) ** 2).sum()) / degrees[place]
        expected[place] = [float(((kernel @ added) * added).sum()) / degrees[place] for kernel in kernels]
    if np.linalg.cond(expected / np.abs(expected).max(axis=0)) > 1 / _SINGULAR:
        raise ValueError("effects that cannot be separated")
    return squares, degrees, expected


def _finer(kernels: Sequence[Float64[Array, "n n"]], one: int, other: int) -> bool:
    """Whether rows in the same group of one effect are in the same group of the other."""
    return bool((kernels[one] <= kernels[other]).all())


def _range(columns: Float64[Array, "n m"]) -> Float64[Array, "n r"]:
    """Orthonormal basis of the space spanned by the columns."""
    vectors, sizes, _ = np.linalg.svd(columns, full_matrices=False)
    return np.asarray(vectors[:, sizes > _SINGULAR * len(columns)])


def _projection(kernels: Sequence[Float64[Array, "n n"]], variances: Float64[Array, " k"]) -> Float64[Array, "n n"]:
    """P = V⁻¹ − V⁻¹1 (1ᵀV⁻¹1)⁻¹ 1ᵀV⁻¹."""
    total = sum(variance * kernel for variance, kernel in zip(variances, kernels, strict=True) if variance)
    inverse = scipy.linalg.cho_solve(scipy.linalg.cho_factor(total, lower=True), np.eye(len(kernels[0])))
    rows = inverse.sum(axis=1)
    return np.asarray(inverse - np.outer(rows, rows) / float(rows.sum()))


def _information(projection: Float64[Array, "n n"], kernels: Sequence[Float64[Array, "n n"]]) -> Float64[Array, "k k"]:
    products = [projection @ kernel for kernel in kernels[:-1]] + [projection]
    return np.array([[0.5 * float((one * other.T).sum()) for other in products] for one in products])


def _likelihood(
    y: Float64[Array, " n"], kernels: Sequence[Float64[Array, "n n"]], variances: Float64[Array, " k"]
) -> float:
    """Restricted log-likelihood, apart from a constant."""
    total = sum(variance * kernel for variance, kernel in zip(variances, kernels, strict=True) if variance)
    factor, lower = scipy.linalg.cho_factor(total, lower=True)
    ones = scipy.linalg.cho_solve((factor, lower), np.ones(len(y)))
    own = scipy.linalg.cho_solve((factor, lower), y)
    weight = float(ones.sum())
    quadratic = float(y @ own) - float(ones @ y) ** 2 / weight
    return -float(np.log(np.diag(factor)).sum()) - 0.5 * (np.log(weight) + quadratic)


def _scored(
    y: Float64[Array, " n"], kernels: Sequence[Float64[Array, "n n"]], start: Float64[Array, " k"]
) -> Float64[Array, " k"]:
    """Fisher scoring. Components that would become negative are removed while the likelihood favours it."""
    variances = np.where(start > _LEAST_SHARE, start, 0.0)
    variances[-1] = max(variances[-1], 1e-3)  # the values have variance 1; the residual stays positive
    best = _likelihood(y, kernels, variances)
    for _ in range(_STEPS):
        projection = _projection(kernels, variances)
        own = projection @ y
        score = np.array([0.5 * (float(own @ kernel @ own) - float((projection * kernel).sum())) for kernel in kernels])
        information = _information(projection, kernels)
        free = np.flatnonzero((variances > 0) | (score > 0))
        step = np.zeros_like(variances)
        step[free] = np.linalg.solve(information[np.ix_(free, free)], score[free])
        length = 1.0
        while True:
            found = np.maximum(variances + length * step, 0.0)
            found[-1] = max(found[-1], _LEAST_SHARE)
            found[:-1][found[:-1] < _LEAST_SHARE] = 0.0
            reached = _likelihood(y, kernels, found)
            if reached >= best - 1e-12 or length < 1e-6:  # rounding error of a likelihood of the order of its rows
                break
            length /= 2
        moved = float(np.abs(found - variances).max()) / float(found.sum())
        left = bool(((found == 0) & (variances > 0)).any())  # then the others have not moved to where they belong
        variances, best = found, reached
        if moved < _CONVERGED and not left:
            break
    return variances
