"""Poses of the target with which all cameras see it, and neighbouring pairs share views.

All numbers here are made up; no measurement uses them.
"""

from __future__ import annotations

import math

import numpy as np

from mammometry.base.errors import UnknownWordError
from mammometry.calibration.targets.target import Target
from mammometry.geometry import Array, Camera, Float64, Rig, Transform
from mammometry.simulate.rigs.targets import useful_points

_GRAZING_DEG = 65.0  # angle between a board's normal and the line of sight above which a view is of no use
_FADE_DEG = 5.0  # degrees below `_GRAZING_DEG` over which a view's value falls to 0
_CANDIDATES = 30  # candidates for each pose
_ATTEMPTS = 6  # most draws of all poses, of which the best is used
_WELL_SEEN_SHARE = 5 / 8  # share of the poses that every camera should see well: five of the default eight
_BALANCE = 1.5  # weight of a camera that has seen one pose fewer: e to the power of this
_SHIFT_MM = 35.0  # largest shift of a target from the rig's centre along each axis
_SMALL_SHIFT_MM = 20.0  # largest shift of an upright target, mm: it must be completely in the picture
_CYLINDER_TILT_DEG = 12.0
"""Standard deviation of an upright target's tilt about each axis. `find_cylinder` allows about 40° in all."""
_TURN_DEG = 8.0  # largest rotation in both directions of a board whose x axis must point right
_MIXING = 0.8
"""Concentration of the mixture of pairs that a board faces. Below 1, it mostly faces one of them."""
_MIDDLE_SHARE = 0.6  # weight of the direction that faces all pairs, relative to that of the mixture
_FACING_STD = 0.12  # standard deviation of each coordinate of the direction that a board faces


def draw_poses(rig: Rig, target: Target, count: int, seed: int) -> dict[str, Transform]:
    """Draw poses of a target in the centre of the rig.

    The best of many candidates are used, so that all cameras see the target and neighbouring pairs share views. The
    first pose faces all cameras as well as a board can. If the rig allows it, every camera sees a flat board within 65°
    of its normal in at least five of eight poses. The target's orientation follows its `ConvexBody.attitude`.

    Returns:
        Name of the pose ("00", "01", …) → rig from target.

    Raises:
        ValueError: no pose is requested.
    """
    if count < 1:
        raise UnknownWordError("a session needs at least one pose", count)
    pair_axes = np.array([-(pair.left.axis_world + pair.right.axis_world) for pair in rig.pairs])
    pair_axes /= np.linalg.norm(pair_axes, axis=1, keepdims=True)
    needed = math.ceil(count * _WELL_SEEN_SHARE)
    best: tuple[int, list[Transform]] = (-1, [])
    for attempt in range(_ATTEMPTS):
        poses, seen = _drawn(rig, target, pair_axes, count, np.random.default_rng([seed, 12, attempt]))
        if seen > best[0]:
            best = (seen, poses)
        if seen >= needed:
            break
    return {f"{index:02d}": pose for index, pose in enumerate(best[1])}


def _drawn(
    rig: Rig, target: Target, pair_axes: Float64[Array, "p 3"], count: int, rng: np.random.Generator
) -> tuple[list[Transform], int]:
    """All poses, and the number of good views of the camera that has fewest."""
    poses: list[Transform] = []
    seen = np.zeros(len(rig.cameras))
    for index in range(count):
        # Each candidate faces a random mixture of pairs. Cameras with few good views so far have more weight.
        draw = _HELD[target.body.attitude]
        candidates = [draw(rig, target, pair_axes, index == 0, rng) for _ in range(_CANDIDATES)]
        good = np.array([[_usefulness(camera, pose, target) for camera in rig.cameras.values()] for pose in candidates])
        chosen = int(np.argmax(good @ np.exp(-_BALANCE * (seen - seen.min())) if index else good.sum(axis=1)))
        poses.append(candidates[chosen])
        seen += good[chosen] > 0.0
    return poses, int(seen.min())


def _upright(
    rig: Rig, target: Target, pair_axes: Float64[Array, "p 3"], first: bool, rng: np.random.Generator
) -> Transform:
    """Placement with the z axis up (mean −y of the cameras), slightly tilted except in the first pose."""
    up = _unit(sum(-camera.camera_from_world.rotation[1] for camera in rig.cameras.values()))
    tilt = rng.normal(0.0, 0.0 if first else math.radians(_CYLINDER_TILT_DEG), 3)
    axis = Transform.from_rotation_vector(tilt, np.zeros(3)).rotate(up[None])[0]
    return _placed(target, axis, rng.uniform(0.0, 2 * math.pi), rng.uniform(-1.0, 1.0, 3) * _SMALL_SHIFT_MM)


