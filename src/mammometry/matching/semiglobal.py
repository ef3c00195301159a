"""Semi-global matching (Hirschmüller 2008), the start of every match on a coarse level.

The kernels release the GIL and have NumPy versions in the tests.
"""

from concurrent.futures import ThreadPoolExecutor

import numpy as np

from mammometry.base.machine.compiled import fast_kernel, kernel
from mammometry.base.machine.cores import in_bands
from mammometry.geometry.arrays import Array, Bool, Float32, UInt8, UInt16
from mammometry.matching.filters import blur, gaussian_taps
from mammometry.matching.noise import noise_variance
from mammometry.matching.pyramid import Level

COSTS_TO_ONE = 100
"""Costs are integer hundredths: they fit into a byte, and the sum of all paths into 16 bits. Memory limits the level on
which a match can start."""


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

    1 − the product of the neighbourhoods, which are unit vectors. `outside` is the cost of a match outside the subject.
    """
    height, width = here_mask.shape
    length = here.shape[2]
    costs = np.zeros((height, width, count), dtype=np.uint8)
    unit, half = np.float32(COSTS_TO_ONE), np.float32(0.5)
    no_partner = np.uint8(unit * np.float32(outside) + half)
    partners = np.empty((length, width), dtype=np.float32)  # one row: neighbouring shifts are contiguous
    products = np.empty(count, dtype=np.float32)
    for i in range(height):
        for j in range(width):
            for k in range(length):
                partners[k, j] = there[i, j, k]
        for j in range(width):
            if not here_mask[i, j]:
                continue
            first, last = max(0, -j - lowest), min(count, width - j - lowest)  # shifts whose match is in the image
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
    """Fill in the costs of all shifts along one path at a pixel, and return the smallest.

    They are also added to `total`. `previous` and `target` have one more shift on either side. Everything has 16 bits,
    of which a processor adds 16 numbers at once; `min` would widen them.
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

    Semi-global matching (Hirschmüller 2008). A change of the shift by one pixel costs `small_step`, by more
    `large_step`, all in hundredths. Paths do not cross unmasked pixels.
    """
    height, width, count = costs.shape
    total = np.zeros((height, width, count), dtype=np.uint16)
    small, large = np.uint16(small_step), np.uint16(large_step)
    last, nothing, never = count + 1, np.uint16(0), np.uint16(30_000)
    for backward in range(2):
        # Paths from the row above (left, middle, right) and from the pixel before. A path's first pixel has no
        # predecessor: it starts from zeros between two shifts that are never chosen.
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
    """Shift of lowest cost for either image.

    For this image it is refined by a parabola. For the other image it is found along the diagonals of the same volume.
    There is no NaN: where all costs are equal, the shift is that of the range's centre.
    """
    height, width, count = total.shape
    middle = np.float32(lowest + count // 2)
    ours = np.full((height, width), middle, dtype=np.float32)
    theirs = np.full((height, width), -middle, dtype=np.float32)
    for i in range(height):
        best = np.full(width, np.float32(1e9), dtype=np.float32)  # for each pixel of the other image
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


_SMALL_STEP, _LARGE_STEP = COSTS_TO_ONE // 4, COSTS_TO_ONE  # cost of a shift change by 1 px and by more
_OUTSIDE = 1.2  # cost of a match outside the subject; two unrelated neighbourhoods cost 1
_FAR_PX = 2  # spacing of the wider neighbourhood's pixels; the image is first smoothed with half of it
_POWER_PX = 1.5  # Gaussian σ over which a neighbourhood's variance is averaged: its own width
_GRAIN = 4.0  # factor on the measured noise: compression hides most; 4 to 8 gave equal results (docs/decisions/0015)
_FLAT = 1e-3  # standard deviation of luma (0…1) below which a neighbourhood weighs less: a quarter of an 8-bit step


def span_px(mask: Bool[Array, "h w"]) -> float:
    """The subject's size: side of a square with its area, px."""
    return float(np.sqrt(np.count_nonzero(mask)))


