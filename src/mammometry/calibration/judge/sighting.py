"""Placement of the target by one camera alone, with covariance.

It shows whether the camera moved. If the target is displaced by the twist w (`geometry.twist`) and the camera by the
twist m, the camera sees the target displaced by w − m. So each view of a known target is linear in the twists of both.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from mammometry.base.value import value
from mammometry.calibration.adjust.calibrated import Calibration, ParameterCovariance
from mammometry.calibration.adjust.initialise import LEAST_POINTS
from mammometry.calibration.adjust.linear_model import FREE, LinearModel, linear_model, square_root
from mammometry.calibration.adjust.robust import RAYLEIGH_MEDIAN
from mammometry.calibration.detection.detect import Detection
from mammometry.calibration.judge.expected_error import derivatives
from mammometry.geometry import Array, Bool, Camera, Float64, Transform
from mammometry.geometry.twist import as_motion, as_twist

_STEPS = 10
"""Most Gauss–Newton steps."""
_SETTLED_PX = 1e-7
"""Displacement of the image, px, below which a step ends the fit."""
_OUTLIER_SIGMA = 6.0
"""Robust standard deviations above which points are excluded."""
_OUTLIER_ROUNDS = 3
"""Most searches for outliers."""


@value(eq=False)
class Sighting:
    """Placement of the target as one calibrated camera alone sees it."""

    camera: str
    pose: str
    world_from_target: Transform
    information: Float64[Array, "6 6"]
    """Inverse covariance of that placement, as a twist of the world. Singular directions are kept."""
    by_camera: Float64[Array, "6 k"]
    """Derivative of the placement's twist by the camera's own parameters, in the order of their covariance."""
    uv_by_twist: Float64[Array, "n 2 6"]
    """Derivative of the points' image by a twist of the target, px."""
    residual_px: Float64[Array, "n 2"]
    """Projected − measured at this placement, px, of the points that were used."""

    @property
    def rms_px(self) -> float:
        """Root mean square length of the residuals, px."""
        return float(np.sqrt(np.mean(np.sum(self.residual_px**2, axis=1))))

    def twist_from(self, world_from_target: Transform) -> Float64[Array, 6]:
        """Twist from `world_from_target` to the placement that this camera sees."""
        return as_twist(self.world_from_target @ world_from_target.inverse())

    def shift_px(self, twist: Float64[Array, 6]) -> float:
        """RMS image displacement of the points by a target twist, px."""
        return float(np.sqrt(np.mean(np.sum((self.uv_by_twist @ twist) ** 2, axis=1))))


def sight(
    camera: Camera,
    detection: Detection,
    target_points: Float64[Array, "p 3"],
    start: Transform,
    *,
    noise_factor: float = 1.0,
    parameters: Sequence[str] = (),
    keep: Bool[Array, " n"] | None = None,
) -> Sighting | None:
    """Estimate the target's placement from one calibrated camera (Gauss–Newton resection).

    Args:
        camera: as calibrated.
        detection: what it saw.
        target_points: the target's points in its own frame, mm.
        start: approximate world_from_target.
        noise_factor: factor on the standard deviations of the detection.
        parameters: names of calibrated parameters. Of those, the camera's own are used for `Sighting.by_camera`.
        keep: points to use. None: those within six robust standard deviations.

    Returns:
        None if fewer than six points remain, or none is in front of the camera.
    """
    chosen = np.ones(len(detection.ids), bool) if keep is None else keep
    placed = start
    for _ in range(1 if keep is not None else _OUTLIER_ROUNDS):
        if chosen.sum() < LEAST_POINTS:
            return None
        whitener = np.linalg.inv(np.linalg.cholesky(detection.covariance_px2[chosen])) / noise_factor
        points, uv = target_points[detection.ids[chosen]], detection.uv[chosen]
        found = _resected(camera, points, uv, whitener, placed)
        if found is None:
            return None
        placed = found
        if keep is None:
            length = np.linalg.norm(camera.project(placed.apply(target_points[detection.ids])) - detection.uv, axis=1)
            fresh = length <= _OUTLIER_SIGMA * max(float(np.nanmedian(length)) / RAYLEIGH_MEDIAN, 1e-6)
            if (fresh == chosen).all():
                break
            chosen = fresh
    own = tuple(name for name in parameters if name.startswith(f"{camera.name}."))
    model, by_twist = _model(camera, placed.apply(points), uv, whitener, own)
    fit = model.fit(np.repeat([FREE, 0.0], [6, len(own)]))
    return Sighting(
        camera=camera.name,
        pose=detection.pose,
        world_from_target=placed,
        information=model.matrix[:6, :6],
        by_camera=-fit.covariance[:6, :6] @ model.matrix[:6, 6:],
        uv_by_twist=by_twist,
        residual_px=camera.project(placed.apply(points)) - uv,
    )


