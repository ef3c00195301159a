"""Sub-pixel silhouette from the subject's blocks and the photograph.

Near the contour each pixel is compared with the background and the subject *next to it*, in linear light and along the
colour direction in which these two differ. So a shaded flank or a bright patch of the background does not move the
silhouette, and a flank darker than its background is also found. If the two do not differ, the blocks' outline is used.
Only a narrow band of pixels is computed.
"""

import numpy as np
from scipy import ndimage

from mammometry.base.machine.compiled import kernel
from mammometry.geometry.arrays import Array, Bool, Float32, Shaped, UInt8, read_only
from mammometry.matching.filters import blur, gaussian_taps

# Widths in pixels of the reference size, see `foreground`; chosen on the captures of docs/decisions/0020.
_GUARD_PX = 3.0  # pixels closer to the contour than this are mixed (blur, resampling)
_NEIGHBOURHOOD_PX = 5.0  # Gaussian σ over which background and subject are averaged next to the contour
_FEATHER_PX = 4.0  # largest distance from the contour at which the coverage is measured; 0 or 1 beyond it
_CALM_PX = 0.5  # Gaussian σ that removes the pixels' noise
_LEAST_CONTRAST = 0.004  # smallest difference of linear light between subject and background
_WIDENING = (8.0, 2.0, 1.0)  # factors on the neighbourhood, wide to narrow: the narrowest with enough weight is used
_ENOUGH_WEIGHT = 0.02  # smallest share of a neighbourhood on the wanted side
_OUTSIDE, _BAND, _INSIDE = 0, 1, 2  # zones of a pixel: outside, near the contour, inside


def sub_pixel_coverage(
    pixels: Shaped[Array, "h w channels"],
    linear: Float32[Array, " levels"],
    subject: Bool[Array, "H W"],
    step: int,
    unit: float,
    contour_level: float,
) -> Float32[Array, "h w"]:
    """Share of each pixel that the subject covers, smooth near the contour, without spots and holes.

    Args:
        pixels: sRGB-encoded, 8 or 16 bit.
        linear: linear light of each level.
        subject: blocks of step × step pixels, at least one.
        step: pixels per block.
        unit: pixels per pixel of the reference size.
        contour_level: coverage at the silhouette.
    """
    guard, reach = _GUARD_PX * unit, 4 * _GUARD_PX * unit
    shape_hw = pixels.shape[:2]
    rows, columns = _around(subject, int(np.ceil(reach / step)) + 2)  # everything outside is background
    part = (slice(rows.start * step, rows.stop * step), slice(columns.start * step, columns.stop * step))
    subject, pixels = subject[rows, columns], read_only(pixels[part].copy())
    light = block_means(pixels, linear, step)
    inside, outside = ndimage.distance_transform_edt(subject), ndimage.distance_transform_edt(~subject)
    signed = (step * np.where(subject, inside - 0.5, 0.5 - outside)).astype(np.float32)
    bright = _beside(light, (signed > guard) & (signed < reach), step / unit)
    dark = _beside(light, (-signed > guard) & (-signed < reach), step / unit)
    blocks, widths = (signed, bright, dark), (guard / 2, _FEATHER_PX * unit)
    share, zone = compare(pixels, linear, blocks, step, widths)
    del pixels  # freed early: 40 MB for a full-size torso
    share = blur(share, gaussian_taps(_CALM_PX * unit))
    share = finish(share, zone, signed, step, widths, contour_level)
    coverage = np.zeros(shape_hw, dtype=np.float32)
    coverage[part] = share
    return coverage


def _around(subject: Bool[Array, "H W"], margin: int) -> tuple[slice, slice]:
    """Rows and columns of the subject with a margin of blocks, within the image."""
    held = (np.nonzero(subject.any(axis=axis))[0] for axis in (1, 0))
    rows, columns = (
        slice(max(int(there[0]) - margin, 0), min(int(there[-1]) + 1 + margin, size))
        for there, size in zip(held, subject.shape, strict=True)
    )
    return rows, columns


