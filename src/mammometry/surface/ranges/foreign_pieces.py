"""Pieces of range data that are not the subject.

What lies far behind the subject's middle is background, where no silhouette kept it out. What hangs together with the
largest surface that the pairs see is the subject: smaller pieces that touch it nowhere fly about it.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence

import numpy as np
from scipy import ndimage

from mammometry.geometry.arrays import Array, Bool, Float64
from mammometry.surface.ranges.range_image import RangeImage

_BEHIND = 1.4  # of the middle's depth, as in `matching.coarse_depth`
_STEP_PX = (
    5.0  # edge of a cell, of a pixel's width on the surface: what lies in cells that touch hangs together; by eye
)
_MOST_CELLS = 256  # along a side
_SMALLEST = 0.05  # of the largest piece, counted in cells; by eye


def subject_data(
    range_images: Sequence[RangeImage], blind: Collection[str], middle_world: Float64[Array, 3] | None
) -> list[Bool[Array, "h w"]]:
    """Per view and element, whether its datum is the subject's.

    Where a view has no silhouette the largest piece alone is kept; else also what is not much smaller.

    Args:
        range_images: of all pairs.
        blind: pairs without silhouettes.
        middle_world: about which the subject stands, world frame, mm.
    """
    keep = [image.valid.copy() for image in range_images]
    if middle_world is not None:
        for image, kept in zip(range_images, keep, strict=True):
            if image.name in blind and kept.any():
                depth = image.camera.camera_from_world.apply(image.valid_points_world())[:, 2]
                middle = float(image.camera.camera_from_world.apply(middle_world[None])[0, 2])
                kept[image.valid] = depth < _BEHIND * middle
    kept_images = [image.keeping(kept) for image, kept in zip(range_images, keep, strict=True)]
    points = np.concatenate([image.valid_points_world() for image in kept_images])
    if not len(points):
        return keep
    low, high = points.min(axis=0), points.max(axis=0)
    pixel_mm = float(np.nanmedian([image.pixel_mm() for image in kept_images]))
    edge = max(_STEP_PX * pixel_mm, float((high - low).max()) / _MOST_CELLS)
    cells = ((points - low) / edge).astype(np.intp)
    filled = np.zeros(cells.max(axis=0) + 1, dtype=bool)
    filled[tuple(cells.T)] = True
    pieces, _ = ndimage.label(filled, structure=np.ones((3, 3, 3)))
    sizes = np.bincount(pieces[filled])
    least = 1.0 if blind else _SMALLEST
    chosen = (sizes >= least * sizes.max())[pieces[tuple(cells.T)]]
    start = 0
    for image, kept in zip(kept_images, keep, strict=True):
        count = int(np.count_nonzero(image.valid))
        kept[image.valid] = chosen[start : start + count]
        start += count
    return keep
