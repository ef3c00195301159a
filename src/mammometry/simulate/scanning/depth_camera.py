"""Depth pictures of a body, as a telephone takes them while it is carried around the front.

Chosen so that fused scans look like those of telephones: noise that neighbouring pixels share, folds that are bridged
since a pixel sees the mean of its surroundings, and rims that are lost raggedly where skin is seen at a slant.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from scipy import ndimage

from mammometry.base.value import value
from mammometry.geometry.arrays import Array, Float32, Float64
from mammometry.geometry.transform import Transform
from mammometry.study.rays import RayScene

_FIELD_RAD = math.radians(50.0)  # of view, across; as of the front cameras of telephones
_DISTANCE_MM = (480.0, 620.0)  # from the chest
_WALK_DEG = (
    *((-65, 0), (-45, 0), (-22, 0), (0, 0), (22, 0), (45, 0), (65, 0)),
    *((50, -32), (18, -35), (-18, -35), (-50, -32)),
    *((-45, 28), (-15, 30), (15, 30), (45, 28)),
)  # azimuths and elevations of a walk around the front: below the breasts as well as above; chosen by eye
_STEP_MM = 20.0  # of depth between neighbouring pixels: an edge of the body
_BLUR_PX = 1.1  # standard deviation of the surroundings that one pixel sees
_SHARED_PX, _SHARED = 2.5, 0.15  # pixels over which noise is alike, and this part's share of its variance
_SLANT = (0.22, 0.12)  # cosine of incidence below which skin is lost, and by how much this limit wanders
_WANDER_PX = 9.0  # over which it wanders
_EDGE_LOST = 0.7  # share of the pixels at an edge of the body that are lost
_POSE_MM, _POSE_RAD = 0.5, 0.0008  # error of a picture's place and direction, for 1 mm of noise


@value(eq=False)
class DepthPicture:
    """One depth picture."""

    depth_mm: Float32[Array, "h w"]
    """Along the camera's axis, mm. NaN where nothing is seen."""
    trust: Float32[Array, "h w"]
    """Weight of each pixel: cosine of incidence."""
    camera_from_world: Transform
    """Where the telephone believes that it took the picture."""
    focal_px: float
    """Focal length. The axis meets the picture's middle."""


def depth_pictures(
    scene: RayScene, target: Float64[Array, 3], *, noise_mm: float, width_px: int, rng: np.random.Generator
) -> Iterator[DepthPicture]:
    """Take fifteen depth pictures around a body's front.

    Args:
        scene: the body, y to the head and z ahead, mm.
        target: at which the telephone looks, about the chest's middle.
        noise_mm: standard deviation of one pixel's depth at half a metre.
        width_px: of a picture; its height is three quarters.
        rng: of noise, places and lost pixels.
    """
    for azimuth, elevation in _WALK_DEG:
        a, e = np.radians(np.array([azimuth, elevation]) + rng.normal(0.0, 3.0, 2))
        away = np.array([math.sin(a) * math.cos(e), math.sin(e), math.cos(a) * math.cos(e)])
        centre = target + rng.uniform(*_DISTANCE_MM) * away
        yield _picture(scene, _looking(centre, target + rng.normal(0.0, 15.0, 3)), noise_mm, width_px, rng)


def _looking(centre: Float64[Array, 3], target: Float64[Array, 3]) -> Transform:
    """Frame of a camera that is held upright: x right, y down, z ahead."""
    ahead = (target - centre) / np.linalg.norm(target - centre)
    right = np.cross(ahead, [0.0, 1.0, 0.0])
    right /= np.linalg.norm(right)
    rotation = np.stack([right, np.cross(ahead, right), ahead])
    return Transform(rotation=rotation, translation_mm=-rotation @ centre)


def _picture(scene: RayScene, camera: Transform, noise_mm: float, width: int, rng: np.random.Generator) -> DepthPicture:
    height, focal = 3 * width // 4, width / 2 / math.tan(_FIELD_RAD / 2)
    row, column = np.mgrid[:height, :width].astype(np.float64)
    rays = np.stack([(column - (width - 1) / 2) / focal, (row - (height - 1) / 2) / focal, np.ones_like(row)], axis=-1)
    length = np.linalg.norm(rays, axis=-1)
    rays /= length[..., None]
    hits = scene.cast(-camera.rotation.T @ camera.translation_mm, rays @ camera.rotation)
    depth, cosine = hits.range_mm / length, np.nan_to_num(hits.cosine)
    depth = np.where(cosine > 0, depth, np.nan)
    seen = np.isfinite(depth)
    mean = _blurred(np.nan_to_num(depth), seen)
    low, high = (which(np.where(seen, depth, mean), 3) for which in (ndimage.minimum_filter, ndimage.maximum_filter))
    whole = ndimage.minimum_filter(seen, 3)
    edge = ~whole | (high - low > _STEP_MM)
    limit = _SLANT[0] + _SLANT[1] * _field(depth.shape, _WANDER_PX, rng)
    kept = seen & (cosine > limit) & ~(edge & (rng.random(depth.shape) < _EDGE_LOST))
    alone, shared = np.sqrt([1.0 - _SHARED, _SHARED])
    noise = alone * _field(depth.shape, 0.0, rng) + shared * _field(depth.shape, _SHARED_PX, rng)
    noise *= noise_mm * (mean / 500.0) ** 2 / np.sqrt(np.clip(cosine, 0.2, 1.0))
    measured = np.where(kept, np.where(edge, depth, mean) + noise, np.nan).astype(np.float32)
    drift = Transform.from_rotation_vector(
        noise_mm * rng.normal(0.0, _POSE_RAD, 3), noise_mm * rng.normal(0.0, _POSE_MM, 3)
    )
    return DepthPicture(
        depth_mm=measured,
        trust=np.clip(cosine, 0.0, 1.0).astype(np.float32),
        camera_from_world=drift @ camera,
        focal_px=focal,
    )


def _blurred(depth: Float64[Array, "h w"], seen: Array) -> Float64[Array, "h w"]:
    """Mean depth around each pixel, of what is seen."""
    share = ndimage.gaussian_filter(seen.astype(np.float64), _BLUR_PX)
    return np.asarray(ndimage.gaussian_filter(depth, _BLUR_PX) / np.maximum(share, 1e-9))


def _field(shape: tuple[int, ...], alike_px: float, rng: np.random.Generator) -> Float64[Array, "h w"]:
    """Random numbers of unit variance, alike over a few pixels."""
    drawn = rng.normal(size=shape)
    if alike_px:
        drawn = ndimage.gaussian_filter(drawn, alike_px, mode="wrap")
        drawn /= drawn.std()
    return np.asarray(drawn)
