"""Linear model of small motions, with normal priors.

An observation is its derivatives by the unknowns, times the unknowns, plus noise. Every motion is estimated here: of a
target in one view (`judge.sighting`), of cameras between views of a target (`judge.moved_cameras`,
`judge.pose_motion`), of cameras and body from pairs (`surface.motion.rigid_motion`, `walk.motion`). Those modules state
what is observed, in units of its noise. A hypothesis is one prior standard deviation for each unknown: 0 if it did not
move, infinite if nothing is known of its motion. Hypotheses are compared by χ² (`Fit.misfit`) or by their evidence
(MacKay 1992, Neural Computation 4, 415).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import cholesky, solve_triangular

from mammometry.geometry.arrays import Array, Float64, Int64

FREE = np.inf
"""Prior standard deviation of an unknown without prior information."""
_UNDETERMINED = 1e-12
"""Eigenvalue of the scaled matrix, relative to the largest, below which a direction is not determined: rounding leaves
1e-16 of those that are not, and the weakest that rigs and boards determine has 1e-4."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Fit:
    """Most probable motions under one hypothesis."""

    motions: Float64[Array, " p"]
    """0 where held. Directions that are not determined are 0 too, with each unknown in units of its own standard
    error."""
    covariance: Float64[Array, "p p"]
    """Of the motions, after the observations. 0 where held, and in directions that are not determined."""
    misfit: float
    """χ² of the residuals, and of the motions by their priors."""
    freedom: int
    """Observations less determined unknowns."""
    log_evidence: float
    """Log probability of the observations, up to a constant. Comparable where the same unknowns have no prior."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LinearModel:
    """Observations in units of their noise, summed up.

    H is their derivative by the unknowns, y their values.
    """

    matrix: Float64[Array, "p p"]
    """HᵀH."""
    right: Float64[Array, " p"]
    """Hᵀy."""
    squares: float
    """yᵀy."""
    count: int
    """Number of observations."""
    log_det: float = 0.0
    """Log determinant of the noise's covariance."""

    def log_evidence(self, std: Float64[Array, "h p"]) -> Float64[Array, " h"]:
        """Log evidence of hypotheses in which every unknown has a prior, as `fit` gives it."""
        scaled = self.matrix * std[:, :, None] * std[:, None, :]
        scaled[:, range(len(self.right)), range(len(self.right))] += 1.0
        lower = np.linalg.cholesky(scaled)
        right = self.right * std
        explained = np.sum(right * np.linalg.solve(scaled, right[:, :, None])[:, :, 0], axis=1)
        log_det: Float64[Array, " h"] = np.sum(np.log(np.diagonal(lower, axis1=1, axis2=2)), axis=1)
        return -(self.squares - explained + self.log_det) / 2 - log_det

    def fit(self, std: Float64[Array, " p"]) -> Fit:
        """Estimate the motions under a hypothesis.

        Args:
            std: prior standard deviation of each unknown: 0 holds it at 0, `FREE` is no prior.
        """
        free, own, whitened, pulled, log_evidence = self._solved(std)
        motions, covariance = np.zeros(len(std)), np.diag(std**2)
        root = whitened(np.diag(own))
        motions[free] = root.T @ pulled
        covariance[np.ix_(free, free)] = root.T @ root
        misfit = max(self.squares - float(pulled @ pulled), 0.0)
        freedom = self.count - len(pulled)
        return Fit(motions=motions, covariance=covariance, misfit=misfit, freedom=freedom, log_evidence=log_evidence)

    def beyond(self, fit: Fit, more: slice | Int64[Array, " k"]) -> LinearModel:
        """Return a model for further unknowns with those of `fit` eliminated, so that they may take any value.

        Args:
            fit: of this model, without the further unknowns.
            more: the further unknowns.
        """
        found = np.flatnonzero(np.diag(fit.covariance) > 0)
        cross = self.matrix[more][:, found]
        return LinearModel(
            matrix=self.matrix[more][:, more] - cross @ fit.covariance[np.ix_(found, found)] @ cross.T,
            right=self.right[more] - cross @ fit.motions[found],
            squares=fit.misfit,
            count=fit.freedom,
        )

    def _solved(self, std: Float64[Array, " p"]) -> _Solved:
        free = np.flatnonzero((std > 0) & (np.diag(self.matrix) > 0))
        has_prior = np.isfinite(std[free])
        own = np.where(has_prior, std[free], 1 / np.sqrt(np.diag(self.matrix)[free]))
        scaled = np.diag(has_prior) + self.matrix[np.ix_(free, free)] * np.outer(own, own)
        whitened, half_log_det = _by_cholesky(scaled) if has_prior.all() else _by_eigenvectors(scaled)
        pulled = whitened(self.right[free] * own)
        misfit = self.squares - float(pulled @ pulled)
        return free, own, whitened, pulled, -(misfit + self.log_det) / 2 - half_log_det


_Whitener = Callable[[Float64[Array, "..."]], Float64[Array, "..."]]
_Solved = tuple[Int64[Array, " f"], Float64[Array, " f"], _Whitener, Float64[Array, " r"], float]
"""Free unknowns, their scales, the whitener of the scaled matrix, the whitened right side, and the log evidence."""


def linear_model(white: Sequence[Float64[Array, "_ q"]], unknowns: int, *, log_det: float = 0.0) -> LinearModel:
    """Sum up observations that were divided by their noise.

    Args:
        white: parts with independent noise, one row an observation: its derivatives by the unknowns, its value, and its
            derivatives by errors that all parts share, each normal with standard deviation 1.
        unknowns: number of unknowns.
        log_det: log determinant of the parts' own noise.
    """
    products = np.zeros((white[0].shape[1],) * 2)
    for part in white:
        products += part.T @ part
    # Shared errors are few: they are eliminated by the Woodbury identity.
    known = unknowns + 1
    lower = cholesky(np.eye(len(products) - known) + products[known:, known:], lower=True, check_finite=False)
    taken = solve_triangular(lower, products[known:, :known], lower=True, check_finite=False)
    left = products[:known, :known] - taken.T @ taken
    return LinearModel(
        matrix=left[:-1, :-1],
        right=left[:-1, -1],
        squares=float(left[-1, -1]),
        count=sum(map(len, white)),
        log_det=log_det + 2 * float(np.sum(np.log(np.diag(lower)))),
    )


def square_root(matrix: Float64[Array, "q q"]) -> Float64[Array, "q q"]:
    """Find a matrix that gives a covariance or an information when multiplied by its transpose.

    Rows may have different units: the result is exact to rounding in each.
    """
    diagonal = np.diag(matrix)
    scale = np.sqrt(np.where(diagonal > 0, diagonal, 1.0))
    values, vectors = np.linalg.eigh(matrix / np.outer(scale, scale))
    root: Float64[Array, "q q"] = scale[:, None] * vectors * np.sqrt(np.maximum(values, 0.0))
    return root


def _by_cholesky(scaled: Float64[Array, "f f"]) -> tuple[_Whitener, float]:
    lower = cholesky(scaled, lower=True)
    return lambda right: solve_triangular(lower, right, lower=True), float(np.sum(np.log(np.diag(lower))))


def _by_eigenvectors(scaled: Float64[Array, "f f"]) -> tuple[_Whitener, float]:
    values, vectors = np.linalg.eigh(scaled)
    kept = values > _UNDETERMINED * values[-1]
    root = vectors[:, kept] / np.sqrt(values[kept])
    return lambda right: root.T @ right, float(np.sum(np.log(values[kept]))) / 2
