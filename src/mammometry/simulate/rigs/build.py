"""Virtual rigs: planned positions of cameras and flashes, and rigs built with small errors.

All sizes here are made up; no measurement uses them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from mammometry.base.errors import UnknownWordError
from mammometry.geometry import Array, Camera, Float64, Rig, Transform

FULL_SIZE_WH = (4504, 3000)
"""Width and height of the reference rig's photographs, pixels: 13.5 megapixels."""
FULL_FOCAL_PX = 8100.0
"""Focal length of the reference rig's cameras, pixels: about 0.1 mm per pixel at `DISTANCE_MM`."""
DISTANCE_MM = 780.0
"""Distance of the reference rig's cameras from its centre, mm."""

Triple = tuple[float, float, float]


@dataclass(frozen=True, slots=True, kw_only=True)
class LensPlan:
    """A camera and its lens as designed, at full size and without errors."""

    size_wh: tuple[int, int] = FULL_SIZE_WH
    """Width and height of the picture, pixels."""
    focal_px: float = FULL_FOCAL_PX
    """Focal length, pixels."""
    distortion: tuple[float, float, float, float, float] = (-0.05, 0.1, 0.0, 0.0, 0.0)
    """Brown's k1, k2, p1, p2, k3."""
    principal_point_px: tuple[float, float] | None = None
    """Principal point, pixels. None: the picture's centre."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraPlan:
    """One camera, given by its position."""

    name: str
    centre_mm: Triple
    """Perspective centre, rig frame, mm."""
    target_mm: Triple = (0.0, 0.0, 0.0)
    """Point that it looks at, rig frame, mm."""
    right: Triple = (1.0, 0.0, 0.0)
    """Direction in the rig frame that is approximately to the right in its picture."""
    lens: LensPlan = LensPlan()


@dataclass(frozen=True, slots=True, kw_only=True)
class PairPlan:
    """A convergent pair, given by the position of its centre. Directions are in the rig frame."""

    name: str
    """Its cameras are named NAME_left and NAME_right."""
    towards: Triple
    """Direction from the subject to the middle between the cameras."""
    along: Triple
    """Approximate direction from the left camera to the right one."""
    distance_mm: float = DISTANCE_MM
    """Distance of each camera from the rig's centre, mm."""
    distance_spread: float = 0.0
    """Half-width of the uniform distribution of the distance, as a share of it."""
    convergence_deg: tuple[float, float] = (16.0, 16.0)
    """Range of the angle between the two lines of sight, degrees."""
    lens: LensPlan = LensPlan()


@dataclass(frozen=True, slots=True, kw_only=True)
class RigErrors:
    """Standard deviations of a built rig's differences from its plan."""

    position_mm: float = 8.0
    """Position of a camera, each coordinate, mm."""
    aim_mm: float = 4.0
    """Point that it looks at, each coordinate, mm."""
    roll_deg: float = 1.0
    """Roll about the line of sight, degrees."""
    focal: float = 0.01
    """Focal length, relative."""
    aspect: float = 1e-4
    """Ratio of a pixel's height to its width."""
    principal_point: float = 0.007
    """Principal point, each coordinate, in heights of the picture."""
    distortion: tuple[float, float, float, float] = (0.03, 0.1, 3e-4, 3e-4)
    """Distortion k1, k2, p1 and p2."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RigPlan:
    """The cameras and flashes around the subject."""

    name: str
    stations: tuple[PairPlan | CameraPlan, ...]
    """Pairs, and single cameras that `pairs` refers to."""
    pairs: tuple[tuple[str, str, str], ...] = ()
    """Name, left and right camera of each pair made of single cameras."""
    flashes_mm: tuple[Triple, ...]
    """Positions of the flashes, rig frame, mm."""
    strengths: tuple[float, ...] | None = None
    """Strengths of the flashes relative to each other. None: all equal."""
    facing: Triple
    """Normal of the white surface at the rig's centre for which the flashes are adjusted."""
    errors: RigErrors = RigErrors()
    lean_rad: float | None = None
    """Forward lean of the subject, rad. None: the subject's own."""


def _reference_pair(name: str, towards: Triple, along: Triple) -> PairPlan:
    return PairPlan(name=name, towards=towards, along=along, distance_spread=0.03, convergence_deg=(13.0, 19.0))


REFERENCE = RigPlan(
    name="reference",
    stations=(
        _reference_pair("front", (0.0, -0.074, 0.997), (1.0, 0.0, 0.0)),
        _reference_pair("floor", (0.0, -0.998, 0.063), (1.0, 0.0, 0.0)),
        _reference_pair("left", (-0.826, -0.439, 0.354), (0.58, -0.62, 0.53)),
        _reference_pair("right", (0.826, -0.439, 0.354), (0.58, 0.62, -0.53)),
    ),
    flashes_mm=((0.0, 260.0, 880.0), (0.0, -860.0, 190.0), (-830.0, -180.0, 430.0), (830.0, -180.0, 430.0)),
    facing=(0.0, -math.sqrt(0.5), math.sqrt(0.5)),
)
"""Eight cameras of 4504 × 3000 pixels in four convergent pairs, about 0.1 mm per pixel, and four flashes."""


LEAST_SCALE = 0.02
"""Smallest scale of the pictures: the reference rig's are then 90 × 60 pixels, too few to find any target."""
LARGEST_SCALE = 2.0
"""Largest scale of the pictures: the reference rig's then have 54 megapixels, half of the largest cameras'."""
NO_LENGTH = 1e-9
"""Length below which a vector has no direction: far above the rounding of unit vectors."""


