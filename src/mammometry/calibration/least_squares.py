"""Levenberg–Marquardt on dense normal equations; knows nothing of cameras."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Generic, Protocol, TypeVar, runtime_checkable

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from mammometry.geometry.arrays import Array, Float64

S = TypeVar("S")

_DAMPING_START = 1e-4
_DAMPING_LEAST = 1e-12
_DAMPING_MOST = 1e12


@runtime_checkable
class Problem(Protocol[S]):
    """What is minimised: half a sum of squares, or its robust relative, over a state of any kind."""

    def cost(self, state: S) -> float:
        """Half the (robust) sum of squares; infinite where the state is impossible."""

    def normal_equations(self, state: S) -> tuple[Float64[Array, "p p"], Float64[Array, " p"]]:
        """Gauss–Newton matrix and gradient of the cost by a small step of the state."""

    def moved(self, state: S, step: Float64[Array, " p"]) -> S:
        """The state after a small step."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Minimum(Generic[S]):
    """Where the descent ended."""

    state: S
    cost: float
    iterations: int
    converged: bool
    """Whether the step that was left is shorter than the tolerance."""


class SingularNormalEquationsError(ValueError):
    """The observations do not determine the parameters."""

    def __init__(self, parameter: int) -> None:
        super().__init__(f"parameter {parameter} is not determined")
        self.parameter = parameter
        """Index of the parameter that takes the greatest part in what is undetermined."""


def minimise(problem: Problem[S], start: S, *, max_iterations: int, tolerance: float = 1e-5) -> Minimum[S]:
    """Descend from `start` by Levenberg–Marquardt with Marquardt's scaling.

    Args:
        problem: what is minimised.
        start: where to begin; its cost must be finite.
        max_iterations: at most so many accepted or refused steps.
        tolerance: end when the Newton step that is left is this many standard deviations long (of unit weight).
    """
    state, cost = start, problem.cost(start)
    damping = _DAMPING_START
    matrix, gradient = problem.normal_equations(state)
    for iteration in range(1, max_iterations + 1):
        step = _damped_step(matrix, gradient, damping)
        if step is None:
            damping = max(damping, _DAMPING_START) * 10
            continue
        trial = problem.moved(state, step)
        trial_cost = problem.cost(trial)
        decrement = float(-gradient @ step)  # squared length of the step in standard deviations
        if trial_cost <= cost:
            small = decrement < tolerance**2 and damping < 1e-2
            state, cost = trial, trial_cost
            damping = max(damping / 10, _DAMPING_LEAST)
            if small:
                return Minimum(state=state, cost=cost, iterations=iteration, converged=True)
            matrix, gradient = problem.normal_equations(state)
        elif decrement < max(tolerance**2, 1e-12 * cost):  # the cost cannot be told apart any more
            return Minimum(state=state, cost=cost, iterations=iteration, converged=True)
        else:
            damping = max(damping, 1e-8) * 10
            if damping > _DAMPING_MOST:
                break
    return Minimum(state=state, cost=cost, iterations=max_iterations, converged=False)


def inverse(matrix: Float64[Array, "p p"]) -> Float64[Array, "p p"]:
    """Invert a normal matrix: the covariance for observations of unit weight.

    Raises:
        SingularNormalEquationsError: it is not positive definite to working precision.
    """
    scale = np.sqrt(np.diag(matrix))
    if not (scale > 0).all():
        raise SingularNormalEquationsError(int(np.argmin(scale)))
    scaled = matrix / np.outer(scale, scale)
    values, vectors = np.linalg.eigh(scaled)
    if values[0] < len(matrix) * np.finfo(np.float64).eps * values[-1]:
        raise SingularNormalEquationsError(int(np.argmax(np.abs(vectors[:, 0]))))
    result: Float64[Array, "p p"] = (vectors / values) @ vectors.T / np.outer(scale, scale)
    return result


def _damped_step(
    matrix: Float64[Array, "p p"], gradient: Float64[Array, " p"], damping: float
) -> Float64[Array, " p"] | None:
    scale = np.sqrt(np.maximum(np.diag(matrix), np.finfo(np.float64).tiny))
    scaled = matrix / np.outer(scale, scale)
    scaled[np.diag_indices_from(scaled)] += damping
    try:
        factor = cho_factor(scaled, lower=True, overwrite_a=True, check_finite=False)
    except np.linalg.LinAlgError:
        return None
    step: Float64[Array, " p"] = -cho_solve(factor, gradient / scale, check_finite=False) / scale
    return step
