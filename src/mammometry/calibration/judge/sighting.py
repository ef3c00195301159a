"""Placement of the target by one camera alone, with covariance.

It shows whether the camera moved. A small motion is six numbers, a *twist*: rotation, rad, then translation, mm, of
the world, ``x' = x + r × x + t``. If the target is displaced by the twist w and the camera by the twist m, the camera
sees the target displaced by w − m. So whatever moved, everything that a view of a known target shows is linear in the
twists.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from mammometry.base.value import value
from mammometry.calibration.adjust.calibrated import Calibration, ParameterCovariance
from mammometry.calibration.adjust.initialise import LEAST_POINTS
from mammometry.calibration.adjust.projection import INTRINSIC_NAMES, intrinsics_of, project_with_derivatives
from mammometry.calibration.detection.detect import Detection
from mammometry.geometry import Array, Bool, Camera, Float64, Transform

_STEPS = 10
"""Gauss–Newton steps, at most."""
_SETTLED_PX = 1e-7
"""A step that moves the image by less ends the fit, px."""
_OUTLIER_SIGMA = 6.0
"""Points farther off than this many robust standard deviations are left out."""
_OUTLIER_ROUNDS = 3
"""Times that outliers are sought again."""


@value(eq=False)
class Sighting:
    """Placement of the target as one calibrated camera alone sees it."""

    camera: str
    pose: str
    world_from_target: Transform
    information: Float64[Array, "6 6"]
    """Inverse covariance of that placement, as a twist of the world. Singular directions are kept."""
    by_camera: Float64[Array, "6 k"]
    """Derivative of the placement's twist by the camera's own parameters (`camera_parameters`)."""
    uv_by_twist: Float64[Array, "n 2 6"]
    """Derivative of the points' image by a twist of the target, px."""
    residual_px: Float64[Array, "n 2"]
    """Projected − measured at this placement, px, without the points left out."""

    @property
    def rms_px(self) -> float:
        """Root mean square length of the residuals, px."""
        return float(np.sqrt(np.mean(np.sum(self.residual_px**2, axis=1))))

    def twist_from(self, world_from_target: Transform) -> Float64[Array, 6]:
        """The motion that carries `world_from_target` to where this camera sees the target."""
        return as_twist(self.world_from_target @ world_from_target.inverse())

    def shift_px(self, twist: Float64[Array, 6]) -> float:
        """RMS image displacement of the points by a target twist, px."""
        return float(np.sqrt(np.mean(np.sum((self.uv_by_twist @ twist) ** 2, axis=1))))


def as_twist(motion: Transform) -> Float64[Array, 6]:
    """A small motion as rotation, rad, and translation, mm."""
    return np.concatenate([motion.rotation_vector_rad, motion.translation_mm])


def as_motion(twist: Float64[Array, 6]) -> Transform:
    """The inverse of `as_twist`."""
    return Transform(rotation=Rotation.from_rotvec(twist[:3]).as_matrix(), translation_mm=twist[3:].copy())


