"""Bundle adjustment of all cameras and target placements at once, with covariance (paper 2.2)."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from mammometry.base.errors import CalibrationError
from mammometry.base.machine.cores import one_blas_thread
from mammometry.base.progress import Progress, no_progress
from mammometry.calibration.adjust.calibrated import Calibration, ParameterCovariance, SetAside
from mammometry.calibration.adjust.initialise import InitialRig, initialise, require_connected
from mammometry.calibration.adjust.least_squares import SingularNormalEquationsError
from mammometry.calibration.adjust.left_out import leave_poses_out
from mammometry.calibration.adjust.network import POSE_NAMES_CAMERA, Network, State, residuals, tie_of
from mammometry.calibration.adjust.projection import INTRINSIC_NAMES, CameraPrior
from mammometry.calibration.adjust.robust import (
    RobustResult,
    adjusted,
    bad_views,
    clustered_covariance,
    independent_covariance,
)
from mammometry.calibration.detection.detect import Detection, Observations
from mammometry.calibration.settings import BundleSettings, CalibrateSettings
from mammometry.calibration.targets.target import Target
from mammometry.geometry import Array, Bool, Camera, Float64, Rig, Transform

FREE_TARGET_POSES = 6
"""Fewest placements from which ``auto`` adjusts a board's shape. With fewer, its shape and the cameras' parameters can
hardly be separated."""

_PARAMETERS = {
    "brown": INTRINSIC_NAMES[:9],
    "paper": ("f_px", *INTRINSIC_NAMES[2:6]),  # 2.2: f, x₀, y₀, μ, ν
}


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class UsedDetection:
    """One detection that is used, and its source."""

    camera: str
    pose: str
    detection: Detection
    index: int
    """Index in its observations' `detections`."""
    own: bool
    """Whether it is one of its camera's separate photographs."""

    @property
    def station(self) -> str:
        """Name of the target's placement: the pose, or a camera's own."""
        return f"{self.camera}/{self.pose}" if self.own else self.pose


def all_views(observations: Observations, own: Mapping[str, Observations], initial: InitialRig) -> list[UsedDetection]:
    """All views with an initial placement, shared poses before the cameras' own."""
    views = [
        UsedDetection(camera=detection.camera, pose=detection.pose, detection=detection, index=i, own=False)
        for i, detection in enumerate(observations.detections)
        if detection.pose in initial.world_from_target and len(detection.ids)
    ]
    for separate in own.values():
        views += [
            UsedDetection(camera=detection.camera, pose=detection.pose, detection=detection, index=i, own=True)
            for i, detection in enumerate(separate.detections)
            if (detection.camera, detection.pose) in initial.own_camera_from_target
        ]
    return views


def network_of(
    views: Sequence[UsedDetection],
    observations: Observations,
    own: Mapping[str, Observations],
    initial: InitialRig,
    priors: Mapping[str, CameraPrior],
    settings: BundleSettings,
) -> tuple[Network, State]:
    """Flatten the views and their initial values."""
    cameras = tuple(observations.sizes_wh)
    stations = tuple(dict.fromkeys([*sorted({v.station for v in views if not v.own}), *(v.station for v in views)]))
    target_of = {"": observations.target, **{camera: separate.target for camera, separate in own.items()}}
    targets = list(dict.fromkeys(target_of.values()))  # equal boards share their points
    tables = [target.points_target for target in targets]
    first_rows = np.concatenate([[0], np.cumsum([len(table) for table in tables])])
    rows = {camera: first_rows[targets.index(target)] for camera, target in target_of.items()}
    prior_mm = np.full((first_rows[-1], 3), np.inf)
    for k, target in enumerate(targets):
        placements = {view.station for view in views if target_of[view.camera if view.own else ""] == target}
        if _is_free(target, len(placements), settings):
            prior_mm[first_rows[k] : first_rows[k + 1]] = _shape_prior_mm(target, settings)
    first = np.stack([initial.intrinsics[camera] for camera in cameras])
    prior_std = np.full_like(first, np.inf)
    for i, camera in enumerate(cameras):
        if camera in priors:
            prior_std[i] = priors[camera].intrinsics_std
    covariance = np.concatenate([view.detection.covariance_px2 for view in views])
    names = _PARAMETERS[settings.model]
    network = Network(
        cameras=cameras,
        stations=stations,
        view_camera=np.array([cameras.index(view.camera) for view in views]),
        view_station=np.array([stations.index(view.station) for view in views]),
        view_group=np.array([int(view.own) for view in views]),
        view_start=np.concatenate([[0], np.cumsum([len(view.detection.ids) for view in views])]),
        point=np.concatenate([view.detection.ids + rows[view.camera if view.own else ""] for view in views]),
        uv=np.concatenate([view.detection.uv for view in views]),
        whitener=np.linalg.inv(np.linalg.cholesky(covariance)),
        tie=tie_of(names),
        intrinsic_names=names,
        prior_intrinsics=first,
        prior_intrinsics_std=prior_std,
        nominal_points=np.concatenate(tables),
        prior_mm=prior_mm,
    )
    return network, _start(network, views, initial, settings)


