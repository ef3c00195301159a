"""The rig's least-squares problem against differences of its own cost, and its minimum against SciPy's."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import least_squares
from virtual_rig import BOARD, cameras_in_rig, observe, placements

from mammometry.calibration.adjust.adjustment import Adjustment
from mammometry.calibration.adjust.bundle import all_views, network_of
from mammometry.calibration.adjust.initialise import initialise
from mammometry.calibration.adjust.least_squares import NormalEquations, damped_step, inverse, minimise
from mammometry.calibration.adjust.network import Network, State, residuals, tie_of
from mammometry.calibration.adjust.robust import robust_sigma
from mammometry.calibration.settings import BundleSettings


def small_problem(*, free_target: bool, model: str = "brown", huber: float = 3.0) -> tuple[Adjustment, State]:
    """Two cameras, four poses, noise and a few gross errors, at the initial values."""
    cameras = {name: cameras_in_rig()[name] for name in ("front_left", "front_right")}
    observations = observe(cameras, placements(4), noise_px=0.1, seed=3)
    settings = BundleSettings(
        free_target="always" if free_target else "never", model="paper" if model == "paper" else "brown"
    )
    initial = initialise(observations)
    network, start = network_of(all_views(observations, {}, initial), observations, {}, initial, {}, settings)
    uv = network.uv.copy()
    uv[::50] += 2.0
    network = replace(network, uv=uv)
    active = np.ones(len(network.uv), bool)
    active[7::31] = False
    held = np.zeros(network.pose_count, bool)
    held[network.columns_of_station(0)] = True
    sigma = np.array([1.3, 1.0])
    return Adjustment(network=network, active=active, held=held, group_sigma=sigma, huber=huber), start


def dense(equations: NormalEquations) -> tuple[np.ndarray, np.ndarray]:
    """The whole matrix, written out, and the gradient."""
    size, total = len(equations.matrix), len(equations.gradient)
    matrix = np.zeros((total, total))
    matrix[:size, :size] = equations.matrix
    matrix[:size, size:] = equations.cross.reshape(size, -1)
    matrix[size:, :size] = matrix[:size, size:].T
    for k, triple in enumerate(equations.triples):
        at = slice(size + 3 * k, size + 3 * k + 3)
        matrix[at, at] = triple
    return matrix, equations.gradient


@pytest.mark.parametrize("free_target", [False, True])
@pytest.mark.parametrize("model", ["brown", "paper"])
def test_gradient_is_the_costs_slope(free_target: bool, model: str) -> None:
    problem, state = small_problem(free_target=free_target, model=model)
    if free_target:  # away from the priors' minimum
        points = state.points + np.random.default_rng(2).normal(size=state.points.shape) * 0.05
        state = replace(state, points=points)
    matrix, gradient = dense(problem.normal_equations(state))
    scale = 1 / np.sqrt(np.diag(matrix))  # a standard deviation of each parameter by itself
    assert len(gradient) == len(problem.network.parameter_names)
    free = np.setdiff1d(np.arange(len(gradient)), np.flatnonzero(problem.held))
    probed = np.random.default_rng(1).permutation(free)[:60]
    for index in probed:
        step = np.zeros(len(gradient))
        step[index] = scale[index] * 1e-2
        slope = (problem.cost(problem.moved(state, step)) - problem.cost(problem.moved(state, -step))) / 2e-2
        # In such units gradients are 1 to 1e4; Huber's kink is smooth enough in its first derivative.
        assert slope == pytest.approx(gradient[index] * scale[index], rel=1e-4, abs=1e-2)


@pytest.mark.parametrize("free_target", [False, True])
def test_normal_matrix_is_that_of_the_differenced_residuals(free_target: bool) -> None:
    problem, state = small_problem(free_target=free_target, huber=np.inf)
    problem = replace(problem, active=np.ones_like(problem.active))
    matrix, _ = dense(problem.normal_equations(state))
    scale = 1 / np.sqrt(np.diag(matrix))
    count = len(matrix)
    free = np.setdiff1d(np.arange(count), np.flatnonzero(problem.held))
    chosen = np.random.default_rng(1).permutation(free)[:40]

    columns = []
    for index in chosen:
        step = np.zeros(count)
        step[index] = scale[index] * 1e-2
        moved, back = problem.moved(state, step), problem.moved(state, -step)
        points = [problem._whitened(residuals(problem.network, at)[0]).ravel() for at in (moved, back)]
        prior = [problem._prior_residuals(at)[1].ravel() for at in (moved, back)]
        columns.append(np.concatenate([points[0] - points[1], prior[0] - prior[1]]) / 2e-2)
    jacobian = np.stack(columns, axis=1)
    expected = matrix[np.ix_(chosen, chosen)] * np.outer(scale[chosen], scale[chosen])
    np.testing.assert_allclose(jacobian.T @ jacobian, expected, atol=1e-5)


def dense_jacobian(problem: Adjustment, state: State) -> tuple[np.ndarray, np.ndarray]:
    """Every residual by every parameter, without free points, and the residuals: plain twin of the block-wise sums."""
    rows, values = [], []
    for seen in problem.linearised(state):
        row = np.zeros((2 * len(seen.residual), problem.network.pose_count))
        row[:, seen.columns] = seen.by_pose.reshape(len(row), -1)
        rows.append(row)
        values.append(seen.residual.ravel())
    jacobian = np.concatenate(rows)
    jacobian[:, problem.held] = 0
    return jacobian, np.concatenate(values)


def test_block_wise_sums_are_those_of_the_dense_jacobian() -> None:
    problem, state = small_problem(free_target=False)
    jacobian, weighted = dense_jacobian(problem, state)
    matrix, gradient = dense(problem.normal_equations(state))
    expected = jacobian.T @ jacobian + np.diag(problem.held.astype(float))
    np.testing.assert_allclose(expected, matrix, rtol=1e-9, atol=1e-9 * np.abs(matrix).max())
    np.testing.assert_allclose(jacobian.T @ weighted, gradient, rtol=1e-9, atol=1e-9 * np.abs(gradient).max())


def test_same_minimum_as_scipy() -> None:
    problem, start = small_problem(free_target=False, huber=np.inf)
    problem = replace(problem, active=np.ones_like(problem.active))
    found = minimise(problem, start, max_iterations=50)
    assert found.converged
    matrix, _ = dense(problem.normal_equations(found.state))
    uncorrelated = np.linalg.inv(np.linalg.cholesky(matrix)).T * ~problem.held[:, None]

    def state_at(x: np.ndarray) -> State:
        return problem.moved(found.state, uncorrelated @ x)

    def residual(x: np.ndarray) -> np.ndarray:
        return problem._whitened(residuals(problem.network, state_at(x))[0]).ravel()

    def slope(x: np.ndarray) -> np.ndarray:
        return dense_jacobian(problem, state_at(x))[0] @ uncorrelated

    displaced = np.random.default_rng(0).normal(size=len(matrix)) * 10
    theirs = least_squares(residual, displaced, slope, xtol=1e-9, ftol=1e-13, gtol=1e-6)
    state = state_at(theirs.x)
    assert found.cost == pytest.approx(theirs.cost, rel=1e-9)
    np.testing.assert_allclose(found.state.intrinsics, state.intrinsics, rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(found.state.camera_centre, state.camera_centre, atol=1e-4)


def test_eliminating_the_points_changes_nothing() -> None:
    """Step and covariance by the Schur complement are those of the whole matrix."""
    problem, state = small_problem(free_target=True)
    equations = problem.normal_equations(state)
    matrix, gradient = dense(equations)
    size = len(equations.matrix)
    covariance = np.linalg.inv(matrix)[:size, :size]
    deviation = np.sqrt(np.diag(covariance))
    np.testing.assert_allclose(
        inverse(equations) / np.outer(deviation, deviation), covariance / np.outer(deviation, deviation), atol=1e-5
    )
    step = damped_step(equations, 1e-3)
    assert step is not None
    damped = matrix + 1e-3 * np.diag(np.diag(matrix))
    np.testing.assert_allclose(damped @ step, -gradient, atol=1e-6 * np.abs(gradient).max())


def test_points_behind_a_camera_cost_everything() -> None:
    problem, start = small_problem(free_target=False)
    turned = replace(start, camera_rotation=start.camera_rotation * np.array([1.0, -1.0, -1.0])[:, None])
    assert problem.cost(turned) == np.inf
    assert np.isinf(problem.whitened_lengths(turned)).all()
    assert np.isfinite(residuals(problem.network, turned)[0]).all()


def test_paper_model_has_one_focal_length_and_two_radial_terms() -> None:
    problem, _ = small_problem(free_target=False, model="paper")
    assert problem.network.intrinsic_names == ("f_px", "cx_px", "cy_px", "k1", "k2")
    np.testing.assert_array_equal(problem.network.tie @ np.arange(1, 6), [1, 1, 2, 3, 4, 5, 0, 0, 0, 0])
    np.testing.assert_array_equal(tie_of(["k3", "fy_px"]) @ [2, 7], [0, 7, 0, 0, 0, 0, 0, 0, 2, 0])


def test_robust_sigma_of_gaussian_residuals_ignores_outliers() -> None:
    lengths = np.linalg.norm(np.random.default_rng(0).normal(size=(20000, 2)) * 0.3, axis=1)
    assert robust_sigma(lengths) == pytest.approx(0.3, rel=0.02)  # the median's own error is 0.6 %
    lengths[:1000] = 1e6
    assert robust_sigma(lengths) == pytest.approx(0.3, rel=0.06)


def test_network_of_board_points_starts_at_the_first_pose() -> None:
    problem, start = small_problem(free_target=False)
    network: Network = problem.network
    assert network.stations == ("00", "01", "02", "03")
    np.testing.assert_allclose(start.station_rotation[0], np.eye(3), atol=1e-12)
    np.testing.assert_allclose(start.station_translation[0], 0, atol=1e-9)
    np.testing.assert_array_equal(network.nominal_points, BOARD.points_target)
