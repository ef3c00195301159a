"""Compiled kernels of semi-global matching (Hirschmüller 2008), the start of every match.

As those of `correlate` they release the interpreter's lock and have NumPy twins in the tests.
"""

import numpy as np

from mammometry.compiled import fast_kernel
from mammometry.geometry.arrays import Array, Bool, Float32, UInt8, UInt16

COSTS_TO_ONE = 100
"""Costs are whole hundredths: a byte holds them, and sixteen bits hold the sum of all paths. Memory is what limits the
level on which a match can start."""


@fast_kernel
def matching_costs(
    here: Float32[Array, "h w n"],
    there: Float32[Array, "h w n"],
    here_mask: Bool[Array, "h w"],
    there_mask: Bool[Array, "h w"],
    lowest: int,
    count: int,
    outside: float,
) -> UInt8[Array, "h w d"]:
    """1 − product of the neighbourhoods (unit vectors) for the shifts lowest … lowest + count − 1, in hundredths.

    `outside` is the cost of a partner that is not the subject.
    """
    height, width = here_mask.shape
    costs = np.empty((height, width, count), dtype=np.uint8)
    unit, half = np.float32(COSTS_TO_ONE), np.float32(0.5)
    no_partner = np.uint8(unit * np.float32(outside) + half)
    for i in range(height):
        for j in range(width):
            for d in range(count):
                partner = j + lowest + d
                if not here_mask[i, j]:
                    costs[i, j, d] = 0
                elif partner < 0 or partner >= width or not there_mask[i, partner]:
                    costs[i, j, d] = no_partner
                else:
                    total = np.float32(0.0)
                    for k in range(here.shape[2]):
                        total += here[i, j, k] * there[i, partner, k]
                    costs[i, j, d] = np.uint8(max(unit * (np.float32(1.0) - total) + half, np.float32(0.0)))
    return costs


@fast_kernel
def aggregate(
    costs: UInt8[Array, "h w d"], mask: Bool[Array, "h w"], small_step: int, large_step: int
) -> UInt16[Array, "h w d"]:
    """Sum of the costs along eight paths that end at each pixel (semi-global matching, Hirschmüller 2008).

    A change of the shift by one pixel costs `small_step`, by more `large_step`; all in hundredths. Paths do not cross
    what is not masked.
    """
    height, width, count = costs.shape
    total = np.zeros((height, width, count), dtype=np.uint16)
    p1 = np.float32(small_step)
    p2 = np.float32(large_step)
    far = np.float32(1e6)
    for backward in range(2):
        # Paths from the row above (left, middle, right) and from the pixel before; padded by one disparity each side.
        above = np.full((3, width + 2, count + 2), far, dtype=np.float32)
        above_least = np.full((3, width + 2), np.float32(-1.0), dtype=np.float32)
        current = np.full((3, width + 2, count + 2), far, dtype=np.float32)
        current_least = np.full((3, width + 2), np.float32(-1.0), dtype=np.float32)
        before = np.full(count + 2, far, dtype=np.float32)
        updated = np.full(count + 2, far, dtype=np.float32)
        for ii in range(height):
            i = height - 1 - ii if backward else ii
            before_least = np.float32(-1.0)
            for jj in range(width):
                j = width - 1 - jj if backward else jj
                if not mask[i, j]:
                    before_least = np.float32(-1.0)
                    for path in range(3):
                        current_least[path, jj + 1] = np.float32(-1.0)
                    continue
                for path in range(4):
                    if path < 3:
                        previous = above[path, jj + path]
                        least = above_least[path, jj + path]
                        target = current[path, jj + 1]
                    else:
                        previous = before
                        least = before_least
                        target = updated
                    smallest = far
                    if least < 0:
                        for d in range(count):
                            value = np.float32(costs[i, j, d])
                            target[d + 1] = value
                            total[i, j, d] += np.uint16(value)
                            smallest = min(smallest, value)
                    else:
                        jump = least + p2
                        for d in range(count):
                            value = min(min(previous[d], previous[d + 2]) + p1, min(previous[d + 1], jump))
                            value += np.float32(costs[i, j, d]) - least
                            target[d + 1] = value
                            total[i, j, d] += np.uint16(value)
                            smallest = min(smallest, value)
                    if path < 3:
                        current_least[path, jj + 1] = smallest
                    else:
                        before_least = smallest
                before, updated = updated, before
            above, current = current, above
            above_least, current_least = current_least, above_least
    return total


@fast_kernel
def cheapest(
    total: UInt16[Array, "h w d"], mask: Bool[Array, "h w"], lowest: int
) -> tuple[Float32[Array, "h w"], Float32[Array, "h w"]]:
    """Shift of least cost seen from this image and, along the diagonals of the same volume, from the other one.

    Sub-pixel by a parabola for this image; NaN-free: where nothing competes the shift is that of the range's middle.
    """
    height, width, count = total.shape
    middle = np.float32(lowest + count // 2)
    ours = np.full((height, width), middle, dtype=np.float32)
    theirs = np.full((height, width), -middle, dtype=np.float32)
    for i in range(height):
        best = np.full(width, np.float32(1e9), dtype=np.float32)  # of each pixel of the other image
        for j in range(width):
            if not mask[i, j]:
                continue
            least = np.float32(1e9)
            at = 0
            for d in range(count):
                value = np.float32(total[i, j, d])
                if value < least:
                    least = value
                    at = d
                partner = j + lowest + d
                if 0 <= partner < width and value < best[partner]:
                    best[partner] = value
                    theirs[i, partner] = -np.float32(lowest + d)
            offset = np.float32(0.0)
            if 0 < at < count - 1:
                low, high = np.float32(total[i, j, at - 1]), np.float32(total[i, j, at + 1])
                bend = low + high - np.float32(2.0) * least
                if bend > np.float32(1e-6):
                    offset = np.float32(0.5) * (low - high) / bend
            ours[i, j] = np.float32(lowest + at) + offset
    return ours, theirs