def held_at_first(network: Network, priors: Mapping[str, CameraPrior]) -> Bool[Array, " p"]:
    """Parameters that are held: the world's placement, those fixed by priors, and k3 at first."""
    held = np.zeros(network.pose_count, bool)
    held[network.columns_of_station(0)] = True
    held[network.columns_of_intrinsic("k3")] = True
    for i, camera in enumerate(network.cameras):
        if camera in priors:
            fixed = [name in priors[camera].fixed for name in INTRINSIC_NAMES]
            touched = (network.tie[fixed] != 0).any(axis=0)
            held[network.columns_of_camera(i)[: len(touched)][touched]] = True
    return held


def _is_free(target: Target, placements: int, settings: BundleSettings) -> bool:
    if settings.free_target == "auto":
        return not target.is_surveyed and placements >= FREE_TARGET_POSES
    return settings.free_target == "always"


def _shape_prior_mm(target: Target, settings: BundleSettings) -> tuple[float, float, float]:
    """Prior standard deviations of the target's points, mm. In depth, a measured flatness is used instead."""
    across_x, across_y, depth = settings.target_prior_mm
    return across_x, across_y, target.flatness_mm or depth


def _start(network: Network, views: Sequence[UsedDetection], initial: InitialRig, settings: BundleSettings) -> State:
    intrinsics = np.stack([initial.intrinsics[camera] for camera in network.cameras])
    if settings.model == "paper":
        intrinsics[:, :2] = intrinsics[:, :2].mean(axis=1, keepdims=True)
    placements = {}
    for view in views:
        if view.own:
            world_from_camera = initial.camera_from_world[view.camera].inverse()
            placements[view.station] = world_from_camera @ initial.own_camera_from_target[view.camera, view.pose]
        else:
            placements[view.station] = initial.world_from_target[view.pose]
    first_from_world = placements[network.stations[0]].inverse()  # the first pose may have been excluded
    targets = [first_from_world @ placements[station] for station in network.stations]
    cameras = [initial.camera_from_world[camera] @ first_from_world.inverse() for camera in network.cameras]
    return State(
        intrinsics=intrinsics,
        camera_rotation=np.stack([camera.rotation for camera in cameras]),
        camera_centre=np.stack([camera.inverse().translation_mm for camera in cameras]),
        station_rotation=np.stack([target.rotation for target in targets]),
        station_translation=np.stack([target.translation_mm for target in targets]),
        points=network.nominal_points.copy(),
    )


K3_SIGMA = 4.0
"""Standard deviations (for errors shared by a photograph's points) above which ``auto`` accepts k3."""
VIEW_RATIO = 50.0
"""Ratio to all views' median residual above which a whole view is excluded. Only a photograph of another pose, swapped
cameras or a mirrored target exceeds it."""

__all__ = ["BundleSettings", "Calibration", "ParameterCovariance", "SetAside", "calibrate"]

_LEAST_VIEW_ERROR_PX = 1.0
"""Median residual below which a view is never excluded, px."""
_FIRST_VIEW_ERROR_WIDTHS = 0.02
"""The same before the first adjustment, in image widths. Initial values are good to about a pixel, while photographs of
another pose are far off."""


