"""Range data after a correction of the camera poses. The same two rays are intersected again."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mammometry.geometry.arrays import Array, Float64
from mammometry.geometry.camera import Camera, StereoPair
from mammometry.geometry.transform import Transform
from mammometry.surface.ranges.range_image import RangeImage


def retriangulated(image: RangeImage, before: StereoPair, after: StereoPair) -> RangeImage:
    """Triangulate a range image again with cameras in other poses.

    Each datum keeps its ray in the left camera and its ray in the right one; it is the point of the left ray nearest
    to the right one. Rays that no longer meet in front of the camera are not valid.

    Args:
        image: as measured with `before`.
        before: its pair.
        after: the same cameras, posed otherwise.
    """
    left, right = (motion(a, b) for a, b in ((before.left, after.left), (before.right, after.right)))
    points = image.valid_points_world()
    rays = points - before.left.centre_world
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    rays_right = points - before.right.centre_world
    rays_right /= np.linalg.norm(rays_right, axis=1, keepdims=True)
    centre = left.apply(before.left.centre_world)
    distance = _nearest(left.rotate(rays), right.rotate(rays_right), right.apply(before.right.centre_world) - centre)
    range_mm = np.zeros_like(image.range_mm)
    range_mm[image.valid] = distance
    good = np.isfinite(range_mm) & (range_mm > 0)
    moved = replace(image.camera, camera_from_world=image.camera.camera_from_world @ left.inverse())
    return replace(image, camera=moved, range_mm=np.where(good, range_mm, np.float32(0))).keeping(good)


def motion(before: Camera, after: Camera) -> Transform:
    """Motion between two poses of a camera, world frame."""
    found: Transform = after.camera_from_world.inverse() @ before.camera_from_world
    return found


def _nearest(
    rays: Float64[Array, "n 3"], others: Float64[Array, "n 3"], baseline: Float64[Array, 3]
) -> Float64[Array, " n"]:
    """Distance along each ray to the point nearest the other ray, mm."""
    cosine = np.einsum("ij,ij->i", rays, others)
    with np.errstate(divide="ignore", invalid="ignore"):
        distance: Float64[Array, " n"] = (rays @ baseline - cosine * (others @ baseline)) / (1 - cosine**2)
    return distance
