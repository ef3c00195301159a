"""Virtual rigs, built from their plans with small errors."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from mammometry.geometry.arrays import Array, Float64
from mammometry.geometry.camera import Camera, Rig
from mammometry.geometry.transform import Transform
from mammometry.simulate.rigs.plan import REFERENCE, CameraPlan, RigErrors, RigPlan, Triple

LEAST_SCALE = 0.02
"""Smallest scale of the pictures: the reference rig's are then 90 × 60 pixels, too few to find any target."""
LARGEST_SCALE = 2.0
"""Largest scale of the pictures: the reference rig's then have 54 megapixels, half as many as the largest cameras'."""
NO_LENGTH = 1e-9
"""Length below which a vector has no direction. Far above rounding of unit vectors."""


def build_rig(plan: RigPlan, scale: float, seed: int) -> Rig:
    """Build a rig from its plan, with small realistic random errors.

    Args:
        plan: where everything should stand.
        scale: of the full-size images; 0.25 of 4504 × 3000 gives 1126 × 750.
        seed: of the errors; one seed gives the same rig at every scale.

    Raises:
        ValueError: the scale is not within 0.02 … 2, or the plan's directions make no rig.
    """
    if not LEAST_SCALE <= scale <= LARGEST_SCALE:
        raise ValueError(f"scale must lie between {LEAST_SCALE} and {LARGEST_SCALE:g}, found {scale}")
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


def flashes(brightness: float = 1.0, plan: RigPlan = REFERENCE) -> Float64[Array, "l 4"]:
    """Positions of the flashes, rig frame, mm, and their strength.

    Strength is irradiance × mm² at distance 1. Together they give a white surface in the middle of the rig that faces
    `plan.facing` the radiance `brightness`, where 1 is the sensor's full scale.

    Raises:
        ValueError: no flash lights such a surface.
    """
    positions = np.array(plan.flashes_mm)
    strengths = np.ones(len(positions)) if plan.strengths is None else np.array(plan.strengths)
    distances = np.linalg.norm(positions, axis=1)
    facing = positions @ np.array(plan.facing)
    total = float((strengths * np.clip(facing, 0.0, None) / distances**3).sum())
    if not total > 0.0:
        raise ValueError(f"no flash of rig {plan.name} stands on the side that its cameras see")
    return np.column_stack([positions, strengths * (brightness / total)])


def _camera(plan: CameraPlan, errors: RigErrors, scale: float, rng: np.random.Generator) -> Camera:
    """One camera with its own small errors."""
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
    if lens.principal_point_px is not None:  # pyramid rule: (u + ½) scales with the image
        middle = (np.array(lens.principal_point_px) + 0.5) * scale - 0.5
    cx, cy = middle + rng.normal(0.0, errors.principal_point * height, 2)
    aspect = rng.normal(1.0, errors.aspect)
    matrix = np.array([[focal, 0.0, cx], [0.0, focal * aspect, cy], [0.0, 0.0, 1.0]])
    drawn = [rng.normal(mean, spread) for mean, spread in zip(lens.distortion[:4], errors.distortion, strict=True)]
    distortion = np.array([*drawn, lens.distortion[4]])
    pose = Transform(rotation=rotation, translation_mm=-rotation @ centre)
    return Camera(name=plan.name, size_wh=(width, height), matrix=matrix, distortion=distortion, camera_from_world=pose)


def triple(vector: Any) -> Triple:
    """Three numbers as plain floats."""
    x, y, z = (float(value) for value in vector)
    return x, y, z


def _unit(vector: Array) -> Float64[Array, 3]:
    length = float(np.linalg.norm(vector))
    if length < NO_LENGTH:
        raise ValueError("a direction of the rig has no length, or runs along the line of sight")
    unit: Float64[Array, 3] = vector / length
    return unit
