"""Compiled kernel of the first surface: the solid's signed distance at millions of cube corners.

One kernel only, so that little is compiled; its plain NumPy twin stands in tests/unit/surface/.
"""

import numpy as np
from numba import njit, prange

from mammometry.geometry.arrays import Array, Float32, Float64

RULE_DEFAULT, RULE_NEAREST, RULE_FURTHEST, RULE_TSDF = 0, 1, 2, 3

# Columns of `view_table` and `contour_table`: rotation (9), translation (3), fx, fy, cx, cy, then k1, k2, p1, p2, k3,
# width, height and the index of the image's first pixel in the flat pixel array.
TABLE_COLUMNS = 24


@njit(cache=True, parallel=True, fastmath=False)
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
    """
    n = origins.shape[0]
    out = np.empty((n, side, side, side), dtype=np.float32)
    for block in prange(n):
        for index in range(side * side * side):
            i, j, k = index // (side * side), (index // side) % side, index % side
            x = origins[block, 0] + i * spacing
            y = origins[block, 1] + j * spacing
            z = origins[block, 2] + k * spacing
            value = -truncation
            for f in range(planes.shape[0]):
                value = max(value, planes[f, 0] * x + planes[f, 1] * y + planes[f, 2] * z - planes[f, 3])

            # Silhouettes: pixel distance times the size of a pixel at the sample's depth.
            for c in range(contours.shape[0]):
                if value >= truncation:
                    break
                table = contours[c]
                depth = table[6] * x + table[7] * y + table[8] * z + table[11]
                if depth <= 1.0:
                    continue
                xn = (table[0] * x + table[1] * y + table[2] * z + table[9]) / depth
                yn = (table[3] * x + table[4] * y + table[5] * z + table[10]) / depth
                r2 = xn * xn + yn * yn
                if r2 > 4.0:
                    continue
                radial = 1.0 + r2 * (table[16] + r2 * (table[17] + r2 * table[20]))
                xd = xn * radial + 2.0 * table[18] * xn * yn + table[19] * (r2 + 2.0 * xn * xn)
                yd = yn * radial + table[18] * (r2 + 2.0 * yn * yn) + 2.0 * table[19] * xn * yn
                u = table[12] * xd + table[14]
                v = table[13] * yd + table[15]
                width, height = int(table[21]), int(table[22])
                if not (u >= 0.0 and v >= 0.0 and u < width - 1 and v < height - 1):
                    continue
                column, row = int(u), int(v)
                du, dv = u - column, v - row
                at = int(table[23]) + row * width + column
                pixels = (1.0 - dv) * ((1.0 - du) * distances[at] + du * distances[at + 1]) + dv * (
                    (1.0 - du) * distances[at + width] + du * distances[at + width + 1]
                )
                value = max(value, pixels * depth / table[12])

            if value >= truncation:
                out[block, i, j, k] = truncation
                continue

            total = 0.0
            weights = 0.0
            free = False
            supported = False
            lowest = np.inf
            highest = -np.inf
            for w in range(views.shape[0]):
                table = views[w]
                xc = table[0] * x + table[1] * y + table[2] * z + table[9]
                yc = table[3] * x + table[4] * y + table[5] * z + table[10]
                zc = table[6] * x + table[7] * y + table[8] * z + table[11]
                if zc <= 1.0:
                    continue
                u = table[12] * xc / zc + table[14]
                v = table[13] * yc / zc + table[15]
                width, height = int(table[21]), int(table[22])
                if not (u >= 0.0 and v >= 0.0 and u < width - 1 and v < height - 1):
                    continue
                column, row = int(u), int(v)
                du, dv = u - column, v - row
                at = int(table[23]) + row * width + column
                r00, r01 = elements[at, 0], elements[at + 1, 0]
                r10, r11 = elements[at + width, 0], elements[at + width + 1, 0]
                near = min(min(r00, r01), min(r10, r11))
                far = max(max(r00, r01), max(r10, r11))
                nearest = at + (1 if du >= 0.5 else 0) + (width if dv >= 0.5 else 0)
                distance = np.sqrt(xc * xc + yc * yc + zc * zc)
                if near > 0.0 and far - near < jump:
                    seen = (1.0 - dv) * ((1.0 - du) * r00 + du * r01) + dv * ((1.0 - du) * r10 + du * r11)
                else:
                    seen = elements[nearest, 0]
                if seen <= 0.0:
                    continue
                cosine = elements[nearest, 1]
                weight = elements[nearest, 2]
                gap = (seen - distance) * cosine
                if gap < truncation:
                    supported = True
                if weight == 0.0:
                    continue
                lowest = min(lowest, gap)
                highest = max(highest, gap)
                if rule == RULE_TSDF:
                    if gap > -truncation:
                        total += abs(weight) * min(gap, truncation)
                        weights += abs(weight)
                elif abs(gap) < truncation:
                    total += abs(weight) * gap
                    weights += abs(weight)
                elif gap > 0.0 and weight > 0.0:
                    free = True
            measured = -truncation
            if rule == RULE_DEFAULT:
                if weights > 0.0:
                    measured = total / weights
                elif free or not supported:
                    measured = truncation
            elif rule == RULE_TSDF:
                if weights > 0.0:
                    measured = total / weights
                elif not supported:
                    measured = truncation
            elif rule == RULE_NEAREST:
                measured = lowest if np.isfinite(lowest) else (-truncation if supported else truncation)
            else:
                measured = highest if np.isfinite(highest) else (-truncation if supported else truncation)
            out[block, i, j, k] = min(max(value, measured), truncation)
    return out
