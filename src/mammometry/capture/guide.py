"""Suggestions where to hold the board next during a calibration.

The suggested position is the one that reduces the expected errors most. The information that a view adds to the
cameras' covariance follows from its derivatives, before the picture is taken.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from mammometry.base.value import value
from mammometry.calibration.adjust.calibrated import Calibration
from mammometry.calibration.judge.expected_error import derivatives, expected_error, shape_shifts, working_volume
from mammometry.geometry import Array, Float64, Rig, Transform
from mammometry.simulate.rigs.targets import sees_target, visible_points

GOOD_MM = 0.05
"""Expected error of points below which a calibration is good enough, mm: a tenth of the paper's limit on a plate, as in
`findings.RESIDUAL_GOOD_MM`.
"""
POSES = 12
"""Number of poses after which a rig is usually calibrated well enough."""
_CANDIDATES = 80  # positions that are compared; twice as many change the result by a few per cent
_REACH = 0.6  # largest distance of the board from the centre, as a share of half the working volume's side
_TILT_STD = 0.35  # standard deviation of each coordinate of the board's unit normal: about 20°
_FEWEST_CAMERAS = 2  # fewest cameras that must see the board; a single camera does not connect anything


@value(eq=False)
class Suggestion:
    """A position for the board, and the expected improvement."""

    world_from_target: Transform
    now_mm: float
    """Expected error of the worst pair's points now."""
    then_mm: float
    """The same after adding this pose."""
    outlines_px: Mapping[str, Float64[Array, "4 2"]]
    """Camera that would see the board → its outline in the picture, px. Read-only."""
    outlines: Mapping[str, Float64[Array, "4 2"]]
    """The same as shares of the picture's width and height, for a live picture of any size. Read-only."""
    sentence: str
    """Instruction for the person who holds the board."""


@dataclass(frozen=True, slots=True, kw_only=True)
class GuideProgress:
    """Quality of the calibration so far."""

    poses: int
    error_mm: float
    """Expected error of the worst pair's points."""
    good_enough: bool
    sentence: str


def opening(pair_names: tuple[str, ...], taken: int) -> str:
    """Position of the board before the first calibration, facing each pair in turn."""
    if not taken:
        return "Hold the board in the middle, so that as many cameras as possible see it."
    pair = pair_names[(taken - 1) % len(pair_names)]
    return f"Keep the board in the middle and turn it towards pair {pair}, tilted by a hand's breadth at one edge."


def progress(calibration: Calibration) -> GuideProgress:
    """How far the calibration is from being good enough."""
    errors = expected_error(calibration).rms_mm
    worst = max(errors, key=lambda pair: np.nan_to_num(errors[pair], nan=np.inf))
    poses, good = len(calibration.world_from_target), bool(errors[worst] <= GOOD_MM)
    word = "Good enough" if good else "Not yet good enough"
    return GuideProgress(
        poses=poses,
        error_mm=float(errors[worst]),
        good_enough=good,
        sentence=f"{word}: pair {worst} is expected to measure points to {errors[worst]:.3f} mm, "
        f"the goal is {GOOD_MM:g} mm; {poses} poses so far.",
    )


def suggest(calibration: Calibration) -> Suggestion | None:
    """Next position of the board, given the poses so far. None if no two cameras would see any position."""
    shifts = shape_shifts(calibration)
    own = np.ix_(shifts.columns, shifts.columns)
    information = np.linalg.pinv(calibration.covariance.independent[own], hermitian=True)
    # The error is a trace, so each pair's points are summed once and not for each position.
    moments = {
        pair: np.einsum("nkp,nkq->pq", free, free) / len(free)
        for pair, free in shifts.by_parameter.items()
        if len(free)
    }

    def worst_mm(covariance: Float64[Array, "p p"]) -> float:
        return float(np.sqrt(max(np.trace(moment @ covariance) for moment in moments.values())))

    # Errors common to the points of a photograph increase the true error, by the same factor before and after.
    shared = worst_mm(calibration.covariance.matrix[own]) / worst_mm(calibration.covariance.independent[own])
    weight = 1.0 / _variance_px2(calibration)
    best: tuple[float, Transform] | None = None
    for placed in _places(calibration, np.random.default_rng([0, len(calibration.world_from_target)])):
        gain = _information_of(calibration, placed, shifts.names, weight)
        if gain is None:
            continue
        then_mm = worst_mm(np.linalg.pinv(information + gain, hermitian=True))
        if best is None or then_mm < best[0]:
            best = (then_mm, placed)
    if best is None:
        return None
    outlines = _outlines(calibration, best[1])
    cameras = calibration.rig.cameras
    return Suggestion(
        world_from_target=best[1],
        now_mm=shared * worst_mm(calibration.covariance.independent[own]),
        then_mm=shared * best[0],
        outlines_px=outlines,
        outlines={name: (uv + 0.5) / np.array(cameras[name].size_wh) for name, uv in outlines.items()},
        sentence=_in_words(calibration, best[1], tuple(outlines)),
    )


