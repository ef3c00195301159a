"""Covariance of the parameters, for independent and for shared errors.

Corner errors of one photograph are not independent: defocus, light and the lens's remainder shift neighbours alike.
The inverse of the normal matrix does not include this. The scatter of the views' own pulls on the minimum does: V = Σ
dᵥ dᵥᵀ, with dᵥ the step towards which view v's residuals pull. This is the *sandwich* covariance clustered by views,
with the small-sample correction CR2 (Bell and McCaffrey 2002, Survey Methodology 28): a view has drawn its own camera
and station towards itself, so its residuals are smaller than its errors.
"""

from __future__ import annotations

import numpy as np

from mammometry.calibration.adjust.least_squares import inverse
from mammometry.calibration.adjust.robust import Solved
from mammometry.geometry.arrays import Array, Float64

_LEAST_REST = 0.1  # a view that tells nine tenths of what is known of something cannot be judged by the others
_LEAST_SHARE = 1e-12
"""Smallest share that is divided by, against rounding."""


def independent_covariance(solved: Solved) -> Float64[Array, "p p"]:
    """Inverse normal matrix of cameras and stations, times the residuals' variance factor.

    Zero where held.

    Raises:
        SingularNormalEquationsError: the observations do not determine the parameters.
        ValueError: there are no more coordinates than parameters.
    """
    problem = solved.problem
    covariance = inverse(problem.normal_equations(solved.state))
    covariance[problem.held] = 0.0
    covariance[:, problem.held] = 0.0
    priors = int(np.isfinite(problem.network.prior_intrinsics_std).sum()) + 3 * len(problem.network.free_points)
    motion_parameters = int((~problem.held).sum()) + 3 * len(problem.network.free_points)
    redundancy = 2 * int(problem.active.sum()) + priors - motion_parameters
    if redundancy <= 0:
        raise ValueError(f"{int(problem.active.sum())} points for {motion_parameters} parameters")
    return covariance * (2 * problem.cost(solved.state) / redundancy)


def clustered_covariance(solved: Solved, independent: Float64[Array, "p p"]) -> Float64[Array, "p p"]:
    """Covariance of errors that the points of a view share.

    Nowhere below the independent one. There are fewer views than parameters, so that directions in which no view
    happens to pull would seem to be known exactly, and others too badly. In the independent covariance's units, in
    which they all are alike where errors are independent, the variances are therefore drawn half-way to their mean.
    """
    free = ~solved.problem.held
    lower = np.linalg.cholesky(independent[np.ix_(free, free)])
    scaled = np.linalg.solve(lower, _shifts(solved)[:, free].T)
    variances, vectors = np.linalg.eigh(scaled @ scaled.T)
    root = lower @ vectors * np.sqrt(np.maximum((variances + variances.mean()) / 2, 1.0))
    covariance = np.zeros_like(independent)
    covariance[np.ix_(free, free)] = root @ root.T
    return covariance


def _shifts(solved: Solved) -> Float64[Array, "v p"]:
    """Newton step towards which each view's residuals pull, its leverage undone."""
    problem, state = solved.problem, solved.state
    equations = problem.normal_equations(state)
    _, by_triple = equations.reduced()
    everything, without_points = inverse(equations), inverse(equations.without_triples())
    shifts = []
    for seen in problem.linearised(state):
        free = ~problem.held[seen.columns]
        columns, flat = seen.columns[free], seen.by_pose[:, :, free].reshape(-1, int(free.sum()))
        residual = _without_leverage(flat, without_points[np.ix_(columns, columns)], seen.residual.ravel())
        pull = np.zeros(len(everything))
        pull[columns] = flat.T @ residual
        if len(seen.order):
            of_points = np.einsum("nij,ni->nj", seen.by_point, residual.reshape(-1, 2))
            pull -= np.einsum("pni,ni->p", by_triple[:, seen.order], of_points)
        shifts.append(everything @ pull)
    return np.stack(shifts)


def _without_leverage(
    flat: Float64[Array, "m k"], covariance: Float64[Array, "k k"], residual: Float64[Array, " m"]
) -> Float64[Array, " m"]:
    """A view's residuals without leverage: (1 − J C Jᵀ)^−½ r.

    J is by the view's own camera and station. The result is as large as the errors. The target's points, which all
    views share, are taken as fixed here.
    """
    root = flat @ np.linalg.cholesky(covariance)
    shares, vectors = np.linalg.eigh(root.T @ root)
    shares = np.maximum(shares, _LEAST_SHARE)
    factor = (1.0 / np.sqrt(np.maximum(1.0 - shares, _LEAST_REST)) - 1.0) / shares
    raised: Float64[Array, " m"] = residual + root @ (vectors @ (factor * (vectors.T @ (root.T @ residual))))
    return raised