def build_rig(plan: RigPlan, scale: float, seed: int) -> Rig:
    """Build a rig from its plan, with small realistic random errors.

    Args:
        plan: nominal positions.
        scale: size of the images relative to full size; 0.25 of 4504 × 3000 is 1126 × 750.
        seed: seed of the errors; it gives the same rig at every scale.

    Raises:
        ValueError: the scale is not within 0.02 … 2, or the plan's directions are impossible.
    """
    if not LEAST_SCALE <= scale <= LARGEST_SCALE:
        raise UnknownWordError(f"scale must be between {LEAST_SCALE} and {LARGEST_SCALE:g}", scale)
    rng = np.random.default_rng([seed, 11])
    cameras: dict[str, Camera] = {}
    pair_names: dict[str, tuple[str, str]] = {}
    for station in plan.stations:
        if isinstance(station, CameraPlan):
            cameras[station.name] = _camera(station, plan.errors, scale, rng)
            continue
        out, along = _unit(np.array(station.towards)), np.array(station.along)
        along = _unit(along - along @ out * out)
        half_angle = math.radians(rng.uniform(*station.convergence_deg)) / 2.0
        distance = station.distance_mm * rng.uniform(1.0 - station.distance_spread, 1.0 + station.distance_spread)
        pair_names[station.name] = (f"{station.name}_left", f"{station.name}_right")
        for name, sign in zip(pair_names[station.name], (-1.0, 1.0), strict=True):
            centre = distance * (math.cos(half_angle) * out + sign * math.sin(half_angle) * along)
            camera = CameraPlan(name=name, centre_mm=triple(centre), right=triple(along), lens=station.lens)
            cameras[name] = _camera(camera, plan.errors, scale, rng)
    pair_names |= {name: (left, right) for name, left, right in plan.pairs}
    return Rig(name=plan.name, cameras=cameras, pair_names=pair_names)


def pairs_of(rig: Rig, names: tuple[str, ...]) -> Rig:
    """The rig with only these pairs and their cameras.

    Raises:
        ValueError: the rig has no pair of that name.
    """
    unknown = [name for name in names if name not in rig.pair_names]
    if unknown or not names:
        raise UnknownWordError(f"pairs of the rig are {', '.join(rig.pair_names)}", f"{', '.join(unknown) or 'none'}")
    pair_names = {name: rig.pair_names[name] for name in names}
    kept = [camera for pair in pair_names.values() for camera in pair]
    return Rig(name=rig.name, cameras={name: rig.cameras[name] for name in kept}, pair_names=pair_names)


def flashes(brightness: float = 1.0, plan: RigPlan = REFERENCE) -> Float64[Array, "l 4"]:
    """Positions of the flashes, rig frame, mm, and their strength: irradiance × mm² at distance 1.

    Together, they give a white surface at the rig's centre that faces `plan.facing` the radiance `brightness`, where 1
    is the sensor's full scale.

    Raises:
        ValueError: no flash lights such a surface.
    """
    positions = np.array(plan.flashes_mm)
    strengths = np.ones(len(positions)) if plan.strengths is None else np.array(plan.strengths)
    distances = np.linalg.norm(positions, axis=1)
    facing = positions @ np.array(plan.facing)
    total = float((strengths * np.clip(facing, 0.0, None) / distances**3).sum())
    if not total > 0.0:
        raise ValueError(f"no flash of rig {plan.name} is on the side that its cameras see")
    return np.column_stack([positions, strengths * (brightness / total)])


def _camera(plan: CameraPlan, errors: RigErrors, scale: float, rng: np.random.Generator) -> Camera:
    """A camera with its own small errors."""
    lens = plan.lens
    centre, right = np.array(plan.centre_mm) + rng.normal(0.0, errors.position_mm, 3), np.array(plan.right)
    z = _unit(np.array(plan.target_mm) + rng.normal(0.0, errors.aim_mm, 3) - centre)
    x = _unit(right - right @ z * z)
    roll = math.radians(rng.normal(0.0, errors.roll_deg))
    y = np.cross(z, x)
    x = math.cos(roll) * x + math.sin(roll) * y
    rotation = np.stack([x, np.cross(z, x), z])
    width, height = (round(scale * side) for side in lens.size_wh)
    focal = lens.focal_px * scale * rng.normal(1.0, errors.focal)
    middle = np.array([0.5 * (width - 1), 0.5 * (height - 1)])
    if lens.principal_point_px is not None:  # u + ½ scales with the image
        middle = (np.array(lens.principal_point_px) + 0.5) * scale - 0.5
    cx, cy = middle + rng.normal(0.0, errors.principal_point * height, 2)
    aspect = rng.normal(1.0, errors.aspect)
    matrix = np.array([[focal, 0.0, cx], [0.0, focal * aspect, cy], [0.0, 0.0, 1.0]])
    drawn = [rng.normal(mean, spread) for mean, spread in zip(lens.distortion[:4], errors.distortion, strict=True)]
    distortion = np.array([*drawn, lens.distortion[4]])
    pose = Transform(rotation=rotation, translation_mm=-rotation @ centre)
    return Camera(name=plan.name, size_wh=(width, height), matrix=matrix, distortion=distortion, camera_from_world=pose)


def triple(vector: Any) -> Triple:
    """A vector as three floats."""
    x, y, z = (float(value) for value in vector)
    return x, y, z


def _unit(vector: Array) -> Float64[Array, 3]:
    length = float(np.linalg.norm(vector))
    if length < NO_LENGTH:
        raise ValueError("a direction of the rig has no length, or runs along the line of sight")
    unit: Float64[Array, 3] = vector / length
    return unit
