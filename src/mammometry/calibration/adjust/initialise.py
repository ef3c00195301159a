"""Initial values for the adjustment: each camera's intrinsics, then the poses of cameras and targets."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from itertools import combinations
from threading import Lock

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from mammometry.base.errors import CalibrationError
from mammometry.base.value import value
from mammometry.calibration.adjust.projection import CameraPrior
from mammometry.calibration.detection.detect import Detection, Observations
from mammometry.calibration.targets.target import Target
from mammometry.geometry import Array, Bool, Float64, Transform
from mammometry.geometry.lens import undistort

_SWEEPS = 5
"""Sweeps of medians over poses and cameras. Affects the start of the adjustment only."""
_AGREE_RAD, _AGREE_SHARE = 0.05, 0.1  # initial intrinsics err by a few per cent, images of another pose by more


def median_transform(transforms: Sequence[Transform]) -> Transform:
    """Rotation and translation closest to all others (medoids).

    Up to half of the transforms may be arbitrarily wrong; exactly half only if the others agree.
    """
    if len(transforms) == 1:
        return transforms[0]
    matrices = np.stack([transform.rotation for transform in transforms])
    cosine = (np.einsum("aij,bij->ab", matrices, matrices) - 1) / 2
    rotation = matrices[int(np.arccos(np.clip(cosine, -1, 1)).sum(axis=1).argmin())]
    shifts = np.stack([transform.translation_mm for transform in transforms])
    translation_mm = shifts[int(np.linalg.norm(shifts[:, None] - shifts[None], axis=2).sum(axis=1).argmin())]
    return Transform(rotation=rotation, translation_mm=translation_mm)


def components(views: Sequence[tuple[str, str]]) -> list[tuple[set[str], set[str]]]:
    """Group cameras and poses that are connected by views (camera, pose), the largest group first."""
    groups: list[tuple[set[str], set[str]]] = []
    for camera, pose in views:
        touched = [group for group in groups if camera in group[0] or pose in group[1]]
        merged: tuple[set[str], set[str]] = ({camera}, {pose})
        for group in touched:
            merged[0].update(group[0])
            merged[1].update(group[1])
            groups.remove(group)
        groups.append(merged)
    return sorted(groups, key=lambda group: (-len(group[0]), -len(group[1]), min(group[0])))


def average_network(
    camera_from_target: Mapping[tuple[str, str], Transform],
) -> tuple[dict[str, Transform], dict[str, Transform]]:
    """Compute the poses of all cameras and targets from the estimate of each view.

    Views must be connected. First a spanning tree over the cameras whose relative poses agree in most poses, with the
    median for each edge; then sweeps of medians over poses and cameras. The world is the target in the first pose, in
    name order.

    Returns:
        camera → camera_from_world, and pose → world_from_target.
    """
    cameras = sorted({camera for camera, _ in camera_from_target})
    poses = sorted({pose for _, pose in camera_from_target})
    cameras_from_rig = _spanning_tree(cameras, camera_from_target)
    rig_from_targets: dict[str, Transform] = {}
    for _ in range(_SWEEPS):
        for pose in poses:
            seen = [camera for camera in cameras if (camera, pose) in camera_from_target]
            rig_from_targets[pose] = median_transform(
                [cameras_from_rig[camera].inverse() @ camera_from_target[camera, pose] for camera in seen]
            )
        for camera in cameras:
            seen = [pose for pose in poses if (camera, pose) in camera_from_target]
            cameras_from_rig[camera] = median_transform(
                [camera_from_target[camera, pose] @ rig_from_targets[pose].inverse() for pose in seen]
            )
    rig_from_world = rig_from_targets[poses[0]]
    world_from_rig = rig_from_world.inverse()
    return (
        {camera: camera_from_rig @ rig_from_world for camera, camera_from_rig in cameras_from_rig.items()},
        {pose: world_from_rig @ rig_from_target for pose, rig_from_target in rig_from_targets.items()},
    )


def _spanning_tree(
    cameras: Sequence[str], camera_from_target: Mapping[tuple[str, str], Transform]
) -> dict[str, Transform]:
    """Find camera → camera_from_rig from one camera, by Prim's algorithm, the best agreement first."""
    edges: dict[tuple[str, str], tuple[int, Transform]] = {}
    for camera_pair, other in combinations(cameras, 2):
        relative = [
            placed @ camera_from_target[camera_pair, pose].inverse()
            for (camera, pose), placed in camera_from_target.items()
            if camera == other and (camera_pair, pose) in camera_from_target
        ]
        if relative:
            other_from_one = median_transform(relative)
            agreeing = sum(_agree(motion, other_from_one) for motion in relative)
            edges[camera_pair, other] = agreeing, other_from_one
            edges[other, camera_pair] = agreeing, other_from_one.inverse()
    root = max(edges, key=lambda edge: edges[edge][0])[0] if edges else cameras[0]
    found = {root: Transform.identity()}
    while len(found) < len(cameras):
        onwards = [edge for edge in edges if edge[0] in found and edge[1] not in found]
        if not onwards:
            raise ValueError(f"no pose connects {sorted(set(cameras) - set(found))}")
        known, camera = max(onwards, key=lambda edge: edges[edge][0])
        found[camera] = edges[known, camera][1] @ found[known]
    return found