def sightings(calibration: Calibration) -> tuple[Sighting, ...]:
    """Each view of a calibration by itself, about the adjusted placement, with only the points used."""
    found = []
    for detection, residual_px in zip(calibration.observations.detections, calibration.residuals_px, strict=True):
        good = np.isfinite(residual_px).all(axis=1)
        start = calibration.world_from_target.get(detection.pose)
        if start is None:
            continue
        seen = sight(
            calibration.rig.cameras[detection.camera],
            detection,
            calibration.target_points,
            start,
            noise_factor=calibration.noise_factor,
            parameters=calibration.covariance.names,
            keep=good,
        )
        if seen is not None:
            found.append(seen)
    return tuple(found)


def disagreement(
    seen: Sequence[Sighting],
    placed: Mapping[str, Transform],
    moves: Float64[Array, "s m"],
    cameras: ParameterCovariance | None = None,
    *,
    inflation: float = 1.0,
) -> LinearModel:
    """Model of m motions, six numbers each, that make sightings disagree with placements of the target.

    Args:
        seen: the sightings.
        placed: exposure → placement.
        moves: effect of each motion on each sighting's twist: 1 of the target's, −1 of the camera's, else 0.
        cameras: covariance of the calibrated cameras; None if unknown.
        inflation: factor on the standard deviations of the sightings' own noise.
    """
    twists = np.array([sighting.twist_from(placed[sighting.pose]) for sighting in seen])
    columns = [np.kron(moves, np.eye(6)), twists.reshape(-1, 1)]
    if cameras is not None:
        of_seen = [n for n, name in enumerate(cameras.names) if name.rpartition(".")[0] in {s.camera for s in seen}]
        effect = np.zeros((len(seen), 6, len(of_seen)))
        for i, sighting in enumerate(seen):
            own = [k for k, n in enumerate(of_seen) if cameras.names[n].startswith(f"{sighting.camera}.")]
            effect[i][:, own] = sighting.by_camera
        columns.append(effect.reshape(-1, len(of_seen)) @ square_root(cameras.matrix[np.ix_(of_seen, of_seen)]))
    roots = np.array([square_root(sighting.information).T for sighting in seen]) / inflation
    rows = np.concatenate(columns, axis=1)
    white = (roots @ rows.reshape(len(seen), 6, -1)).reshape(rows.shape)
    return linear_model([white], 6 * moves.shape[1])


def moves_of(seen: Sequence[Sighting], poses: Sequence[str], cameras: Sequence[str]) -> Float64[Array, "s m"]:
    """Effects of the target's motions in poses, then of cameras' motions, on sightings (`disagreement`)."""
    of_poses = [[float(sighting.pose == pose) for pose in poses] for sighting in seen]
    of_cameras = [[-float(sighting.camera == camera) for camera in cameras] for sighting in seen]
    return np.concatenate([np.array(of_poses), np.array(of_cameras).reshape(len(seen), -1)], axis=1)


def _resected(
    camera: Camera,
    points: Float64[Array, "n 3"],
    uv: Float64[Array, "n 2"],
    whitener: Float64[Array, "n 2 2"],
    start: Transform,
) -> Transform | None:
    placed = start
    for _ in range(_STEPS):
        world = placed.apply(points)
        if (camera.camera_from_world.apply(world)[:, 2] <= 0).any():
            return None
        model, by_twist = _model(camera, world, uv, whitener, ())
        if not np.isfinite(model.squares):
            return None
        step = model.fit(np.full(6, FREE)).motions
        placed = as_motion(step) @ placed
        if np.abs(by_twist @ step).max() < _SETTLED_PX:
            break
    return placed


def _model(
    camera: Camera,
    world: Float64[Array, "n 3"],
    uv: Float64[Array, "n 2"],
    whitener: Float64[Array, "n 2 2"],
    parameters: tuple[str, ...],
) -> tuple[LinearModel, Float64[Array, "n 2 6"]]:
    """Model of the target's twist and of camera parameters, and the derivatives of the image by the twist."""
    by_world, by_parameters = derivatives(camera, world, parameters)
    by_twist = np.concatenate([np.cross(world[:, None, :], by_world), by_world], axis=2)
    left = (uv - camera.project(world))[:, :, None]
    white = whitener @ np.concatenate([by_twist, by_parameters, left], axis=2)
    return linear_model([white.reshape(2 * len(uv), -1)], 6 + len(parameters)), by_twist
