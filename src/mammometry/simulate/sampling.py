"""Where in a pixel to sample, and a camera's lens as the kernels take it."""

from __future__ import annotations

import numpy as np

from mammometry.geometry.arrays import Array, Float64
from mammometry.geometry.camera import Camera


def lens_parameters(camera: Camera) -> Float64[Array, 9]:
    """Return fx, fy, cx, cy, k1, k2, p1, p2, k3."""
    k = camera.matrix
    return np.array([k[0, 0], k[1, 1], k[0, 2], k[1, 2], *camera.distortion])


def net_offsets(count: int) -> Float64[Array, "n 2"]:
    """Sample positions in a pixel, −0.5 … 0.5: Hammersley's net, one sample in every row and column of `count`.

    An edge's share of the pixel is then right to half a sample for every upright or level edge and for the mean.

    Raises:
        ValueError: the number is no power of two.
    """
    bits = count.bit_length() - 1
    if count != 1 << bits:
        raise ValueError(f"the number of samples must be a power of two, found {count}")
    index = np.arange(count)
    mirrored = sum(((index >> bit) & 1) << (bits - 1 - bit) for bit in range(bits)) if bits else index
    return (np.stack([index, mirrored], axis=1) + 0.5) / count - 0.5


def picture_window(
    camera: Camera, points_world: Float64[Array, "n 3"], margin_px: int = 4
) -> tuple[int, int, int, int]:
    """Rows from and to, columns from and to, of the part of a picture that these points can touch; empty where none.

    A point behind the camera asks for the whole picture.
    """
    height, width = camera.shape_hw
    uv = camera.project(points_world)
    if not np.isfinite(uv).all():
        return 0, height, 0, width
    left, top = np.floor(uv.min(axis=0)).astype(int) - margin_px
    right, bottom = np.ceil(uv.max(axis=0)).astype(int) + margin_px + 1
    top, left = max(int(top), 0), max(int(left), 0)
    return top, max(top, min(int(bottom), height)), left, max(left, min(int(right), width))
