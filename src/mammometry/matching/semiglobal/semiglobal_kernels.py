"""Compiled kernels of semi-global matching (Hirschmüller 2008), the start of every match.

As those of `correlate` they release the interpreter's lock and have NumPy twins in the tests.
"""

import numpy as np

from mammometry.base.machine.compiled import fast_kernel, kernel
from mammometry.geometry.arrays import Array, Bool, Float32, UInt8, UInt16

COSTS_TO_ONE = 100
"""Costs are whole hundredths: a byte holds them, and sixteen bits hold the sum of all paths. Memory limits the level on
which a match can start.
"""


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
    """Cost of each of `count` shifts from `lowest`, in hundredths.

    1 − the product of the neighbourhoods, which are unit vectors. `outside` is the cost of a partner that is not the
    subject.
    """
    height, width = here_mask.shape
    length = here.shape[2]
    costs = np.zeros((height, width, count), dtype=np.uint8)
    unit, half = np.float32(COSTS_TO_ONE), np.float32(0.5)
    no_partner = np.uint8(unit * np.float32(outside) + half)
    partners = np.empty((length, width), dtype=np.float32)  # of one row: neighbouring shifts lie side by side
    products = np.empty(count, dtype=np.float32)
    for i in range(height):
        for j in range(width):
            for k in range(length):
                partners[k, j] = there[i, j, k]
        for j in range(width):
            if not here_mask[i, j]:
                continue
            first, last = max(0, -j - lowest), min(count, width - j - lowest)  # shifts whose partner is in the picture
            line = costs[i, j]
            line[:] = no_partner
            if first >= last:
                continue
            total = products[: last - first]
            total[:] = np.float32(0.0)
            for k in range(length):
                value = here[i, j, k]
                other = partners[k, j + lowest + first : j + lowest + last]
                for d in range(last - first):
                    total[d] += value * other[d]
            for d in range(first, last):
                if there_mask[i, j + lowest + d]:
                    line[d] = np.uint8(max(unit * (np.float32(1.0) - products[d - first]) + half, np.float32(0.0)))
    return costs


@kernel
def _along_path(previous, least, costs, small, large, target, total):  # type: ignore[no-untyped-def]
    """Costs of all shifts along one path at one pixel.

    Also added to `total`. Returns the least of them. `previous` and `target` have one shift more on either side. All is
    of 16 bits, of which a processor adds sixteen numbers at once; so no `min`, which would widen them.
    """
    jump, smallest = np.uint16(least + large), np.uint16(65535)
    for d in range(costs.shape[0]):
        lower, same, higher = previous[d], previous[d + 1], previous[d + 2]
        beside = np.uint16((lower if lower < higher else higher) + small)
        same = same if same < jump else jump
        value = np.uint16(np.uint16((beside if beside < same else same) + np.uint16(costs[d])) - least)
        target[d + 1] = value
        total[d] = np.uint16(total[d] + value)
        smallest = value if value < smallest else smallest
    return smallest


@fast_kernel
def aggregate(
    costs: UInt8[Array, "h w d"], mask: Bool[Array, "h w"], small_step: int, large_step: int
) -> UInt16[Array, "h w d"]:
    """Sum of the costs along eight paths ending at each pixel.

    Semi-global matching, Hirschmüller 2008. A change of the shift by one pixel costs `small_step`, by more
    `large_step`, all in hundredths. Paths do not cross unmasked pixels.
    """
    height, width, count = costs.shape
    total = np.zeros((height, width, count), dtype=np.uint16)
    small, large = np.uint16(small_step), np.uint16(large_step)
    last, nothing, never = count + 1, np.uint16(0), np.uint16(30_000)
    for backward in range(2):
        # Paths from the row above (left, middle, right) and from the pixel before. One starts with nothing behind it:
        # zeros between two shifts that are never taken.
        above = np.full((3, width + 2, count + 2), never)
        above[:, :, 1:last] = nothing
        current = above.copy()
        above_least = np.zeros((3, width + 2), dtype=np.uint16)
        current_least = np.zeros((3, width + 2), dtype=np.uint16)
        before, updated = np.full(count + 2, never), np.full(count + 2, never)
        for ii in range(height):
            i = height - 1 - ii if backward else ii
            before[1:last] = nothing
            before_least = nothing
            for jj in range(width):
                j = width - 1 - jj if backward else jj
                if not mask[i, j]:
                    before[1:last] = nothing
                    before_least = nothing
                    current[:, jj + 1, 1:last] = nothing
                    current_least[:, jj + 1] = nothing
                    continue
                line, sums = costs[i, j], total[i, j]
                for path in range(3):
                    current_least[path, jj + 1] = _along_path(
                        above[path, jj + path], above_least[path, jj + path], line, small, large,
                        current[path, jj + 1], sums,
                    )  # fmt: skip
                before_least = _along_path(before, before_least, line, small, large, updated, sums)
                before, updated = updated, before
            above, current = current, above
            above_least, current_least = current_least, above_least
    return total


@fast_kernel
def cheapest(
    total: UInt16[Array, "h w d"], mask: Bool[Array, "h w"], lowest: int
) -> tuple[Float32[Array, "h w"], Float32[Array, "h w"]]:
    """Shift of least cost, seen from either image.

    From the other one along the diagonals of the same volume. Sub-pixel by a parabola for this image; NaN-free: where
    nothing competes the shift is that of the range's middle.
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
