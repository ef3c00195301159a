"""Compiled kernels on range images. Plain NumPy versions: tests/unit/surface/."""

import numpy as np

from mammometry.base.machine.compiled import kernel, small_kernel
from mammometry.geometry.arrays import Array, Bool, Float32, Float64, Int32

_LEAST_MASS = 6.0  # fewest data in a window for a normal: twice what a plane needs
_FAR = np.int64(1) << 60  # px²: initial distance, larger than any true one
_SPREAD = 1e-3  # px⁴: data whose covariance has a smaller determinant are on a line


@kernel
def inverse_depth_planes(
    range_mm: Float32[Array, "h w"], valid: Bool[Array, "h w"], intrinsics: Float64[Array, " 4"], half: int
) -> Float32[Array, "h w 3"]:
    """Normal of the inverse-depth plane around each valid pixel, camera frame. NaN if unknown.

    It points towards the camera. The plane 1/z = a x + b y + c is a least-squares fit to the valid data within `half`
    pixels along both axes. `intrinsics`: fx, fy, cx, cy of this array. The window's sums are updated from pixel to
    pixel, so the cost does not depend on its size. Unknown with fewer than six data, or with all of them on a line.
    """
    height, width = valid.shape
    fx, fy, cx, cy = intrinsics[0], intrinsics[1], intrinsics[2], intrinsics[3]
    normals = np.full((height, width, 3), np.nan, dtype=np.float32)
    bands = (height + 63) // 64
    columns = np.empty((width, 9))
    for band in range(bands):
        columns[:] = 0.0
        first, last = band * 64, min(height, band * 64 + 64)
        bottom = max(first - half, 0)
        top = bottom  # rows bottom … top − 1 are in the sums
        for row in range(first, last):
            while top < min(row + half + 1, height):
                _add_row(columns, range_mm, valid, top, first, fx, fy, cx, cy, 1.0)
                top += 1
            while bottom < row - half:
                _add_row(columns, range_mm, valid, bottom, first, fx, fy, cx, cy, -1.0)
                bottom += 1
            # One variable per sum: an array of nine would be read from memory and written back for every pixel.
            n, sx, sy, sxx, sxy, syy, sq, sxq, syq = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
            for column in range(-half, width):
                if column + half < width:
                    more = columns[column + half]
                    n, sx, sy = n + more[0], sx + more[1], sy + more[2]
                    sxx, sxy, syy = sxx + more[3], sxy + more[4], syy + more[5]
                    sq, sxq, syq = sq + more[6], sxq + more[7], syq + more[8]
                if column - half - 1 >= 0:
                    less = columns[column - half - 1]
                    n, sx, sy = n - less[0], sx - less[1], sy - less[2]
                    sxx, sxy, syy = sxx - less[3], sxy - less[4], syy - less[5]
                    sq, sxq, syq = sq - less[6], sxq - less[7], syq - less[8]
                if column < 0 or not valid[row, column] or n < _LEAST_MASS - 0.5:
                    continue
                mx, my, mean = sx / n, sy / n, sq / n
                cxx, cxy, cyy = sxx - sx * mx, sxy - sx * my, syy - sy * my
                determinant = cxx * cyy - cxy * cxy
                if determinant <= _SPREAD * n * n:
                    continue
                cxq, cyq = sxq - sx * mean, syq - sy * mean
                a = (cyy * cxq - cxy * cyq) / determinant
                b = (cxx * cyq - cxy * cxq) / determinant
                # From pixels relative to (cx, first row) to ideal coordinates, by the focal lengths.
                c = mean - a * (mx + width * 0.5 - cx) - b * (my + first - cy)
                a, b = a * fx, b * fy
                length = np.sqrt(a * a + b * b + c * c)
                normals[row, column, 0] = -a / length
                normals[row, column, 1] = -b / length
                normals[row, column, 2] = -c / length
    return normals


