"""Virtual rigs: where the cameras and the flashes stand, and where the board is held.

Rig frame: origin in the middle of the working volume; x right as the front pair sees it, y up, z from the subject
towards the front pair; mm. The subject leans forward by 45°, over the floor pair.
"""

from __future__ import annotations

import math

import numpy as np

from mammometry.calibration.target import CharucoTarget, ChessboardTarget
from mammometry.geometry.arrays import Array, Float64
from mammometry.geometry.camera import Camera, Rig
from mammometry.geometry.transform import Transform

FULL_SIZE_WH = (4504, 3000)
"""Of the reference rig's cameras, pixels."""
FULL_FOCAL_PX = 8100.0
DISTANCE_MM = 780.0

# Pair → direction from the subject to the middle of the pair, and from its left to its right camera.
_PAIRS = {
    "front": ((0.0, -0.074, 0.997), (1.0, 0.0, 0.0)),
    "floor": ((0.0, -0.998, 0.063), (1.0, 0.0, 0.0)),
    "left": ((-0.826, -0.439, 0.354), (0.58, -0.62, 0.53)),
    "right": ((0.826, -0.439, 0.354), (0.58, 0.62, -0.53)),
}
_FLASHES_MM = ((0.0, 260.0, 880.0), (0.0, -860.0, 190.0), (-830.0, -180.0, 430.0), (830.0, -180.0, 430.0))

_GRAZING_DEG = 65.0
_USEFUL_DEG = 70.0
_USEFUL_CORNERS = 12
_CANDIDATES = 30
_ATTEMPTS = 6


def reference_rig(scale: float, seed: int) -> Rig:
    """Build the reference rig: eight cameras in four convergent pairs, with a rig's small errors drawn by seed.

    Args:
        scale: of the 4504 × 3000 images; 0.25 gives 1126 × 750.
        seed: of the errors of position (8 mm), aim (4 mm), roll (1°), focal length (1 %), principal point (0.7 %
            of the image's height) and lens distortion.

    Raises:
        ValueError: the scale is not within 0.02 … 1.
    """
    if not 0.02 <= scale <= 1.0:
        raise ValueError(f"scale must lie between 0.02 and 1, found {scale}")
    rng = np.random.default_rng([seed, 11])
    cameras: dict[str, Camera] = {}
    pair_names: dict[str, tuple[str, str]] = {}
    for pair, (towards, along) in _PAIRS.items():
        out, baseline = np.array(towards), np.array(along)
        out /= np.linalg.norm(out)
        baseline -= baseline @ out * out
        baseline /= np.linalg.norm(baseline)
        half_angle = math.radians(rng.uniform(6.5, 9.5))
        distance = DISTANCE_MM * rng.uniform(0.97, 1.03)
        for side, sign in (("left", -1.0), ("right", 1.0)):
            name = f"{pair}_{side}"
            centre = distance * (math.cos(half_angle) * out + sign * math.sin(half_angle) * baseline)
            cameras[name] = _camera(name, centre + rng.normal(0.0, 8.0, 3), baseline, scale, rng)
        pair_names[pair] = (f"{pair}_left", f"{pair}_right")
    return Rig(name="reference", cameras=cameras, pair_names=pair_names)


def pairs_of(rig: Rig, names: tuple[str, ...]) -> Rig:
    """Return the rig with only these pairs and their cameras.

    Raises:
        ValueError: the rig has no pair of that name.
    """
    unknown = [name for name in names if name not in rig.pair_names]
    if unknown or not names:
        raise ValueError(f"pairs of the rig are {', '.join(rig.pair_names)}, found {', '.join(unknown) or 'none'}")
    pair_names = {name: rig.pair_names[name] for name in names}
    kept = [camera for pair in pair_names.values() for camera in pair]
    return Rig(name=rig.name, cameras={name: rig.cameras[name] for name in kept}, pair_names=pair_names)


