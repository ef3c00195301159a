"""The same minimum as Ceres finds, with the model written again and its derivatives by complex steps."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from test_bundle_adjustment import small_problem

from mammometry.calibration.adjust.least_squares import minimise

pyceres = pytest.importorskip("pyceres")


def turned(vector: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Rodrigues' formula, for complex vectors too."""
    angle = np.sqrt(np.sum(vector**2))
    axis = vector / angle
    along = (points @ axis)[:, None] * axis
    across = np.stack(
        [
            axis[1] * points[:, 2] - axis[2] * points[:, 1],
            axis[2] * points[:, 0] - axis[0] * points[:, 2],
            axis[0] * points[:, 1] - axis[1] * points[:, 0],
        ],
        axis=1,
    )
    return along + np.cos(angle) * (points - along) + np.sin(angle) * across


def projected(camera: np.ndarray, station: np.ndarray, points: np.ndarray) -> np.ndarray:
    """A view's image points by its camera (turn, shift, fx fy cx cy k1 k2 p1 p2) and its station (turn, shift)."""
    x, y, z = (turned(camera[:3], turned(station[:3], points) + station[3:]) + camera[3:6]).T
    fx, fy, cx, cy, k1, k2, p1, p2 = camera[6:]
    x, y = x / z, y / z
    r2 = x * x + y * y
    radial = 1 + k1 * r2 + k2 * r2 * r2
    u = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
    v = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
    return np.stack([fx * u + cx, fy * v + cy], axis=1)


class View(pyceres.CostFunction):  # type: ignore[misc]
    """Whitened residuals of one view."""

    def __init__(self, points: np.ndarray, uv: np.ndarray, whitener: np.ndarray) -> None:
        super().__init__()
        self.points, self.uv, self.whitener = points, uv, whitener
        self.set_num_residuals(2 * len(points))
        self.set_parameter_block_sizes([14, 6])

    def Evaluate(self, parameters, residuals, jacobians) -> bool:  # type: ignore[no-untyped-def]
        camera, station = (np.array(block, complex) for block in parameters)
        white = np.einsum("nij,nj->ni", self.whitener, projected(camera, station, self.points).real - self.uv)
        residuals[:] = white.ravel()
        for block, size in enumerate((14, 6)):
            if jacobians is None or jacobians[block] is None:
                continue
            columns = []
            for index in range(size):
                at = [camera.copy(), station.copy()]
                at[block][index] += 1e-30j
                slope = projected(*at, self.points).imag / 1e-30
                columns.append(np.einsum("nij,nj->ni", self.whitener, slope).ravel())
            jacobians[block][:] = np.stack(columns, axis=1).ravel()
        return True


@pytest.mark.slow
def test_same_minimum_as_ceres() -> None:
    problem, start = small_problem(free_target=False, huber=np.inf)
    network = problem.network
    held = problem.held.copy()
    held[network.columns_of_intrinsic("k3")] = True
    problem = replace(problem, active=np.ones(len(network.uv), bool), held=held)
    ours = minimise(problem, start, max_iterations=50, tolerance=1e-8)
    cameras = [
        np.concatenate([Rotation.from_matrix(rotation).as_rotvec(), -rotation @ centre, intrinsics[:8]])
        for rotation, centre, intrinsics in zip(
            start.camera_rotation, start.camera_centre, start.intrinsics, strict=True
        )
    ]
    stations = [
        np.concatenate([Rotation.from_matrix(rotation).as_rotvec(), translation])
        for rotation, translation in zip(start.station_rotation, start.station_translation, strict=True)
    ]
    stations[0] = np.array([2 * np.pi, 0, 0, 0, 0, 0])  # the world: a full turn, as no turn has no axis
    theirs = pyceres.Problem()
    for view, (camera, station) in enumerate(zip(network.view_camera, network.view_station, strict=True)):
        part = slice(network.view_start[view], network.view_start[view + 1])
        points = network.nominal_points[network.point[part]]
        whitener = network.whitener[part] / problem.group_sigma[network.view_group[view]]
        cost = View(points, network.uv[part], whitener)
        theirs.add_residual_block(cost, None, [cameras[camera], stations[station]])
    theirs.set_parameter_block_constant(stations[0])
    options = pyceres.SolverOptions()
    options.function_tolerance, options.gradient_tolerance, options.parameter_tolerance = 1e-16, 1e-12, 1e-14
    options.max_num_iterations = 200
    options.minimizer_progress_to_stdout = False
    summary = pyceres.SolverSummary()
    pyceres.solve(options, theirs, summary)
    assert ours.cost == pytest.approx(summary.final_cost, rel=1e-10)
    for i, camera in enumerate(cameras):
        centre = -Rotation.from_rotvec(camera[:3]).as_matrix().T @ camera[3:6]
        np.testing.assert_allclose(ours.state.intrinsics[i, :4], camera[6:10], rtol=1e-6)
        np.testing.assert_allclose(ours.state.intrinsics[i, 4:8], camera[10:], atol=5e-6)  # of k2: 1e-4 px
        np.testing.assert_allclose(ours.state.camera_centre[i], centre, rtol=1e-6)
