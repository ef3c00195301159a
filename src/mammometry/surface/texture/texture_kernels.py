"""Compiled kernels that look up points in photographs, and copy photographs onto a viewing mesh.

Photographs are read as recorded, without a floating-point copy. Where the picture is coarser, its pixels are means of
step × step recorded ones. Plain NumPy versions: tests/unit/surface/ (test_texture_kernels.py, test_atlas_kernels.py).
"""

import numpy as np

from mammometry.base.machine.compiled import kernel, small_kernel
from mammometry.geometry.arrays import Array, Bool, Float32, Float64, Int32, Int64, Integer, UInt8
from mammometry.surface.fusion.camera_records import LEAST_DEPTH_MM, in_camera, pixel, view_of

_MM_PER_M = 1000.0  # the weight is 1 at normal incidence from a metre


@kernel
def facing(
    vertices: Float64[Array, "n 3"],
    normals: Float64[Array, "n 3"],
    row: Float64[Array, " 24"],
    centre: Float64[Array, " 3"],
    least_cosine: float,
    sharpness: float,
) -> tuple[Float32[Array, " n"], Float64[Array, "n 3"]]:
    """Weight of one photograph at each vertex, and the vertex's position in it. Occlusion is ignored.

    Args:
        vertices: world frame, mm.
        normals: unit, outwards.
        row: the camera, from `camera_records.view_row`.
        centre: its perspective centre, world frame, mm.
        least_cosine: least cosine of incidence at which a photograph counts.
        sharpness: power of that cosine in the weight.

    Returns:
        Weight: cosine to that power over the squared distance in metres, 0 if the camera does not face the vertex or
        the vertex is outside its image. Position: column, row and inverse depth in 1/mm, column −1 outside the image.
    """
    view = view_of(row)
    weights, places = np.zeros(len(vertices), dtype=np.float32), np.empty((len(vertices), 3))
    for n in range(len(vertices)):
        x, y, z = vertices[n, 0], vertices[n, 1], vertices[n, 2]
        xc, yc, zc = in_camera(view, x, y, z)
        places[n, 0], places[n, 1] = pixel(view, xc, yc, zc)
        places[n, 2] = 1.0 / max(zc, LEAST_DEPTH_MM)
        if places[n, 0] < 0.0:
            continue
        dx, dy, dz = centre[0] - x, centre[1] - y, centre[2] - z
        distance = np.sqrt(dx * dx + dy * dy + dz * dz)
        cosine = (normals[n, 0] * dx + normals[n, 1] * dy + normals[n, 2] * dz) / distance
        if cosine > least_cosine:
            weights[n] = cosine**sharpness * (_MM_PER_M / distance) ** 2
    return weights, places


@kernel
def hidden(
    places: Float64[Array, "n 3"], inverse_depths: Float32[Array, "h w"], clearance_mm: float
) -> Bool[Array, " n"]:
    """Points that the surface hides from the camera.

    At all four pixels around such a point the surface is nearer by more than the clearance. A plane through the point
    never hides it, however oblique it is: at one of the four it is behind the point.

    Args:
        places: column and row in pixels of `inverse_depths`, inverse depth in 1/mm.
        inverse_depths: inverse depth of the surface nearest to the camera, 1/mm. −∞ where there is none.
        clearance_mm: least distance in front of a point from which the surface hides it.
    """
    height, width = inverse_depths.shape
    covered = np.zeros(len(places), dtype=np.bool_)
    for n in range(len(places)):
        column, row = int(np.floor(places[n, 0])), int(np.floor(places[n, 1]))
        if column < 0 or row < 0 or column + 1 >= width or row + 1 >= height:
            continue
        least = min(
            min(inverse_depths[row, column], inverse_depths[row, column + 1]),
            min(inverse_depths[row + 1, column], inverse_depths[row + 1, column + 1]),
        )
        covered[n] = least > 0.0 and 1.0 / places[n, 2] - 1.0 / least > clearance_mm
    return covered


@kernel
def colours_at(pixels: Integer[Array, "h w c"], full_scale: float, uv: Float64[Array, "n 2"]) -> Float32[Array, "n 3"]:
    """Colours at positions in a photograph, 0…1, linear between pixels. Outside the image, its border's.

    `full_scale` is the level that counts as 1. A grey photograph has one channel.
    """
    height, width, channels = pixels.shape
    colours = np.empty((len(uv), 3), dtype=np.float32)
    for n in range(len(uv)):
        u, v = min(max(uv[n, 0], 0.0), width - 1.0), min(max(uv[n, 1], 0.0), height - 1.0)
        column, row = int(u), int(v)
        du, dv = u - column, v - row
        right, below = min(column + 1, width - 1), min(row + 1, height - 1)
        for channel in range(3):
            c = min(channel, channels - 1)
            above = (1.0 - du) * pixels[row, column, c] + du * pixels[row, right, c]
            under = (1.0 - du) * pixels[below, column, c] + du * pixels[below, right, c]
            colours[n, channel] = ((1.0 - dv) * above + dv * under) / full_scale
    return colours


