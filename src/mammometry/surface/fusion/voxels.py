"""A field sampled in blocks near its surface, so that the cost grows with area, not with volume.

Space is divided into blocks of 8³ cubes, first with cubes four times as large. A block is evaluated if the coarser
field changes sign in it, if it contains measured data, or if the adjacent face of an evaluated neighbour has the other
sign: the surface is followed until it closes. Other blocks are inside or outside according to their centre. Far from
all data the large cubes themselves are meshed (`isosurface`).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy import ndimage

from mammometry.base.progress import Progress, no_progress, part
from mammometry.base.value import value
from mammometry.geometry.arrays import Array, Bool, Float32, Float64, Int32, Int64
from mammometry.surface.fusion import field_kernels as kernels

BLOCK = 8  # cubes along a block's edge; affects speed only
FAR_CUBES = 4  # edge of a large cube in small ones (docs/decisions/0016)
TRANSITION = 7  # fine cubes from the large ones to where the field is unchanged

Sampler = Callable[[Float64[Array, "n 3"], int, float], Float32[Array, "n s s s"]]
"""(origins, side, spacing) → field at side³ points from each origin, mm, positive outside."""


@value(eq=False)
class BlockGrid:
    """The evaluated blocks of a grid, and the sign of all others."""

    origin: Float64[Array, 3]
    """World position of the first corner, mm."""
    cube_mm: float
    """Edge of a cube, mm."""
    index: Int32[Array, "x y z"]
    """Row of each block in `values`. −1 if it was not evaluated."""
    outside: Bool[Array, "x y z"]
    """Whether a block that was not evaluated is outside the solid."""
    values: Float32[Array, "b 8 8 8"]
    """Field at the cubes' corners of each evaluated block, mm, positive outside."""
    truncation_mm: float
    """Value of blocks that were not evaluated, by their sign, mm."""
    far: Bool[Array, "x y z"]
    """Blocks far from all data. They are not evaluated here, but in `coarse`."""
    coarse: Float32[Array, "p q r"]
    """Field at every `FAR_CUBES`-th corner of the whole grid, mm."""

    def dense(self, low: Int64[Array, 3], high: Int64[Array, 3]) -> Float32[Array, "x y z"]:
        """Values of the blocks low ≤ block < high as one array. Blocks beyond the grid are outside."""
        return _dense(self.index, self.outside, self.values, self.truncation_mm, low, high)


def sample_blocks(
    sample: Sampler,
    box: Float64[Array, "2 3"],
    seeds: Float64[Array, "n 3"],
    *,
    cube_mm: float,
    truncation_mm: float,
    near_mm: float = np.inf,
    progress: Progress = no_progress,
) -> BlockGrid:
    """Evaluate the field in all blocks that contain the surface.

    `box` is the lowest and highest corner, mm. Blocks farther than `near_mm` (plus a transition) from all seeds are
    evaluated with cubes `FAR_CUBES` times as large.
    """
    low, high = box
    far_edge = BLOCK * cube_mm * FAR_CUBES
    shape = np.maximum(np.ceil((high - low) / far_edge).astype(int), 1) + 2
    origin = (low + high) / 2 - shape * far_edge / 2

    centres = origin + (np.indices(shape).reshape(3, -1).T + 0.5) * far_edge
    outside = sample(centres, 1, far_edge).reshape(shape) > 0
    outside[[0, -1]] = outside[:, [0, -1]] = outside[:, :, [0, -1]] = True
    around = ndimage.generate_binary_structure(3, 3)
    wanted = ndimage.binary_dilation(outside, around) & ndimage.binary_dilation(~outside, around)
    wanted |= ~kernels.empty_cells(seeds, origin, far_edge, wanted.shape)
    index, values = _followed(sample, origin, cube_mm * FAR_CUBES, outside, wanted, barred=np.zeros_like(wanted))
    coarse = _dense(index, outside, values, truncation_mm, np.zeros(3, np.int64), shape + 1)
    coarse = coarse[tuple(slice(0, n * BLOCK + 1) for n in shape)]
    progress(0.2)

    shape = shape * FAR_CUBES
    empty = kernels.empty_cells(seeds, origin, BLOCK * cube_mm, (int(shape[0]), int(shape[1]), int(shape[2])))
    reach = near_mm / cube_mm + np.sqrt(3) * (TRANSITION + BLOCK)  # between centres of blocks, in cubes
    far = ndimage.distance_transform_edt(empty) * BLOCK > reach
    half = BLOCK // FAR_CUBES // 2
    outside = coarse[half::2, half::2, half::2] > 0
    corners = sliding_window_view(coarse > 0, (3, 3, 3))[::2, ::2, ::2]
    wanted = (corners.any(axis=(3, 4, 5)) & ~corners.all(axis=(3, 4, 5)) | ~empty) & ~far
    index, values = _followed(sample, origin, cube_mm, outside, wanted, barred=far, progress=part(progress, 0.2, 1.0))
    return BlockGrid(
        origin=origin,
        cube_mm=cube_mm,
        index=index,
        outside=outside,
        values=values,
        truncation_mm=truncation_mm,
        far=far,
        coarse=coarse,
    )


