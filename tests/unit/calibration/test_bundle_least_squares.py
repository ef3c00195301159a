"""Levenberg–Marquardt on functions whose minimum is known."""

from dataclasses import dataclass

import numpy as np
import pytest

from mammometry.calibration.adjust.least_squares import NormalEquations, SingularNormalEquationsError, inverse, minimise


def plain(matrix: np.ndarray, gradient: np.ndarray | None = None) -> NormalEquations:
    """Normal equations without triples."""
    size = len(matrix)
    gradient = np.zeros(size) if gradient is None else gradient
    return NormalEquations(matrix=matrix, cross=np.zeros((size, 0, 3)), triples=np.zeros((0, 3, 3)), gradient=gradient)


@dataclass
class Rosenbrock:
    """Residuals 10 (y − x²) and 1 − x: a bent valley with its minimum, zero, at (1, 1)."""

    impossible_beyond: float = np.inf

    def _residual(self, state: np.ndarray) -> np.ndarray:
        return np.array([10 * (state[1] - state[0] ** 2), 1 - state[0]])

    def cost(self, state: np.ndarray) -> float:
        if abs(state[1]) > self.impossible_beyond:
            return float("inf")
        return 0.5 * float(self._residual(state) @ self._residual(state))

    def normal_equations(self, state: np.ndarray) -> NormalEquations:
        jacobian = np.array([[-20 * state[0], 10], [-1, 0]])
        return plain(jacobian.T @ jacobian, jacobian.T @ self._residual(state))

    def moved(self, state: np.ndarray, step: np.ndarray) -> np.ndarray:
        return state + step


def test_finds_the_bent_valleys_end() -> None:
    found = minimise(Rosenbrock(), np.array([-1.2, 1.0]), max_iterations=100)
    assert found.converged
    np.testing.assert_allclose(found.state, [1, 1], atol=1e-8)


def test_steps_back_from_impossible_states() -> None:
    # The undamped first step lands at y = −3.84, which is impossible here.
    found = minimise(Rosenbrock(impossible_beyond=1.7), np.array([-1.2, 1.0]), max_iterations=200)
    assert found.converged
    np.testing.assert_allclose(found.state, [1, 1], atol=1e-8)


def test_says_when_it_has_not_converged() -> None:
    assert not minimise(Rosenbrock(), np.array([-1.2, 1.0]), max_iterations=2).converged


def test_inverse_of_a_badly_scaled_matrix() -> None:
    scale = np.array([1e-6, 1.0, 1e5])
    matrix = np.array([[2.0, 0.5, 0.1], [0.5, 3.0, 0.2], [0.1, 0.2, 1.0]]) * np.outer(scale, scale)
    np.testing.assert_allclose(
        inverse(plain(matrix)) * np.outer(scale, scale), np.linalg.inv(matrix / np.outer(scale, scale))
    )


def test_inverse_names_what_is_not_determined() -> None:
    vector = np.array([0.0, 0.1, 1.0, 0.0])
    null = vector / np.linalg.norm(vector)
    with pytest.raises(SingularNormalEquationsError) as caught:
        inverse(plain(np.eye(4) - np.outer(null, null)))
    assert caught.value.parameter in (1, 2)
    with pytest.raises(SingularNormalEquationsError) as caught:
        inverse(plain(np.diag([1.0, 0.0, 2.0])))
    assert caught.value.parameter == 1