@kernel
def deepest_triangles(
    corners: Float64[Array, "b 3 2"], first: int, stop: int, width: int, margin: float
) -> tuple[Int32[Array, " p"], Int32[Array, " p"], Int32[Array, " p"], Float32[Array, "p 3"]]:
    """Triangle in which each pixel is deepest, for pixels in triangles or just outside.

    Just outside: at most `margin` pixels from the lines of the sides and the bounding box. Depth is the distance from
    the nearest side, negative outside. Of equally deep triangles the last counts. Triangles without area have no
    pixels.

    Args:
        corners: column and row, integers at pixel centres.
        first: first row.
        stop: last row plus one.
        width: width of the picture.
        margin: pixels.

    Returns:
        Triangle, row, column and barycentric coordinates of each pixel, row by row.
    """
    owner = np.full((stop - first, width), -1, dtype=np.int32)
    depths = np.empty((stop - first, width), dtype=np.float32)
    count = 0
    for number in range(len(corners)):
        x0, y0 = corners[number, 0, 0], corners[number, 0, 1]
        x1, y1 = corners[number, 1, 0], corners[number, 1, 1]
        x2, y2 = corners[number, 2, 0], corners[number, 2, 1]
        top, bottom = min(y0, y1, y2) - margin, max(y0, y1, y2) + margin
        area = (x1 - x0) * (y2 - y0) - (y1 - y0) * (x2 - x0)
        if area == 0.0 or bottom < first or top > stop - 1:
            continue
        height0 = abs(area) / np.hypot(x2 - x1, y2 - y1)
        height1 = abs(area) / np.hypot(x0 - x2, y0 - y2)
        height2 = abs(area) / np.hypot(x1 - x0, y1 - y0)
        left, right = min(x0, x1, x2) - margin, max(x0, x1, x2) + margin
        for row in range(max(first, int(np.ceil(top))), min(stop - 1, int(np.floor(bottom))) + 1):
            for column in range(max(0, int(np.ceil(left))), min(width - 1, int(np.floor(right))) + 1):
                a = ((x1 - column) * (y2 - row) - (y1 - row) * (x2 - column)) / area
                b = ((x2 - column) * (y0 - row) - (y2 - row) * (x0 - column)) / area
                depth = min(a * height0, b * height1, (1.0 - a - b) * height2)
                if depth < -margin:
                    continue
                if owner[row - first, column] < 0:
                    count += 1
                elif np.float32(depth) < depths[row - first, column]:
                    continue
                owner[row - first, column] = number
                depths[row - first, column] = depth
    triangle, between = np.empty(count, dtype=np.int32), np.empty((count, 3), dtype=np.float32)
    rows, columns = np.empty(count, dtype=np.int32), np.empty(count, dtype=np.int32)
    count = 0
    for row in range(first, stop):
        for column in range(width):
            number = owner[row - first, column]
            if number < 0:
                continue
            x0, y0 = corners[number, 0, 0], corners[number, 0, 1]
            x1, y1 = corners[number, 1, 0], corners[number, 1, 1]
            x2, y2 = corners[number, 2, 0], corners[number, 2, 1]
            area = (x1 - x0) * (y2 - y0) - (y1 - y0) * (x2 - x0)
            a = ((x1 - column) * (y2 - row) - (y1 - row) * (x2 - column)) / area
            b = ((x2 - column) * (y0 - row) - (y2 - row) * (x0 - column)) / area
            triangle[count], rows[count], columns[count] = number, row, column
            between[count, 0], between[count, 1], between[count, 2] = a, b, 1.0 - a - b
            count += 1
    return triangle, rows, columns, between


@kernel
def shares_of(
    weights: Float32[Array, "k n"],
    corners: Int32[Array, "p 3"],
    between: Float32[Array, "p 3"],
    own: Int32[Array, " p"],
    least: float,
) -> Float32[Array, "k p"]:
    """Share of each photograph in each pixel. Shares of a pixel add up to 1.

    Args:
        weights: weight of each photograph at each vertex.
        corners: the vertices of each pixel's triangle.
        between: barycentric coordinates of the pixel; negative ones, just outside, count as 0.
        own: the photograph of its triangle.
        least: weight of that photograph if no other has any.
    """
    shares = np.empty((len(weights), len(corners)), dtype=np.float32)
    for place in range(len(corners)):
        a, b, c = corners[place, 0], corners[place, 1], corners[place, 2]
        u, v, w = max(between[place, 0], 0.0), max(between[place, 1], 0.0), max(between[place, 2], 0.0)
        total = least
        for k in range(len(weights)):
            share = u * weights[k, a] + v * weights[k, b] + w * weights[k, c]
            total += share
            shares[k, place] = share + least if k == own[place] else share
        for k in range(len(weights)):
            shares[k, place] /= total
    return shares


