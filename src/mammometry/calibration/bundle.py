"""Bundle adjustment of the whole rig (paper 2.2): all cameras and all target placements at once, with covariance."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np

from mammometry.calibration.adjustment import (
    POSE_NAMES_CAMERA,
    Adjustment,
    Network,
    State,
    residuals,
    robust_sigma,
    tie_of,
)
from mammometry.calibration.detect import Detection, Observations
from mammometry.calibration.initialise import InitialRig, initialise, require_connected
from mammometry.calibration.least_squares import Minimum, SingularNormalEquationsError, inverse, minimise
from mammometry.calibration.projection import INTRINSIC_NAMES
from mammometry.calibration.settings import BundleSettings, CalibrateSettings
from mammometry.calibration.target import Target
from mammometry.errors import CalibrationError
from mammometry.geometry.arrays import Array, Bool, Float64, read_only
from mammometry.geometry.camera import Camera, Rig
from mammometry.geometry.transform import Transform
from mammometry.progress import Progress, no_progress

__all__ = ["BundleSettings", "Calibration", "ParameterCovariance", "SetAside", "calibrate"]

_GROUPS = 2
_SIGMA_ROUNDS = 8
_SIGMA_SETTLED = 0.01
_LEAST_SIGMA = 0.05
_ROUGH = 1e-2  # standard deviations: enough while noise and outliers are still being found
_REJECT_ROUNDS = 3
_SET_ASIDE_ROUNDS = 3
_LEAST_VIEW_ERROR_PX = 1.0
_FIRST_VIEW_ERROR_WIDTHS = 0.02


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ParameterCovariance:
    """Joint covariance of all cameras and placements, whatever else was adjusted."""

    names: tuple[str, ...]
    """One a parameter: ``front_left.fx_px``, ``front_left.centre_x_mm``, ``pose 01.rotation_x_rad``; px, mm and rad.
    Rotations are small ones applied from the left: about the camera's axes, or the world's for poses."""
    matrix: Float64[Array, "p p"]
    """From the residuals, which it takes as independent: real ones are not, expect 1–2 times these errors at a quarter
    of the reference size, 2–5 times at full size."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "matrix", read_only(self.matrix))


