"""Find what moved while the rig was calibrated.

Which camera, between which poses, and how far. Every view by itself gives the target's placement (`sighting`). Each
thing that may have moved explains a part of the disagreement by six numbers. The one that explains most is named
first. Then the search is repeated on what is left.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtri

from mammometry.base.value import value
from mammometry.calibration.adjust.calibrated import Calibration
from mammometry.calibration.judge.expected_error import derivatives
from mammometry.calibration.judge.reconstruction import moved_pair
from mammometry.calibration.judge.sighting import Sighting, as_motion, moved
from mammometry.geometry import Array, Float64, StereoPair

_MOST_MOVEMENTS = 6
"""Movements that are named, at most: with more, nothing stood still."""
_MEDIAN = float(chdtri(6, 0.5))
"""Median of χ² with the six degrees of freedom of one sighting."""
_UNDETERMINED = 1e-9
"""Relative singular value below which a direction is not determined: rounding."""


@value(eq=False)
class Movement:
    """One or two cameras that moved relative to the others. From one pose on, or in one pose only."""

    cameras: tuple[str, ...]
    """One camera. Or both of a pair, which an unsteadily held target also looks like."""
    first: str
    """The pose from which on."""
    only: bool
    """Whether in that pose alone: not exposed together with the others, or pushed and back again."""
    shift_mm: Float64[Array, 3]
    """Displacement of the first camera's perspective centre, world axes."""
    turn_rad: Float64[Array, 3]
    """Rotation vector, world axes. One flat target hardly distinguishes a shift from a turn."""
    shift_px: float
    """RMS displacement of the target in their pictures."""
    sigma: float
    """Length of the motion in its standard errors, from the scatter of all views."""
    effect_mm: float
    """RMS displacement of the pair's points between before and after. For one pose, that pose's share."""


@dataclass(frozen=True, slots=True)
class _Suspicion:
    cameras: tuple[str, ...]
    first: str
    only: bool
    views: tuple[int, ...]


def movements(calibration: Calibration, seen: Sequence[Sighting], least_sigma: float) -> tuple[Movement, ...]:
    """Find all movements that stand out, the most certain first.

    Args:
        calibration: the adjusted rig.
        seen: its views, each by itself (`sighting.sightings`).
        least_sigma: length in standard errors from which on a movement is reported.
    """
    poses = [pose for pose in calibration.world_from_target if any(sighting.pose == pose for sighting in seen)]
    cameras = [name for name in calibration.rig.cameras if any(sighting.camera == name for sighting in seen)]
    if len(poses) < 2 or len(cameras) < 2:
        return ()
    roots = [_root(sighting.information) for sighting in seen]
    twists = [
        root @ sighting.twist_from(calibration.world_from_target[sighting.pose])
        for root, sighting in zip(roots, seen, strict=True)
    ]
    right = np.concatenate(twists)
    columns = np.zeros((len(right), 6 * (len(poses) + len(cameras))))
    for i, sighting in enumerate(seen):
        for at, sign in ((poses.index(sighting.pose), 1.0), (len(poses) + cameras.index(sighting.camera), -1.0)):
            columns[6 * i : 6 * i + 6, 6 * at : 6 * at + 6] = sign * roots[i]
    suspicions = list(_suspicions(calibration.rig.pair_names, seen, poses))
    found: list[Movement] = []
    explained = _basis(columns)
    while len(found) < _MOST_MOVEMENTS:
        rest = right - explained @ (explained.T @ right)
        noise = max(1.0, float(np.median(np.sum(rest.reshape(-1, 6) ** 2, axis=1))) / (_MEDIAN * _freedom(explained)))
        best = max(
            ((_gain(suspicion, roots, explained, rest), i) for i, suspicion in enumerate(suspicions)), default=(0.0, 0)
        )
        sigma = float(np.sqrt(best[0] / noise))
        if sigma < least_sigma:
            break
        suspicion = suspicions[best[1]]
        block = _columns(suspicion, roots)
        found.append(_movement(calibration, seen, suspicion, _solved(block, explained, rest), sigma))
        explained = _basis(np.concatenate([explained, block], axis=1))
    return tuple(found)


def _suspicions(
    pair_names: Mapping[str, tuple[str, str]], seen: Sequence[Sighting], poses: Sequence[str]
) -> Iterator[_Suspicion]:
    """A camera from one pose on. A camera, or a pair, in one pose only."""
    for camera in dict.fromkeys(sighting.camera for sighting in seen):
        mine = [pose for pose in poses if any((sighting.camera, sighting.pose) == (camera, pose) for sighting in seen)]
        for k, pose in enumerate(mine):
            here = tuple(i for i, sighting in enumerate(seen) if (sighting.camera, sighting.pose) == (camera, pose))
            yield _Suspicion((camera,), pose, True, here)
            if 2 <= k <= len(mine) - 2:  # nearer to the ends it is the same as one or two single poses
                later = tuple(
                    i for i, sighting in enumerate(seen) if sighting.camera == camera and sighting.pose in mine[k:]
                )
                yield _Suspicion((camera,), pose, False, later)
    for pair in pair_names.values():
        for pose in poses:
            both = tuple(i for i, sighting in enumerate(seen) if sighting.camera in pair and sighting.pose == pose)
            others = [sighting for sighting in seen if sighting.pose == pose and sighting.camera not in pair]
            if len(both) == 2 and len(others) > 1:
                yield _Suspicion(pair, pose, True, both)


