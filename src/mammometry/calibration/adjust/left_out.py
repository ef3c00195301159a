"""Cross-validation: residuals of poses that were left out of the adjustment.

The adjustment without some poses starts at the minimum of all poses, which is near. Their contribution is subtracted
from the normal equations, so that a single step is enough and each observation is evaluated once for all folds. Even a
correct model fits used poses better than unused ones, by an amount that depends on the number of unknowns. This amount
is found by repeating the procedure with residuals whose signs are random, which removes correlations between neighbours
(wild bootstrap: Wu 1986, Annals of Statistics 14).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from mammometry.calibration.adjust.adjustment import Adjustment
from mammometry.calibration.adjust.least_squares import DAMPING_LEAST, NormalEquations, damped_step, minimise
from mammometry.calibration.adjust.network import State, residuals
from mammometry.calibration.adjust.robust import GROUPS, RobustResult
from mammometry.geometry.arrays import Array, Int64

_FOLDS = 12
"""Number of groups of left-out poses, for speed. Rigs with up to twelve poses leave out one at a time."""
_STEPS = 6
"""Most Levenberg–Marquardt steps without a fold, which starts near its minimum."""
_NEAR = 0.1  # tolerance of a refined result: remaining step in standard deviations
_LINEAR = 0.1  # largest relative difference of the cost's actual from its predicted decrease after a single step
_NO_PRIOR = 1e9
"""Factor on a prior's standard deviation that removes the prior's effect."""
_SEED = 0  # seed of the random signs


@dataclass(frozen=True, slots=True, kw_only=True)
class LeftOut:
    """Residuals of poses that were used and left out."""

    poses: int
    """Number of poses that could be left out without leaving a camera undetermined."""
    fitted_px: float
    """RMS length of these poses' residuals in the adjustment of all poses."""
    left_out_px: float
    """The same with each pose left out in turn: everything is adjusted without it. Then only the placement of its
    target is estimated, with the cameras and target points from the other poses."""
    chance_ratio: float
    """`ratio` if errors of the same size were independent between points: the effect of the number of unknowns
    alone."""

    @property
    def ratio(self) -> float:
        """RMS of left-out over that of used poses. 1 if the cameras fit unused poses as well as used ones."""
        return self.left_out_px / self.fitted_px

    @property
    def excess(self) -> float:
        """`ratio` over `chance_ratio`: 1 if the model is right, more if errors are shared within a pose."""
        return self.ratio / self.chance_ratio


def leave_poses_out(solved: RobustResult) -> LeftOut | None:
    """Leave out each shared pose in turn, in groups if there are many.

    If no shared pose can be spared, as with one exposure of a surveyed target, the cameras' separate photographs are
    left out instead. None if none of them can be spared either.
    """
    for group in range(GROUPS):
        found = _left_out(solved, group)
        by_chance = _left_out(_with_drawn_signs(solved), group) if found else None
        if found and by_chance:
            poses, fitted_px, left_out_px = found
            chance_ratio = by_chance[2] / by_chance[1]
            return LeftOut(poses=poses, fitted_px=fitted_px, left_out_px=left_out_px, chance_ratio=chance_ratio)
    return None


def _with_drawn_signs(solved: RobustResult) -> RobustResult:
    """Give each residual a random sign, to simulate independent errors of the same sizes, and minimise."""
    problem, state = solved.problem, solved.state
    residual_px, _ = residuals(problem.network, state)
    signs = np.random.default_rng(_SEED).choice([-1.0, 1.0], size=(len(residual_px), 1))
    uv = problem.network.uv + residual_px - signs * residual_px
    drawn = replace(problem, network=replace(problem.network, uv=uv))
    return RobustResult(problem=drawn, minimum=minimise(drawn, state, max_iterations=_STEPS, tolerance=_NEAR))


def _left_out(solved: RobustResult, group: int) -> tuple[int, float, float] | None:
    """Number of a group's poses that could be left out, and RMS of their residuals used and left out, px."""
    problem, state = solved.problem, solved.state
    network = problem.network
    fitted_px, _ = residuals(network, state)
    of_group = network.view_group == group
    stations = sorted(set(network.view_station[of_group].tolist()))
    squares_fitted, squares_left_out, count, poses = 0.0, 0.0, 0, 0
    everything = _holding(problem, []).normal_equations(state)
    for fold in (stations[i::_FOLDS] for i in range(min(_FOLDS, len(stations)))):
        members = np.flatnonzero(np.isin(network.view_station, fold))
        rest = network.view_camera[of_group & ~np.isin(network.view_station, fold)]
        if not set(network.view_camera[members].tolist()) <= set(rest.tolist()):
            continue
        rows = np.isin(network.view, members)
        datum = next(station for station in range(len(network.stations)) if station not in fold)
        without = replace(_holding(problem, [*fold, datum]), active=problem.active & ~rows)
        elsewhere = _adjusted_without(without, state, everything.minus(_of_views(problem, members, state)))
        placing = _placing(problem, members, fold)
        placed = minimise(placing, elsewhere, max_iterations=_STEPS, tolerance=_NEAR).state
        left_out_px, _ = residuals(placing.network, placed)
        squares_fitted += float(np.sum(fitted_px[rows & problem.active] ** 2))
        squares_left_out += float(np.sum(left_out_px[placing.active] ** 2))
        count += int(placing.active.sum())
        poses += len(fold)
    if not count:
        return None
    return poses, float(np.sqrt(squares_fitted / count)), float(np.sqrt(squares_left_out / count))


def _adjusted_without(without: Adjustment, state: State, equations: NormalEquations) -> State:
    """Newton step from the minimum of all poses to the one without some poses.

    If the cost does not fall as predicted, it is minimised iteratively.
    """
    step = damped_step(equations.holding(without.held), DAMPING_LEAST)
    if step is not None:
        stepped = without.moved(state, step)
        expected = -0.5 * float(equations.gradient @ step)
        if abs(without.cost(state) - without.cost(stepped) - expected) <= _LINEAR * expected + _NEAR**2 / 2:
            return stepped
    return minimise(without, state, max_iterations=_STEPS, tolerance=_NEAR).state


def _of_views(problem: Adjustment, members: Int64[Array, " v"], state: State) -> NormalEquations:
    """Contribution of these views to the normal equations, without fixed parameters."""
    network = problem.network.of_views(members.tolist())
    network = replace(
        network,
        prior_mm=_NO_PRIOR * network.prior_mm,  # free points stay free
        prior_intrinsics_std=np.full_like(network.prior_intrinsics_std, np.inf),
    )
    active = problem.active[np.isin(problem.network.view, members)]
    return replace(_holding(problem, []), network=network, active=active).normal_equations(state)


def _holding(problem: Adjustment, stations: Sequence[int]) -> Adjustment:
    """Hold only these stations: those left out, which are undetermined, and one as the datum."""
    held = problem.held.copy()
    for station in range(len(problem.network.stations)):
        held[problem.network.columns_of_station(station)] = station in stations
    return replace(problem, held=held)


def _placing(problem: Adjustment, members: Int64[Array, " v"], stations: Sequence[int]) -> Adjustment:
    """Problem of these stations' placements alone. Cameras and target points are fixed."""
    network = problem.network.of_views(members.tolist())
    network = replace(network, prior_mm=np.full_like(network.prior_mm, np.inf))
    held = np.ones_like(problem.held)
    for station in stations:
        held[network.columns_of_station(station)] = False
    return replace(problem, network=network, held=held, active=problem.active[np.isin(problem.network.view, members)])