@kernel
def _add_row(columns, range_mm, valid, row, first, fx, fy, cx, cy, sign):  # type: ignore[no-untyped-def]
    width = valid.shape[1]
    y = float(row - first)
    ideal_y = (row - cy) / fy
    for column in range(width):
        if valid[row, column]:
            x = column - width * 0.5
            ideal_x = (column - cx) / fx
            q = np.sqrt(1.0 + ideal_x * ideal_x + ideal_y * ideal_y) / range_mm[row, column]
            sums = columns[column]
            sums[0] += sign
            sums[1] += sign * x
            sums[2] += sign * y
            sums[3] += sign * x * x
            sums[4] += sign * x * y
            sums[5] += sign * y * y
            sums[6] += sign * q
            sums[7] += sign * x * q
            sums[8] += sign * y * q


@kernel
def incidence_cosines(normals: Float32[Array, "h w 3"], intrinsics: Float64[Array, " 4"]) -> Float32[Array, "h w"]:
    """Cosine of incidence at each pixel, from normals in the camera frame."""
    height, width = normals.shape[:2]
    cosines = np.empty((height, width), dtype=np.float32)
    for row in range(height):
        y = (row - intrinsics[3]) / intrinsics[1]
        for column in range(width):
            cosines[row, column] = incidence_cosine(normals[row, column], (column - intrinsics[2]) / intrinsics[0], y)
    return cosines


@kernel
def incidence_cosine(normal, x, y):  # type: ignore[no-untyped-def]
    """Cosine of incidence of a normal at ideal image coordinates."""
    return -(normal[0] * x + normal[1] * y + normal[2]) / np.sqrt(1.0 + x * x + y * y)


@kernel
def nearest_true(mask: Bool[Array, "h w"]) -> tuple[Int32[Array, "h w"], Int32[Array, "h w"]]:
    """Row and column of the nearest true pixel, for every pixel. −1 if there is none.

    Vectors to the nearest one are propagated in two sweeps over the image (Danielsson 1980). This is exact except for
    rare ties, where the error is a fraction of a pixel.
    """
    height, width = mask.shape
    rows = np.full((height, width), -1, dtype=np.int32)
    columns = np.full((height, width), -1, dtype=np.int32)
    squares = np.empty(width, dtype=np.int64)
    for row in range(height):
        for column in range(width):
            if mask[row, column]:
                rows[row, column], columns[row, column] = row, column
        _sweep_row(mask, rows, columns, squares, row, -1)
    for row in range(height - 2, -1, -1):
        _sweep_row(mask, rows, columns, squares, row, 1)
    return rows, columns


def distance_px(mask: Bool[Array, "h w"]) -> Float32[Array, "h w"]:
    """Distance of every pixel from the nearest true pixel of `mask`, which must have one."""
    return _distances(*nearest_true(mask))


@kernel
def _distances(rows: Int32[Array, "h w"], columns: Int32[Array, "h w"]) -> Float32[Array, "h w"]:
    distances = np.empty(rows.shape, dtype=np.float32)
    for row in range(rows.shape[0]):
        for column in range(rows.shape[1]):
            down, along = np.float64(rows[row, column] - row), np.float64(columns[row, column] - column)
            distances[row, column] = np.sqrt(down * down + along * along)
    return distances


@kernel
def _sweep_row(mask, rows, columns, squares, row, towards):  # type: ignore[no-untyped-def]
    """Take nearer true pixels from the previous row, then from both sides. `squares` is a buffer."""
    height, width = rows.shape
    before = row + towards
    for column in range(width):
        squares[column] = _FAR if rows[row, column] < 0 else _square(rows, columns, row, column, row, column)
    if 0 <= before < height:
        for column in range(width):
            if not mask[row, column]:
                _nearer(rows, columns, squares, row, column, before, column)
                if column > 0:
                    _nearer(rows, columns, squares, row, column, before, column - 1)
                if column + 1 < width:
                    _nearer(rows, columns, squares, row, column, before, column + 1)
    for column in range(1, width):
        if not mask[row, column]:
            _nearer(rows, columns, squares, row, column, row, column - 1)
    for column in range(width - 2, -1, -1):
        if not mask[row, column]:
            _nearer(rows, columns, squares, row, column, row, column + 1)


