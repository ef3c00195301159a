"""The observed network as a least-squares problem: whitened reprojection errors, Huber loss, priors."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from mammometry.calibration.adjust.least_squares import NormalEquations
from mammometry.calibration.adjust.network import Network, State, before_camera, into_camera, residuals
from mammometry.calibration.adjust.projection import project_with_derivatives
from mammometry.geometry.arrays import Array, Bool, Float64, Int64

_BLOCK = 20_000  # points linearised at once, so that their derivatives stay in the cache


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LinearView:
    """Weighted residuals of one view and their derivatives."""

    columns: Int64[Array, " k"]
    """Columns of the parameters of its camera and of its station."""
    residual: Float64[Array, "n 2"]
    by_pose: Float64[Array, "n 2 k"]
    """Derivative of `residual` by these parameters."""
    order: Int64[Array, " n_or_none"]
    """Index of each point among the free ones. Empty if the view's target is fixed."""
    by_point: Float64[Array, "n 2 3"]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Adjustment:
    """The least-squares problem of a network. The free points are the `triples` of the normal equations."""

    network: Network
    active: Bool[Array, " n"]
    """Points that are used."""
    held: Bool[Array, " p"]
    """Parameters that are held fixed, including at least one station as the datum."""
    group_sigma: Float64[Array, " g"]
    """Factor on the standard deviations of each group's detections."""
    huber: float
    """Whitened residual length beyond which the loss grows linearly. Infinite for plain least squares."""

    def cost(self, state: State) -> float:
        """Half the sum of the loss. Infinite if a used point is behind its camera."""
        residual_px, depth = residuals(self.network, state)
        if (depth[self.active] <= 0).any():
            return float("inf")
        length = np.linalg.norm(self._whitened(residual_px), axis=1)[self.active]
        huber = self.huber if np.isfinite(self.huber) else 0.0
        loss = np.where(length <= self.huber, length**2, 2 * huber * length - huber**2)
        prior = sum(float((part**2).sum()) for part in self._prior_residuals(state))
        return 0.5 * float(loss.sum()) + 0.5 * prior

    def normal_equations(self, state: State) -> NormalEquations:
        """Gauss–Newton matrix and gradient with reweighting. Held parameters have ones on the diagonal."""
        network = self.network
        size, free = network.pose_count, network.free_points
        matrix, gradient = np.zeros((size, size)), np.zeros(size)
        cross, triples = np.zeros((size, len(free), 3)), np.zeros((len(free), 3, 3))
        of_points = np.zeros((len(free), 3))
        for seen in self.linearised(state):
            flat = seen.by_pose.reshape(-1, len(seen.columns))
            matrix[np.ix_(seen.columns, seen.columns)] += flat.T @ flat
            gradient[seen.columns] += flat.T @ seen.residual.ravel()
            if len(seen.order):
                transposed = seen.by_point.transpose(0, 2, 1)
                of_points[seen.order] += (transposed @ seen.residual[:, :, None])[:, :, 0]
                triples[seen.order] += transposed @ seen.by_point
                both = (seen.by_pose.transpose(0, 2, 1) @ seen.by_point).transpose(1, 0, 2)
                cross[np.ix_(seen.columns, seen.order)] += both
        of_intrinsics, on_points = self._prior_residuals(state)
        weight = network.tie.T / network.prior_intrinsics_std[:, None, :]  # camera, parameter, intrinsic value
        for camera in range(len(network.cameras)):
            columns = network.columns_of_camera(camera)[: network.tie.shape[1]]
            matrix[np.ix_(columns, columns)] += weight[camera] @ weight[camera].T
            gradient[columns] += weight[camera] @ of_intrinsics[camera]
        triples[:, range(3), range(3)] += 1.0 / network.prior_mm[free] ** 2
        of_points += on_points / network.prior_mm[free]
        gradient = np.concatenate([gradient, of_points.ravel()])
        return NormalEquations(matrix=matrix, cross=cross, triples=triples, gradient=gradient).holding(self.held)

    def moved(self, state: State, step: Float64[Array, " p"]) -> State:
        """Return the state after a small step."""
        network = self.network
        cameras, intrinsic_count = len(network.cameras), network.tie.shape[1]
        by_camera = step[: cameras * network.per_camera].reshape(cameras, -1)
        by_station = step[cameras * network.per_camera : network.pose_count].reshape(-1, 6)
        points = state.points.copy()
        points[network.free_points] += step[network.pose_count :].reshape(-1, 3)
        pose = by_camera[:, intrinsic_count:]
        return State(
            intrinsics=state.intrinsics + by_camera[:, :intrinsic_count] @ network.tie.T,
            camera_rotation=Rotation.from_rotvec(pose[:, :3]).as_matrix() @ state.camera_rotation,
            camera_centre=state.camera_centre + pose[:, 3:],
            station_rotation=Rotation.from_rotvec(by_station[:, :3]).as_matrix() @ state.station_rotation,
            station_translation=state.station_translation + by_station[:, 3:],
            points=points,
        )

    def whitened_lengths(self, state: State) -> Float64[Array, " n"]:
        """Length of every residual, in its group's standard deviations. Infinite behind the camera."""
        residual_px, depth = residuals(self.network, state)
        length = np.linalg.norm(self._whitened(residual_px), axis=1)
        return np.where(depth > 0, length, np.inf)

    def linearised(self, state: State) -> Iterator[LinearView]:
        """Yield every view's weighted residuals and derivatives."""
        network = self.network
        of_free = np.full(len(network.nominal_points), -1)
        of_free[network.free_points] = np.arange(len(network.free_points))
        starts = network.view_start
        first = 0
        while first < len(network.view_camera):
            last = max(first + 1, int(np.searchsorted(starts, starts[first] + _BLOCK, side="right")) - 1)
            residual, by_pose, by_point = self._linearised(state, slice(starts[first], starts[last]))
            for view in range(first, last):
                part = slice(starts[view] - starts[first], starts[view + 1] - starts[first])
                camera, station = network.view_camera[view], network.view_station[view]
                order = of_free[network.point[starts[view] : starts[view + 1]]]
                yield LinearView(
                    columns=np.concatenate([network.columns_of_camera(camera), network.columns_of_station(station)]),
                    residual=residual[part],
                    by_pose=by_pose[part],
                    order=order if (order >= 0).all() else order[:0],  # a view's points are all free, or none
                    by_point=by_point[part],
                )
            first = last

    def _linearised(
        self, state: State, part: slice
    ) -> tuple[Float64[Array, "n 2"], Float64[Array, "n 2 k"], Float64[Array, "n 2 3"]]:
        """Weighted residuals of some points, and their derivatives by camera and station, and by the points."""
        network, active = self.network, self.active[part]
        view = network.view[part]
        camera, station = network.view_camera[view], network.view_station[view]
        rotation = state.camera_rotation[camera]
        turned, points_camera = into_camera(network, state, part)
        points_camera = before_camera(points_camera, active)
        projection = project_with_derivatives(points_camera, state.intrinsics[camera])
        sigma = self.group_sigma[network.view_group[view]]
        whitener = network.whitener[part] / sigma[:, None, None]
        residual = (whitener @ (projection.uv - network.uv[part])[:, :, None])[:, :, 0]
        length = np.linalg.norm(residual, axis=1)
        weight = np.sqrt(np.minimum(1.0, self.huber / np.maximum(length, 1e-300))) * active
        whitener *= weight[:, None, None]
        by_camera_point = whitener @ projection.by_point
        by_world = by_camera_point @ rotation
        by_pose = np.empty((len(view), 2, network.per_camera + 6))
        intrinsic_count = network.tie.shape[1]
        by_pose[:, :, :intrinsic_count] = whitener @ (projection.by_intrinsics @ network.tie)
        by_pose[:, :, intrinsic_count : intrinsic_count + 3] = np.cross(points_camera[:, None, :], by_camera_point)
        by_pose[:, :, intrinsic_count + 3 : intrinsic_count + 6] = -by_world
        by_pose[:, :, -6:-3] = np.cross(turned[:, None, :], by_world)
        by_pose[:, :, -3:] = by_world
        return residual * weight[:, None], by_pose, by_world @ state.station_rotation[station]

    def _whitened(self, residual_px: Float64[Array, "n 2"]) -> Float64[Array, "n 2"]:
        sigma = self.group_sigma[self.network.view_group[self.network.view]]
        whitened: Float64[Array, "n 2"] = np.einsum("nij,nj->ni", self.network.whitener, residual_px) / sigma[:, None]
        return whitened

    def _prior_residuals(self, state: State) -> tuple[Float64[Array, "c 10"], Float64[Array, "k 3"]]:
        """Deviations of intrinsics and free points from their priors, in the priors' standard deviations."""
        network, free = self.network, self.network.free_points
        return (
            (state.intrinsics - network.prior_intrinsics) / network.prior_intrinsics_std,
            (state.points[free] - network.nominal_points[free]) / network.prior_mm[free],
        )