def make_rig(name: str, scale: float, seed: int) -> Rig:
    """Build a rig by name: ``reference``, or ``reference:front`` / ``reference:front,floor`` for some of its pairs.

    Raises:
        ValueError: there is no rig, or no pair, of that name.
    """
    base, _, pairs = name.partition(":")
    if base != "reference":
        raise ValueError(f"the built-in rig is reference, or a part of it as in reference:front, found {name!r}")
    rig = reference_rig(scale, seed)
    return pairs_of(rig, tuple(pairs.split(","))) if pairs else rig


def flashes(brightness: float = 1.0) -> Float64[Array, "4 4"]:
    """Positions of the four flashes, rig frame, mm, and their strength: irradiance × mm² at distance 1.

    Together they give a white surface in the middle of the rig that faces front and floor alike the radiance
    `brightness`, where 1 is the sensor's full scale.
    """
    positions = np.array(_FLASHES_MM)
    distances = np.linalg.norm(positions, axis=1)
    facing = positions @ np.array([0.0, -math.sqrt(0.5), math.sqrt(0.5)])
    total = float((np.clip(facing, 0.0, None) / distances**3).sum())
    return np.column_stack([positions, np.full(len(positions), brightness / total)])


def draw_board_poses(rig: Rig, target: CharucoTarget | ChessboardTarget, count: int, seed: int) -> dict[str, Transform]:
    """Draw poses of a board in the middle of the rig such that all cameras see it and neighbouring pairs share views.

    The first pose faces all cameras as well as one board can. Every camera sees the board at no more than 65° from its
    normal in at least five of eight poses where the rig allows it: of many candidates the best is taken.

    Returns:
        Pose's name ("00", "01", …) → rig from board.
    """
    if count < 1:
        raise ValueError(f"a session needs at least one pose, found {count}")
    pair_axes = np.array([-(pair.left.axis_world + pair.right.axis_world) for pair in rig.pairs])
    pair_axes /= np.linalg.norm(pair_axes, axis=1, keepdims=True)
    needed = math.ceil(count * 5 / 8)
    best: tuple[int, list[Transform]] = (-1, [])
    for attempt in range(_ATTEMPTS):
        poses, seen = _drawn_poses(rig, target, pair_axes, count, np.random.default_rng([seed, 12, attempt]))
        if seen > best[0]:
            best = (seen, poses)
        if seen >= needed:
            break
    return {f"{index:02d}": pose for index, pose in enumerate(best[1])}


def _drawn_poses(
    rig: Rig,
    target: CharucoTarget | ChessboardTarget,
    pair_axes: Float64[Array, "p 3"],
    count: int,
    rng: np.random.Generator,
) -> tuple[list[Transform], int]:
    """One draw of poses, and how many of them the camera that sees fewest of them sees well."""
    middle = _unit(pair_axes.sum(axis=0))
    poses: list[Transform] = []
    seen = np.zeros(len(rig.cameras))
    for index in range(count):
        # Candidates face a mixture of pairs; the cameras seen least so far weigh most.
        candidates = []
        for _ in range(_CANDIDATES):
            mixture = _unit(rng.dirichlet(np.full(len(pair_axes), 0.8)) @ pair_axes)
            facing = middle if index == 0 else _unit(mixture + 0.6 * middle + rng.normal(0.0, 0.12, 3))
            candidates.append(_board_pose(target, facing, rng.uniform(0.0, 2 * math.pi), rng.uniform(-35.0, 35.0, 3)))
        good = np.array([[_usefulness(camera, pose, target) for camera in rig.cameras.values()] for pose in candidates])
        chosen = int(np.argmax(good @ np.exp(-1.5 * (seen - seen.min())) if index else good.sum(axis=1)))
        poses.append(candidates[chosen])
        seen += good[chosen] > 0.0
    return poses, int(seen.min())


def sees_board(camera: Camera, rig_from_board: Transform, target: CharucoTarget | ChessboardTarget) -> bool:
    """Whether the camera's picture of the board is worth keeping: at most 70° oblique, at least 12 corners in frame."""
    straight = _obliquity_deg(camera, rig_from_board, target) <= _USEFUL_DEG
    return straight and int(_corners_in_frame(camera, rig_from_board, target).sum()) >= _USEFUL_CORNERS