def _information_of(
    calibration: Calibration, placed: Transform, names: tuple[str, ...], weight: float
) -> Float64[Array, "p p"] | None:
    """Information about the cameras from a view of the board, with its pose eliminated (Schur complement)."""
    target = calibration.observations.target
    size = len(names)
    own, cross, pose = np.zeros((size, size)), np.zeros((size, 6)), np.zeros((6, 6))
    seeing = 0
    for camera in calibration.rig.cameras.values():
        if not sees_target(camera, placed, target):
            continue
        seeing += 1
        world = placed.apply(calibration.target_points[visible_points(camera, placed, target)])
        by_world, by_parameter = derivatives(camera, world, names)
        by_twist = np.concatenate([np.cross(world[:, None, :], by_world), by_world], axis=2).reshape(-1, 6)
        rows = by_parameter.reshape(-1, size)
        own += weight * rows.T @ rows
        cross += weight * rows.T @ by_twist
        pose += weight * by_twist.T @ by_twist
    if seeing < _FEWEST_CAMERAS:
        return None
    gain: Float64[Array, "p p"] = own - cross @ np.linalg.pinv(pose, hermitian=True) @ cross.T
    return gain


def _places(calibration: Calibration, rng: np.random.Generator) -> list[Transform]:
    """Positions around the rig's centre, facing some of the pairs, with any rotation about the normal."""
    rig, target = calibration.rig, calibration.observations.target
    volume = working_volume(calibration)
    grid, middle = volume.grid_world, volume.middle_world
    reach = _REACH * 0.5 * float(np.ptp(grid[..., 0]))
    axes = _pair_axes(rig)
    places = []
    for _ in range(_CANDIDATES):
        facing = rng.dirichlet(np.ones(len(axes))) @ axes + rng.normal(0.0, _TILT_STD, 3)
        z = -facing / np.linalg.norm(facing)  # pointing into the board
        helper = np.eye(3)[int(np.abs(z).argmin())]
        a = np.cross(helper, z) / np.linalg.norm(np.cross(helper, z))
        turn = rng.uniform(0.0, 2 * np.pi)
        x = np.cos(turn) * a + np.sin(turn) * np.cross(z, a)
        rotation = np.stack([x, np.cross(z, x), z], axis=1)
        at = middle + rng.uniform() * rng.uniform(-reach, reach, 3)  # more often near the centre, where more is visible
        places.append(Transform(rotation=rotation, translation_mm=at - rotation @ target.body.middle_mm))
    return places


def _pair_axes(rig: Rig) -> Float64[Array, "p 3"]:
    axes = np.array([-(pair.left.axis_world + pair.right.axis_world) for pair in rig.pairs])
    unit: Float64[Array, "p 3"] = axes / np.linalg.norm(axes, axis=1, keepdims=True)
    return unit


def _variance_px2(calibration: Calibration) -> float:
    """Variance of one coordinate of a point, as estimated by the calibration."""
    variances = [
        np.trace(detection.covariance_px2, axis1=1, axis2=2) / 2 for detection in calibration.observations.detections
    ]
    return float(np.median(np.concatenate(variances))) * calibration.noise_factor**2


def _outlines(calibration: Calibration, placed: Transform) -> dict[str, Float64[Array, "4 2"]]:
    target = calibration.observations.target
    corners = target.points_target[:, :2]
    (left, top), (right, bottom) = corners.min(axis=0), corners.max(axis=0)
    outline = np.array([[left, top, 0.0], [right, top, 0.0], [right, bottom, 0.0], [left, bottom, 0.0]])
    seeing = [camera for camera in calibration.rig.cameras.values() if sees_target(camera, placed, target)]
    return {camera.name: camera.project(placed.apply(outline)) for camera in seeing}


def _in_words(calibration: Calibration, placed: Transform, seeing: tuple[str, ...]) -> str:
    rig = calibration.rig
    facing = -placed.rotation[:, 2]
    pair = rig.pairs[int((_pair_axes(rig) @ facing).argmax())]
    offset = (
        placed.apply(calibration.observations.target.body.middle_mm[None])[0] - working_volume(calibration).middle_world
    )
    across, down, away = pair.left.camera_from_world.rotate(offset[None])[0]
    words = [
        f"{abs(size) / 10:.0f} cm {word[0] if size > 0 else word[1]}"
        for size, word in ((across, ("right", "left")), (down, ("down", "up")), (away, ("away", "nearer")))
        if abs(size) >= 10
    ]
    where = f", {', '.join(words)} of the middle as pair {pair.name} sees it" if words else " in the middle"
    return f"Turn the board towards pair {pair.name}{where}, as outlined in {len(seeing)} pictures."