@small_kernel
def _nearer(rows, columns, squares, row, column, from_row, from_column):  # type: ignore[no-untyped-def]
    if rows[from_row, from_column] >= 0:
        square = _square(rows, columns, row, column, from_row, from_column)
        if square < squares[column]:
            squares[column] = square
            rows[row, column], columns[row, column] = rows[from_row, from_column], columns[from_row, from_column]


@small_kernel
def _square(rows, columns, row, column, from_row, from_column):  # type: ignore[no-untyped-def]
    down, along = rows[from_row, from_column] - row, columns[from_row, from_column] - column
    return down * down + along * along


@kernel
def ray_directions(
    height: int, width: int, rotation: Float64[Array, "3 3"], intrinsics: Float64[Array, " 4"]
) -> Float64[Array, "h w 3"]:
    """Unit directions through all pixels, world frame. `rotation`: of camera_from_world."""
    rays = np.empty((height, width, 3))
    for row in range(height):
        y = (row - intrinsics[3]) / intrinsics[1]
        for column in range(width):
            x = (column - intrinsics[2]) / intrinsics[0]
            length = np.sqrt(1.0 + x * x + y * y)
            for axis in range(3):
                rays[row, column, axis] = (x * rotation[0, axis] + y * rotation[1, axis] + rotation[2, axis]) / length
    return rays


@kernel
def camera_points(
    range_mm: Float32[Array, "h w"], known: Bool[Array, "h w"], intrinsics: Float64[Array, " 4"]
) -> Float32[Array, "h w 3"]:
    """Points of the known elements, camera frame, mm. NaN elsewhere."""
    points = np.full((*known.shape, 3), np.float32(np.nan))
    for row in range(known.shape[0]):
        y = (row - intrinsics[3]) / intrinsics[1]
        for column in range(known.shape[1]):
            if known[row, column]:
                x = (column - intrinsics[2]) / intrinsics[0]
                depth = range_mm[row, column] / np.sqrt(1.0 + x * x + y * y)
                points[row, column, 0], points[row, column, 1] = x * depth, y * depth
                points[row, column, 2] = depth
    return points


@kernel
def valid_points(
    range_mm: Float32[Array, "h w"],
    valid: Bool[Array, "h w"],
    rotation: Float64[Array, "3 3"],
    centre: Float64[Array, " 3"],
    intrinsics: Float64[Array, " 4"],
) -> Float64[Array, "n 3"]:
    """Points of the valid elements, in row order, world frame, mm."""
    points = np.empty((valid.sum(), 3))
    count = 0
    for row in range(valid.shape[0]):
        y = (row - intrinsics[3]) / intrinsics[1]
        for column in range(valid.shape[1]):
            if valid[row, column]:
                x = (column - intrinsics[2]) / intrinsics[0]
                scale = range_mm[row, column] / np.sqrt(1.0 + x * x + y * y)
                for axis in range(3):
                    points[count, axis] = centre[axis] + scale * (
                        x * rotation[0, axis] + y * rotation[1, axis] + rotation[2, axis]
                    )
                count += 1
    return points


