"""Skin a little past the edges of a pair's data.

Where something hides skin, matching ends before it does: windows near the edge see both, and their data lean towards
what hides. Skin that faces the camera goes on there. Where the subject really ends, its skin turns away.
"""

from __future__ import annotations

import numpy as np

from mammometry.geometry.arrays import Array, Float64
from mammometry.surface.ranges import image_kernels
from mammometry.surface.ranges.range_image import RangeImage

_REFERENCE_DIAGONAL_PX = 1353.0  # of the 1126 × 750 images on which widths were measured, as in `occluders`
_EDGE_PX = 6.0  # of data beside an edge that lean towards what is there, at that size: half a window; chosen by eye
_PAST_PX = 6.0  # past the edge, at that size, as far again; chosen by eye
_NEIGHBOURHOOD_MM = 6.0  # half-width of the window that gives the skin's direction; chosen by eye
_TURNED_MM = 0.5  # by which data lie behind the tangent plane where skin turns away; chosen by eye
_LEAST_COSINE = 0.5  # 60° off the normal: skin that is seen more obliquely may end there, as in `slits`


def continued_world(image: RangeImage) -> Float64[Array, "n 3"]:
    """Continue a pair's data past their edges.

    Points on their tangent planes, world frame, mm. Only of skin that faces the camera and does not turn away. Data
    nearer to an edge than half a window say no more than that.
    """
    unit = max(1.0, float(np.hypot(*image.valid.shape)) / _REFERENCE_DIAGONAL_PX)
    if not image.valid.any() or image.valid.all():  # no data, or none with an edge
        return np.empty((0, 3))
    sound = image_kernels.distance_px(~image.valid) > _EDGE_PX * unit
    if not sound.any():
        return np.empty((0, 3))
    normals = image.keeping(sound).normals_camera(_NEIGHBOURHOOD_MM)
    cosines = image_kernels.incidence_cosines(normals, image.camera.intrinsics)
    rows, columns = image_kernels.nearest_true(sound)
    own_row, own_column = np.nonzero(~sound)
    row, column = rows[own_row, own_column], columns[own_row, own_column]
    near = np.hypot(row - own_row, column - own_column) <= (_EDGE_PX + _PAST_PX) * unit
    near &= cosines[row, column] >= _LEAST_COSINE  # never where there is no normal
    own_row, own_column, row, column = (indices[near] for indices in (own_row, own_column, row, column))
    # Not `image.ray_directions`: of a whole picture they take 90 MB.
    datum, ray = (
        image.camera.rays_world(np.stack(at, axis=-1).astype(np.float64))
        for at in ((column, row), (own_column, own_row))
    )
    there = datum * image.range_mm[row, column][:, None]
    normal = normals[row, column] @ image.camera.camera_from_world.rotation
    steep = -np.einsum("ni,ni->n", normal, ray)
    range_mm = -np.einsum("ni,ni->n", normal, there) / np.maximum(steep, _LEAST_COSINE / 2)
    behind = image.valid[own_row, own_column] & (image.range_mm[own_row, own_column] > range_mm + _TURNED_MM)
    turned = np.zeros(image.valid.shape, dtype=bool)
    turned[row[behind], column[behind]] = True
    kept = (steep >= _LEAST_COSINE / 2) & ~turned[row, column]  # a plane seen so obliquely runs off
    points: Float64[Array, "n 3"] = image.camera.centre_world + ray[kept] * range_mm[kept, None]
    return points
