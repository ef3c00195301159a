"""Network to adjust, with first values, from the detections."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from mammometry.calibration.adjust.initialise import InitialRig
from mammometry.calibration.adjust.network import Network, State, tie_of
from mammometry.calibration.adjust.projection import INTRINSIC_NAMES, CameraPrior
from mammometry.calibration.detection.detect import Detection, Observations
from mammometry.calibration.settings import BundleSettings
from mammometry.calibration.targets.target import Target
from mammometry.geometry.arrays import Array, Bool

FREE_TARGET_POSES = 6
"""Placements from which ``auto`` adjusts a board: fewer hardly separate its shape from the cameras'."""

_PARAMETERS = {
    "brown": INTRINSIC_NAMES[:9],
    "paper": ("f_px", *INTRINSIC_NAMES[2:6]),  # 2.2: f, x₀, y₀, μ, ν
}


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class View:
    """One detection that takes part, and where it came from."""

    camera: str
    pose: str
    detection: Detection
    index: int
    """In its observations' `detections`."""
    own: bool
    """Whether it is one of its camera's separate photographs."""

    @property
    def station(self) -> str:
        """Name of the target's placement: the pose, or a camera's own."""
        return f"{self.camera}/{self.pose}" if self.own else self.pose


def all_views(observations: Observations, own: Mapping[str, Observations], initial: InitialRig) -> list[View]:
    """All views with a first placement, shared poses before the cameras' own."""
    views = [
        View(camera=detection.camera, pose=detection.pose, detection=detection, index=i, own=False)
        for i, detection in enumerate(observations.detections)
        if detection.pose in initial.world_from_target and len(detection.ids)
    ]
    for separate in own.values():
        views += [
            View(camera=detection.camera, pose=detection.pose, detection=detection, index=i, own=True)
            for i, detection in enumerate(separate.detections)
            if (detection.camera, detection.pose) in initial.own_camera_from_target
        ]
    return views


def network_of(
    views: Sequence[View],
    observations: Observations,
    own: Mapping[str, Observations],
    initial: InitialRig,
    priors: Mapping[str, CameraPrior],
    settings: BundleSettings,
) -> tuple[Network, State]:
    """Flatten the views, and the first values that belong to them."""
    cameras = tuple(observations.sizes_wh)
    stations = tuple(dict.fromkeys([*sorted({v.station for v in views if not v.own}), *(v.station for v in views)]))
    target_of = {"": observations.target, **{camera: separate.target for camera, separate in own.items()}}
    targets = list(dict.fromkeys(target_of.values()))  # a board that all cameras saw separately is one board
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
    """Parameters that keep their values. The world's placement, what priors fix, and k3 at first."""
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
    """The settings' prior, with the board's measured flatness, if any, as depth."""
    across_x, across_y, depth = settings.target_prior_mm
    return across_x, across_y, target.flatness_mm or depth


def _start(network: Network, views: Sequence[View], initial: InitialRig, settings: BundleSettings) -> State:
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
    first_from_world = placements[network.stations[0]].inverse()  # the first pose may have been set aside
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
