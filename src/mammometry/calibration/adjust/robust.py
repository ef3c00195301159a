"""Robust adjustment: estimates the noise and leaves out gross errors."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from mammometry.calibration.adjust.adjustment import Adjustment
from mammometry.calibration.adjust.least_squares import Minimum, minimise
from mammometry.calibration.adjust.network import Network, State, residuals
from mammometry.geometry.arrays import Array, Bool, Float64

HUBER_MAD = 3.0
"""Residuals up to this many robust standard deviations count in full, larger ones linearly."""
REJECT_SIGMA = 10.0
"""Robust standard deviations beyond which points are left out of the last adjustment. Photographs of one capture
differ twofold in noise, so ten of all photographs' are five of the worst one's. Nearer points do no harm, since they
count linearly only.
"""
_MAX_ITERATIONS = 50
"""Levenberg–Marquardt steps of one adjustment. 5–15 are usual."""

GROUPS = 2
"""Groups of views with their own noise: the rig's target, and the cameras' separate photographs."""
RAYLEIGH_MEDIAN = float(np.sqrt(2 * np.log(2)))
"""Median length of a two-dimensional residual with unit standard deviation in each coordinate."""

_SIGMA_ROUNDS = 8
"""Estimates of the noise, at most."""
_SIGMA_SETTLED = 0.01
"""Relative change of the noise that counts as none."""
_LEAST_SIGMA = 0.05
"""Least factor on the detections' standard deviations: exact pictures would have none."""
_ROUGH = 1e-2  # standard deviations: enough while noise and outliers are still being found
_REJECT_ROUNDS = 3
"""Times that outliers are sought again, at most."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Solved:
    """A problem without its outliers, and its minimum."""

    problem: Adjustment
    minimum: Minimum[State]

    @property
    def state(self) -> State:
        """Values of all parameters at the minimum."""
        return self.minimum.state


def adjusted(network: Network, held: Bool[Array, " p"], start: State) -> Solved:
    """Adjust with the noise estimated along the way, then without outliers."""
    problem = Adjustment(
        network=network,
        active=np.ones(len(network.uv), bool),
        held=held,
        group_sigma=np.ones(GROUPS),
        huber=HUBER_MAD,
    )
    problem = _with_sigma(problem, start)
    most = _MAX_ITERATIONS
    for _ in range(_SIGMA_ROUNDS):
        start = minimise(problem, start, max_iterations=most, tolerance=_ROUGH).state
        before, problem = problem.group_sigma, _with_sigma(problem, start)
        if (np.abs(problem.group_sigma / before - 1) < _SIGMA_SETTLED).all():
            break
    for _ in range(_REJECT_ROUNDS):
        active: Bool[Array, " n"] = problem.whitened_lengths(start) < REJECT_SIGMA
        if (active == problem.active).all():
            break
        problem = replace(problem, active=active)
        start = minimise(problem, start, max_iterations=most, tolerance=_ROUGH).state
        problem = _with_sigma(problem, start)
    return Solved(problem=problem, minimum=minimise(problem, start, max_iterations=most))


def bad_views(network: Network, state: State, ratio: float, least_px: float) -> dict[int, float]:
    """View → median residual, px, if far beyond its group's others."""
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
    """The same with each group's noise from its active points' residuals."""
    length = problem.whitened_lengths(state)
    group = problem.network.view_group[problem.network.view]
    sigma = problem.group_sigma.copy()
    for i in range(GROUPS):
        member = (group == i) & problem.active
        if member.any():
            sigma[i] = max(sigma[i] * robust_sigma(length[member]), _LEAST_SIGMA)
    return replace(problem, group_sigma=sigma)
