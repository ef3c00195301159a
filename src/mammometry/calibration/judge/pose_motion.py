"""Find motion during the calibration: which camera, between which poses, and how far.

Each view alone gives the target's placement (`sighting`). Each possible motion explains part of the disagreement with
six parameters. The one that explains most is reported first. Then the search is repeated on the remainder.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtri

from mammometry.base.value import value
from mammometry.calibration.adjust.calibrated import Calibration
from mammometry.calibration.adjust.linear_model import FREE, Fit, LinearModel
from mammometry.calibration.judge.expected_error import derivatives
from mammometry.calibration.judge.reconstruction import moved_pair
from mammometry.calibration.judge.sighting import Sighting, disagreement, moves_of
from mammometry.geometry import Array, Float64, StereoPair
from mammometry.geometry.twist import as_motion, moved_camera

_MOST_MOVEMENTS = 6
"""Most movements that are reported. With more, everything moved."""
_MEDIAN = float(chdtri(6, 0.5))
"""Median of χ² with the six degrees of freedom of one sighting."""
_EXPLAINED = 1e-10
"""Smallest share of a motion's information not explained by those found so far; rounding leaves 1e-13."""
_ALIKE = 1e-6
"""Relative difference of the explained χ² below which two motions are equivalent, apart from rounding."""
_LEAST_FREEDOM = 0.05
"""Smallest share of the observations that must remain to estimate the noise."""


@value(eq=False)
class MovedCameras:
    """One or two cameras that moved relative to the others, from one pose on or in one pose only."""

    cameras: tuple[str, ...]
    """One camera, or both of a pair: an unsteady target looks the same."""
    first: str
    """First pose of the motion."""
    only: bool
    """Whether in that pose alone: not exposed together with the others, or moved back afterwards."""
    shift_mm: Float64[Array, 3]
    """Displacement of the first camera's perspective centre, world axes."""
    turn_rad: Float64[Array, 3]
    """Rotation vector, world axes. With one flat target, a shift and a rotation can hardly be distinguished."""
    shift_px: float
    """RMS displacement of the target in their pictures."""
    sigma: float
    """Length of the motion in its standard errors, from the scatter of all views."""
    effect_mm: float
    """RMS displacement of the pair's points by the motion. If only one pose is affected, the share of that pose."""


@dataclass(frozen=True, slots=True)
class _Suspicion:
    cameras: tuple[str, ...]
    first: str
    only: bool
    views: tuple[int, ...]


def movements(calibration: Calibration, seen: Sequence[Sighting], least_sigma: float) -> tuple[MovedCameras, ...]:
    """Find all significant movements, the most certain first.

    Args:
        calibration: the adjusted rig.
        seen: its single views (`sighting.sightings`).
        least_sigma: length in standard errors above which a movement is reported.
    """
    poses = [pose for pose in calibration.world_from_target if pose in {sighting.pose for sighting in seen}]
    cameras = [name for name in calibration.rig.cameras if name in {sighting.camera for sighting in seen}]
    if len(poses) < 2 or len(cameras) < 2:
        return ()
    suspicions = list(_suspicions(calibration.rig.pair_names, seen, poses))
    own = moves_of(seen, poses, cameras)
    suspected = -np.array([[float(i in suspicion.views) for suspicion in suspicions] for i in range(len(seen))])
    moves = np.concatenate([own, suspected.reshape(len(seen), -1)], axis=1)
    model = disagreement(seen, calibration.world_from_target, moves)
    std = np.repeat([FREE, 0.0], [6 * own.shape[1], 6 * len(suspicions)])
    parts = [slice(start, start + 6) for start in range(6 * own.shape[1], len(std), 6)]
    twists = np.array([sighting.twist_from(calibration.world_from_target[sighting.pose]) for sighting in seen])
    information = np.array([sighting.information for sighting in seen])
    found: list[MovedCameras] = []
    fit = model.fit(std)
    while len(found) < _MOST_MOVEMENTS:
        left = twists - moves @ fit.motions.reshape(-1, 6)
        typical = float(np.median(np.einsum("vi,vij,vj->v", left, information, left)))
        noise = max(1.0, typical / (_MEDIAN * max(fit.freedom / model.count, _LEAST_FREEDOM)))
        gains = np.array([_gain(model, fit, part) for part in parts])
        sigma = float(np.sqrt(gains.max(initial=0.0) / noise))
        if sigma < least_sigma:
            break
        best = int(np.argmax(gains > (1 - _ALIKE) * gains.max()))  # the first of those that explain equally much
        std[parts[best]] = FREE
        fit = model.fit(std)
        found.append(_movement(calibration, seen, suspicions[best], fit.motions[parts[best]], sigma))
    return tuple(found)


