"""Cross-validation: poses that take no part in the adjustment are to fit as well as those that do."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from mammometry.calibration.adjustment import Adjustment
from mammometry.calibration.least_squares import minimise
from mammometry.calibration.network import residuals
from mammometry.calibration.robust import Solved

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
    """Leave out each shared pose in turn; None where none can be spared."""
    problem, state = solved.problem, solved.state
    network = problem.network
    view = network.view
    squares_fitted, squares_left_out, count, poses = 0.0, 0.0, 0, 0
    fitted_px, _ = residuals(network, state)
    shared = sorted(set(network.view_station[network.view_group == 0].tolist()))
    for station in shared:
        members = np.flatnonzero(network.view_station == station)
        others = set(network.view_camera[(network.view_group == 0) & (network.view_station != station)].tolist())
        if not set(network.view_camera[members].tolist()) <= others:
            continue
        without = _moved_datum(problem, station, next(other for other in shared if other != station))
        rows = np.isin(view, members)
        without = replace(without, active=problem.active & ~rows)
        elsewhere = minimise(without, state, max_iterations=_STEPS, tolerance=_NEAR).state
        placing, active = _placing(problem, members, station), problem.active[rows]
        placed = minimise(placing, elsewhere, max_iterations=_STEPS, tolerance=_NEAR).state
        left_out_px, _ = residuals(placing.network, placed)
        squares_fitted += float(np.sum(fitted_px[rows][active] ** 2))
        squares_left_out += float(np.sum(left_out_px[active] ** 2))
        count += int(active.sum())
        poses += 1
    if not count:
        return None
    return LeftOut(
        poses=poses,
        fitted_px=float(np.sqrt(squares_fitted / count)),
        left_out_px=float(np.sqrt(squares_left_out / count)),
    )


def _moved_datum(problem: Adjustment, station: int, other: int) -> Adjustment:
    """Hold the left-out station, which nothing determines any more; if it was the datum, another takes its place."""
    held = problem.held.copy()
    columns = problem.network.columns_of_station(station)
    if held[columns].all():
        held[problem.network.columns_of_station(other)] = True
    held[columns] = True
    return replace(problem, held=held)


def _placing(problem: Adjustment, members: np.ndarray, station: int) -> Adjustment:
    """The problem of one station's placement alone: cameras and the target's points stay as they are."""
    network = problem.network.of_views(members.tolist())
    network = replace(network, prior_mm=np.full_like(network.prior_mm, np.inf))
    held = np.ones_like(problem.held)
    held[network.columns_of_station(station)] = False
    rows = np.isin(problem.network.view, members)
    return replace(problem, network=network, held=held, active=problem.active[rows])