@dataclass(frozen=True, slots=True, kw_only=True)
class SetAside:
    """A view that fits the others so badly that it was left out: another pose's picture, a moved camera or target."""

    camera: str
    pose: str
    residual_px: float
    """Median reprojection error of its points by what the other views say, px."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Calibration:
    """The calibrated rig, and how well it agrees with what was seen."""

    rig: Rig
    world: str
    """Which frame the world is, in words."""
    world_from_target: Mapping[str, Transform]
    """Pose → placement of the target; read-only."""
    target_points: Float64[Array, "n 3"]
    """The target's points in its own frame, mm: the nominal ones unless they were adjusted too."""
    observations: Observations
    """Of the rig's target, as given."""
    residuals_px: tuple[Float64[Array, "_ 2"], ...]
    """Projected − measured, px, in the order of ``observations.detections``; NaN for points that were left out."""
    intrinsics_observations: Mapping[str, Observations]
    """Camera → its separate photographs, as given; read-only, often empty."""
    intrinsics_residuals_px: Mapping[str, tuple[Float64[Array, "_ 2"], ...]]
    """As `residuals_px`, for the separate photographs."""
    rms_px: float
    """Root mean square length of the rig's `residuals_px`."""
    noise_factor: float
    """Standard deviation of the rig's residuals in units of the detections' own: 1 where those are honest."""
    parameter_std: Mapping[str, Mapping[str, float]]
    """Camera → parameter (``fx_px`` … ``k3``, ``rotation_x_rad`` …, ``centre_x_mm`` …) → standard deviation."""
    covariance: ParameterCovariance
    set_aside: tuple[SetAside, ...]
    """Views that were left out as a whole."""
    iterations: int
    """Steps of the last adjustment."""
    converged: bool
    """Whether the last adjustment reached its minimum."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "target_points", read_only(self.target_points))
        object.__setattr__(self, "residuals_px", tuple(read_only(part) for part in self.residuals_px))
        for name in ("world_from_target", "intrinsics_observations", "intrinsics_residuals_px"):
            object.__setattr__(self, name, MappingProxyType(dict(getattr(self, name))))
        std = {camera: MappingProxyType(dict(values)) for camera, values in self.parameter_std.items()}
        object.__setattr__(self, "parameter_std", MappingProxyType(std))


def calibrate(
    observations: Observations,
    pair_names: Mapping[str, tuple[str, str]],
    rig_name: str,
    settings: CalibrateSettings = CalibrateSettings(),
    *,
    intrinsics_observations: Mapping[str, Observations] | None = None,
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
        progress: told the fraction done.

    Raises:
        CalibrationError: too few views, cameras that share no pose with the rest, a pair whose left and right are
            swapped, image sizes that differ, or parameters that the observations do not determine.
    """
    own = dict(intrinsics_observations or {})
    _check_pairs(pair_names, observations)
    initial = initialise(observations, settings.bundle, intrinsics_observations=own)
    progress(0.3)
    views = _all_views(observations, own, initial)
    views, set_aside = _without_gross_views(views, observations, own, initial, settings.bundle)
    network, start = _network(views, observations, own, initial, settings.bundle)
    solved = _adjusted(network, start, settings.bundle)
    for _ in range(_SET_ASIDE_ROUNDS):
        bad = _bad_views(network, solved.minimum.state, settings.bundle.view_ratio, _LEAST_VIEW_ERROR_PX)
        if not bad:
            break
        set_aside += [SetAside(camera=views[i].camera, pose=views[i].pose, residual_px=px) for i, px in bad.items()]
        views = [view for i, view in enumerate(views) if i not in bad]
        _require_every_camera(views, observations, set_aside)
        network, start = _network(views, observations, own, initial, settings.bundle)
        solved = _adjusted(network, start, settings.bundle)
    progress(0.9)
    calibration = _as_calibration(solved, views, observations, own, pair_names, rig_name, tuple(set_aside))
    _check_baselines(calibration.rig)
    progress(1.0)
    return calibration


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _View:
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
        return f"{self.camera}/{self.pose}" if self.own else self.pose


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Solved:
    problem: Adjustment
    minimum: Minimum[State]


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


def _all_views(observations: Observations, own: Mapping[str, Observations], initial: InitialRig) -> list[_View]:
    """All views that have a first placement, the shared poses before the cameras' own."""
    views = [
        _View(camera=detection.camera, pose=detection.pose, detection=detection, index=i, own=False)
        for i, detection in enumerate(observations.detections)
        if detection.pose in initial.world_from_target and len(detection.ids)
    ]
    for separate in own.values():
        views += [
            _View(camera=detection.camera, pose=detection.pose, detection=detection, index=i, own=True)
            for i, detection in enumerate(separate.detections)
            if (detection.camera, detection.pose) in initial.own_camera_from_target
        ]
    return views


def _without_gross_views(
    views: list[_View],
    observations: Observations,
    own: Mapping[str, Observations],
    initial: InitialRig,
    settings: BundleSettings,
) -> tuple[list[_View], list[SetAside]]:
    """Leave out views that the first values already show to be of something else, before they can pull."""
    network, start = _network(views, observations, own, initial, settings)
    least_px = _FIRST_VIEW_ERROR_WIDTHS * max(width for width, _ in observations.sizes_wh.values())
    bad = _bad_views(network, start, settings.view_ratio, least_px)
    set_aside = [SetAside(camera=views[i].camera, pose=views[i].pose, residual_px=px) for i, px in bad.items()]
    kept = [view for i, view in enumerate(views) if i not in bad]
    _require_every_camera(kept, observations, set_aside)
    return kept, set_aside


