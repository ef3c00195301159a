"""Compiled kernels of the first surface: the solid's signed distance at millions of cube corners.

Their plain NumPy twins stand in tests/unit/surface/.
"""

import numpy as np

from mammometry.base.compiled import kernel
from mammometry.geometry.arrays import Array, Bool, Float32, Float64, Int32
from mammometry.surface.image_kernels import incidence_cosine

RULE_DEFAULT, RULE_NEAREST, RULE_FURTHEST, RULE_TSDF = 0, 1, 2, 3

# Columns of `view_table` and `contour_table`: rotation (9), translation (3), fx, fy, cx, cy, then k1, k2, p1, p2, k3,
# width, height and the index of the image's first pixel in the flat pixel array.
TABLE_COLUMNS = 24

_LEAST_COSINE, _UNKNOWN_COSINE = 0.1, 0.5
# A tangent plane seen edge-on runs away: it is held within the slope that one pixel a pixel at 80° gives.
_STEEPEST = 6.0

# A block's picture is at most so much wider than that of a ball around it without lens distortion.
_DISTORTION = 1.5


@kernel
def sample_field(
    origins: Float64[Array, "n 3"],
    side: int,
    spacing: float,
    views: Float64[Array, "v 24"],
    elements: Float32[Array, "p 3"],
    contours: Float64[Array, "c 24"],
    distances: Float32[Array, " q"],
    planes: Float64[Array, "f 4"],
    truncation: float,
    jump: float,
    rule: int,
) -> Float32[Array, "n s s s"]:
    """Signed distance, mm, positive outside, cut to ±truncation, at the corners of n blocks of side³ samples.

    `elements`: range, cosine of incidence, weight per pixel of every view; weight > 0 measured, −w extrapolated with
    weight w (no claim on free space), 0 with a range: filled, it only supports what lies behind it; range 0: nothing.
    `distances`: pixels from the silhouette, positive outside. `planes`: n·x − d, positive outside.

    Source by source, for all samples of a block; silhouettes that are too far from a block to tell are skipped.
    """
    n, samples = origins.shape[0], side * side * side
    reach = 0.5 * np.sqrt(3.0) * (side - 1) * spacing
    out = np.empty((n, samples), dtype=np.float32)
    for block in range(n):
        x, y, z = origins[block, 0], origins[block, 1], origins[block, 2]
        bound = np.empty(samples)
        for index in range(samples):
            i, j, k = index // (side * side), (index // side) % side, index % side
            value = -truncation
            for f in range(planes.shape[0]):
                value = max(
                    value,
                    planes[f, 0] * (x + i * spacing)
                    + planes[f, 1] * (y + j * spacing)
                    + planes[f, 2] * (z + k * spacing)
                    - planes[f, 3],
                )
            bound[index] = value
        outside = bound.min() >= truncation
        middle = 0.5 * (side - 1) * spacing
        for c in range(contours.shape[0]):
            if outside:
                break
            table = contours[c]
            told = _told(table, distances, x + middle, y + middle, z + middle, reach, truncation)
            if told > 0:
                outside = True
            elif told == 0:
                outside = _bound_by_silhouette(table, distances, x, y, z, side, spacing, truncation, bound)
        if outside:
            out[block] = truncation
            continue

        total = np.zeros(samples)
        weights = np.zeros(samples)
        free = np.zeros(samples, dtype=np.bool_)
        supported = np.zeros(samples, dtype=np.bool_)
        if rule == RULE_NEAREST:
            total[:] = np.inf
        elif rule == RULE_FURTHEST:
            total[:] = -np.inf
        for w in range(views.shape[0]):
            _ask_view(
                views[w], elements, x, y, z, side, spacing, truncation, jump, rule, total, weights, free, supported
            )
        for index in range(samples):
            measured = -truncation
            if rule == RULE_DEFAULT:
                if weights[index] > 0.0:
                    measured = total[index] / weights[index]
                elif free[index] or not supported[index]:
                    measured = truncation
            elif rule == RULE_TSDF:
                if weights[index] > 0.0:
                    measured = total[index] / weights[index]
                elif not supported[index]:
                    measured = truncation
            elif np.isfinite(total[index]):
                measured = total[index]
            elif not supported[index]:
                measured = truncation
            out[block, index] = min(max(bound[index], measured), truncation)
    return out.reshape(n, side, side, side)


@kernel
def _pixel(table, xc, yc, zc):  # type: ignore[no-untyped-def]
    """Column and row of a point in the camera's frame; column −1 where it is not in the picture. Without branches."""
    inverse = 1.0 / max(zc, 1.0)
    xn, yn = xc * inverse, yc * inverse
    r2 = xn * xn + yn * yn
    radial = 1.0 + r2 * (table[16] + r2 * (table[17] + r2 * table[20]))
    u = table[12] * (xn * radial + 2.0 * table[18] * xn * yn + table[19] * (r2 + 2.0 * xn * xn)) + table[14]
    v = table[13] * (yn * radial + table[18] * (r2 + 2.0 * yn * yn) + 2.0 * table[19] * xn * yn) + table[15]
    inside = (zc > 1.0) & (r2 <= 4.0) & (u >= 0.0) & (v >= 0.0) & (u < table[21] - 1.0) & (v < table[22] - 1.0)
    return (u if inside else -1.0), v


