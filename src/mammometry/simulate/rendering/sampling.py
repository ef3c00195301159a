"""Sample positions in pixels and lens, and lenses for the kernels."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache

import numpy as np

from mammometry.base.errors import UnknownWordError
from mammometry.geometry import Array, Camera, Float32, Float64, read_only


@dataclass(frozen=True, slots=True, kw_only=True)
class Aperture:
    """A thin lens: rays through its opening meet in the sharp plane.

    The ray through its middle is the camera model's, so defocus moves nothing. A point at the depth z makes a disc of
    ``diameter_mm · fx · |1/z − 1/focus_mm|`` pixels across.
    """

    diameter_mm: float = 0.0
    """Of the opening. 0 is a pinhole."""
    focus_mm: float = math.inf
    """Depth of the plane that is sharp, from the perspective centre."""


PINHOLE = Aperture()


def lens_parameters(camera: Camera) -> Float64[Array, 9]:
    """Return fx, fy, cx, cy, k1, k2, p1, p2, k3."""
    return np.array([*camera.intrinsics, *camera.distortion])


def lens_rays(
    camera: Camera, directions: Float32[Array, "n 3"], aperture: Aperture, places: Float64[Array, "n 2"]
) -> tuple[Float32[Array, "n 3"], Float32[Array, "n 3"]]:
    """Origins and directions, world frame, of rays that leave the lens at `places` of its unit disc.

    Args:
        camera: whose lens it is.
        directions: of the rays through the middle of the lens.
        aperture: the opening and what it is focused at.
        places: −1 … 1 of the opening's radius, along the camera's x and y.
    """
    centre = camera.centre_world
    if aperture.diameter_mm == 0.0:
        return np.ascontiguousarray(np.broadcast_to(centre.astype(np.float32), directions.shape)), directions
    across, axis = camera.camera_from_world.rotation[:2], camera.camera_from_world.rotation[2]
    shift = 0.5 * aperture.diameter_mm * places @ across
    middle = directions.astype(np.float64)
    towards = middle * (aperture.focus_mm / (middle @ axis))[:, None] - shift
    towards /= np.linalg.norm(towards, axis=1, keepdims=True)
    return (centre + shift).astype(np.float32), towards.astype(np.float32)


@cache
def disc_offsets(count: int) -> Float64[Array, "n 2"]:
    """Places on the unit disc, one for each of `net_offsets`.

    Their mean is the disc's own (0), and so is their covariance (a quarter). Their order is unrelated to the net's, so
    defocus moves nothing.
    """
    if count == 1:
        return read_only(np.zeros((1, 2)))
    index = np.arange(count)
    radius, angle = np.sqrt((index + 0.5) / count), index * math.pi * (3.0 - math.sqrt(5.0))
    places = radius[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    places -= places.mean(axis=0)
    places @= 0.5 * np.linalg.inv(np.linalg.cholesky(places.T @ places / count)).T
    rng, net = np.random.default_rng(count), net_offsets(count)
    orders = [rng.permutation(count) for _ in range(300)]
    return read_only(places[min(orders, key=lambda order: float(np.abs(net.T @ places[order]).max()))])


def net_offsets(count: int) -> Float64[Array, "n 2"]:
    """Sample positions in a pixel, −0.5 … 0.5: Hammersley's net.

    One sample in every row and column of `count`. So an edge's share of the pixel is right to half a sample for every
    upright or level edge and for the mean.

    Raises:
        ValueError: the number is no power of two.
    """
    bits = count.bit_length() - 1
    if count != 1 << bits:
        raise UnknownWordError("the number of samples must be a power of two", count)
    index = np.arange(count)
    mirrored = sum(((index >> bit) & 1) << (bits - 1 - bit) for bit in range(bits)) if bits else index
    return (np.stack([index, mirrored], axis=1) + 0.5) / count - 0.5


def picture_window(
    camera: Camera, points_world: Float64[Array, "n 3"], margin_px: int = 4
) -> tuple[int, int, int, int]:
    """Part of a picture that some points can cover: rows from and to, columns from and to.

    Empty if none. A point behind the camera gives the whole picture.
    """
    height, width = camera.shape_hw
    uv = camera.project(points_world)
    if not np.isfinite(uv).all():
        return 0, height, 0, width
    left, top = np.floor(uv.min(axis=0)).astype(int) - margin_px
    right, bottom = np.ceil(uv.max(axis=0)).astype(int) + margin_px + 1
    top, left = max(int(top), 0), max(int(left), 0)
    return top, max(top, min(int(bottom), height)), left, max(left, min(int(right), width))