def _usefulness(camera: Camera, rig_from_board: Transform, target: CharucoTarget | ChessboardTarget) -> float:
    """Share of the corners in frame, falling to 0 where the view is too oblique."""
    straightness = float(np.clip((_GRAZING_DEG - _obliquity_deg(camera, rig_from_board, target)) / 5.0, 0.0, 1.0))
    return straightness and straightness * float(_corners_in_frame(camera, rig_from_board, target).mean())


def _corners_in_frame(camera: Camera, rig_from_board: Transform, target: CharucoTarget | ChessboardTarget) -> Array:
    uv = camera.project(rig_from_board.apply(target.points_target))
    with np.errstate(invalid="ignore"):
        inside: Array = np.all((uv >= 0.0) & (uv <= np.array(camera.size_wh) - 1.0), axis=1)
    return inside


def _obliquity_deg(camera: Camera, rig_from_board: Transform, target: CharucoTarget | ChessboardTarget) -> float:
    """Angle between the board's normal and the line of sight to its middle, degrees."""
    to_camera = _unit(camera.centre_world - rig_from_board.apply(_middle(target)))
    return math.degrees(math.acos(np.clip(-rig_from_board.rotation[:, 2] @ to_camera, -1.0, 1.0)))


def _middle(target: CharucoTarget | ChessboardTarget) -> Float64[Array, 3]:
    """Middle of the board, board frame, mm."""
    return 0.5 * target.square_mm * np.array([*target.squares, 0.0])


def _board_pose(
    target: CharucoTarget | ChessboardTarget, facing: Float64[Array, 3], turn_rad: float, middle_mm: Float64[Array, 3]
) -> Transform:
    """Rig from board: the printed side faces `facing`, turned in its plane, its middle at `middle_mm`."""
    z = -facing
    helper = np.array([0.0, 0.0, 1.0]) if abs(z[2]) < 0.9 else np.array([0.0, 1.0, 0.0])
    a = _unit(np.cross(helper, z))
    b = np.cross(z, a)
    x = math.cos(turn_rad) * a + math.sin(turn_rad) * b
    rotation = np.stack([x, np.cross(z, x), z], axis=1)
    return Transform(rotation=rotation, translation_mm=middle_mm - rotation @ _middle(target))


def _camera(
    name: str, centre: Float64[Array, 3], right: Float64[Array, 3], scale: float, rng: np.random.Generator
) -> Camera:
    """One camera that looks at the middle of the rig, with its own small errors."""
    z = _unit(rng.normal(0.0, 4.0, 3) - centre)
    x = _unit(right - right @ z * z)
    roll = math.radians(rng.normal(0.0, 1.0))
    y = np.cross(z, x)
    x = math.cos(roll) * x + math.sin(roll) * y
    rotation = np.stack([x, np.cross(z, x), z])
    width, height = (round(scale * side) for side in FULL_SIZE_WH)
    focal = FULL_FOCAL_PX * scale * rng.normal(1.0, 0.01)
    shift = rng.normal(0.0, 0.007 * height, 2)
    matrix = np.array(
        [
            [focal, 0.0, 0.5 * (width - 1) + shift[0]],
            [0.0, focal * rng.normal(1.0, 1e-4), 0.5 * (height - 1) + shift[1]],
            [0.0, 0.0, 1.0],
        ]
    )
    distortion = np.array(
        [rng.normal(-0.05, 0.03), rng.normal(0.1, 0.1), rng.normal(0.0, 3e-4), rng.normal(0.0, 3e-4), 0.0]
    )
    pose = Transform(rotation=rotation, translation_mm=-rotation @ centre)
    return Camera(name=name, size_wh=(width, height), matrix=matrix, distortion=distortion, camera_from_world=pose)


def _unit(vector: Array) -> Float64[Array, 3]:
    unit: Float64[Array, 3] = vector / np.linalg.norm(vector)
    return unit