def _agree(one: Transform, other: Transform) -> bool:
    between = one @ other.inverse()
    turn_rad = float(np.linalg.norm(Rotation.from_matrix(between.rotation).as_rotvec()))
    shift_mm = float(np.linalg.norm(one.translation_mm - other.translation_mm))
    return turn_rad < _AGREE_RAD and shift_mm < _AGREE_SHARE * float(np.linalg.norm(other.translation_mm))


_MAX_INITIAL_VIEWS = 15
"""Views for a camera's first intrinsics, for speed. The adjustment uses all."""

_LEAST_VIEWS = 3
"""Fewest views of a flat target that determine a camera's intrinsics (Zhang 2000)."""
LEAST_POINTS = 6
"""Fewest points to place, recognise or compare a target."""
_LEAST_FLAT_POINTS = 4
"""Fewest points to place a flat target: four determine a homography."""
_FLAT = 1e-6
"""Points with a smaller thickness, as a share of their extent, are flat: rounding only."""
_VIEW_ERROR_RATIO = 3.0
"""Ratio to the median error above which a view is not used for initial intrinsics."""
_VIEW_ERROR_PX = 2.0
"""Views with smaller errors are always used, px."""
_THREAD_COUNT = Lock()
"""Held while OpenCV's number of threads is changed, which is one for the whole process."""


class TooFewViewsError(CalibrationError):
    """Cameras saw the target too rarely, or never together with the others.

    Args:
        subject: the cameras, in words.
        found: how often they saw it.
        expected: how often they must see it.
        remedy: what the user can do about it.
    """

    code = "too-few-views"

    def __init__(self, subject: str, *, cameras: Sequence[str], found: str, expected: str, remedy: str) -> None:
        super().__init__(subject, found=found, expected=expected, remedy=remedy)
        self.cameras = tuple(cameras)


@value(eq=False)
class InitialRig:
    """Initial values of the adjustment, good to about a pixel."""

    intrinsics: Mapping[str, Float64[Array, 10]]
    """Camera → fx, fy, cx, cy (px), k1, k2, p1, p2, k3, and no skew (px)."""
    camera_from_world: Mapping[str, Transform]
    world_from_target: Mapping[str, Transform]
    """Pose → placement of the rig's target. The first pose's, in name order, is the world."""
    own_camera_from_target: Mapping[tuple[str, str], Transform]
    """(Camera, pose) → placement of the target in that camera's own intrinsics photographs."""