def _followed(
    sample: Sampler,
    origin: Float64[Array, 3],
    cube_mm: float,
    outside: Bool[Array, "x y z"],
    wanted: Bool[Array, "x y z"],
    *,
    barred: Bool[Array, "x y z"],
    progress: Progress = no_progress,
) -> tuple[Int32[Array, "x y z"], Float32[Array, "b 8 8 8"]]:
    """Index and values of the wanted blocks and of those along the surface, except barred ones."""
    index = np.full(outside.shape, -1, dtype=np.int32)
    parts = [np.zeros((0, BLOCK, BLOCK, BLOCK), dtype=np.float32)]
    count = 0
    while True:
        new = np.argwhere(wanted & (index < 0) & ~barred)
        if not len(new):
            break
        index[tuple(new.T)] = np.arange(count, count + len(new), dtype=np.int32)
        values = sample(origin + new * (BLOCK * cube_mm), BLOCK, cube_mm)
        parts.append(values)
        count += len(new)
        wanted = _neighbours_across_sign_changes(new, values > 0, index, outside)
        progress(min(0.9, 0.2 + 0.1 * len(parts)))
    progress(1.0)
    return index, np.concatenate(parts)


def _dense(
    index: Int32[Array, "x y z"],
    outside: Bool[Array, "x y z"],
    values: Float32[Array, "b 8 8 8"],
    truncation_mm: float,
    low: Int64[Array, 3],
    high: Int64[Array, 3],
) -> Float32[Array, "x8 y8 z8"]:
    """Values of the blocks low ≤ block < high as one array. Blocks beyond the grid are outside."""
    window = tuple(slice(max(a, 0), b) for a, b in zip(low, high, strict=True))
    pads = [(max(-a, 0), max(b - n, 0)) for a, b, n in zip(low, high, index.shape, strict=True)]
    index = np.pad(index[window], pads, constant_values=-1)
    outside = np.pad(outside[window], pads, constant_values=True)
    blocks = np.where(outside, np.float32(truncation_mm), np.float32(-truncation_mm))
    filled = np.broadcast_to(blocks[..., None, None, None], (*index.shape, BLOCK, BLOCK, BLOCK)).copy()
    known = index >= 0
    filled[known] = values[index[known]]
    x, y, z = index.shape
    return filled.transpose(0, 3, 1, 4, 2, 5).reshape(x * BLOCK, y * BLOCK, z * BLOCK)


def _neighbours_across_sign_changes(
    blocks: Int64[Array, "n 3"],
    positive: Bool[Array, "n 8 8 8"],
    index: Int32[Array, "x y z"],
    outside: Bool[Array, "x y z"],
) -> Bool[Array, "x y z"]:
    """Unevaluated blocks whose sign differs from the touching evaluated face."""
    wanted = np.zeros(index.shape, dtype=bool)
    for axis in range(3):
        for step, face in ((-1, 0), (1, BLOCK - 1)):
            neighbour = blocks.copy()
            neighbour[:, axis] += step
            within = (neighbour[:, axis] >= 0) & (neighbour[:, axis] < index.shape[axis])
            at = tuple(neighbour[within].T)
            signs = np.take(positive[within], face, axis=axis + 1).reshape(int(within.sum()), BLOCK * BLOCK)
            differs = (signs != outside[at][:, None]).any(axis=1) & (index[at] < 0)
            wanted[tuple(neighbour[within][differs].T)] = True
    return wanted
