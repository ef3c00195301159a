"""Range images after a change of the cameras' poses, or of the body's shape by breathing."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy import ndimage

from mammometry.geometry import Array, Camera, Float64, StereoPair, Transform
from mammometry.surface.ranges.range_image import RangeImage
from mammometry.surface.ranges.visibility import JUMP_MM

_WHOLE = 0.999  # interpolation weight at which all four neighbours have data


def retriangulated(image: RangeImage, before: StereoPair, after: StereoPair) -> RangeImage:
    """Triangulate a range image again with the cameras in other poses.

    Each datum keeps its rays in both cameras and is the point of the left ray nearest to the right one. Rays that no
    longer meet in front of the camera are not valid.

    Args:
        image: range image measured with `before`.
        before: its pair.
        after: the same cameras in other poses.
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


def displaced(image: RangeImage, shift_world: Float64[Array, "n 3"]) -> RangeImage:
    """Range image of points moved by small, smooth shifts, seen from the same camera.

    Each pixel's value is interpolated between the moved neighbours of the point that it now shows.

    Args:
        image: range image.
        shift_world: shift of each valid datum, in row order, mm.
    """
    points = image.valid_points_world()
    rows, columns = np.nonzero(image.valid)
    come_from = 2 * np.stack([columns, rows], axis=1) - image.camera.project(points + shift_world)
    ray = points - image.camera.centre_world
    further_mm = np.linalg.norm(ray + shift_world, axis=1) - np.linalg.norm(ray, axis=1)
    known = np.zeros((2, *image.valid.shape), dtype=np.float32)
    known[0], known[1][image.valid] = image.range_mm, further_mm
    at = come_from[:, ::-1].T
    range_mm = sum(ndimage.map_coordinates(part, at, order=1, mode="nearest") for part in known)
    nearest = tuple(np.clip(np.rint(at).astype(np.intp), 0, np.array(image.valid.shape)[:, None] - 1))
    whole = ndimage.map_coordinates(image.valid.astype(np.float32), at, order=1, mode="constant") > _WHOLE
    whole &= np.abs(range_mm - image.range_mm[nearest]) < JUMP_MM
    moved, kept = np.zeros_like(image.range_mm), np.zeros_like(image.valid)
    moved[image.valid], kept[image.valid] = np.where(whole, range_mm, 0.0), whole
    return replace(image, range_mm=moved, valid=kept).keeping(kept)


def motion(before: Camera, after: Camera) -> Transform:
    """Rigid motion between two poses of a camera, world frame."""
    found: Transform = after.camera_from_world.inverse() @ before.camera_from_world
    return found


def _nearest(
    rays: Float64[Array, "n 3"], others: Float64[Array, "n 3"], baseline: Float64[Array, 3]
) -> Float64[Array, " n"]:
    """Distance along each ray to its point nearest to the other ray, mm."""
    cosine = np.einsum("ij,ij->i", rays, others)
    with np.errstate(divide="ignore", invalid="ignore"):
        distance: Float64[Array, " n"] = (rays @ baseline - cosine * (others @ baseline)) / (1 - cosine**2)
    return distance