def _require_every_camera(views: Sequence[_View], observations: Observations, set_aside: Sequence[SetAside]) -> None:
    left = {view.camera for view in views if not view.own}
    for camera in observations.sizes_wh:
        if camera not in left:
            poses = ", ".join(view.pose for view in set_aside if view.camera == camera)
            raise CalibrationError(
                f"camera {camera}",
                found=f"pictures that do not fit the other cameras' in any pose ({poses})",
                expected="pictures exposed together with the other cameras'",
                remedy="Check that its files are of the poses they are named after and that nothing moved",
            )
    require_connected([(view.camera, view.pose) for view in views if not view.own])


def _bad_views(network: Network, state: State, ratio: float, least_px: float) -> dict[int, float]:
    """View → its median residual, px, where that is far beyond the other views' of its group."""
    residual_px, depth = residuals(network, state)
    length = np.where(depth > 0, np.linalg.norm(residual_px, axis=1), np.inf)
    starts = network.view_start
    medians = np.array([np.median(length[starts[i] : starts[i + 1]]) for i in range(len(network.view_camera))])
    bad: dict[int, float] = {}
    for group in range(_GROUPS):
        member = network.view_group == group
        if member.any():
            limit = max(least_px, ratio * float(np.median(medians[member])))
            bad |= {int(i): float(medians[i]) for i in np.flatnonzero(member & (medians > limit))}
    return dict(sorted(bad.items()))


def _network(
    views: Sequence[_View],
    observations: Observations,
    own: Mapping[str, Observations],
    initial: InitialRig,
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
            prior_mm[first_rows[k] : first_rows[k + 1]] = settings.target_prior_mm
    tie, names = tie_of(settings.model, free_k3=settings.free_k3)
    covariance = np.concatenate([view.detection.covariance_px2 for view in views])
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
        tie=tie,
        intrinsic_names=names,
        nominal_points=np.concatenate(tables),
        prior_mm=prior_mm,
    )
    return network, _start(network, views, initial, settings)


def _is_free(target: Target, placements: int, settings: BundleSettings) -> bool:
    if settings.free_target == "auto":
        return not target.is_surveyed and placements >= settings.free_target_poses
    return settings.free_target == "always"


def _start(network: Network, views: Sequence[_View], initial: InitialRig, settings: BundleSettings) -> State:
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


def _adjusted(network: Network, start: State, settings: BundleSettings) -> _Solved:
    """Adjust with the noise estimated along the way, then without outliers."""
    group = network.view_group[network.view]
    problem = Adjustment(
        network=network,
        active=np.ones(len(network.uv), bool),
        group_sigma=np.ones(_GROUPS),
        huber=settings.huber_mad,
    )
    problem = _with_sigma(problem, start, group)
    most = settings.max_iterations
    for _ in range(_SIGMA_ROUNDS):
        start = minimise(problem, start, max_iterations=most, tolerance=_ROUGH).state
        before, problem = problem.group_sigma, _with_sigma(problem, start, group)
        if (np.abs(problem.group_sigma / before - 1) < _SIGMA_SETTLED).all():
            break
    for _ in range(_REJECT_ROUNDS):
        active: Bool[Array, " n"] = problem.whitened_lengths(start) < settings.reject_sigma
        if (active == problem.active).all():
            break
        problem = replace(problem, active=active)
        start = minimise(problem, start, max_iterations=most, tolerance=_ROUGH).state
        problem = _with_sigma(problem, start, group)
    return _Solved(problem=problem, minimum=minimise(problem, start, max_iterations=most))


def _with_sigma(problem: Adjustment, state: State, group: Array) -> Adjustment:
    """The same with each group's noise taken from the residuals of its points that take part."""
    length = problem.whitened_lengths(state)
    sigma = problem.group_sigma.copy()
    for i in range(_GROUPS):
        member = (group == i) & problem.active
        if member.any():
            sigma[i] = max(sigma[i] * robust_sigma(length[member]), _LEAST_SIGMA)
    return replace(problem, group_sigma=sigma)


