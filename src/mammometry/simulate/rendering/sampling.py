"""Sample positions in pixels and lens apertures, and lens parameters for the kernels."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache

import numpy as np

from mammometry.base.errors import UnknownWordError
from mammometry.geometry import Array, Camera, Float32, Float64, read_only


@dataclass(frozen=True, slots=True, kw_only=True)
class Aperture:
    """Aperture of a thin lens: rays through it meet in the sharp plane.

    The ray through its centre is that of the camera model, so defocus does not shift the image. A point at depth z
    becomes a disc with a diameter of ``diameter_mm · fx · |1/z − 1/focus_mm|`` pixels.
    """

    diameter_mm: float = 0.0
    """Diameter, mm. 0: a pinhole."""
    focus_mm: float = math.inf
    """Depth of the sharp plane from the perspective centre, mm."""


PINHOLE = Aperture()


def lens_parameters(camera: Camera) -> Float64[Array, 9]:
    """Parameters fx, fy, cx, cy, k1, k2, p1, p2, k3."""
    return np.array([*camera.intrinsics, *camera.distortion])


def lens_rays(
    camera: Camera, directions: Float32[Array, "n 3"], aperture: Aperture, places: Float64[Array, "n 2"]
) -> tuple[Float32[Array, "n 3"], Float32[Array, "n 3"]]:
    """Origins and directions, world frame, of rays that start at `places` on the lens's unit disc.

    Args:
        camera: camera with the lens.
        directions: directions of the rays through the lens's centre.
        aperture: aperture and focus.
        places: −1 … 1 of the aperture's radius, along the camera's x and y.
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
    """Positions on the unit disc, one for each of `net_offsets`.

    Their mean (0) and covariance (a quarter) are those of the disc. Their order is uncorrelated with that of the net,
    so defocus does not shift the image.
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
    """Sample positions in a pixel, −0.5 … 0.5 (Hammersley's net).

    Each of `count` rows and columns has one sample. So the share of a pixel on one side of a horizontal or vertical
    edge is accurate to half a sample, and the mean is exact.

    Raises:
        ValueError: the number is not a power of two.
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
    """Part of a picture that may show points: rows from and to, columns from and to. Empty if none.

    If a point is behind the camera, this is the whole picture.
    """
    height, width = camera.shape_hw
    uv = camera.project(points_world)
    if not np.isfinite(uv).all():
        return 0, height, 0, width
    left, top = np.floor(uv.min(axis=0)).astype(int) - margin_px
    right, bottom = np.ceil(uv.max(axis=0)).astype(int) + margin_px + 1
    top, left = max(int(top), 0), max(int(left), 0)
    return top, max(top, min(int(bottom), height)), left, max(left, min(int(right), width))
