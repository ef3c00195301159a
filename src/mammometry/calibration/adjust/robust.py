"""Robust adjustment: noise estimate, outliers, and the parameters' covariance.

Corner errors of one photograph are not independent: defocus, light and lens errors shift neighbours alike. The inverse
of the normal matrix does not include this, but the scatter between views does: V = Σ dᵥ dᵥᵀ, where dᵥ is the step that
view v's residuals cause. This is the *sandwich* covariance clustered by views, with the small-sample correction CR2
(Bell and McCaffrey 2002, Survey Methodology 28): the adjustment has fitted a view's camera and station to it, so its
residuals are smaller than its errors.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from mammometry.calibration.adjust.adjustment import Adjustment
from mammometry.calibration.adjust.least_squares import Minimum, inverse, minimise
from mammometry.calibration.adjust.network import Network, State, residuals
from mammometry.geometry.arrays import Array, Bool, Float64

HUBER_MAD = 3.0
"""Robust standard deviations up to which residuals count quadratically; larger ones count linearly."""
REJECT_SIGMA = 10.0
"""Robust standard deviations beyond which points are excluded from the last adjustment. The noise of one capture's
photographs differs by a factor of two, so ten for all photographs together are five for the worst one. Smaller outliers
do no harm, since their loss is only linear."""
_MAX_ITERATIONS = 50
"""Levenberg–Marquardt steps of one adjustment. 5–15 are usual."""

GROUPS = 2
"""Groups of views with their own noise: the rig's target, and the cameras' separate photographs."""
RAYLEIGH_MEDIAN = float(np.sqrt(2 * np.log(2)))
"""Median length of a two-dimensional residual with unit standard deviation in each coordinate."""

_SIGMA_ROUNDS = 8
"""Most estimates of the noise."""
_SIGMA_SETTLED = 0.01
"""Relative change of the noise below which it has converged."""
_LEAST_SIGMA = 0.05
"""Smallest factor on the detections' standard deviations. Exact synthetic images would have none."""
_ROUGH = 1e-2  # standard deviations: tolerance while noise and outliers are estimated
_REJECT_ROUNDS = 3
"""Most searches for outliers."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RobustResult:
    """A problem without outliers, and its minimum."""

    problem: Adjustment
    minimum: Minimum[State]

    @property
    def state(self) -> State:
        """Values of all parameters at the minimum."""
        return self.minimum.state


def adjusted(network: Network, held: Bool[Array, " p"], start: State) -> RobustResult:
    """Adjust while estimating the noise, then without outliers."""
    problem = Adjustment(
        network=network, active=np.ones(len(network.uv), bool), held=held, group_sigma=np.ones(GROUPS), huber=HUBER_MAD
    )
    problem = _with_sigma(problem, start)
    for _ in range(_SIGMA_ROUNDS):
        start = minimise(problem, start, max_iterations=_MAX_ITERATIONS, tolerance=_ROUGH).state
        before, problem = problem.group_sigma, _with_sigma(problem, start)
        if (np.abs(problem.group_sigma / before - 1) < _SIGMA_SETTLED).all():
            break
    for _ in range(_REJECT_ROUNDS):
        active: Bool[Array, " n"] = problem.whitened_lengths(start) < REJECT_SIGMA
        if (active == problem.active).all():
            break
        problem = replace(problem, active=active)
        start = minimise(problem, start, max_iterations=_MAX_ITERATIONS, tolerance=_ROUGH).state
        problem = _with_sigma(problem, start)
    return RobustResult(problem=problem, minimum=minimise(problem, start, max_iterations=_MAX_ITERATIONS))


def bad_views(network: Network, state: State, ratio: float, least_px: float) -> dict[int, float]:
    """View → median residual, px, of views far above the others of their group."""
    residual_px, depth = residuals(network, state)
    length = np.where(depth > 0, np.linalg.norm(residual_px, axis=1), np.inf)
    starts = network.view_start
    medians = np.array([np.median(length[starts[i] : starts[i + 1]]) for i in range(len(network.view_camera))])
    bad: dict[int, float] = {}
    for group in range(GROUPS):
        member = network.view_group == group
        if member.any():
            limit = max(least_px, ratio * float(np.median(medians[member])))
            bad |= {int(i): float(medians[i]) for i in np.flatnonzero(member & (medians > limit))}
    return dict(sorted(bad.items()))


def robust_sigma(lengths: Float64[Array, " n"]) -> float:
    """Standard deviation per coordinate of two-dimensional residuals. From the median of their lengths."""
    return float(np.median(lengths)) / RAYLEIGH_MEDIAN


def _with_sigma(problem: Adjustment, state: State) -> Adjustment:
    """Update each group's noise from the residuals of its used points."""
    length = problem.whitened_lengths(state)
    group = problem.network.view_group[problem.network.view]
    sigma = problem.group_sigma.copy()
    for i in range(GROUPS):
        member = (group == i) & problem.active
        if member.any():
            sigma[i] = max(sigma[i] * robust_sigma(length[member]), _LEAST_SIGMA)
    return replace(problem, group_sigma=sigma)


_LEAST_REST = 0.1  # smallest share of the other views' information about a view's parameters
_LEAST_SHARE = 1e-12
"""Smallest share used as a divisor, against rounding."""


def independent_covariance(solved: RobustResult) -> Float64[Array, "p p"]:
    """Inverse normal matrix of cameras and stations, times the residuals' variance factor. Zero if held.

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


def clustered_covariance(solved: RobustResult, independent: Float64[Array, "p p"]) -> Float64[Array, "p p"]:
    """Covariance of errors shared by the points of a view.

    No variance is smaller than the independent one. There are fewer views than parameters, so some directions would
    seem exact and others too uncertain. Therefore the variances, in units of the independent ones, are moved half-way
    to their mean.
    """
    free = ~solved.problem.held
    lower = np.linalg.cholesky(independent[np.ix_(free, free)])
    scaled = np.linalg.solve(lower, _shifts(solved)[:, free].T)
    variances, vectors = np.linalg.eigh(scaled @ scaled.T)
    root = lower @ vectors * np.sqrt(np.maximum((variances + variances.mean()) / 2, 1.0))
    covariance = np.zeros_like(independent)
    covariance[np.ix_(free, free)] = root @ root.T
    return covariance


def _shifts(solved: RobustResult) -> Float64[Array, "v p"]:
    """Newton step due to each view's residuals, corrected for leverage."""
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
    """A view's residuals corrected for leverage: (1 − J C Jᵀ)^−½ r.

    J is the derivative by the view's own camera and station. The result has the size of the errors. The target's
    points, which all views share, are treated as fixed.
    """
    root = flat @ np.linalg.cholesky(covariance)
    shares, vectors = np.linalg.eigh(root.T @ root)
    shares = np.maximum(shares, _LEAST_SHARE)
    factor = (1.0 / np.sqrt(np.maximum(1.0 - shares, _LEAST_REST)) - 1.0) / shares
    raised: Float64[Array, " m"] = residual + root @ (vectors @ (factor * (vectors.T @ (root.T @ residual))))
    return raised