def _turned_at_random(
    rig: Rig, target: Target, pair_axes: Float64[Array, "p 3"], first: bool, rng: np.random.Generator
) -> Transform:
    axis = _unit(rng.normal(size=3))
    return _placed(target, axis, rng.uniform(0.0, 2 * math.pi), rng.uniform(-1.0, 1.0, 3) * _SHIFT_MM)


def _facing(
    rig: Rig, target: Target, pair_axes: Float64[Array, "p 3"], first: bool, rng: np.random.Generator
) -> Transform:
    """Placement that faces a mixture of the pairs, or all of them in the first pose."""
    middle = _unit(pair_axes.sum(axis=0))
    mixture = _unit(rng.dirichlet(np.full(len(pair_axes), _MIXING)) @ pair_axes)
    facing = middle if first else _unit(mixture + _MIDDLE_SHARE * middle + rng.normal(0.0, _FACING_STD, 3))
    turn_rad, shift_mm = rng.uniform(0.0, 2 * math.pi), rng.uniform(-_SHIFT_MM, _SHIFT_MM, 3)
    if target.body.looks_alike_turned:
        right = sum(camera.camera_from_world.rotation[0] for camera in rig.cameras.values())
        a, b = _plane(-facing)
        turn_rad = math.atan2(right @ b, right @ a) + math.radians(_TURN_DEG) * (turn_rad / math.pi - 1.0)
    return _placed(target, -facing, turn_rad, shift_mm)


_HELD = {"facing": _facing, "upright": _upright, "any": _turned_at_random}
"""`ConvexBody.attitude` → function that draws a candidate pose."""


def _usefulness(camera: Camera, pose: Transform, target: Target) -> float:
    """Share of the points that are seen well, falling to 0 where the view is too oblique."""
    straightness = 1.0
    if not target.is_surveyed:
        straightness = float(np.clip((_GRAZING_DEG - _obliquity_deg(camera, pose, target)) / _FADE_DEG, 0.0, 1.0))
    seen = useful_points(camera, pose, target) if straightness > 0.0 else None
    return 0.0 if seen is None else straightness * float(seen.mean())


def _obliquity_deg(camera: Camera, pose: Transform, target: Target) -> float:
    """Angle between a board's normal and the line of sight at the board's centre, degrees."""
    to_camera = _unit(camera.centre_world - pose.apply(target.body.middle_mm))
    normal = pose.rotate(target.body.normals_target[:1])[0]
    return math.degrees(math.acos(np.clip(normal @ to_camera, -1.0, 1.0)))


def _placed(target: Target, z: Float64[Array, 3], turn_rad: float, at_mm: Float64[Array, 3]) -> Transform:
    """Rig from target, with its centre at `at_mm` and its z axis along `z`, rotated about that axis."""
    a, b = _plane(z)
    x = math.cos(turn_rad) * a + math.sin(turn_rad) * b
    rotation = np.stack([x, np.cross(z, x), z], axis=1)
    return Transform(rotation=rotation, translation_mm=at_mm - rotation @ target.body.middle_mm)


def _plane(z: Float64[Array, 3]) -> tuple[Float64[Array, 3], Float64[Array, 3]]:
    """Two axes perpendicular to z."""
    helper = np.array([0.0, 0.0, 1.0]) if abs(z[2]) < 0.9 else np.array([0.0, 1.0, 0.0])
    a = _unit(np.cross(helper, z))
    return a, np.cross(z, a)


def _unit(vector: Array) -> Float64[Array, 3]:
    unit: Float64[Array, 3] = vector / np.linalg.norm(vector)
    return unit


def looking(centre: Float64[Array, 3], target: Float64[Array, 3], roll_rad: float = 0.0) -> Transform:
    """Pose of a camera that looks at a point: x right, y down, z ahead.

    Without a roll, the camera is upright in a world with y up.

    Args:
        centre: centre of the camera, mm.
        target: point that it looks at, mm.
        roll_rad: rotation about its line of sight.
    """
    ahead = (target - centre) / np.linalg.norm(target - centre)
    right = np.cross(ahead, [0.0, 1.0, 0.0])
    right /= np.linalg.norm(right)
    down = np.cross(ahead, right)
    rolled = math.cos(roll_rad) * right + math.sin(roll_rad) * down
    rotation = np.stack([rolled, np.cross(ahead, rolled), ahead])
    return Transform(rotation=rotation, translation_mm=-rotation @ centre)