def initialise(
    observations: Observations,
    *,
    intrinsics_observations: Mapping[str, Observations] | None = None,
    priors: Mapping[str, CameraPrior] | None = None,
) -> InitialRig:
    """Initial values of all cameras and target placements, from observations alone.

    Intrinsics come from each camera's own views or separate photographs, then the target's pose in every view, then the
    poses of the whole graph by a spanning tree and medians.

    Args:
        observations: of the rig's target, with all cameras exposed together in each pose.
        intrinsics_observations: camera → separate photographs of any target by this camera alone.
        priors: camera → prior of its lens, the start of its intrinsics.

    Raises:
        CalibrationError: a camera saw the target too rarely, or shares no pose with the others; names the camera and
            what is needed.
    """
    own, known = dict(intrinsics_observations or {}), dict(priors or {})
    _check_sizes(observations, own, known)
    usable = _usable(observations)
    intrinsics: dict[str, Float64[Array, 10]] = {}
    camera_from_target: dict[tuple[str, str], Transform] = {}
    own_camera_from_target: dict[tuple[str, str], Transform] = {}
    for camera in observations.sizes_wh:
        source = own.get(camera, observations)
        views = [view for view in _usable(source) if view.camera == camera]
        if camera in known:
            intrinsics[camera] = known[camera].intrinsics
        else:
            intrinsics[camera] = _intrinsics(camera, source, views)
        if camera in own:
            own_camera_from_target |= _poses(views, source, intrinsics[camera])
        mine = [view for view in usable if view.camera == camera]
        camera_from_target |= _poses(mine, observations, intrinsics[camera])
        if not any(seer == camera for seer, _ in camera_from_target):
            raise TooFewViewsError(
                f"camera {camera}",
                cameras=[camera],
                found="no usable view of the rig's target",
                expected=f"at least one with {_least_placed(observations.target.points_target)} points",
                remedy="Check its photographs: focus, light, and that the target is inside the frame",
            )
    require_connected(list(camera_from_target))
    cameras_from_world, world_from_targets = average_network(camera_from_target)
    return InitialRig(
        intrinsics=intrinsics,
        camera_from_world=cameras_from_world,
        world_from_target=world_from_targets,
        own_camera_from_target=own_camera_from_target,
    )


def require_connected(views: Sequence[tuple[str, str]]) -> None:
    """Require that all cameras are connected by shared poses.

    Raises:
        CalibrationError: names cameras that are not connected.
    """
    groups = components(views)
    if len(groups) > 1:
        rest = [" with ".join(sorted(cameras)) for cameras, _ in groups[1:]]
        raise TooFewViewsError(
            f"cameras {', '.join(rest)}",
            cameras=sorted(camera for cameras, _ in groups[1:] for camera in cameras),
            found=f"no pose shared with {', '.join(sorted(groups[0][0]))}",
            expected="the target seen by cameras of both groups in at least one pose",
            remedy="Add a calibration pose that both see, with all cameras exposed together",
        )


def _check_sizes(observations: Observations, own: Mapping[str, Observations], known: Mapping[str, CameraPrior]) -> None:
    for camera, prior in known.items():
        of_prior, seen = prior.camera.size_wh, observations.sizes_wh.get(camera, prior.camera.size_wh)
        if of_prior != seen:
            raise CalibrationError(
                f"prior of camera {camera}",
                found=f"photographs of {of_prior[0]} × {of_prior[1]} pixels",
                expected=f"{seen[0]} × {seen[1]} pixels, as in its calibration photographs",
                remedy="Use a prior of the same camera and image size, or none",
            )
    for camera, separate in own.items():
        if camera not in observations.sizes_wh:
            raise CalibrationError(
                f"intrinsics photographs of {camera}",
                found="a camera that is not in the rig",
                expected=f"one of {', '.join(observations.sizes_wh)}",
                remedy="Correct the folder's name",
            )
        size, expected = separate.sizes_wh.get(camera), observations.sizes_wh[camera]
        if size != expected:
            raise CalibrationError(
                f"intrinsics photographs of {camera}",
                found="none" if size is None else f"{size[0]} × {size[1]} pixels",
                expected=f"{expected[0]} × {expected[1]} pixels, as in its other photographs",
                remedy="Use photographs of the same camera without cropping or scaling",
            )


