"""Hair, straps and cords before the skin: long, narrow, nearer and far darker than its surroundings.

Matching measures them as if they were skin. Colour alone does not tell, for a fold, a scar or a tattoo may be as dark;
nor does depth, for a nipple stands out as far. What is long, dark, and before its surroundings is no skin.
"""

import numpy as np
from scipy import ndimage

from mammometry.base.photograph import LUMA, Photograph
from mammometry.geometry.arrays import Array, Bool, Float32
from mammometry.geometry.camera import Camera
from mammometry.matching.foreground.foreground import blocks_of
from mammometry.surface.ranges.range_image import SIGMAS, RangeImage

EDGE_PX = 6.0
"""Of data beside an edge that lean towards what is there, at the foreground's reference size: half a window. Chosen by
eye.
"""
_WIDEST_MM = 16.0  # of what is narrow: areolae and the shade below a breast are wider; chosen by eye
_LONGER_MM = 25.0  # than this, across which no nipple is; chosen by eye
_DARK = 0.5  # of its surroundings' encoded luma: hair .1 to .45, nipples .6 and more; chosen by eye
_BEFORE_MM = 1.0  # before its surroundings, besides `SIGMAS` of the datum's own σ; chosen by eye
_STANDING = 0.25  # of a dark place's data that stand out: the rest of a strand lies on the skin; chosen by eye


def strands_in(image: RangeImage, photograph: Photograph, camera: Camera) -> Bool[Array, "h w"]:
    """Mask of the data that show something dark, long and narrow before the skin, and of those beside it.

    Args:
        image: of a pair.
        photograph: of one of its cameras.
        camera: that took it.
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
    uv = np.floor((camera.project(points) + 0.5) / step)  # of blocks
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
    beside = ndimage.distance_transform_edt(~strand[shown]) * step <= EDGE_PX * blocks.unit
    return np.asarray(beside.repeat(step, axis=0).repeat(step, axis=1)[: shape[0], : shape[1]])


def _levelled(values: Float32[Array, "h w"], width: float) -> Float32[Array, "h w"]:
    """Values without valleys narrower than a width, blocks. What is −∞ is not known."""
    size = max(3, round(width) | 1)
    highest = ndimage.maximum_filter(values, size)
    return np.asarray(ndimage.minimum_filter(np.where(highest == -np.inf, np.float32(np.inf), highest), size))
