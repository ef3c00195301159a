"""Virtual rigs: where the cameras and the flashes stand.

Rig frame: origin in the middle of the working volume; x right as the front pair sees it, y up, z from the subject
towards the front pair; mm. The subject leans forward by 45°, over the floor pair.
"""

from __future__ import annotations

import math

import numpy as np

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