@kernel
def ray_gaps(
    points: Float64[Array, "n 3"],
    rotation: Float64[Array, "3 3"],
    translation: Float64[Array, " 3"],
    intrinsics: Float64[Array, " 4"],
    range_mm: Float32[Array, "h w"],
    valid: Bool[Array, "h w"],
    jump_mm: float,
) -> Float64[Array, " n"]:
    """Seen range minus distance of each point, mm. NaN without a datum. See `visibility.gap_mm`."""
    height, width = valid.shape
    gaps = np.full(len(points), np.nan)
    for i in range(len(points)):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        xc = rotation[0, 0] * x + rotation[0, 1] * y + rotation[0, 2] * z + translation[0]
        yc = rotation[1, 0] * x + rotation[1, 1] * y + rotation[1, 2] * z + translation[1]
        zc = rotation[2, 0] * x + rotation[2, 1] * y + rotation[2, 2] * z + translation[2]
        if not zc > 0.0:
            continue
        u = intrinsics[0] * xc / zc + intrinsics[2]
        v = intrinsics[1] * yc / zc + intrinsics[3]
        if not (u > -0.5 and v > -0.5 and u < width - 0.5 and v < height - 0.5):
            continue
        column, row = int(np.rint(u)), int(np.rint(v))
        if not valid[row, column]:
            continue
        seen = float(range_mm[row, column])
        left, top = min(max(int(np.floor(u)), 0), width - 2), min(max(int(np.floor(v)), 0), height - 2)
        if left >= 0 and top >= 0:
            smooth = valid[top, left] and valid[top, left + 1] and valid[top + 1, left] and valid[top + 1, left + 1]
            if smooth:
                r00, r01 = float(range_mm[top, left]), float(range_mm[top, left + 1])
                r10, r11 = float(range_mm[top + 1, left]), float(range_mm[top + 1, left + 1])
                if max(max(r00, r01), max(r10, r11)) - min(min(r00, r01), min(r10, r11)) < jump_mm:
                    du, dv = u - left, v - top
                    seen = (1 - dv) * ((1 - du) * r00 + du * r01) + dv * ((1 - du) * r10 + du * r11)
        gaps[i] = seen - np.sqrt(xc * xc + yc * yc + zc * zc)
    return gaps


@kernel
def resampled(
    image: Float32[Array, "a b"], places: Float64[Array, "n m 2"], height: int, width: int
) -> Float32[Array, "h w"]:
    """Values of an image at positions (row, column) given on a coarse grid, bilinear. 0 outside the image.

    The grid's ends are those of the result.
    """
    result = np.zeros((height, width), dtype=np.float32)
    place_rows, place_columns = places[..., 0], places[..., 1]
    for row in range(height):
        y = row * (places.shape[0] - 1) / max(height - 1, 1)
        i = min(int(y), places.shape[0] - 2)
        for column in range(width):
            x = column * (places.shape[1] - 1) / max(width - 1, 1)
            j = min(int(x), places.shape[1] - 2)
            r, c = _between_four(place_rows, i, j, y - i, x - j), _between_four(place_columns, i, j, y - i, x - j)
            if r >= 0.0 and c >= 0.0 and r <= image.shape[0] - 1 and c <= image.shape[1] - 1:
                top, left = min(int(r), image.shape[0] - 2), min(int(c), image.shape[1] - 2)
                result[row, column] = _between_four(image, top, left, r - top, c - left)
    return result


@kernel
def _between_four(image, row, column, down, along):  # type: ignore[no-untyped-def]
    return (1.0 - down) * ((1.0 - along) * image[row, column] + along * image[row, column + 1]) + down * (
        (1.0 - along) * image[row + 1, column] + along * image[row + 1, column + 1]
    )


@kernel
def outline_distances(
    inside: Bool[Array, "h w"], starts: Float64[Array, "n 2"], steps: Float64[Array, "n 2"], band: float
) -> Float32[Array, "h w"]:
    """Signed distance of every pixel from an outline, px, negative inside. There must be an outline.

    Within `band` it is exact, from the nearest of the outline's short straight pieces (row, column). Farther away it is
    the distance from the nearest pixel on either side of the outline, plus or minus half a pixel.
    """
    height, width = inside.shape
    squares = np.full((height, width), np.float32(np.inf))
    for piece in range(len(starts)):
        r, c, dr, dc = starts[piece, 0], starts[piece, 1], steps[piece, 0], steps[piece, 1]
        length2 = max(dr * dr + dc * dc, 1e-12)
        top, bottom = max(int(np.ceil(min(r, r + dr) - band)), 0), min(int(max(r, r + dr) + band), height - 1)
        left, right = max(int(np.ceil(min(c, c + dc) - band)), 0), min(int(max(c, c + dc) + band), width - 1)
        for row in range(top, bottom + 1):
            for column in range(left, right + 1):
                along = min(max(((row - r) * dr + (column - c) * dc) / length2, 0.0), 1.0)
                down, across = row - r - along * dr, column - c - along * dc
                squares[row, column] = min(squares[row, column], np.float32(down * down + across * across))
    edge = np.zeros((height, width), dtype=np.bool_)
    for row in range(height):
        for column in range(width):
            if row > 0 and inside[row, column] != inside[row - 1, column]:
                edge[row, column] = edge[row - 1, column] = True
            if column > 0 and inside[row, column] != inside[row, column - 1]:
                edge[row, column] = edge[row, column - 1] = True
    rows, columns = nearest_true(edge)
    for row in range(height):
        for column in range(width):
            if squares[row, column] <= band * band:
                distance = np.sqrt(squares[row, column])
            else:
                i, j = rows[row, column], columns[row, column]
                distance = np.sqrt(np.float32((row - i) ** 2 + (column - j) ** 2))
                distance += np.float32(0.5 if inside[i, j] == inside[row, column] else -0.5)
            squares[row, column] = -distance if inside[row, column] else distance
    return squares