def start(
    left: Level, right: Level, noise: tuple[Float32[Array, "h w"], Float32[Array, "h w"]], range_share: float
) -> tuple[Float32[Array, "h w"], Float32[Array, "h w"]]:
    """Initial shifts of both directions, by semi-global matching.

    Right − left for the left image and left − right for the right one, pixels of this level. The search covers ±
    `range_share` of the subject's width around the shift between the two centroids. `noise` is the noise's variance
    around each pixel of either image.
    """
    columns = [np.nonzero(level.mask.any(axis=0))[0] for level in (left, right)]
    width = max(int(c[-1] - c[0] + 1) for c in columns)
    centres = [
        float(np.average(np.arange(level.mask.shape[1]), weights=level.mask.sum(axis=0))) for level in (left, right)
    ]
    reach = int(np.ceil(range_share * width))
    return _searched(left, right, noise, round(centres[1] - centres[0]) - reach, 2 * reach + 1)


def both_ways(
    left: Level, right: Level, lowest: int, count: int
) -> tuple[Float32[Array, "h w"], Float32[Array, "h w"]]:
    """Shifts of both directions, as in `start`, of two whole images.

    Right − left is one of `count` integers from `lowest` on, px. The noise is estimated from the images.
    """
    return _searched(left, right, (noise_variance(left, ()), noise_variance(right, ())), lowest, count)


def _searched(
    left: Level, right: Level, noise: tuple[Float32[Array, "h w"], Float32[Array, "h w"]], lowest: int, count: int
) -> tuple[Float32[Array, "h w"], Float32[Array, "h w"]]:
    with ThreadPoolExecutor(2) as pool:
        here, there = pool.map(_unit_neighbourhoods, (left, right), noise)

    def cost(rows: slice) -> UInt8[Array, "n w d"]:
        pictures = (here[rows], there[rows], left.mask[rows], right.mask[rows])
        return np.asarray(matching_costs(*pictures, lowest, count, _OUTSIDE))

    total = aggregate(np.concatenate(in_bands(cost, len(here))), left.mask, _SMALL_STEP, _LARGE_STEP)
    found = in_bands(lambda rows: cheapest(total[rows], left.mask[rows], lowest), len(total))
    return np.concatenate([ours for ours, _ in found]), np.concatenate([theirs for _, theirs in found])


def _unit_neighbourhoods(level: Level, noise: Float32[Array, "h w"]) -> Float32[Array, "h w 18"]:
    """Two neighbourhoods of each pixel, minus their means over the subject, with unit length together.

    0 outside the subject. The first has 3 × 3 adjacent pixels: a larger one does not fit on steep skin, which one image
    shows narrower than the other. Its weight is the share of its variance that is not noise. The rest is the weight of
    the second, of 3 × 3 pixels of the smoothed image at a spacing of two, for shaded skin, where the first one is
    mostly noise.
    """
    near, near_power = _neighbourhood(level.image, level.mask, 1)
    far, far_power = _neighbourhood(blur(level.image, gaussian_taps(_FAR_PX / 2)), level.mask, _FAR_PX)
    power = blur(near_power, gaussian_taps(_POWER_PX)) / 8  # nine values minus their mean: eight degrees of freedom
    share = np.clip(1 - _GRAIN * noise / np.maximum(power, 1e-12), 0, 1)
    near *= np.sqrt(share / (near_power + 9 * _FLAT**2))[..., None]
    far *= np.sqrt((1 - share) / (far_power + 9 * _FLAT**2))[..., None]
    return np.concatenate([near, far], axis=2, dtype=np.float32)


def _neighbourhood(
    image: Float32[Array, "h w"], mask: Bool[Array, "h w"], spacing: int
) -> tuple[Float32[Array, "h w 9"], Float32[Array, "h w"]]:
    """3 × 3 pixels with a spacing, minus the mean of the subject's, and the sum of their squares."""
    height, width = mask.shape
    padded = np.pad(image, spacing, mode="edge")
    subject = np.pad(mask, spacing).astype(np.float32)
    offsets = [(i * spacing, j * spacing) for i in range(3) for j in range(3)]
    values = np.stack([padded[i : i + height, j : j + width] for i, j in offsets], axis=2)
    weights = np.stack([subject[i : i + height, j : j + width] for i, j in offsets], axis=2)
    mean = (values * weights).sum(axis=2) / np.maximum(weights.sum(axis=2), 1)
    values = (values - mean[..., None]) * weights
    return values, (values**2).sum(axis=2)
