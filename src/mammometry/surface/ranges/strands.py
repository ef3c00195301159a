"""Hair, straps and cords in front of the skin.

They are long, narrow, nearer and much darker than the skin around them. Matching measures them like skin. A dark fold,
scar or tattoo is not nearer than its surroundings, and a nipple is not long. None of the limits here is critical.
"""

import numpy as np
from scipy import ndimage

from mammometry.base.photograph import LUMA, Photograph
from mammometry.geometry.arrays import Array, Bool, Float32
from mammometry.geometry.camera import Camera
from mammometry.matching.foreground.foreground import blocks_of
from mammometry.surface.ranges.range_image import SIGMAS, RangeImage

EDGE_PX = 6.0
"""Width of the band along an edge whose data are biased by it, px at the foreground's reference size: half a window.
"""
_WIDEST_MM = 16.0  # largest width: areolae and the shade below a breast are wider
_LONGER_MM = 25.0  # smallest length: more than a nipple's
_DARK = 0.5  # largest luma relative to the surroundings: hair has 0.1 to 0.45, nipples at least 0.6
_BEFORE_MM = 1.0  # least distance in front of the surroundings, if above `SIGMAS` of the datum's own σ
_STANDING = 0.25  # least share of a dark place's data in front: the rest of a strand touches the skin


def strands_in(image: RangeImage, photograph: Photograph, camera: Camera) -> Bool[Array, "h w"]:
    """Mask of the data on strands in front of the skin, and of data next to them.

    Args:
        image: range image of a pair.
        photograph: photograph of one of its cameras.
        camera: the camera of that photograph.
    """
    shape, blocks = image.valid.shape, blocks_of(photograph)
    step = blocks.step
    luma = blocks.encoded @ LUMA if blocks.encoded.shape[2] == 3 else blocks.encoded[..., 0]
    valid, range_mm = image.valid[::step, ::step], image.range_mm[::step, ::step]
    row, column = np.nonzero(valid)
    if not len(row):
        return np.zeros(shape, dtype=bool)
    block_mm = step * image.pixel_mm()
    dark = luma < _DARK * _levelled(luma, _WIDEST_MM / block_mm)
    places, count = ndimage.label(dark, structure=np.ones((3, 3)))
    sides = [[side.stop - side.start for side in box] for box in ndimage.find_objects(places)]
    rays = image.camera.rays_world(np.stack([column, row], axis=1) * float(step))
    points = image.camera.centre_world + rays * range_mm[row, column].astype(np.float64)[:, None]
    uv = np.floor((camera.project(points) + 0.5) / step)  # position in blocks
    inside = np.all((uv >= 0) & (uv < luma.shape[::-1]), axis=1)
    u, v = uv[inside].astype(np.intp).T
    shown = np.zeros(valid.shape, dtype=places.dtype)
    shown[row[inside], column[inside]] = places[v, u]
    behind_mm = _levelled(np.where(valid, range_mm, -np.inf), _WIDEST_MM / block_mm)
    before = behind_mm - range_mm > np.maximum(_BEFORE_MM, SIGMAS * image.sigma_mm[::step, ::step])
    data, standing = (np.bincount(some.ravel(), minlength=count + 1) for some in (shown, shown[before]))
    strand = (data > 0) & (standing >= _STANDING * data)
    strand &= [False, *(np.hypot(*side) > _LONGER_MM / block_mm for side in sides)]
    if not strand.any():
        return np.zeros(shape, dtype=bool)
    near = ndimage.distance_transform_edt(~strand[shown]) * step <= EDGE_PX * blocks.unit
    return np.asarray(near.repeat(step, axis=0).repeat(step, axis=1)[: shape[0], : shape[1]])


def _levelled(values: Float32[Array, "h w"], width: float) -> Float32[Array, "h w"]:
    """Values without valleys narrower than a width in blocks (a closing). −∞ is unknown."""
    size = max(3, round(width) | 1)
    highest = ndimage.maximum_filter(values, size)
    return np.asarray(ndimage.minimum_filter(np.where(highest == -np.inf, np.float32(np.inf), highest), size))