@kernel
def _between(image, start, width, u, v):  # type: ignore[no-untyped-def]
    """Bilinear value of a flat image at a place inside it."""
    column, row = int(u), int(v)
    du, dv = u - column, v - row
    at = start + row * width + column
    return (1.0 - dv) * ((1.0 - du) * image[at] + du * image[at + 1]) + dv * (
        (1.0 - du) * image[at + width] + du * image[at + width + 1]
    )


@kernel
def _told(
    table: Float64[Array, " 24"],
    distances: Float32[Array, " q"],
    x: float,
    y: float,
    z: float,
    reach: float,
    truncation: float,
) -> int:
    """What a silhouette says of all points within reach of one: 1 far outside, −1 far inside, 0 it depends.

    Its distances change by one pixel a pixel at most.
    """
    depth = table[6] * x + table[7] * y + table[8] * z + table[11]
    if depth <= reach + 1.0:
        return 0
    xc = table[0] * x + table[1] * y + table[2] * z + table[9]
    yc = table[3] * x + table[4] * y + table[5] * z + table[10]
    u, v = _pixel(table, xc, yc, depth)
    radius = _DISTORTION * max(table[12], table[13]) * reach / (depth - reach)
    if not (u >= radius and v >= radius and u + radius < table[21] - 1.0 and v + radius < table[22] - 1.0):
        return 0
    pixels = _between(distances, int(table[23]), int(table[21]), u, v)
    limit = truncation * table[12] / (depth - reach)
    if pixels - radius > limit:
        return 1
    return -1 if pixels + radius < -limit else 0


@kernel
def _bound_by_silhouette(
    table: Float64[Array, " 24"],
    distances: Float32[Array, " q"],
    x: float,
    y: float,
    z: float,
    side: int,
    spacing: float,
    truncation: float,
    bound: Float64[Array, " k"],
) -> bool:
    """Raise `bound` to a silhouette's pixel distances times a pixel's size at each depth; whether all is outside."""
    start, width = int(table[23]), int(table[21])
    u, v, depth = np.empty_like(bound), np.empty_like(bound), np.empty_like(bound)
    _seen_at(table, x, y, z, side, spacing, u, v, depth, np.empty_like(bound))
    outside = True
    for index in range(len(bound)):
        if u[index] >= 0.0:
            pixels = _between(distances, start, width, u[index], v[index])
            bound[index] = max(bound[index], pixels * depth[index] / table[12])
        outside = outside and bound[index] >= truncation
    return outside


@kernel
def _ask_view(
    table: Float64[Array, " 24"],
    elements: Float32[Array, "p 3"],
    x: float,
    y: float,
    z: float,
    side: int,
    spacing: float,
    truncation: float,
    jump: float,
    rule: int,
    total: Float64[Array, " k"],
    weights: Float64[Array, " k"],
    free: Array,
    supported: Array,
) -> None:
    """Add what one view says of a block's samples; `total` holds the extreme itself under the paper's two rules."""
    start, width = int(table[23]), int(table[21])
    u, v, distance = np.empty_like(total), np.empty_like(total), np.empty_like(total)
    _seen_at(table, x, y, z, side, spacing, u, v, np.empty_like(total), distance)
    for index in range(len(total)):
        if u[index] < 0.0:
            continue
        column, row = int(u[index]), int(v[index])
        du, dv = u[index] - column, v[index] - row
        at = start + row * width + column
        r00, r01 = elements[at, 0], elements[at + 1, 0]
        r10, r11 = elements[at + width, 0], elements[at + width + 1, 0]
        near = min(min(r00, r01), min(r10, r11))
        far = max(max(r00, r01), max(r10, r11))
        nearest = at + (1 if du >= 0.5 else 0) + (width if dv >= 0.5 else 0)
        if near > 0.0 and far - near < jump:
            seen = (1.0 - dv) * ((1.0 - du) * r00 + du * r01) + dv * ((1.0 - du) * r10 + du * r11)
        else:
            seen = np.float64(elements[nearest, 0])
        if seen <= 0.0:
            continue
        weight = elements[nearest, 2]
        gap = (seen - distance[index]) * elements[nearest, 1]
        if gap < truncation:
            supported[index] = True
        if weight == 0.0:
            continue
        if rule == RULE_NEAREST:
            total[index] = min(total[index], gap)
        elif rule == RULE_FURTHEST:
            total[index] = max(total[index], gap)
        elif rule == RULE_TSDF:
            if gap > -truncation:
                total[index] += abs(weight) * min(gap, truncation)
                weights[index] += abs(weight)
        elif abs(gap) < truncation:
            total[index] += abs(weight) * gap
            weights[index] += abs(weight)
        elif gap > 0.0 and weight > 0.0:
            free[index] = True


