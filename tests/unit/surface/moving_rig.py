"""An ellipsoid with three pairs, in closed form, with cameras that stand elsewhere than calibrated."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from spheres import camera_towards, ellipsoid_range, range_image

from mammometry.geometry.camera import Camera, Rig
from mammometry.geometry.transform import Transform
from mammometry.surface.motion.agreement import RowErrors
from mammometry.surface.ranges.range_image import RangeImage

RADII = (95.0, 120.0, 70.0)
_FRONT, _LEFT, _RIGHT = (0.0, 0.0, 1.0), (-0.8, 0.1, 0.7), (0.8, 0.1, 0.7)
_APART = 0.15  # of the two cameras of a pair, to either side, of the distance


def calibrated_rig() -> Rig:
    """Three pairs around an ellipsoid, in general position."""
    cameras: dict[str, Camera] = {}
    for name, direction in (("front", _FRONT), ("left", _LEFT), ("right", _RIGHT)):
        for side, sign in (("l", -1.0), ("r", 1.0)):
            aside = np.cross([0.0, 1.0, 0.0], direction)
            camera = camera_towards(
                f"{name}_{side}", np.array(direction) + sign * _APART * aside, size=150, focal=220.0
            )
            cameras[camera.name] = camera
    return Rig(
        name="three",
        cameras=cameras,
        pair_names={name: (f"{name}_l", f"{name}_r") for name in ("front", "left", "right")},
    )


def standing(
    rig: Rig, turns_rad: Mapping[str, np.ndarray] | None = None, shifts_mm: Mapping[str, np.ndarray] | None = None
) -> Rig:
    """The rig with cameras turned about their centres, and pairs shifted as a whole."""
    cameras = dict(rig.cameras)
    for name, turn in (turns_rad or {}).items():
        rotation = (
            Transform.from_rotation_vector(np.array(turn), np.zeros(3)).rotation
            @ cameras[name].camera_from_world.rotation
        )
        pose = Transform(rotation=rotation, translation_mm=-rotation @ cameras[name].centre_world)
        cameras[name] = replace(cameras[name], camera_from_world=pose)
    for pair, shift in (shifts_mm or {}).items():
        for name in rig.pair_names[pair]:
            pose = cameras[name].camera_from_world
            moved = replace(pose, translation_mm=pose.translation_mm - pose.rotation @ shift)
            cameras[name] = replace(cameras[name], camera_from_world=moved)
    return replace(rig, cameras=cameras)


def measured(
    calibrated: Rig, stood: Rig, pair: str, *, radii=RADII, noise_mm: float = 0.0, seed: int = 0
) -> tuple[RangeImage, RowErrors]:
    """What a pair measures with the calibrated cameras of a body that others photographed, pixel by pixel.

    Independent of the code under test: every pixel's true point is projected into the right camera as it stood, and
    both rays are met again where the calibration believes the cameras to be, by solving for the two distances.
    """
    left, right = stood.pair(pair).left, stood.pair(pair).right
    believed = calibrated.pair(pair)
    true_mm = ellipsoid_range(left, radii)
    height, width = left.shape_hw
    uv = np.stack(np.meshgrid(np.arange(width, dtype=float), np.arange(height, dtype=float)), axis=-1)
    seen = np.isfinite(true_mm)
    points = left.centre_world + left.rays_world(uv[seen]) * true_mm[seen][:, None]
    ray, other = believed.left.rays_world(uv[seen]), believed.right.rays_world(right.project(points))
    baseline = believed.right.centre_world - believed.left.centre_world
    sides = np.stack([ray, -other], axis=2)
    squared = sides.transpose(0, 2, 1) @ sides
    distance = np.linalg.solve(squared, (sides.transpose(0, 2, 1) @ baseline)[:, :, None])[:, 0, 0]
    plane = np.cross(ray, baseline)  # right rays that leave the epipolar plane towards larger rows are behind it
    angle = -np.arcsin(np.einsum("ni,ni->n", other, plane) / np.linalg.norm(plane, axis=1))
    rng = np.random.default_rng([seed, *pair.encode()])
    smooth = _smooth(rng, points) * noise_mm if noise_mm else 0.0
    image = np.full((height, width), np.nan)
    image[seen] = distance + smooth
    nominal = believed.left.centre_world + ray * distance[:, None]
    some = slice(None, None, max(1, len(points) // 30))
    rows = RowErrors(points=nominal[some], angle_rad=angle[some], pixel_rad=1 / float(right.matrix[0, 0]) / 4)
    return range_image(believed.left, image, name=pair, sigma_mm=0.05), rows


def _smooth(rng: np.random.Generator, points: np.ndarray) -> np.ndarray:
    """Errors as windows make them: alike over some ten millimetres, of unit size."""
    waves = rng.normal(0.0, 1 / 12.0, (40, 3))
    phases = rng.uniform(0, 2 * np.pi, 40)
    return np.asarray(np.sqrt(2 / 40) * np.cos(points @ waves.T + phases).sum(axis=1))
