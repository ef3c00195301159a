"""Slits in a silhouette that are no background, by the skin on both their sides.

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

_LEAST = np.ones((3, 3))  # blocks of a slit: one line alone is an outlier
_WIDEST_MM = 90.0  # between both sides of a slit: a band or a rail has 15 to 50 mm; chosen by eye
_SIDE_MM = 12.0  # of skin on each side, from which its direction is taken; chosen by eye
_LEAST_BLOCKS = 4  # of measured skin on each side
_EDGE_BLOCKS = 4  # from the slit to the nearest measured skin, at most: windows end before an edge; chosen by eye
_STEEPEST = np.tan(np.radians(60.0))  # of skin that faces the camera: at an occluding edge it is steeper; chosen by eye
_SQUARE = np.cos(np.radians(50.0))  # a line crosses a slit's edges: others are chords of a bent outline; chosen by eye
_OUTLINE_BLOCKS = 2.0  # Gaussian by which an outline's direction is taken; chosen by eye
_BEND = 0.5  # of the slit's width: how far apart in depth both sides' continuations may meet; chosen by eye


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Slits:
    """Where one camera's silhouette has slits between skin that faces it."""

    blocks: Bool[Array, "H W"]
    bridges_world: Float64[Array, "n 3"]
    """Points between both sides, one a block and direction of scanning, mm."""


def find_slits(camera: Camera, subject: Bool[Array, "H W"], step: int, depth_mm: Float64[Array, "H W"]) -> Slits:
    """Scan rows and columns of a silhouette for slits.

    Args:
        camera: whose silhouette it is.
        subject: blocks of `step` pixels on the subject.
        step: pixels a block.
        depth_mm: measured depth along the optical axis of each block, infinite where none is measured.
    """
    found: list[tuple[Array, Array, Array]] = []
    focal = camera.intrinsics[:2]
    measured = np.where(subject, depth_mm, np.inf)
    even = ndimage.gaussian_filter(subject.astype(np.float64), _OUTLINE_BLOCKS)
    slopes = np.stack(np.gradient(even)[::-1])  # along rows, along columns
    square = np.abs(slopes) >= _SQUARE * np.linalg.norm(slopes, axis=0)
    for axis in (0, 1):  # lines along rows, then along columns
        lines = [array if axis == 0 else array.T for array in (subject, measured, square[axis])]
        for line, (on, depth, crossed) in enumerate(zip(*lines, strict=True)):
            for first, last, bridge_mm in _bridged(on, depth, crossed, step / focal[axis]):
                at = np.arange(first, last)
                row, column = (np.full_like(at, line), at) if axis == 0 else (at, np.full_like(at, line))
                found.append((row, column, bridge_mm))
    blocks = np.zeros(subject.shape, dtype=bool)
    if not found:
        return Slits(blocks=blocks, bridges_world=np.zeros((0, 3)))
    row, column, bridge_mm = (np.concatenate(part) for part in zip(*found, strict=True))
    blocks[row, column] = True
    blocks = ndimage.binary_opening(blocks, _LEAST)
    kept = blocks[row, column]
    xy = camera.normalised_from_pixels(np.stack([column, row], axis=1)[kept] * float(step))
    points = np.concatenate([xy, np.ones((len(xy), 1))], axis=1) * bridge_mm[kept, None]
    return Slits(blocks=blocks, bridges_world=camera.camera_from_world.inverse().apply(points))


def _bridged(
    subject: Bool[Array, " w"], depth_mm: Float64[Array, " w"], crossed: Bool[Array, " w"], block_per_mm: float
) -> Iterator[tuple[int, int, Float64[Array, " k"]]]:
    """Yield the slits of one line: first block, the one after the last, and the depth between both sides."""
    edges = np.flatnonzero(np.diff(subject.astype(np.int8)))
    for before, after in zip(edges[:-1], edges[1:] + 1, strict=True):
        if not (subject[before] and crossed[before] and crossed[after]):  # a run of subject, or a chord
            continue
        near, far = _side(depth_mm[before::-1], block_per_mm), _side(depth_mm[after:], block_per_mm)
        if near is None or far is None:
            continue
        count = after - before
        at = np.arange(1, count)
        middle = count / 2
        mean_mm = 2 / (near.inverse(0) + far.inverse(0))
        width_mm = np.hypot(count * block_per_mm * mean_mm, 1 / near.inverse(0) - 1 / far.inverse(0))
        ahead, back = near.inverse(middle), far.inverse(middle)
        if width_mm > _WIDEST_MM or min(ahead, back) <= 0 or abs(1 / ahead - 1 / back) > _BEND * width_mm:
            continue
        share = at / count
        yield before + 1, after, 1 / ((1 - share) * near.inverse(0) + share * far.inverse(0))


@dataclass(frozen=True, slots=True)
class _Side:
    """Inverse depth of skin beside a slit, linear in blocks from its edge into the slit: a plane's is."""

    at_edge: float
    slope: float

    def inverse(self, blocks: float) -> float:
        return self.at_edge + self.slope * blocks


def _side(outward_mm: Float64[Array, " k"], block_per_mm: float) -> _Side | None:
    """Skin from a slit's edge outward. None unless it is measured up to the edge and faces the camera."""
    known = np.isfinite(outward_mm[: 4 * _LEAST_BLOCKS + _EDGE_BLOCKS])
    if not known[:_EDGE_BLOCKS].any():
        return None
    reach = max(2 * _LEAST_BLOCKS, int(_SIDE_MM / (block_per_mm * outward_mm[np.argmax(known)])))
    at = np.flatnonzero(np.isfinite(outward_mm[:reach]))
    if len(at) < _LEAST_BLOCKS:
        return None
    inverse = 1 / outward_mm[at]
    slope, at_edge = np.polyfit(at, inverse, 1)
    # z' = −(1/z)' z², over a block of block_per_mm · z
    if abs(slope) > _STEEPEST * block_per_mm * at_edge:
        return None
    return _Side(float(at_edge), float(-slope))
