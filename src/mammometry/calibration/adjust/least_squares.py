"""Levenberg–Marquardt on normal equations.

Independent of cameras. The first parameters are dense. Any number of triples follow that are coupled only through the
first parameters; they are eliminated first (Schur complement).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Generic, Protocol, TypeVar, runtime_checkable

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from mammometry.geometry.arrays import Array, Bool, Float64

S = TypeVar("S")

_DAMPING_START = 1e-4
"""First damping, relative to the matrix's diagonal."""
DAMPING_LEAST = 1e-12
"""Smallest damping: below it, rounding is larger."""
_DAMPING_MOST = 1e12
"""Damping from which on no step can reduce the cost."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class NormalEquations:
    """Gauss–Newton matrix and gradient of p coupled parameters and k triples, which are eliminated."""

    matrix: Float64[Array, "p p"]
    cross: Float64[Array, "p k 3"]
    triples: Float64[Array, "k 3 3"]
    """The matrix's diagonal blocks of the triples."""
    gradient: Float64[Array, " q"]
    """All p + 3 k parameters."""

    @property
    def scale(self) -> Float64[Array, " q"]:
        """Square roots of the matrix's diagonal, all p + 3 k."""
        triples = np.einsum("kii->ki", self.triples).ravel()
        diagonal: Float64[Array, " q"] = np.sqrt(np.concatenate([np.diag(self.matrix), triples]))
        return diagonal

    def scaled(self, scale: Float64[Array, " q"]) -> NormalEquations:
        """Normal equations for parameters multiplied by `scale`."""
        size = len(self.matrix)
        first, last = scale[:size], scale[size:].reshape(-1, 3)
        return NormalEquations(
            matrix=self.matrix / np.outer(first, first),
            cross=self.cross / (first[:, None, None] * last),
            triples=self.triples / (last[:, :, None] * last[:, None, :]),
            gradient=self.gradient / scale,
        )

    def without_triples(self) -> NormalEquations:
        """Normal equations of the dense parameters alone, with the triples fixed."""
        size = len(self.matrix)
        return replace(self, cross=self.cross[:, :0], triples=self.triples[:0], gradient=self.gradient[:size])

    def minus(self, other: NormalEquations) -> NormalEquations:
        """Normal equations without the contribution of some observations."""
        return NormalEquations(
            matrix=self.matrix - other.matrix,
            cross=self.cross - other.cross,
            triples=self.triples - other.triples,
            gradient=self.gradient - other.gradient,
        )

    def holding(self, held: Bool[Array, " p"]) -> NormalEquations:
        """Normal equations with held parameters: ones on the diagonal."""
        matrix, cross, gradient = self.matrix.copy(), self.cross.copy(), self.gradient.copy()
        matrix[held], matrix[:, held], cross[held] = 0.0, 0.0, 0.0
        gradient[: len(matrix)][held] = 0.0
        matrix[held, held] = 1.0
        return replace(self, matrix=matrix, cross=cross, gradient=gradient)

    def damped(self, damping: float) -> NormalEquations:
        """Normal equations with a term added to the whole diagonal."""
        return replace(
            self, matrix=self.matrix + damping * np.eye(len(self.matrix)), triples=self.triples + damping * np.eye(3)
        )

    def reduced(self) -> tuple[Float64[Array, "p p"], Float64[Array, "p k 3"]]:
        """Schur complement of the triples, and the cross matrix times their inverse."""
        if not len(self.triples):
            return self.matrix, self.cross
        by_triple: Float64[Array, "p k 3"] = np.matmul(
            self.cross.transpose(1, 0, 2), np.linalg.inv(self.triples)
        ).transpose(1, 0, 2)
        size = len(self.matrix)
        return self.matrix - by_triple.reshape(size, -1) @ self.cross.reshape(size, -1).T, by_triple