@kernel
def spans(
    range_mm: Float32[Array, "h w"],
    valid: Bool[Array, "h w"],
    subject: Bool[Array, "h w"],
    others_mm: Float32[Array, "H W"],
    block_px: int,
    slope_px: int,
    least_jump_mm: float,
    tolerance_mm: float,
) -> Float32[Array, "h w"]:
    """Ranges of assumed surfaces that span gaps between near and far skin, mm. 0 elsewhere.

    Spans are along rows and columns, between two data with only the subject between them. The span continues the nearer
    skin with its slope and bends evenly to meet the farther one. Where a row and a column both span a pixel, the
    shorter span has more weight. If other views measured something in front of the span, the skin is hidden by another
    object, and the line has no span.

    Args:
        range_mm: range of each pixel.
        valid: pixels with a datum.
        subject: pixels on the subject.
        others_mm: range of the nearest datum of other views in each block of pixels, infinite without one.
        block_px: side of a block.
        slope_px: distance over which the nearer skin's slope is measured.
        least_jump_mm: least difference of the two sides' ranges.
        tolerance_mm: largest distance of other views' data in front of a span.
    """
    height, width = valid.shape
    total, weight = np.zeros((height, width)), np.zeros((height, width))
    for axis in range(2):
        for line in range(height if axis == 0 else width):
            ranges = range_mm[line] if axis == 0 else range_mm[:, line]
            known = valid[line] if axis == 0 else valid[:, line]
            on = subject[line] if axis == 0 else subject[:, line]
            others = others_mm[line // block_px] if axis == 0 else others_mm[:, line // block_px]
            last = -1
            for at in range(len(ranges)):
                if known[at]:
                    if last >= 0 and at - last > 1 and abs(ranges[at] - ranges[last]) > least_jump_mm:
                        span = _parabola(ranges, known, last, at, slope_px)
                        agrees = True
                        for between in range(last + 1 + block_px, at - block_px):  # not the gap's own sides
                            if others[between // block_px] < span[between - last - 1] - tolerance_mm:
                                agrees = False
                        for between in range(last + 1, at if agrees else last + 1):
                            row, column = (line, between) if axis == 0 else (between, line)
                            total[row, column] += span[between - last - 1] / (at - last)
                            weight[row, column] += 1.0 / (at - last)
                    last = at
                elif not on[at]:
                    last = -1
    found = np.zeros((height, width), dtype=np.float32)
    for row in range(height):
        for column in range(width):
            if weight[row, column] > 0.0:
                found[row, column] = total[row, column] / weight[row, column]
    return found


@kernel
def _parabola(
    ranges: Float32[Array, " n"], known: Bool[Array, " n"], last: int, at: int, slope_px: int
) -> Float64[Array, " k"]:
    """Ranges between two data of a line: the nearer one's slope, bent evenly to meet the farther one."""
    near, far, inward = (last, at, -1) if ranges[last] < ranges[at] else (at, last, 1)
    start = np.float64(ranges[near])
    chord = (np.float64(ranges[far]) - start) / (at - last)
    back = near + inward * slope_px
    slope = 0.0
    if 0 <= back < len(ranges) and known[back]:
        slope = min(max((start - np.float64(ranges[back])) / slope_px, 0.0), chord)
    away = np.abs(np.arange(last + 1, at) - near)
    return start + slope * away + (chord - slope) * away * away / (at - last)