@small_kernel
def _sum(levels, row, column, channel, step):  # type: ignore[no-untyped-def]
    """Sum of the levels that form one pixel."""
    total = np.int64(0)
    for down in range(step):
        for along in range(step):
            total += levels[row * step + down, column * step + along, channel]
    return total


@small_kernel
def _between_four(image, row, column, channel):  # type: ignore[no-untyped-def]
    """Value between pixels. Outside the image, its border's."""
    v, u = min(max(row, 0.0), image.shape[0] - 1.0), min(max(column, 0.0), image.shape[1] - 1.0)
    top, left = int(v), int(u)
    below, right = min(top + 1, image.shape[0] - 1), min(left + 1, image.shape[1] - 1)
    above = (1.0 - (u - left)) * image[top, left, channel] + (u - left) * image[top, right, channel]
    under = (1.0 - (u - left)) * image[below, left, channel] + (u - left) * image[below, right, channel]
    return (1.0 - (v - top)) * above + (v - top) * under


@kernel
def pasted(
    photograph: tuple[Integer[Array, "h w c"], float, int],
    low: Int64[Array, " 2"],
    high: Int64[Array, " 2"],
    levelling: tuple[Float32[Array, " 3"], Float32[Array, "a b 3"], int],
) -> UInt8[Array, "y x 3"]:
    """A piece of a photograph after levelling.

    Args:
        photograph: its levels as recorded, with one or three channels; the level that counts as 1; the number of
            recorded pixels per pixel of the piece, along a side.
        low: first column and row of the piece, in its pixels.
        high: last column and row plus one.
        levelling: factor of each channel; summand at every n-th pixel, linear in between; n.
    """
    levels, full_scale, step = photograph
    gain, level, level_step = levelling
    piece = np.empty((high[1] - low[1], high[0] - low[0], 3), dtype=np.uint8)
    scale = full_scale * step * step
    last = levels.shape[2] - 1
    for y in range(len(piece)):
        row = low[1] + y
        for x in range(piece.shape[1]):
            column = low[0] + x
            for channel in range(3):
                value = gain[channel] * _sum(levels, row, column, min(channel, last), step) / scale
                value += _between_four(level, row / level_step, column / level_step, channel)
                piece[y, x, channel] = np.uint8(np.rint(min(max(value, 0.0), 1.0) * 255.0))
    return piece


@kernel
def mix_in(
    mixed: Float32[Array, "p 3"],
    share: Float32[Array, " p"],
    corners: Int32[Array, "p 3"],
    between: Float32[Array, "p 3"],
    uv: Float64[Array, "n 2"],
    photograph: tuple[Integer[Array, "h w c"], float, int],
    levelling: tuple[Float32[Array, " 3"], Float32[Array, "a b 3"], int],
) -> None:
    """Add a photograph's share to pixels that show several.

    Args:
        mixed: colours of the pixels so far, 0…1. Changed in place.
        share: share of this photograph in each.
        corners: the vertices of each pixel's triangle.
        between: barycentric coordinates of the pixel.
        uv: positions of the vertices in the photograph, in pixels of step × step recorded ones.
        photograph: as in `pasted`.
        levelling: as in `pasted`.
    """
    levels, full_scale, step = photograph
    gain, level, level_step = levelling
    scale = full_scale * step * step
    height, width, last = levels.shape[0] // step, levels.shape[1] // step, levels.shape[2] - 1
    for place in range(len(mixed)):
        if share[place] <= 0.0:
            continue
        u, v = 0.0, 0.0
        for corner in range(3):
            u += between[place, corner] * uv[corners[place, corner], 0]
            v += between[place, corner] * uv[corners[place, corner], 1]
        x, y = min(max(u, 0.0), width - 1.0), min(max(v, 0.0), height - 1.0)
        column, row = int(x), int(y)
        right, below = min(column + 1, width - 1), min(row + 1, height - 1)
        along, down = x - column, y - row
        for channel in range(3):
            c = min(channel, last)
            above = (1.0 - along) * _sum(levels, row, column, c, step) + along * _sum(levels, row, right, c, step)
            under = (1.0 - along) * _sum(levels, below, column, c, step) + along * _sum(levels, below, right, c, step)
            value = gain[channel] * ((1.0 - down) * above + down * under) / scale
            value += _between_four(level, v / level_step, u / level_step, channel)
            mixed[place, channel] += share[place] * value
