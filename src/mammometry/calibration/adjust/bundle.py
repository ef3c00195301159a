"""Bundle adjustment of all cameras and target placements at once, with covariance (paper 2.2)."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence

import numpy as np

from mammometry.base.errors import CalibrationError
from mammometry.base.machine.cores import one_blas_thread
from mammometry.base.progress import Progress, no_progress
from mammometry.calibration.adjust.assemble import View, all_views, held_at_first, network_of
from mammometry.calibration.adjust.calibrated import Calibration, ParameterCovariance, SetAside
from mammometry.calibration.adjust.initialise import initialise, require_connected
from mammometry.calibration.adjust.least_squares import SingularNormalEquationsError
from mammometry.calibration.adjust.left_out import leave_poses_out
from mammometry.calibration.adjust.network import POSE_NAMES_CAMERA, Network, State, residuals
from mammometry.calibration.adjust.projection import INTRINSIC_NAMES, CameraPrior
from mammometry.calibration.adjust.robust import (
    Solved,
    adjusted,
    bad_views,
    clustered_covariance,
    independent_covariance,
)
from mammometry.calibration.detection.detect import Observations
from mammometry.calibration.settings import BundleSettings, CalibrateSettings
from mammometry.geometry import Array, Camera, Float64, Rig, Transform

K3_SIGMA = 4.0
"""Standard deviations (for errors that a photograph's points share) above which ``auto`` accepts k3."""
VIEW_RATIO = 50.0
"""Ratio to all views' median residual above which a whole view is set aside and named. Only a picture of another pose,
swapped cameras or a mirrored target reach it."""

__all__ = ["BundleSettings", "Calibration", "ParameterCovariance", "SetAside", "calibrate"]

_SET_ASIDE_ROUNDS = 3
"""Times that views are set aside after an adjustment, at most."""
_LEAST_VIEW_ERROR_PX = 1.0
"""Median residual below which a view is never set aside, px."""
_FIRST_VIEW_ERROR_WIDTHS = 0.02
"""The same before the first adjustment, in picture widths. First values are good to a pixel or so, pictures of another
pose are much farther off."""


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

    Minimises Huber's loss of the reprojection errors, each in its own detection's standard deviations, over intrinsics
    and poses of all cameras and placements of the target; then leaves out outliers, and repeats. The world is the
    target's frame in the first pose (in name order).

    Args:
        observations: of the rig's target, all cameras exposed together in each pose.
        pair_names: pair → names of its left and right camera.
        rig_name: the rig's name.
        settings: of the calibration; `bundle` is used here.
        intrinsics_observations: camera → separate photographs of any target that only this camera took; they take part
            in the adjustment, each with a placement of its own.
        priors: camera → its lens as known beforehand; with one, a single view of a camera suffices.
        progress: called with the fraction done.

    Raises:
        CalibrationError: too few views, cameras that share no pose with the rest, image sizes that differ, or
            parameters that the observations do not determine.
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
        """Leave out views that are of something else."""
        bad = bad_views(network, state, VIEW_RATIO, least_px)
        set_aside.extend(SetAside(camera=views[i].camera, pose=views[i].pose, residual_px=px) for i, px in bad.items())
        views[:] = [view for i, view in enumerate(views) if i not in bad]
        _require_every_camera(views, observations, set_aside)
        return bool(bad)

    widest_px = max(width for width, _ in observations.sizes_wh.values())
    setting_aside(*flattened(), _FIRST_VIEW_ERROR_WIDTHS * widest_px)  # before they can pull
    network, start = flattened()
    solved = adjusted(network, held_at_first(network, priors), start)
    for _ in range(_SET_ASIDE_ROUNDS):
        if not setting_aside(network, solved.state, _LEAST_VIEW_ERROR_PX):
            break
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


def _require_every_camera(views: Sequence[View], observations: Observations, set_aside: Sequence[SetAside]) -> None:
    left = Counter(view.camera for view in views if not view.own)
    aside = {camera: [view.pose for view in set_aside if view.camera == camera] for camera in observations.sizes_wh}
    wrong = [camera for camera, poses in aside.items() if len(poses) > left[camera]]
    if wrong:
        poses = ", ".join(sorted({pose for camera in wrong for pose in aside[camera]}))
        raise CalibrationError(
            f"camera{'s' if len(wrong) > 1 else ''} {', '.join(wrong)}",
            found=f"pictures that do not fit the other cameras' in most poses ({poses})",
            expected="pictures exposed together with the other cameras'",
            remedy="Check that its files are of the poses they are named after, that none was mirrored, and that "
            "nothing moved",
        )
    require_connected([(view.camera, view.pose) for view in views if not view.own])


def _with_needed_k3(solved: Solved, priors: Mapping[str, CameraPrior], settings: BundleSettings) -> Solved:
    """Adjust k3 too for cameras whose photographs agree it is not zero.

    The judge is its standard deviation from the scatter between photographs. If residuals were taken as independent,
    every lens would seem to have one.
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
    solved: Solved,
    views: Sequence[View],
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


def _independent(solved: Solved) -> Float64[Array, "p p"]:
    try:
        return independent_covariance(solved)
    except SingularNormalEquationsError as error:
        raise CalibrationError(
            f"parameter {solved.problem.network.parameter_names[error.parameter]}",
            found="observations that do not determine it",
            expected="poses that cover each camera's field of view, tilted differently",
            remedy="Add calibration poses, above all for that camera",
        ) from error
    except ValueError as error:
        raise CalibrationError(
            "the calibration",
            found=str(error),
            expected="more coordinates than parameters",
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
