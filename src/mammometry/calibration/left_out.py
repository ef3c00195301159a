"""Cross-validation: poses that take no part in the adjustment are to fit as well as those that do."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from mammometry.calibration.adjustment import Adjustment
from mammometry.calibration.least_squares import minimise
from mammometry.calibration.network import residuals
from mammometry.calibration.robust import Solved
from mammometry.geometry.arrays import Array, Int64

_FOLDS = 12
_STEPS = 4  # from the minimum of all poses, which is near: the second step is already below a tenth of the noise
_NEAR = 0.1  # standard deviations


@dataclass(frozen=True, slots=True, kw_only=True)
class LeftOut:
    """Residuals of poses with and without them in the adjustment."""

    poses: int
    """How many could be left out: all, but those without which a camera would lose its place."""
    fitted_px: float
    """RMS length of these poses' residuals in the adjustment of all."""
    left_out_px: float
    """The same when each pose is left out in its turn: all else is adjusted without it, then only its target's
    placement is found, its points as the other poses have them."""

    @property
    def ratio(self) -> float:
        """Left out over fitted: 1 where the cameras fit what they have not seen as well as what they have."""
        return self.left_out_px / self.fitted_px


def leave_poses_out(solved: Solved) -> LeftOut | None:
    """Leave out each shared pose in turn, several at once where there are many; None where none can be spared."""
    problem, state = solved.problem, solved.state
    network = problem.network
    fitted_px, _ = residuals(network, state)
    shared = sorted(set(network.view_station[network.view_group == 0].tolist()))
    squares_fitted, squares_left_out, count, poses = 0.0, 0.0, 0, 0
    for fold in (shared[i::_FOLDS] for i in range(min(_FOLDS, len(shared)))):
        members = np.flatnonzero(np.isin(network.view_station, fold))
        rest = network.view_camera[(network.view_group == 0) & ~np.isin(network.view_station, fold)]
        if not set(network.view_camera[members].tolist()) <= set(rest.tolist()):
            continue
        rows = np.isin(network.view, members)
        datum = next(station for station in shared if station not in fold)
        without = replace(_holding(problem, [*fold, datum]), active=problem.active & ~rows)
        elsewhere = minimise(without, state, max_iterations=_STEPS, tolerance=_NEAR).state
        placing = _placing(problem, members, fold)
        placed = minimise(placing, elsewhere, max_iterations=_STEPS, tolerance=_NEAR).state
        left_out_px, _ = residuals(placing.network, placed)
        squares_fitted += float(np.sum(fitted_px[rows & problem.active] ** 2))
        squares_left_out += float(np.sum(left_out_px[placing.active] ** 2))
        count += int(placing.active.sum())
        poses += len(fold)
    if not count:
        return None
    return LeftOut(
        poses=poses,
        fitted_px=float(np.sqrt(squares_fitted / count)),
        left_out_px=float(np.sqrt(squares_left_out / count)),
    )


def _holding(problem: Adjustment, stations: Sequence[int]) -> Adjustment:
    """Hold these stations and no other: left-out ones, which nothing determines, and one to be the datum."""
    held = problem.held.copy()
    for station in range(len(problem.network.stations)):
        held[problem.network.columns_of_station(station)] = station in stations
    return replace(problem, held=held)


def _placing(problem: Adjustment, members: Int64[Array, " v"], stations: Sequence[int]) -> Adjustment:
    """The problem of these stations' placements alone: cameras and the target's points stay as they are."""
    network = problem.network.of_views(members.tolist())
    network = replace(network, prior_mm=np.full_like(network.prior_mm, np.inf))
    held = np.ones_like(problem.held)
    for station in stations:
        held[network.columns_of_station(station)] = False
    return replace(problem, network=network, held=held, active=problem.active[np.isin(problem.network.view, members)])