def _usable(observations: Observations) -> list[Detection]:
    """Views with enough points that are not on a line."""
    points = observations.target.points_target
    least = _least_placed(points)
    usable = []
    for detection in observations.detections:
        if len(detection.ids) < least:
            continue
        seen = points[detection.ids] - points[detection.ids].mean(axis=0)
        spread = np.linalg.svd(seen, compute_uv=False)
        if spread[1] > 1e-2 * spread[0]:
            usable.append(detection)
    return usable


def least_views(target: Target) -> int:
    """Fewest views of a target that determine a camera's own parameters."""
    return _LEAST_VIEWS if is_flat(target.points_target) else 1


def _least_placed(points: Float64[Array, "n 3"]) -> int:
    """Fewest points that determine a camera's pose."""
    return _LEAST_FLAT_POINTS if is_flat(points) else LEAST_POINTS


def is_flat(points: Float64[Array, "n 3"]) -> bool:
    """Whether points are in a plane."""
    spread = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    return bool(spread[2] < _FLAT * spread[0])


def _intrinsics(camera: str, source: Observations, views: Sequence[Detection]) -> Float64[Array, 10]:
    points = source.target.points_target
    flat = is_flat(points)
    least = least_views(source.target)
    if len(views) < least:
        raise TooFewViewsError(
            f"camera {camera}",
            cameras=[camera],
            found=f"{len(views)} usable {'view' if len(views) == 1 else 'views'} of the target",
            expected=f"at least {least}" + (", tilted differently" if flat else ""),
            remedy=f"Add {least - len(views)} or more calibration poses that this camera sees",
        )
    best = sorted(views, key=lambda view: -len(view.ids))[:_MAX_INITIAL_VIEWS]
    if not flat:
        return _direct_linear(camera, points[best[0].ids], best[0].uv)
    keep = list(best)
    values, errors = _from_flat(camera, points, keep, source.sizes_wh[camera])
    while errors.max() > max(_VIEW_ERROR_PX, _VIEW_ERROR_RATIO * float(np.median(errors))) and len(keep) > _LEAST_VIEWS:
        del keep[int(errors.argmax())]  # one at a time: it may have affected the others
        values, errors = _from_flat(camera, points, keep, source.sizes_wh[camera])
    return values


def _from_flat(
    camera: str, points: Float64[Array, "n 3"], views: Sequence[Detection], size_wh: tuple[int, int]
) -> tuple[Float64[Array, 10], Float64[Array, " v"]]:
    """Zhang's method by OpenCV, with fixed aspect and no tangential terms. Also each view's RMS, px."""
    flags = cv2.CALIB_FIX_ASPECT_RATIO | cv2.CALIB_ZERO_TANGENT_DIST | cv2.CALIB_FIX_K3
    try:
        with _one_opencv_thread():  # several threads would sum in a random order
            _, matrix, distortion, _, _, _, _, errors = cv2.calibrateCameraExtended(
                [points[view.ids].astype(np.float32).reshape(-1, 1, 3) for view in views],
                [view.uv.astype(np.float32).reshape(-1, 1, 2) for view in views],
                size_wh,
                np.eye(3),
                np.zeros(5),
                flags=flags,
                criteria=(cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 30, 1e-9),
            )
    except cv2.error as error:
        raise _undetermined(camera, "views that do not determine a focal length") from error
    k1, k2 = np.asarray(distortion, np.float64).ravel()[:2]
    values = np.array([matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2], k1, k2, *np.zeros(4)])
    if not (np.isfinite(values).all() and min(values[:2]) > 0):
        raise _undetermined(camera, f"a focal length of {values[0]:.0f} pixels")
    return values, np.asarray(errors, np.float64).ravel()


