"""Outlines of the body in a walk's photographs, from the measured skin.

In an ordinary room colour cannot separate the body from its background, so the masks of a walk contain the whole region
around the body (`region.Region`). The pixels of a photograph that are far from all measured skin show the room. Without
this step, the surface would be closed along the walls of the region instead of behind the skin.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from scipy import ndimage

from mammometry.base.machine.cores import map_in_threads
from mammometry.geometry import Array, Bool, Camera, Float32, Float64, Rig
from mammometry.matching.foreground.foreground import Foreground
from mammometry.surface.ranges.range_image import RangeImage

_REACH_MM = 30.0
"""Margin around the measured skin in a photograph, for skin that no pair measured. Enclosed holes are filled."""
_CELL_PX = 4  # side of the cells of the mask
_STEP = 3  # every third pixel of a range image is used, in both directions: denser than the cells


def outlines(range_images: Sequence[RangeImage], given: Mapping[str, Foreground], rig: Rig) -> dict[str, Foreground]:
    """Camera → mask of the body: the given mask within `_REACH_MM` of the measured skin.

    Args:
        range_images: the measured skin of all pairs.
        given: camera → mask of the region around the body.
        rig: the cameras.
    """
    skin_world = np.concatenate([_sampled(image) for image in range_images])
    found = map_in_threads(lambda name: _outlined(given[name], rig.cameras[name], skin_world), list(given))
    return dict(zip(given, found, strict=True))


def _sampled(image: RangeImage) -> Float64[Array, "n 3"]:
    kept = np.zeros_like(image.valid)
    kept[::_STEP, ::_STEP] = image.valid[::_STEP, ::_STEP]
    points: Float64[Array, "n 3"] = image.keeping(kept).valid_points_world()
    return points


def _outlined(given: Foreground, camera: Camera, skin_world: Float64[Array, "n 3"]) -> Foreground:
    height, width = camera.shape_hw
    depth_mm = camera.camera_from_world.apply(skin_world)[:, 2]
    uv = camera.project(skin_world[depth_mm > 0])
    cells = (math.ceil(height / _CELL_PX), math.ceil(width / _CELL_PX))
    column, row = np.floor((uv + 0.5) / _CELL_PX).astype(int).T
    inside = (row >= 0) & (row < cells[0]) & (column >= 0) & (column < cells[1])
    if not inside.any():
        return given
    skin = np.zeros(cells, dtype=bool)
    skin[row[inside], column[inside]] = True
    reach = _REACH_MM * float(camera.matrix[0, 0]) / float(np.median(depth_mm[depth_mm > 0])) / _CELL_PX
    filled = ndimage.binary_fill_holes(ndimage.distance_transform_edt(~skin) <= reach)
    coverage = np.minimum(given.coverage, _smooth(filled, (height, width)))
    return replace(given, coverage=coverage)


def _smooth(cells: Bool[Array, "H W"], shape_hw: tuple[int, int]) -> Float32[Array, "h w"]:
    """Mask of cells, interpolated between their centres at each pixel: ½ at the mask's border."""
    share: Float32[Array, "h w"] = cells.astype(np.float32)
    for side in shape_hw:  # rows, then columns
        at = np.clip((np.arange(side) + 0.5) / _CELL_PX - 0.5, 0.0, len(share) - 1.0)
        before = np.minimum(at.astype(np.intp), max(len(share) - 2, 0))
        after = np.minimum(before + 1, len(share) - 1)
        part = (at - before).astype(np.float32)[:, None]
        share = ((1 - part) * share[before] + part * share[after]).T
    return np.ascontiguousarray(share)