def _root(information: Float64[Array, "6 6"]) -> Float64[Array, "6 6"]:
    """A matrix whose square, transposed from the left, is the information."""
    values, vectors = np.linalg.eigh(information)
    return np.sqrt(np.maximum(values, 0.0))[:, None] * vectors.T


def _columns(suspicion: _Suspicion, roots: Sequence[Float64[Array, "6 6"]]) -> Float64[Array, "s 6"]:
    block = np.zeros((6 * len(roots), 6))
    for i in suspicion.views:
        block[6 * i : 6 * i + 6] = -roots[i]
    return block


def _basis(columns: Float64[Array, "s q"]) -> Float64[Array, "s r"]:
    """Orthonormal basis of what the columns span."""
    scaled = columns / np.maximum(np.linalg.norm(columns, axis=0), np.finfo(np.float64).tiny)
    left, values, _ = np.linalg.svd(scaled, full_matrices=False)
    return left[:, values > _UNDETERMINED * values[0]]


def _freedom(basis: Float64[Array, "s r"]) -> float:
    """Share of the numbers that the basis leaves free."""
    return max(1.0 - basis.shape[1] / basis.shape[0], 0.05)


def _cleared(block: Float64[Array, "s 6"], explained: Float64[Array, "s r"]) -> Float64[Array, "s 6"]:
    return block - explained @ (explained.T @ block)


def _gain(
    suspicion: _Suspicion,
    roots: Sequence[Float64[Array, "6 6"]],
    explained: Float64[Array, "s r"],
    rest: Float64[Array, " s"],
) -> float:
    """Fall of χ² if the suspicion is true."""
    block = _cleared(_columns(suspicion, roots), explained)
    scale = np.linalg.norm(block, axis=0)
    if not (scale > _UNDETERMINED * np.linalg.norm(_columns(suspicion, roots), axis=0)).all():
        return 0.0
    basis = _basis(block / scale)
    return float(np.sum((basis.T @ rest) ** 2))


def _solved(
    block: Float64[Array, "s 6"], explained: Float64[Array, "s r"], rest: Float64[Array, " s"]
) -> Float64[Array, 6]:
    cleared = _cleared(block, explained)
    scale = np.linalg.norm(cleared, axis=0)
    solution: Float64[Array, 6] = np.linalg.lstsq(cleared / scale, rest, rcond=_UNDETERMINED)[0] / scale
    return solution


def _movement(
    calibration: Calibration, seen: Sequence[Sighting], suspicion: _Suspicion, twist: Float64[Array, 6], sigma: float
) -> Movement:
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
                moved(camera_model, motion) if camera_model.name in suspicion.cameras else camera_model
                for camera_model in (pair.left, pair.right)
            )
            effect = moved_pair(pair, left, right, volume)
            effects += [] if effect is None else [effect.displacement_mm]
    poses = sum(sighting.camera == camera.name for sighting in seen)
    return Movement(
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

    The right parameters being θ + dθ, the same image points mean X + dX: P dX + Q dθ is 0 in the left picture, and in
    the right one what a point s above X shows, since both rays miss each other by s, square to the epipolar plane. P
    and Q are the derivatives of the projections; s over the distance is the vertical disparity's angle.

    Args:
        pair: as calibrated.
        points: that it measures, world frame, mm; in front of both cameras.
        names: of the parameters, as in `ParameterCovariance.names`. Those of other cameras give zeros.
    """
    (p_left, q_left), (p_right, q_right) = (derivatives(camera, points, names) for camera in (pair.left, pair.right))
    upwards = np.einsum("nij,nj->ni", p_right, upright(pair, points))  # px for each mm out of the epipolar plane
    system = np.zeros((len(points), 4, 4))
    system[:, :2, :3], system[:, 2:, :3], system[:, 2:, 3] = p_left, p_right, -upwards
    solved = -np.linalg.solve(system, np.concatenate([q_left, q_right], axis=1))
    distance_mm = np.linalg.norm(points - pair.right.centre_world, axis=1)
    return Shifts(points_mm=solved[:, :3], vertical_rad=-solved[:, 3] / distance_mm[:, None])


def upright(pair: StereoPair, points: Float64[Array, "n 3"]) -> Float64[Array, "n 3"]:
    """Unit normals of the epipolar planes through points, towards growing rows, world axes."""
    baseline = pair.right.centre_world - pair.left.centre_world
    normal = np.cross(points - pair.right.centre_world, baseline)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    return normal
