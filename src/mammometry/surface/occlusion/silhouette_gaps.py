"""Slits in a silhouette that are no background.

Skin turns away from the camera where the subject really ends: it is seen at a grazing angle there, or not measured at
all. Skin that faces the camera right up to a slit, on both sides and in line, goes on behind it. A band around the
body, a strap or a rail is what looks like background there.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from mammometry.geometry.arrays import Array, Bool, Float64
from mammometry.geometry.camera import Camera

_LEAST = np.ones((3, 3), dtype=bool)  # blocks of a slit: one line alone is an outlier
_WIDEST_MM = 90.0  # between both sides of a slit: a band or a rail has 15 to 50 mm; chosen by eye
_SIDE_MM = 12.0  # of skin on each side, from which its direction and bend are taken; chosen by eye
_LEAST_BLOCKS = 4  # of measured skin on each side
_EDGE_BLOCKS = 4  # from the slit to the nearest measured skin, at most: windows end before an edge; chosen by eye
_STEEPEST = np.tan(np.radians(60.0))  # of skin that faces the camera: at an occluding edge it is steeper; chosen by eye
_SQUARE = np.cos(np.radians(50.0))  # a line crosses a slit's edges: others are chords of a bent outline; chosen by eye
_OUTLINE_BLOCKS = 2.0  # Gaussian by which an outline's direction is taken; chosen by eye
_BEND = 0.5  # of the slit's width: how far apart in depth both sides' continuations may meet; chosen by eye


def spanned_mm(
    camera: Camera, subject: Bool[Array, "H W"], step: int, depth_mm: Float64[Array, "H W"]
) -> Float64[Array, "H W"]:
    """Depth of what spans the slits in a silhouette, infinite elsewhere.

    Along the optical axis. Rows and columns are scanned. Where both cross a slit, the shorter way counts.

    Args:
        camera: whose silhouette it is.
        subject: blocks of `step` pixels on the subject.
        step: pixels a block.
        depth_mm: measured depth along the optical axis of each block, infinite where none is measured.
    """
    spans = np.full(subject.shape, np.inf)
    widths = np.full(subject.shape, np.inf)
    measured = np.where(subject, depth_mm, np.inf)
    even = ndimage.gaussian_filter(subject.astype(np.float64), _OUTLINE_BLOCKS)
    down, along = np.gradient(even)
    slopes = np.stack([along, down])
    square = np.abs(slopes) >= _SQUARE * np.linalg.norm(slopes, axis=0)
    for axis in (0, 1):  # lines along rows, then along columns
        lines = [array if axis == 0 else array.T for array in (subject, measured, square[axis], spans, widths)]
        for on, depth, crossed, span, width in zip(*lines, strict=True):
            for slit, across_mm in _bridged(on, depth, crossed, step / camera.intrinsics[axis]):
                shorter = len(across_mm) < width[slit]
                span[slit][shorter] = across_mm[shorter]
                width[slit][shorter] = len(across_mm)
    spans[~ndimage.binary_opening(np.isfinite(spans), _LEAST)] = np.inf
    return spans


def points_world(camera: Camera, step: int, depth_mm: Float64[Array, "H W"]) -> Float64[Array, "n 3"]:
    """Points of the blocks that have a depth, mm."""
    row, column = np.nonzero(np.isfinite(depth_mm))
    xy = camera.normalised_from_pixels(np.stack([column, row], axis=1) * float(step))
    points = np.concatenate([xy, np.ones((len(xy), 1))], axis=1) * depth_mm[row, column, None]
    return camera.camera_from_world.inverse().apply(points)


def _bridged(
    subject: Bool[Array, " w"], depth_mm: Float64[Array, " w"], crossed: Bool[Array, " w"], block_per_mm: float
) -> Iterator[tuple[slice, Float64[Array, " k"]]]:
    """Yield the slits of one line, and the depth of what spans each, block by block."""
    edges = np.flatnonzero(np.diff(subject.astype(np.int8)))
    for before, after in zip(edges[:-1], edges[1:] + 1, strict=True):
        if not (subject[before] and crossed[before] and crossed[after]):  # a run of subject, or a chord
            continue
        near, far = _side(depth_mm[before::-1], block_per_mm), _side(depth_mm[after:], block_per_mm)
        if near is None or far is None:
            continue
        blocks = after - before
        mean_mm = 2 / (near.inverse + far.inverse)
        width_mm = np.hypot(blocks * block_per_mm * mean_mm, 1 / near.inverse - 1 / far.inverse)
        ahead, back = (side.inverse + side.slope * blocks / 2 for side in (near, far))
        if width_mm > _WIDEST_MM or min(ahead, back) <= 0 or abs(1 / ahead - 1 / back) > _BEND * width_mm:
            continue
        # The cubic that continues both sides (Hermite's), in inverse depth, where planes are straight.
        t = np.arange(1, blocks) / blocks
        inverse = (
            near.inverse * (1 + 2 * t) * (1 - t) ** 2
            + far.inverse * (3 - 2 * t) * t**2
            + blocks * t * (1 - t) * (near.slope * (1 - t) + far.slope * t)
        )
        yield slice(before + 1, after), 1 / inverse


@dataclass(frozen=True, slots=True)
class _Side:
    """Skin beside a slit."""

    inverse: float
    """Inverse depth at the edge, 1/mm."""
    slope: float
    """Its change per block from the edge into the slit: constant on a plane."""


def _side(outward_mm: Float64[Array, " k"], block_per_mm: float) -> _Side | None:
    """Skin from a slit's edge outward. None unless it is measured up to the edge and faces the camera."""
    known = np.isfinite(outward_mm[: 4 * _LEAST_BLOCKS + _EDGE_BLOCKS])
    if not known[:_EDGE_BLOCKS].any():
        return None
    reach = max(2 * _LEAST_BLOCKS, int(_SIDE_MM / (block_per_mm * outward_mm[np.argmax(known)])))
    at = np.flatnonzero(np.isfinite(outward_mm[:reach]))
    if len(at) < _LEAST_BLOCKS:
        return None
    _, slope, inverse = np.polyfit(at, 1 / outward_mm[at], 2)
    # dz/dx: over a block, z changes by −(1/z)' z², and x by block_per_mm · z.
    if abs(slope) > _STEEPEST * block_per_mm * inverse:
        return None
    return _Side(float(inverse), float(-slope))