def _suspicions(
    pair_names: Mapping[str, tuple[str, str]], seen: Sequence[Sighting], poses: Sequence[str]
) -> Iterator[_Suspicion]:
    """Possible motions: each camera from one pose on, and each camera or pair in one pose only."""
    views = {(sighting.camera, sighting.pose): i for i, sighting in enumerate(seen)}
    for camera in dict.fromkeys(camera for camera, _ in views):
        mine = [pose for pose in poses if (camera, pose) in views]
        for k, pose in enumerate(mine):
            yield _Suspicion((camera,), pose, True, (views[camera, pose],))
            if 2 <= k <= len(mine) - 2:  # nearer to the ends, it is equivalent to one or two single poses
                yield _Suspicion((camera,), pose, False, tuple(views[camera, later] for later in mine[k:]))
    for pair in pair_names.values():
        for pose in poses:
            both = tuple(views[camera, pose] for camera in pair if (camera, pose) in views)
            if len(both) == 2 and sum(other == pose for _, other in views) > 3:
                yield _Suspicion(pair, pose, True, both)


def _gain(model: LinearModel, fit: Fit, part: slice) -> float:
    """Decrease of χ² with one more motion."""
    further = model.beyond(fit, part)
    if not (np.diag(further.matrix) > _EXPLAINED * np.diag(model.matrix)[part]).all():
        return 0.0
    return fit.misfit - further.fit(np.full(6, FREE)).misfit


def _movement(
    calibration: Calibration, seen: Sequence[Sighting], suspicion: _Suspicion, twist: Float64[Array, 6], sigma: float
) -> MovedCameras:
    camera = calibration.rig.cameras[suspicion.cameras[0]]
    motion = as_motion(twist)
    centre = camera.centre_world
    volume = np.concatenate(
        [placed.apply(calibration.target_points) for placed in calibration.world_from_target.values()]
    )
    effects = []
    for pair in calibration.rig.pairs:
        if {pair.left.name, pair.right.name} & set(suspicion.cameras):
            left, right = (
                moved_camera(camera_model, motion) if camera_model.name in suspicion.cameras else camera_model
                for camera_model in (pair.left, pair.right)
            )
            effect = moved_pair(pair, left, right, volume)
            effects += [] if effect is None else [effect.displacement_mm]
    poses = sum(sighting.camera == camera.name for sighting in seen)
    return MovedCameras(
        cameras=suspicion.cameras,
        first=suspicion.first,
        only=suspicion.only,
        shift_mm=motion.apply(centre) - centre,
        turn_rad=motion.rotation_vector_rad,
        shift_px=float(np.sqrt(np.mean([seen[i].shift_px(twist) ** 2 for i in suspicion.views]))),
        sigma=sigma,
        effect_mm=max(effects, default=0.0) / (poses if suspicion.only else 1),
    )


@value(eq=False)
class Shifts:
    """First-order effects of parameters on what a pair measures at some points."""

    points_mm: Float64[Array, "n 3 p"]
    """Displacement of the true point from the measured one per unit error of a parameter, world axes, mm."""
    vertical_rad: Float64[Array, "n p"]
    """Vertical disparity d_v per unit error, as an angle at the right camera: d_v over focal length."""


def shifts(pair: StereoPair, points: Float64[Array, "n 3"], names: tuple[str, ...]) -> Shifts:
    """Propagate parameters' errors through one pair's triangulation.

    If the true right parameters are θ + dθ, the point of the same image points is not X but X + dX. In the left
    picture, P dX + Q dθ = 0. In the right picture, P dX + Q dθ is the image of a shift s of the point, perpendicular to
    the epipolar plane, since both rays then miss each other by s. P and Q are the derivatives of the projections. The
    angle of the vertical disparity is s over the distance.

    Args:
        pair: as calibrated.
        points: points that it measures, world frame, mm, in front of both cameras.
        names: names of the parameters, as in `ParameterCovariance.names`. Those of other cameras give zeros.
    """
    (p_left, q_left), (p_right, q_right) = (derivatives(camera, points, names) for camera in (pair.left, pair.right))
    upwards = np.einsum("nij,nj->ni", p_right, upright(pair, points))  # px per mm perpendicular to the epipolar plane
    system = np.zeros((len(points), 4, 4))
    system[:, :2, :3], system[:, 2:, :3], system[:, 2:, 3] = p_left, p_right, -upwards
    solved = -np.linalg.solve(system, np.concatenate([q_left, q_right], axis=1))
    distance_mm = np.linalg.norm(points - pair.right.centre_world, axis=1)
    return Shifts(points_mm=solved[:, :3], vertical_rad=-solved[:, 3] / distance_mm[:, None])


def upright(pair: StereoPair, points: Float64[Array, "n 3"]) -> Float64[Array, "n 3"]:
    """Unit normals of the epipolar planes through points, pointing towards larger rows, world axes."""
    baseline = pair.right.centre_world - pair.left.centre_world
    normal = np.cross(points - pair.right.centre_world, baseline)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    return normal
