"""The observed network of cameras and target placements, as a least-squares problem.

A *view* is one detection: what one camera saw of the target in one *station*. A station is one placement of a
target: a pose that all cameras share, or one that a single camera saw by itself (a photograph for its intrinsics).
Parameters per camera: intrinsics, then rotation and perspective centre; per station, except the first, which is the
world: rotation and translation; and, where free, the target's points. Rotations move by a small rotation vector from
the left.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from mammometry.calibration.least_squares import NormalEquations
from mammometry.calibration.projection import INTRINSIC_NAMES, project, project_with_derivatives
from mammometry.geometry.arrays import Array, Bool, Float64, Int64

RAYLEIGH_MEDIAN = float(np.sqrt(2 * np.log(2)))
"""Median length of a two-dimensional residual with unit standard deviation in each coordinate."""

POSE_NAMES_CAMERA = ("rotation_x_rad", "rotation_y_rad", "rotation_z_rad", "centre_x_mm", "centre_y_mm", "centre_z_mm")
POSE_NAMES_STATION = ("rotation_x_rad", "rotation_y_rad", "rotation_z_rad", "x_mm", "y_mm", "z_mm")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Network:
    """What was observed, flattened; views in order, their points one after the other."""

    cameras: tuple[str, ...]
    stations: tuple[str, ...]
    """The first one's frame is the world."""
    view_camera: Int64[Array, " v"]
    view_station: Int64[Array, " v"]
    view_group: Int64[Array, " v"]
    """Views of a group have the same factor on their detections' covariances: 0 the rig's target, 1 the intrinsics'."""
    view_start: Int64[Array, " v1"]
    """Index of each view's first point; one more at the end."""
    point: Int64[Array, " n"]
    """Row of the state's `points`."""
    uv: Float64[Array, "n 2"]
    whitener: Float64[Array, "n 2 2"]
    """Inverse of the lower Cholesky factor of a point's covariance: residual px → standard deviations."""
    tie: Float64[Array, "9 m"]
    """Intrinsic values by free parameters: the camera model. Its columns hold ones where a parameter acts."""
    intrinsic_names: tuple[str, ...]
    """Names of the free intrinsic parameters."""
    nominal_points: Float64[Array, "p 3"]
    """All targets' points, each in its target's frame, mm."""
    prior_mm: Float64[Array, "p 3"]
    """Standard deviation of the points about nominal, mm; infinite for those that are fixed."""

    @property
    def view(self) -> Int64[Array, " n"]:
        """The view of each point."""
        return np.repeat(np.arange(len(self.view_camera)), np.diff(self.view_start))

    @property
    def free_points(self) -> Int64[Array, " k"]:
        """Rows of the points that are adjusted."""
        return np.flatnonzero(np.isfinite(self.prior_mm).all(axis=1))

    @property
    def per_camera(self) -> int:
        """Number of parameters of a camera."""
        return self.tie.shape[1] + 6

    @property
    def parameter_count(self) -> int:
        """Number of all parameters."""
        return len(self.cameras) * self.per_camera + 6 * (len(self.stations) - 1) + 3 * len(self.free_points)

    @property
    def parameter_names(self) -> tuple[str, ...]:
        """A name for each parameter, in order: ``front_left.fx_px``, ``pose 01.rotation_x_rad``, ``point 7.x_mm``."""
        of_camera = (*self.intrinsic_names, *POSE_NAMES_CAMERA)
        names = [f"{camera}.{name}" for camera in self.cameras for name in of_camera]
        names += [f"pose {station}.{name}" for station in self.stations[1:] for name in POSE_NAMES_STATION]
        names += [f"point {row}.{axis}_mm" for row in self.free_points for axis in "xyz"]
        return tuple(names)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class State:
    """Values of all parameters."""

    intrinsics: Float64[Array, "c 9"]
    camera_rotation: Float64[Array, "c 3 3"]
    """Of camera_from_world."""
    camera_centre: Float64[Array, "c 3"]
    """Perspective centres, world, mm."""
    station_rotation: Float64[Array, "s 3 3"]
    """Of world_from_target."""
    station_translation: Float64[Array, "s 3"]
    """Of world_from_target, mm."""
    points: Float64[Array, "p 3"]
    """All targets' points, each in its target's frame, mm."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Adjustment:
    """The least-squares problem of a network: whitened residuals, Huber's loss, priors on free points.

    Implements `least_squares.Problem`.
    """

    network: Network
    active: Bool[Array, " n"]
    """Points that take part."""
    group_sigma: Float64[Array, " g"]
    """Factor on the standard deviations of each group's detections."""
    huber: float
    """Lengths of whitened residuals beyond which the loss grows linearly; infinite for plain least squares."""

    def cost(self, state: State) -> float:
        """Half the sum of the loss; infinite if a point that takes part lies behind its camera."""
        residual_px, depth = residuals(self.network, state)
        if (depth[self.active] <= 0).any():
            return float("inf")
        length = np.linalg.norm(self._whitened(residual_px), axis=1)[self.active]
        loss = np.where(length <= self.huber, length**2, 2 * self._huber_finite * length - self._huber_finite**2)
        return 0.5 * float(loss.sum()) + 0.5 * float((self._prior_residual(state) ** 2).sum())

    def normal_equations(self, state: State) -> NormalEquations:
        """Gauss–Newton matrix and gradient, the loss by reweighting; free points are the triples."""
        network = self.network
        residual, jacobian = self._linearised(state)
        per_camera, free = network.per_camera, network.free_points
        base_station = len(network.cameras) * per_camera
        size = base_station + 6 * (len(network.stations) - 1)
        order_of_point = np.full(len(network.nominal_points), -1)
        order_of_point[free] = np.arange(len(free))

        matrix, gradient = np.zeros((size, size)), np.zeros(size)
        cross, triples, of_points = (
            np.zeros((size, len(free), 3)),
            np.zeros((len(free), 3, 3)),
            np.zeros((len(free), 3)),
        )
        of_camera, of_station = np.arange(per_camera), np.arange(6)
        for view, (camera, station) in enumerate(zip(network.view_camera, network.view_station, strict=True)):
            part = slice(network.view_start[view], network.view_start[view + 1])
            columns = camera * per_camera + of_camera
            if station > 0:
                columns = np.concatenate([columns, base_station + 6 * (station - 1) + of_station])
            rows = jacobian[part, :, : len(columns)]
            flat = rows.reshape(-1, len(columns))
            matrix[np.ix_(columns, columns)] += flat.T @ flat
            gradient[columns] += flat.T @ residual[part].ravel()
            order = order_of_point[network.point[part]]
            if len(order) and order[0] >= 0:  # a view's points belong to one target: all are free, or none
                by_point = jacobian[part][:, :, -3:]
                transposed = by_point.transpose(0, 2, 1)
                of_points[order] += (transposed @ residual[part][:, :, None])[:, :, 0]
                triples[order] += transposed @ by_point
                cross[np.ix_(columns, order)] += (rows.transpose(0, 2, 1) @ by_point).transpose(1, 0, 2)
        if len(free):
            weight = 1.0 / network.prior_mm[free]
            triples[:, range(3), range(3)] += weight**2
            of_points += self._prior_residual(state) * weight
        return NormalEquations(
            matrix=matrix, cross=cross, triples=triples, gradient=np.concatenate([gradient, of_points.ravel()])
        )

    def moved(self, state: State, step: Float64[Array, " p"]) -> State:
        """The state after a small step."""
        network = self.network
        cameras, free = len(network.cameras), network.free_points
        intrinsic_count = network.tie.shape[1]
        by_camera = step[: cameras * network.per_camera].reshape(cameras, -1)
        rest = step[cameras * network.per_camera :]
        by_station = np.zeros((len(network.stations), 6))
        by_station[1:] = rest[: 6 * (len(network.stations) - 1)].reshape(-1, 6)
        points = state.points
        if len(free):
            points = points.copy()
            points[free] += rest[6 * (len(network.stations) - 1) :].reshape(-1, 3)
        pose = by_camera[:, intrinsic_count:]
        return replace(
            state,
            intrinsics=state.intrinsics + by_camera[:, :intrinsic_count] @ network.tie.T,
            camera_rotation=Rotation.from_rotvec(pose[:, :3]).as_matrix() @ state.camera_rotation,
            camera_centre=state.camera_centre + pose[:, 3:],
            station_rotation=Rotation.from_rotvec(by_station[:, :3]).as_matrix() @ state.station_rotation,
            station_translation=state.station_translation + by_station[:, 3:],
            points=points,
        )

    def whitened_lengths(self, state: State) -> Float64[Array, " n"]:
        """Length of every residual in its group's standard deviations, also of those left out; infinite if behind."""
        residual_px, depth = residuals(self.network, state)
        length = np.linalg.norm(self._whitened(residual_px), axis=1)
        return np.where(depth > 0, length, np.inf)

    @property
    def _huber_finite(self) -> float:
        return self.huber if np.isfinite(self.huber) else 0.0

    def _whitened(self, residual_px: Float64[Array, "n 2"]) -> Float64[Array, "n 2"]:
        sigma = self.group_sigma[self.network.view_group[self.network.view]]
        whitened: Float64[Array, "n 2"] = np.einsum("nij,nj->ni", self.network.whitener, residual_px) / sigma[:, None]
        return whitened

    def _prior_residual(self, state: State) -> Float64[Array, "k 3"]:
        free = self.network.free_points
        return (state.points[free] - self.network.nominal_points[free]) / self.network.prior_mm[free]

    def _linearised(self, state: State) -> tuple[Float64[Array, "n 2"], Float64[Array, "n 2 k"]]:
        """Weighted residuals and their derivatives by a view's own parameters: camera, station, and point if free."""
        network = self.network
        view = network.view
        camera, station = network.view_camera[view], network.view_station[view]
        rotation = state.camera_rotation[camera]
        turned, points_camera = _into_camera(network, state)
        points_camera = _before_camera(points_camera, self.active)
        projection = project_with_derivatives(points_camera, state.intrinsics[camera])
        by_world = projection.by_point @ rotation
        parts = [
            projection.by_intrinsics @ network.tie,
            np.cross(points_camera[:, None, :], projection.by_point),
            -by_world,
            np.cross(turned[:, None, :], by_world),
            by_world,
        ]
        if len(network.free_points):
            parts.append(by_world @ state.station_rotation[station])
        residual = self._whitened(projection.uv - network.uv)
        length = np.linalg.norm(residual, axis=1)
        weight = np.sqrt(np.minimum(1.0, self.huber / np.maximum(length, 1e-300))) * self.active
        sigma = self.group_sigma[network.view_group[view]]
        whitener = network.whitener * (weight / sigma)[:, None, None]
        return residual * weight[:, None], whitener @ np.concatenate(parts, axis=2)


