"""Observations of a rig as plain arrays for the adjustment.

A *view* is one camera's detection of the target in one *station*. A station is one placement of a target: a pose shared
by all cameras, or one seen by a single camera (a photograph for its intrinsics). Parameters per camera: intrinsics,
rotation and perspective centre. Per station: rotation and translation. Also the target's points, if free. Rotations are
updated by a small rotation vector from the left.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from mammometry.calibration.adjust.projection import INTRINSIC_NAMES, project
from mammometry.geometry.arrays import Array, Bool, Float64, Int64

POSE_NAMES_CAMERA = ("rotation_x_rad", "rotation_y_rad", "rotation_z_rad", "centre_x_mm", "centre_y_mm", "centre_z_mm")
POSE_NAMES_STATION = ("rotation_x_rad", "rotation_y_rad", "rotation_z_rad", "x_mm", "y_mm", "z_mm")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Network:
    """The observations as arrays: views in order, with their points one after another."""

    cameras: tuple[str, ...]
    stations: tuple[str, ...]
    """Names. The first station's frame is the world."""
    view_camera: Int64[Array, " v"]
    view_station: Int64[Array, " v"]
    view_group: Int64[Array, " v"]
    """Group of each view: 0 for the rig's target, 1 for intrinsics photographs. Each group has one factor on the
    covariances of its detections."""
    view_start: Int64[Array, " v1"]
    """Index of each view's first point, and the number of points at the end."""
    point: Int64[Array, " n"]
    """Row of the state's `points`."""
    uv: Float64[Array, "n 2"]
    whitener: Float64[Array, "n 2 2"]
    """Inverse of the lower Cholesky factor of a point's covariance: residual px → standard deviations."""
    tie: Float64[Array, "10 m"]
    """Matrix of the camera model: intrinsic values by adjusted parameters. A 1 marks the value that a parameter
    sets."""
    intrinsic_names: tuple[str, ...]
    """Names of the adjusted intrinsic parameters."""
    prior_intrinsics: Float64[Array, "c 10"]
    """Prior values of the intrinsics."""
    prior_intrinsics_std: Float64[Array, "c 10"]
    """Their standard deviation. Infinite without a prior."""
    nominal_points: Float64[Array, "p 3"]
    """All targets' points, each in its target's frame, mm."""
    prior_mm: Float64[Array, "p 3"]
    """Standard deviation of the points about nominal, mm. Infinite for fixed points."""

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
    def pose_count(self) -> int:
        """Number of parameters of all cameras and stations, held ones included."""
        return len(self.cameras) * self.per_camera + 6 * len(self.stations)

    @property
    def parameter_names(self) -> tuple[str, ...]:
        """Name of each parameter: ``front_left.fx_px``, ``pose 01.rotation_x_rad``, ``point 7.x_mm``."""
        of_camera = (*self.intrinsic_names, *POSE_NAMES_CAMERA)
        names = [f"{camera}.{name}" for camera in self.cameras for name in of_camera]
        names += [f"pose {station}.{name}" for station in self.stations for name in POSE_NAMES_STATION]
        names += [f"point {row}.{axis}_mm" for row in self.free_points for axis in "xyz"]
        return tuple(names)

    def columns_of_camera(self, camera: int | np.integer) -> Int64[Array, " k"]:
        """Columns of a camera's parameters."""
        return camera * self.per_camera + np.arange(self.per_camera)

    def columns_of_station(self, station: int | np.integer) -> Int64[Array, 6]:
        """Columns of a station's parameters."""
        return len(self.cameras) * self.per_camera + 6 * station + np.arange(6)

    def columns_of_intrinsic(self, name: str) -> Int64[Array, " c"]:
        """Column of one intrinsic parameter of each camera. Empty if the model does not have it."""
        if name not in self.intrinsic_names:
            return np.empty(0, np.int64)
        return np.arange(len(self.cameras)) * self.per_camera + self.intrinsic_names.index(name)

    def of_views(self, views: Sequence[int]) -> Network:
        """Network of the same cameras, stations and points with these views only."""
        rows = np.concatenate([np.arange(self.view_start[i], self.view_start[i + 1]) for i in views])
        chosen = np.asarray(views)
        return replace(
            self,
            view_camera=self.view_camera[chosen],
            view_station=self.view_station[chosen],
            view_group=self.view_group[chosen],
            view_start=np.concatenate([[0], np.cumsum(np.diff(self.view_start)[chosen])]),
            point=self.point[rows],
            uv=self.uv[rows],
            whitener=self.whitener[rows],
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class State:
    """Values of all parameters."""

    intrinsics: Float64[Array, "c 10"]
    camera_rotation: Float64[Array, "c 3 3"]
    """Rotation of camera_from_world."""
    camera_centre: Float64[Array, "c 3"]
    """Perspective centres, world, mm."""
    station_rotation: Float64[Array, "s 3 3"]
    """Rotation of world_from_target."""
    station_translation: Float64[Array, "s 3"]
    """Translation of world_from_target, mm."""
    points: Float64[Array, "p 3"]
    """All targets' points, each in its target's frame, mm."""


def tie_of(names: Sequence[str]) -> Float64[Array, "10 m"]:
    """Matrix from adjusted parameters to the ten intrinsic values. ``f_px`` sets both focal lengths."""
    unit = dict(zip(INTRINSIC_NAMES, np.eye(len(INTRINSIC_NAMES)), strict=True))
    unit["f_px"] = unit["fx_px"] + unit["fy_px"]
    return np.stack([unit[name] for name in names], axis=1)


def residuals(network: Network, state: State) -> tuple[Float64[Array, "n 2"], Float64[Array, " n"]]:
    """Reprojection errors, projected − measured, px, and depths in the cameras' frames, mm."""
    everything = slice(0, len(network.uv))
    _, points_camera = into_camera(network, state, everything)
    depth = points_camera[:, 2].copy()
    intrinsics = state.intrinsics[network.view_camera[network.view]]
    return project(before_camera(points_camera, np.zeros(len(depth), bool)), intrinsics) - network.uv, depth


def into_camera(network: Network, state: State, part: slice) -> tuple[Float64[Array, "n 3"], Float64[Array, "n 3"]]:
    """Points rotated into the world's directions but not translated, and points in the camera's frame, mm."""
    view = network.view[part]
    camera, station = network.view_camera[view], network.view_station[view]
    turned = np.einsum("nij,nj->ni", state.station_rotation[station], state.points[network.point[part]])
    from_centre = turned + state.station_translation[station] - state.camera_centre[camera]
    return turned, np.einsum("nij,nj->ni", state.camera_rotation[camera], from_centre)


def before_camera(points_camera: Float64[Array, "n 3"], keep: Bool[Array, " n"]) -> Float64[Array, "n 3"]:
    """Move points behind the camera onto its axis, unless kept, so that their projection is finite."""
    return np.where(((points_camera[:, 2] <= 0) & ~keep)[:, None], (0.0, 0.0, 1.0), points_camera)