@one_blas_thread()
def calibrate(
    observations: Observations,
    pair_names: Mapping[str, tuple[str, str]],
    rig_name: str,
    settings: CalibrateSettings = CalibrateSettings(),
    *,
    intrinsics_observations: Mapping[str, Observations] | None = None,
    priors: Mapping[str, CameraPrior] | None = None,
    progress: Progress = no_progress,
) -> Calibration:
    """Adjust all cameras and target placements to the observations (paper 2.2).

    Minimises the Huber loss of the reprojection errors, each in its detection's standard deviations, over intrinsics
    and poses of all cameras and placements of the target. Then excludes outliers and repeats. The world is the target's
    frame in the first pose (in name order).

    Args:
        observations: of the rig's target, with all cameras exposed together in each pose.
        pair_names: pair → names of its left and right camera.
        rig_name: the rig's name.
        settings: of the calibration; only `bundle` is used.
        intrinsics_observations: camera → separate photographs of any target by this camera alone; they are adjusted
            too, each with its own placement.
        priors: camera → prior of its lens. With one, a single view of the camera is enough.
        progress: called with the fraction done.

    Raises:
        CalibrationError: too few views, cameras that share no pose with the rest, different image sizes, or parameters
            that the observations do not determine.
    """
    own, priors = dict(intrinsics_observations or {}), dict(priors or {})
    _check_pairs(pair_names, observations)
    initial = initialise(observations, intrinsics_observations=own, priors=priors)
    progress(0.2)
    views = all_views(observations, own, initial)
    set_aside: list[SetAside] = []

    def flattened() -> tuple[Network, State]:
        return network_of(views, observations, own, initial, priors, settings.bundle)

    def setting_aside(network: Network, state: State, least_px: float) -> bool:
        """Exclude views that do not fit at all. Return whether there were any."""
        bad = bad_views(network, state, VIEW_RATIO, least_px)
        set_aside.extend(SetAside(camera=views[i].camera, pose=views[i].pose, residual_px=px) for i, px in bad.items())
        views[:] = [view for i, view in enumerate(views) if i not in bad]
        _require_every_camera(views, observations, set_aside)
        return bool(bad)

    widest_px = max(width for width, _ in observations.sizes_wh.values())
    setting_aside(*flattened(), _FIRST_VIEW_ERROR_WIDTHS * widest_px)  # before they affect the adjustment
    network, start = flattened()
    solved = adjusted(network, held_at_first(network, priors), start)
    while setting_aside(network, solved.state, _LEAST_VIEW_ERROR_PX):
        network, start = flattened()
        solved = adjusted(network, held_at_first(network, priors), start)
    progress(0.5)
    solved = _with_needed_k3(solved, priors, settings.bundle)
    progress(0.8)
    calibration = _as_calibration(solved, views, observations, own, pair_names, rig_name, tuple(set_aside))
    progress(1.0)
    return calibration


def _check_pairs(pair_names: Mapping[str, tuple[str, str]], observations: Observations) -> None:
    for pair, names in pair_names.items():
        for camera in names:
            if camera not in observations.sizes_wh:
                raise CalibrationError(
                    f"pair {pair}",
                    found=f"camera {camera}, which has no calibration photograph",
                    expected=f"one of {', '.join(observations.sizes_wh)}",
                    remedy="Correct the pair's camera names, or add that camera's photographs",
                )


def _require_every_camera(
    views: Sequence[UsedDetection], observations: Observations, set_aside: Sequence[SetAside]
) -> None:
    left = Counter(view.camera for view in views if not view.own)
    aside = {camera: [view.pose for view in set_aside if view.camera == camera] for camera in observations.sizes_wh}
    wrong = [camera for camera, poses in aside.items() if len(poses) > left[camera]]
    if wrong:
        poses = ", ".join(sorted({pose for camera in wrong for pose in aside[camera]}))
        raise CalibrationError(
            f"camera{'s' if len(wrong) > 1 else ''} {', '.join(wrong)}",
            found=f"photographs that do not fit those of the other cameras in most poses ({poses})",
            expected="photographs exposed together with those of the other cameras",
            remedy="Check that its files are in the right pose folders, that none was mirrored, and that nothing moved",
        )
    require_connected([(view.camera, view.pose) for view in views if not view.own])


def _with_needed_k3(solved: RobustResult, priors: Mapping[str, CameraPrior], settings: BundleSettings) -> RobustResult:
    """Adjust k3 too for cameras that need it.

    k3 must differ significantly from zero, by its standard deviation from the scatter between photographs. With the one
    for independent residuals, every lens would seem to have a k3.
    """
    network = solved.problem.network
    columns = network.columns_of_intrinsic("k3")
    fixed = [camera in priors and "k3" in priors[camera].fixed for camera in network.cameras]
    free = ~np.array(fixed)[: len(columns)]
    if settings.k3 == "zero" or not free.any():
        return solved
    held = solved.problem.held.copy()
    held[columns[free]] = False
    freed = adjusted(network, held, solved.state)
    if settings.k3 == "free":
        return freed
    std = np.sqrt(np.diag(clustered_covariance(freed, _independent(freed)))[columns])
    known = np.isfinite(network.prior_intrinsics_std[:, INTRINSIC_NAMES.index("k3")])
    needed = free & (known | (np.abs(freed.state.intrinsics[:, INTRINSIC_NAMES.index("k3")]) > K3_SIGMA * std))
    if needed.all():
        return freed
    if not needed.any():
        return solved
    held[columns[free & ~needed]] = True
    return adjusted(network, held, solved.state)