@runtime_checkable
class Problem(Protocol[S]):
    """Problem to minimise: half a sum of squares, or a robust cost. The state may have any type."""

    def cost(self, state: S) -> float:
        """Half the (robust) sum of squares. Infinite if the state is impossible."""

    def normal_equations(self, state: S) -> NormalEquations:
        """Gauss–Newton matrix and gradient with respect to a small step of the state."""

    def moved(self, state: S, step: Float64[Array, " q"]) -> S:
        """The state after a small step."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Minimum(Generic[S]):
    """Result of a minimisation."""

    state: S
    cost: float
    iterations: int
    converged: bool
    """Whether the remaining step is shorter than the tolerance."""


class SingularNormalEquationsError(ValueError):
    """The observations do not determine the parameters."""

    def __init__(self, parameter: int) -> None:
        super().__init__(f"parameter {parameter} is not determined")
        self.parameter = parameter
        """Index of the parameter with the largest share in the undetermined direction."""


def minimise(problem: Problem[S], start: S, *, max_iterations: int, tolerance: float = 1e-5) -> Minimum[S]:
    """Minimise from `start` by Levenberg–Marquardt with Marquardt's scaling.

    Args:
        problem: the problem.
        start: initial state; its cost must be finite.
        max_iterations: largest number of accepted and rejected steps.
        tolerance: stop when the remaining Newton step is this many standard deviations long (of unit weight).
    """
    state, cost = start, problem.cost(start)
    damping = _DAMPING_START
    equations = problem.normal_equations(state)
    for iteration in range(1, max_iterations + 1):
        step = damped_step(equations, damping)
        if step is None:
            damping = max(damping, _DAMPING_START) * 10
            continue
        trial = problem.moved(state, step)
        trial_cost = problem.cost(trial)
        decrement = float(-equations.gradient @ step)  # squared length of the step in standard deviations
        if trial_cost <= cost:
            small = decrement < tolerance**2 and damping < 1e-2
            state, cost = trial, trial_cost
            damping = max(damping / 10, DAMPING_LEAST)
            if small:
                return Minimum(state=state, cost=cost, iterations=iteration, converged=True)
            equations = problem.normal_equations(state)
        elif decrement < max(tolerance**2, 1e-12 * cost):  # the cost differs by rounding only
            return Minimum(state=state, cost=cost, iterations=iteration, converged=True)
        else:
            damping = max(damping, 1e-8) * 10
            if damping > _DAMPING_MOST:
                break
    return Minimum(state=state, cost=cost, iterations=max_iterations, converged=False)


def inverse(equations: NormalEquations) -> Float64[Array, "p p"]:
    """Covariance of the dense parameters, for observations of unit weight.

    Raises:
        SingularNormalEquationsError: the matrix is not positive definite to working precision.
    """
    scale = equations.scale
    if not (scale > 0).all():
        raise SingularNormalEquationsError(int(np.argmin(scale)))
    size = len(equations.matrix)
    matrix, _ = equations.scaled(scale).reduced()
    values, vectors = np.linalg.eigh(matrix)
    if values[0] < len(scale) * np.finfo(np.float64).eps * values[-1]:
        raise SingularNormalEquationsError(int(np.argmax(np.abs(vectors[:, 0]))))
    result: Float64[Array, "p p"] = (vectors / values) @ vectors.T / np.outer(scale[:size], scale[:size])
    return result


def damped_step(equations: NormalEquations, damping: float) -> Float64[Array, " q"] | None:
    """The step with Marquardt's damping. None if the matrix is not positive definite."""
    scale = np.maximum(equations.scale, np.finfo(np.float64).tiny)
    size = len(equations.matrix)
    scaled = equations.scaled(scale).damped(damping)
    first, last = scaled.gradient[:size], scaled.gradient[size:].reshape(-1, 3)
    try:
        matrix, by_triple = scaled.reduced()
        factor = cho_factor(matrix, lower=True, overwrite_a=True, check_finite=False)
    except np.linalg.LinAlgError:
        return None
    of_first = -cho_solve(factor, first - np.einsum("pki,ki->p", by_triple, last), check_finite=False)
    rest = last + np.einsum("pki,p->ki", scaled.cross, of_first)
    of_last = -np.linalg.solve(scaled.triples, rest[:, :, None])[:, :, 0]
    step: Float64[Array, " q"] = np.concatenate([of_first, of_last.ravel()]) / scale
    return step