def _beside(
    light: Float32[Array, "H W channels"], where: Bool[Array, "H W"], px_per_block: float
) -> Float32[Array, "H W channels"]:
    """Mean of the chosen blocks around each block. The neighbourhood is wider if none is near."""
    share = where.astype(np.float32)
    total = np.where(where[..., None], light, np.float32(0))
    mean = np.empty_like(light)
    mean[:] = light[where].mean(axis=0) if where.any() else 0.0
    for widening in _WIDENING:
        taps = gaussian_taps(_NEIGHBOURHOOD_PX * widening / px_per_block)
        weight = blur(share, taps)
        enough = weight > _ENOUGH_WEIGHT
        for channel in range(light.shape[2]):
            around = blur(np.ascontiguousarray(total[..., channel]), taps)
            mean[enough, channel] = around[enough] / weight[enough]
    return mean


@kernel
def block_means(
    pixels: Shaped[Array, "h w channels"], value_of: Float32[Array, " levels"], step: int
) -> Float32[Array, "H W channels"]:
    """Means over blocks of step × step pixels of each level's value. The last blocks may be smaller."""
    height, width, channels = pixels.shape
    rows, columns = (height + step - 1) // step, (width + step - 1) // step
    means = np.zeros((rows, columns, channels), dtype=np.float32)
    for i in range(height):
        row = means[i // step]
        for block in range(columns):
            for j in range(block * step, min(block * step + step, width)):
                for c in range(channels):
                    row[block, c] += value_of[pixels[i, j, c]]
    for i in range(rows):
        down = min(step, height - i * step)
        for j in range(columns):
            across = min(step, width - j * step)
            for c in range(channels):
                means[i, j, c] /= np.float32(down * across)
    return means


@kernel
def _place(index, step, count):  # type: ignore[no-untyped-def]
    """The blocks on either side of a pixel's centre, and the second one's weight in linear interpolation."""
    position = (np.float32(index) + np.float32(0.5)) / np.float32(step) - np.float32(0.5)
    position = min(max(position, np.float32(0.0)), np.float32(count - 1))
    before = min(int(position), max(count - 2, 0))
    return before, min(before + 1, count - 1), position - np.float32(before)


@kernel
def _between(values, i, i1, s, j, j1, t):  # type: ignore[no-untyped-def]
    one = np.float32(1.0)
    above = (one - t) * values[i, j] + t * values[i, j1]
    below = (one - t) * values[i1, j] + t * values[i1, j1]
    return (one - s) * above + s * below


@kernel
def compare(
    pixels: Shaped[Array, "h w channels"],
    linear: Float32[Array, " levels"],
    blocks: tuple[Float32[Array, "H W"], Float32[Array, "H W channels"], Float32[Array, "H W channels"]],
    step: int,
    widths_px: tuple[float, float],
) -> tuple[Float32[Array, "h w"], UInt8[Array, "h w"]]:
    """Position of each pixel's light between background (0) and subject (1), and its zone.

    Farther than guard + feather from the blocks' contour a pixel is inside (2) or outside (0); the rest is the band
    (1). Where both lights are alike, the distance to the blocks' contour is used instead.

    Args:
        pixels: sRGB-encoded, 8 or 16 bit.
        linear: linear light of each level.
        blocks: signed distance to the blocks' contour, px; light of the subject and of the background next to it.
        step: pixels per block.
        widths_px: guard and feather.
    """
    signed_px, bright, dark = blocks
    guard_px, feather_px = widths_px
    height, width, channels = pixels.shape
    rows, columns = signed_px.shape
    share = np.empty((height, width), dtype=np.float32)
    zone = np.empty((height, width), dtype=np.uint8)
    limit = np.float32(guard_px + feather_px)
    places = np.empty((2, width), dtype=np.int64)
    between = np.empty(width, dtype=np.float32)
    for j in range(width):
        places[0, j], places[1, j], between[j] = _place(j, step, columns)
    for i in range(height):
        i0, i1, s = _place(i, step, rows)
        for j in range(width):
            j0, j1, t = places[0, j], places[1, j], between[j]
            # A pixel is within a block's diagonal of its block.
            rough = signed_px[i0, j0]
            if abs(rough) > limit + np.float32(3 * step):
                zone[i, j] = _INSIDE if rough > 0 else _OUTSIDE
                share[i, j] = 1.0 if rough > 0 else 0.0
                continue
            distance = _between(signed_px, i0, i1, s, j0, j1, t)
            if distance >= limit:
                zone[i, j] = _INSIDE
            elif distance <= -limit:
                zone[i, j] = _OUTSIDE
            else:
                zone[i, j] = _BAND
            along = across = np.float32(0.0)
            for c in range(channels):
                low = _between(dark[:, :, c], i0, i1, s, j0, j1, t)
                difference = _between(bright[:, :, c], i0, i1, s, j0, j1, t) - low
                along += (linear[pixels[i, j, c]] - low) * difference
                across += difference * difference
            if across < np.float32(channels * _LEAST_CONTRAST * _LEAST_CONTRAST):
                share[i, j] = min(max(np.float32(0.5) + distance / np.float32(2 * step), np.float32(0.0)), 1.0)
            else:
                share[i, j] = min(max(along / across, np.float32(-1.0)), np.float32(2.0))
    return share, zone


@kernel
def finish(
    share: Float32[Array, "h w"],
    zone: UInt8[Array, "h w"],
    signed_px: Float32[Array, "H W"],
    step: int,
    widths_px: tuple[float, float],
    level: float,
) -> Float32[Array, "h w"]:
    """Coverage of the band around the contour.

    It is computed from the comparison, blended to 0 and 1 at the band's borders; isolated spots and holes are removed.
    A pixel above the level belongs to the subject only if it is connected to the inside, and one below it to the
    background only if it is connected to the outside.
    """
    guard_px, feather_px = widths_px
    height, width = share.shape
    rows, columns = signed_px.shape
    coverage = np.empty((height, width), dtype=np.float32)
    count = 0
    for i in range(height):
        for j in range(width):
            count += zone[i, j] == _BAND
            coverage[i, j] = np.float32(zone[i, j] == _INSIDE)
    band = np.empty((count, 2), dtype=np.int32)
    count = 0
    for i in range(height):
        for j in range(width):
            if zone[i, j] == _BAND:
                band[count, 0], band[count, 1] = i, j
                count += 1
    for n in range(count):
        i, j = band[n]
        i0, i1, s = _place(i, step, rows)
        j0, j1, t = _place(j, step, columns)
        distance = _between(signed_px, i0, i1, s, j0, j1, t)
        surely = min(max((distance - guard_px) / feather_px, 0.0), 1.0)
        hardly = min(max((-distance - guard_px) / feather_px, 0.0), 1.0)
        coverage[i, j] = min(max(max(min(share[i, j], 1.0 - hardly), surely), 0.0), 1.0)
    # Flood the band from both borders; what neither flood reaches is enclosed by the other.
    stack = np.empty((count + 1, 2), dtype=np.int32)
    reached = np.zeros((height, width), dtype=np.bool_)
    for side in (_INSIDE, _OUTSIDE):
        top = 0
        for n in range(count):
            i, j = band[n]
            if (coverage[i, j] >= level) != (side == _INSIDE):
                continue
            beside = False
            for a in range(max(i - 1, 0), min(i + 2, height)):
                for b in range(max(j - 1, 0), min(j + 2, width)):
                    beside = beside or zone[a, b] == side
            if beside:
                reached[i, j] = True
                stack[top, 0], stack[top, 1] = i, j
                top += 1
        while top > 0:
            top -= 1
            i, j = stack[top]
            for a in range(max(i - 1, 0), min(i + 2, height)):
                for b in range(max(j - 1, 0), min(j + 2, width)):
                    if zone[a, b] == _BAND and not reached[a, b] and (coverage[a, b] >= level) == (side == _INSIDE):
                        reached[a, b] = True
                        stack[top, 0], stack[top, 1] = a, b
                        top += 1
    for n in range(count):
        i, j = band[n]
        if not reached[i, j]:
            coverage[i, j] = np.float32(0.0) if coverage[i, j] >= level else np.float32(1.0)
    return coverage