def _as_calibration(
    solved: _Solved,
    views: Sequence[_View],
    observations: Observations,
    own: Mapping[str, Observations],
    pair_names: Mapping[str, tuple[str, str]],
    rig_name: str,
    set_aside: tuple[SetAside, ...],
) -> Calibration:
    network, state = solved.problem.network, solved.minimum.state
    covariance = _covariance(solved)
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
        for name, (fx, fy, cx, cy, *distortion), rotation, centre in zip(
            network.cameras, state.intrinsics, state.camera_rotation, state.camera_centre, strict=True
        )
    }
    target, first = observations.target, network.stations[0]
    what = f"the surveyed {target.kind} target" if target.is_surveyed else f"the {target.kind} board"
    shared = {view.pose for view in views if not view.own}
    return Calibration(
        rig=Rig(name=rig_name, cameras=cameras, pair_names=pair_names),
        world=f"frame of {what} in pose {first}, mm",
        world_from_target={
            pose: Transform(
                rotation=state.station_rotation[i].copy(), translation_mm=state.station_translation[i].copy()
            )
            for i, pose in enumerate(network.stations)
            if pose in shared
        },
        target_points=state.points[: len(target.points_target)].copy(),
        observations=observations,
        residuals_px=tuple(rig_residuals),
        intrinsics_observations=own,
        intrinsics_residuals_px={camera: tuple(parts) for camera, parts in own_residuals.items()},
        rms_px=float(np.sqrt(np.nanmean(squares))),
        noise_factor=float(solved.problem.group_sigma[0]),
        parameter_std=_parameter_std(network, covariance),
        covariance=covariance,
        set_aside=set_aside,
        iterations=solved.minimum.iterations,
        converged=solved.minimum.converged,
    )


def _covariance(solved: _Solved) -> ParameterCovariance:
    """Inverse of the normal matrix times the residuals' variance factor."""
    problem, state = solved.problem, solved.minimum.state
    network = problem.network
    try:
        covariance = inverse(problem.normal_equations(state))
    except SingularNormalEquationsError as error:
        raise CalibrationError(
            f"parameter {network.parameter_names[error.parameter]}",
            found="observations that do not determine it",
            expected="poses that cover each camera's field of view, tilted differently",
            remedy="Add calibration poses, above all for that camera",
        ) from error
    redundancy = 2 * int(problem.active.sum()) + 3 * len(network.free_points) - network.parameter_count
    if redundancy <= 0:
        raise CalibrationError(
            "the calibration",
            found=f"{int(problem.active.sum())} points for {network.parameter_count} parameters",
            expected="more coordinates than parameters",
            remedy="Add calibration poses",
        )
    factor = 2 * problem.cost(state) / redundancy
    return ParameterCovariance(names=network.parameter_names[: len(covariance)], matrix=covariance * factor)


def _parameter_std(network: Network, covariance: ParameterCovariance) -> dict[str, dict[str, float]]:
    std = {}
    count = network.tie.shape[1]
    for i, camera in enumerate(network.cameras):
        part = slice(i * network.per_camera, (i + 1) * network.per_camera)
        block = covariance.matrix[part, part]
        intrinsic = np.sqrt(np.diag(network.tie @ block[:count, :count] @ network.tie.T))
        pose = np.sqrt(np.diag(block)[count:])
        values = np.concatenate([intrinsic, pose]).tolist()
        std[camera] = dict(zip((*INTRINSIC_NAMES, *POSE_NAMES_CAMERA), values, strict=True))
    return std


def _check_baselines(rig: Rig) -> None:
    """The right camera of a pair stands to the right of the left one, seen in the left one's picture."""
    for pair in rig.pairs:
        x_mm, y_mm, _ = pair.left.camera_from_world.apply(pair.right.centre_world)
        if x_mm < 0 and abs(x_mm) > abs(y_mm):
            raise CalibrationError(
                f"pair {pair.name}",
                found=f"{pair.right.name} standing {-x_mm:.0f} mm to the left of {pair.left.name}",
                expected="the right camera to the right of the left one, as their pictures show it",
                remedy="Exchange left and right in the pair, or the two cameras' files if those are swapped",
            )