def _as_calibration(
    solved: RobustResult,
    views: Sequence[UsedDetection],
    observations: Observations,
    own: Mapping[str, Observations],
    pair_names: Mapping[str, tuple[str, str]],
    rig_name: str,
    set_aside: tuple[SetAside, ...],
) -> Calibration:
    network, state = solved.problem.network, solved.state
    independent = _independent(solved)
    clustered = clustered_covariance(solved, independent)
    free = np.flatnonzero(~solved.problem.held)
    covariance = ParameterCovariance(
        names=tuple(network.parameter_names[i] for i in free),
        matrix=clustered[np.ix_(free, free)],
        independent=independent[np.ix_(free, free)],
    )
    residual_px, _ = residuals(network, state)
    residual_px[~solved.problem.active] = np.nan
    rig_residuals = [np.full((len(d.ids), 2), np.nan) for d in observations.detections]
    own_residuals = {
        camera: [np.full((len(d.ids), 2), np.nan) for d in separate.detections] for camera, separate in own.items()
    }
    for i, view in enumerate(views):
        into = own_residuals[view.camera] if view.own else rig_residuals
        into[view.index] = residual_px[network.view_start[i] : network.view_start[i + 1]]
    squares = np.concatenate([np.sum(part**2, axis=1) for part in rig_residuals])
    cameras = {
        name: Camera(
            name=name,
            size_wh=observations.sizes_wh[name],
            matrix=np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]]),
            distortion=np.array(distortion),
            camera_from_world=Transform(rotation=rotation, translation_mm=-rotation @ centre),
        )
        for name, (fx, fy, cx, cy, *distortion, _skew), rotation, centre in zip(
            network.cameras, state.intrinsics, state.camera_rotation, state.camera_centre, strict=True
        )
    }
    target, first = observations.target, network.stations[0]
    what = f"the surveyed {target.kind} target" if target.is_surveyed else f"the {target.kind} board"
    shared = {view.pose for view in views if not view.own}
    target_points = state.points[: len(target.points_target)].copy()
    middles = [
        state.station_rotation[i] @ target_points.mean(axis=0) + state.station_translation[i]
        for i, pose in enumerate(network.stations)
        if pose in shared
    ]
    return Calibration(
        rig=Rig(name=rig_name, cameras=cameras, pair_names=pair_names, target_middle_world=np.median(middles, axis=0)),
        world=f"frame of {what} in pose {first}, mm",
        world_from_target={
            pose: Transform(
                rotation=state.station_rotation[i].copy(), translation_mm=state.station_translation[i].copy()
            )
            for i, pose in enumerate(network.stations)
            if pose in shared
        },
        target_points=target_points,
        observations=observations,
        residuals_px=tuple(rig_residuals),
        intrinsics_observations=own,
        intrinsics_residuals_px={camera: tuple(parts) for camera, parts in own_residuals.items()},
        rms_px=float(np.sqrt(np.nanmean(squares))),
        noise_factor=float(solved.problem.group_sigma[0]),
        parameter_std=_parameter_std(network, clustered),
        independent_std=_parameter_std(network, independent),
        covariance=covariance,
        scale_std=target.scale_std,
        left_out=leave_poses_out(solved),
        set_aside=set_aside,
        iterations=solved.minimum.iterations,
        converged=solved.minimum.converged,
    )


def _independent(solved: RobustResult) -> Float64[Array, "p p"]:
    try:
        return independent_covariance(solved)
    except SingularNormalEquationsError as error:
        raise CalibrationError(
            f"parameter {solved.problem.network.parameter_names[error.parameter]}",
            found="too little information in the photographs",
            expected="poses that cover each camera's field of view, with different tilts",
            remedy="Add calibration poses, especially for that camera",
        ) from error
    except ValueError as error:
        raise CalibrationError(
            "the calibration",
            found=str(error),
            expected="more measured coordinates than parameters",
            remedy="Add calibration poses",
        ) from error


def _parameter_std(network: Network, covariance: Float64[Array, "p p"]) -> dict[str, dict[str, float]]:
    std = {}
    count = network.tie.shape[1]
    for i, camera in enumerate(network.cameras):
        part = network.columns_of_camera(i)
        block = covariance[np.ix_(part, part)]
        intrinsic = np.sqrt(np.diag(network.tie @ block[:count, :count] @ network.tie.T))
        pose = np.sqrt(np.diag(block)[count:])
        values = np.concatenate([intrinsic[: INTRINSIC_NAMES.index("skew_px")], pose]).tolist()
        names = [name for name in INTRINSIC_NAMES if name != "skew_px"]
        std[camera] = dict(zip((*names, *POSE_NAMES_CAMERA), values, strict=True))
    return std