@contextmanager
def _one_opencv_thread() -> Iterator[None]:
    """Limit OpenCV to one thread, so that sums are the same to the last bit."""
    with _THREAD_COUNT:
        before = cv2.getNumThreads()
        cv2.setNumThreads(1)
        try:
            yield
        finally:
            cv2.setNumThreads(before)


def _undetermined(camera: str, found: str) -> CalibrationError:
    return CalibrationError(
        f"camera {camera}",
        found=found,
        expected="a target with a different tilt in each view",
        remedy="Add poses in which the target is tilted by 20–40° to either side",
    )


def _direct_linear(camera: str, points: Float64[Array, "n 3"], uv: Float64[Array, "n 2"]) -> Float64[Array, 10]:
    """Direct linear transformation from one view of a spatial target. Lens distortion is zero."""
    centre, spread = points.mean(axis=0), float(points.std())
    middle, extent = uv.mean(axis=0), float(uv.std())
    ideal = np.column_stack([(points - centre) / spread, np.ones(len(points))])
    image = (uv - middle) / extent
    zeros = np.zeros_like(ideal)
    rows = np.concatenate(
        [
            np.concatenate([ideal, zeros, -image[:, :1] * ideal], axis=1),
            np.concatenate([zeros, ideal, -image[:, 1:] * ideal], axis=1),
        ]
    )
    projection = np.linalg.svd(rows)[2][-1].reshape(3, 4)
    to_pixels = np.array([[extent, 0, middle[0]], [0, extent, middle[1]], [0, 0, 1]])
    left = to_pixels @ projection[:, :3]
    reverse = np.eye(3)[::-1]
    _, r = np.linalg.qr((reverse @ left).T)  # RQ decomposition by QR of the reversed transpose
    matrix = reverse @ r.T @ reverse
    matrix = matrix @ np.diag(np.sign(np.diag(matrix)))
    matrix /= matrix[2, 2]
    values = np.array([matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2], *np.zeros(6)])
    if not (np.isfinite(values).all() and min(values[:2]) > 0):
        raise _undetermined(camera, "points that do not determine a focal length")
    return values


def _poses(
    views: Sequence[Detection], source: Observations, intrinsics: Float64[Array, 10]
) -> dict[tuple[str, str], Transform]:
    points = source.target.points_target
    found = {}
    for view in views:
        camera_from_target = resect(points[view.ids], view.uv, intrinsics)
        if camera_from_target is not None:
            found[view.camera, view.pose] = camera_from_target
    return found


def resect(
    points: Float64[Array, "n 3"], uv: Float64[Array, "n 2"], intrinsics: Float64[Array, 10]
) -> Transform | None:
    """Find camera_from_target from one view with given intrinsics.

    None if no pose puts the points in front of the camera. Both possible tilts of a flat target are refined, and the
    better one is returned.
    """
    distorted = (uv - intrinsics[2:4]) / intrinsics[:2]
    ideal = undistort(distorted, intrinsics[4:9])
    good: Bool[Array, " n"] = np.isfinite(ideal).all(axis=1)
    if good.sum() < _least_placed(points):
        return None
    points, ideal = points[good], ideal[good]
    method = cv2.SOLVEPNP_IPPE if is_flat(points) else cv2.SOLVEPNP_SQPNP
    try:
        _, turns, shifts, _ = cv2.solvePnPGeneric(points, ideal, np.eye(3), None, flags=method)
    except cv2.error:
        return None
    best, least = None, np.inf
    for turn, shift in zip(turns, shifts, strict=True):
        if not (np.isfinite(turn).all() and np.isfinite(shift).all()):
            continue
        turn, shift = cv2.solvePnPRefineLM(points, ideal, np.eye(3), None, turn.reshape(3, 1), shift.reshape(3, 1))
        pose = Transform.from_rotation_vector(turn.ravel(), shift.ravel())
        placed = pose.apply(points)
        if (placed[:, 2] <= 0).any():
            continue
        error = float(np.sum((placed[:, :2] / placed[:, 2:] - ideal) ** 2))
        if error < least:
            best, least = pose, error
    return best