def camera_parameters(model: Sequence[str], camera: str) -> list[str]:
    """Names, without the camera's, of its parameters among those of a covariance."""
    return [name.removeprefix(f"{camera}.") for name in model if name.startswith(f"{camera}.")]


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
    """Place the target by one calibrated camera: Gauss–Newton resection.

    Args:
        camera: as calibrated.
        detection: what it saw.
        target_points: the target's points in its own frame, mm.
        start: world_from_target near the answer.
        noise_factor: on the standard deviations of the detection.
        parameters: names of the camera's parameters, for `Sighting.by_camera`.
        keep: points to use; where not given, those within six robust standard deviations.

    Returns:
        None where fewer than six points are left, or none of them in front of the camera.
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
            fresh = length <= _OUTLIER_SIGMA * max(float(np.nanmedian(length)) / np.sqrt(2 * np.log(2)), 1e-6)
            if (fresh == chosen).all():
                break
            chosen = fresh
    projected, by_twist, by_parameters = _linearised(camera, placed.apply(points), parameters)
    whitened = np.einsum("nij,njk->nik", whitener, by_twist).reshape(-1, 6)
    information = whitened.T @ whitened
    effect = np.einsum("nij,njk->nik", whitener, by_parameters).reshape(len(whitened), -1)
    return Sighting(
        camera=camera.name,
        pose=detection.pose,
        world_from_target=placed,
        information=information,
        by_camera=-np.linalg.pinv(information, hermitian=True) @ (whitened.T @ effect),
        uv_by_twist=by_twist,
        residual_px=projected - uv,
    )


def sightings(calibration: Calibration) -> tuple[Sighting, ...]:
    """Each view of a calibration by itself, about the adjusted placement. Only points that took part."""
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
            parameters=camera_parameters(calibration.covariance.names, detection.camera),
            keep=good,
        )
        if seen is not None:
            found.append(seen)
    return tuple(found)


def covariance_of(
    seen: Sequence[Sighting], cameras: ParameterCovariance | None, *, inflation: float = 1.0
) -> Float64[Array, "s s"]:
    """Joint covariance of the sightings' twists, six each. Their own noise, and the cameras' calibration.

    Args:
        seen: the sightings.
        cameras: covariance of the calibrated cameras; None where it is not known.
        inflation: factor on the standard deviations of the sightings' own noise.
    """
    size = 6 * len(seen)
    covariance = np.zeros((size, size))
    for i, sighting in enumerate(seen):
        covariance[6 * i : 6 * i + 6, 6 * i : 6 * i + 6] = inflation**2 * np.linalg.pinv(
            sighting.information, hermitian=True
        )
    if cameras is not None:
        effect = np.zeros((size, len(cameras.names)))
        for i, sighting in enumerate(seen):
            columns = [k for k, name in enumerate(cameras.names) if name.startswith(f"{sighting.camera}.")]
            effect[6 * i : 6 * i + 6, columns] = sighting.by_camera
        covariance += effect @ cameras.matrix @ effect.T
    return covariance


def moved(camera: Camera, motion: Transform) -> Camera:
    """The camera after a motion, in the world's frame, carried it along."""
    return replace(camera, camera_from_world=camera.camera_from_world @ motion.inverse())


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
        projected, by_twist, _ = _linearised(camera, world, ())
        rows = np.einsum("nij,njk->nik", whitener, by_twist).reshape(-1, 6)
        right = np.einsum("nij,nj->ni", whitener, uv - projected).ravel()
        step = np.linalg.lstsq(rows, right, rcond=None)[0]
        if not np.isfinite(step).all():
            return None
        placed = as_motion(step) @ placed
        if np.abs(by_twist @ step).max() < _SETTLED_PX:
            break
    return placed


def _linearised(
    camera: Camera, world: Float64[Array, "n 3"], parameters: Sequence[str]
) -> tuple[Float64[Array, "n 2"], Float64[Array, "n 2 6"], Float64[Array, "n 2 k"]]:
    """Image points and derivatives by a world twist and camera parameters."""
    rotation = camera.camera_from_world.rotation
    inside = camera.camera_from_world.apply(world)
    projection = project_with_derivatives(inside, np.tile(intrinsics_of(camera), (len(world), 1)))
    by_world = projection.by_point @ rotation
    by_twist = np.concatenate([np.cross(world[:, None, :], by_world), by_world], axis=2)
    by_rotation = np.cross(inside[:, None, :], projection.by_point)
    columns = np.empty((len(world), 2, len(parameters)))
    for k, name in enumerate(parameters):
        if name == "f_px":
            columns[:, :, k] = projection.by_intrinsics[:, :, :2].sum(axis=2)
        elif name in INTRINSIC_NAMES:
            columns[:, :, k] = projection.by_intrinsics[:, :, INTRINSIC_NAMES.index(name)]
        elif name.startswith("rotation_"):
            columns[:, :, k] = by_rotation[:, :, "xyz".index(name[9])]
        else:
            columns[:, :, k] = -by_world[:, :, "xyz".index(name[7])]
    return projection.uv, by_twist, columns