@kernel
def _seen_at(
    table: Float64[Array, " 24"],
    x: float,
    y: float,
    z: float,
    side: int,
    spacing: float,
    u: Float64[Array, " k"],
    v: Float64[Array, " k"],
    depth: Float64[Array, " k"],
    distance: Float64[Array, " k"],
) -> None:
    """Fill in column (−1 where not in the picture), row, depth and distance of a block's samples; many at once."""
    sx, sy, sz = table[2] * spacing, table[5] * spacing, table[8] * spacing
    for i in range(side):
        for j in range(side):
            xi, yj = x + i * spacing, y + j * spacing
            x0 = table[0] * xi + table[1] * yj + table[2] * z + table[9]
            y0 = table[3] * xi + table[4] * yj + table[5] * z + table[10]
            z0 = table[6] * xi + table[7] * yj + table[8] * z + table[11]
            first = (i * side + j) * side
            for k in range(side):
                xc, yc, zc = x0 + k * sx, y0 + k * sy, z0 + k * sz
                u[first + k], v[first + k] = _pixel(table, xc, yc, zc)
                depth[first + k] = zc
                distance[first + k] = np.sqrt(xc * xc + yc * yc + zc * zc)


@kernel
def empty_cells(
    points: Float64[Array, "n 3"], origin: Float64[Array, " 3"], edge_mm: float, shape: tuple[int, int, int]
) -> Bool[Array, "x y z"]:
    """Cells of a grid that hold none of the points; points outside the grid do not count."""
    empty = np.ones(shape, dtype=np.bool_)
    for point in points:
        i = int(np.floor((point[0] - origin[0]) / edge_mm))
        j = int(np.floor((point[1] - origin[1]) / edge_mm))
        k = int(np.floor((point[2] - origin[2]) / edge_mm))
        if 0 <= i < shape[0] and 0 <= j < shape[1] and 0 <= k < shape[2]:
            empty[i, j, k] = False
    return empty


@kernel
def view_elements(
    range_mm: Float32[Array, "h w"],
    valid: Bool[Array, "h w"],
    sigma_mm: Float32[Array, "h w"],
    trust: Float32[Array, "h w"],
    normals: Float32[Array, "h w 3"],
    rows: Int32[Array, "h w"],
    columns: Int32[Array, "h w"],
    subject: Bool[Array, "h w"],
    intrinsics: Float64[Array, " 4"],
    pixel_mm: float,
    extend_mm: float,
    extend_weight: float,
    sigma_floor_mm: float,
) -> Float32[Array, "h w 3"]:
    """What one range image says at each pixel, as `sample_field` reads it; see `field.view_elements`.

    `normals`: camera frame; `rows`, `columns`: the nearest datum with a normal, −1 where there is none at all.
    """
    height, width = valid.shape
    elements = np.zeros((height, width, 3), dtype=np.float32)
    for row in range(height):
        y = (row - intrinsics[3]) / intrinsics[1]
        for column in range(width):
            x = (column - intrinsics[2]) / intrinsics[0]
            i, j = rows[row, column], columns[row, column]
            if valid[row, column]:
                cosine = _clipped(incidence_cosine(normals[row, column], x, y))
                variance = sigma_mm[row, column] ** 2 + sigma_floor_mm**2
                elements[row, column, 0] = range_mm[row, column]
                elements[row, column, 1] = cosine
                elements[row, column, 2] = cosine**2 * trust[row, column] / variance
            elif subject[row, column] and i >= 0:
                normal, nearest = normals[i, j], np.float64(range_mm[i, j])
                own = incidence_cosine(normal, (j - intrinsics[2]) / intrinsics[0], (i - intrinsics[3]) / intrinsics[1])
                cosine = _clipped(own)
                seen, weight = nearest, 0.0
                pixels = np.sqrt(float((i - row) ** 2 + (j - column) ** 2))
                if pixels * pixel_mm <= extend_mm:
                    here = incidence_cosine(normal, x, y)
                    continued = nearest * own / here if here != 0.0 else nearest
                    reach = _STEEPEST * pixel_mm * pixels
                    seen = min(max(continued if continued > 0.0 else nearest, nearest - reach), nearest + reach)
                    variance = sigma_mm[i, j] ** 2 + sigma_floor_mm**2
                    weight = -extend_weight * cosine**2 * trust[i, j] / variance
                elements[row, column, 0] = seen
                elements[row, column, 1] = cosine
                elements[row, column, 2] = weight
    return elements


@kernel
def _clipped(cosine):  # type: ignore[no-untyped-def]
    return min(max(cosine, _LEAST_COSINE), 1.0) if np.isfinite(cosine) else _UNKNOWN_COSINE