def residuals(network: Network, state: State) -> tuple[Float64[Array, "n 2"], Float64[Array, " n"]]:
    """Reprojection errors (projected − measured, px) and depths in the cameras' frames, mm, of all points."""
    _, points_camera = _into_camera(network, state)
    depth = points_camera[:, 2].copy()
    intrinsics = state.intrinsics[network.view_camera[network.view]]
    return project(_before_camera(points_camera, np.zeros(len(depth), bool)), intrinsics) - network.uv, depth


def tie_of(model: str, *, free_k3: bool) -> tuple[Float64[Array, "9 m"], tuple[str, ...]]:
    """How the free parameters of a camera model act on the nine intrinsic values, and their names.

    ``paper``: one focal length, principal point and two radial terms (2.2: f, x₀, y₀, μ, ν). ``brown``: all but k3,
    and k3 too if free.
    """
    identity = np.eye(len(INTRINSIC_NAMES))
    if model == "paper":
        return np.column_stack([identity[0] + identity[1], identity[2:6].T]), ("f_px", *INTRINSIC_NAMES[2:6])
    count = 9 if free_k3 else 8
    return identity[:, :count], INTRINSIC_NAMES[:count]


def robust_sigma(lengths: Float64[Array, " n"]) -> float:
    """Standard deviation per coordinate of two-dimensional residuals, from the median of their lengths."""
    return float(np.median(lengths)) / RAYLEIGH_MEDIAN if len(lengths) else 1.0


def _into_camera(network: Network, state: State) -> tuple[Float64[Array, "n 3"], Float64[Array, "n 3"]]:
    """Points turned into the world's directions but not yet moved there, and in the camera's frame; mm."""
    view = network.view
    camera, station = network.view_camera[view], network.view_station[view]
    turned = np.einsum("nij,nj->ni", state.station_rotation[station], state.points[network.point])
    from_centre = turned + state.station_translation[station] - state.camera_centre[camera]
    return turned, np.einsum("nij,nj->ni", state.camera_rotation[camera], from_centre)


def _before_camera(points_camera: Float64[Array, "n 3"], keep: Bool[Array, " n"]) -> Float64[Array, "n 3"]:
    """Put points behind the camera, unless kept, onto its axis: they are judged by their depth, not their image."""
    return np.where(((points_camera[:, 2] <= 0) & ~keep)[:, None], (0.0, 0.0, 1.0), points_camera)
