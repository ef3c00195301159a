"""Isosurface of a field that is evaluated near the surface only, so that cost grows with area, not with volume.

Space is cut in blocks of 8³ cubes, first of cubes four times as large. A block is evaluated when the coarser field
changes sign in it, when measured data lie in it, or when an evaluated neighbour's face shows the other sign: the
surface is followed until it closes. The rest is inside or outside as its centre says.

Far from all data, where the surface is only closed, the large cubes are meshed themselves: see `stitch`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy import ndimage

from mammometry.geometry.arrays import Array, Bool, Float32, Float64, Int32, Int64, read_only
from mammometry.geometry.mesh import TriangleMesh
from mammometry.progress import Progress, no_progress, part
from mammometry.surface.stitch import OpenMesh, edge_keys, stitched

BLOCK = 8
FAR_CUBES = 4
_CHUNK = 8
_APRON = 3
_BLEND = 4
_COARSE_SMOOTHING = 0.5
_LEVEL_CLEARANCE = 0.01
_FACES_AT_ONCE = 16384

Sampler = Callable[[Float64[Array, "n 3"], int, float], Float32[Array, "n s s s"]]
"""(origins, side, spacing) → field at side³ points from each origin, mm, positive outside."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BlockGrid:
    """The evaluated blocks of a grid, and the sign of all others."""

    origin: Float64[Array, 3]
    """World position of the first corner, mm."""
    cube_mm: float
    """Edge of a cube, mm."""
    index: Int32[Array, "x y z"]
    """Row of each block in `values`; −1 where it was not evaluated."""
    outside: Bool[Array, "x y z"]
    """Whether a block that was not evaluated lies outside the solid."""
    values: Float32[Array, "b 8 8 8"]
    """Field at the corners of the cubes of each evaluated block, mm, positive outside."""
    truncation_mm: float
    """Value of blocks that were not evaluated, by their sign, mm."""
    far: Bool[Array, "x y z"]
    """Blocks far from all data: none of them is evaluated here, `coarse` tells of them."""
    coarse: Float32[Array, "p q r"]
    """Field at every `FAR_CUBES`-th corner of the whole grid, mm."""

    def __post_init__(self) -> None:
        for field in ("origin", "index", "outside", "values", "far", "coarse"):
            object.__setattr__(self, field, read_only(getattr(self, field)))

    def dense(self, low: Int64[Array, 3], high: Int64[Array, 3]) -> Float32[Array, "x y z"]:
        """All values of the blocks low ≤ block < high as one array; blocks beyond the grid are outside."""
        return _dense(self.index, self.outside, self.values, self.truncation_mm, low, high)


def sample_blocks(
    sample: Sampler,
    low: Float64[Array, 3],
    high: Float64[Array, 3],
    seeds: Float64[Array, "n 3"],
    *,
    cube_mm: float,
    truncation_mm: float,
    near_mm: float = np.inf,
    progress: Progress = no_progress,
) -> BlockGrid:
    """Evaluate the field in all blocks between two corners, mm, through which the surface passes.

    Blocks further than `near_mm` from all seeds, and some cubes for the transition, are evaluated `FAR_CUBES` times
    as coarsely.
    """
    far_edge = BLOCK * cube_mm * FAR_CUBES
    shape = np.maximum(np.ceil((high - low) / far_edge).astype(int), 1) + 2
    origin = (low + high) / 2 - shape * far_edge / 2

    centres = origin + (np.indices(shape).reshape(3, -1).T + 0.5) * far_edge
    outside = sample(centres, 1, far_edge).reshape(shape) > 0
    outside[[0, -1]] = outside[:, [0, -1]] = outside[:, :, [0, -1]] = True
    around = ndimage.generate_binary_structure(3, 3)
    wanted = ndimage.binary_dilation(outside, around) & ndimage.binary_dilation(~outside, around)
    wanted[_cells(seeds, origin, far_edge, wanted.shape)] = True
    index, values = _followed(sample, origin, cube_mm * FAR_CUBES, outside, wanted)
    coarse = _dense(index, outside, values, truncation_mm, np.zeros(3, np.int64), shape + 1)
    coarse = coarse[tuple(slice(0, n * BLOCK + 1) for n in shape)]
    progress(0.2)

    shape = shape * FAR_CUBES
    empty = np.ones(shape, dtype=bool)
    empty[_cells(seeds, origin, BLOCK * cube_mm, empty.shape)] = False
    reach = near_mm / cube_mm + np.sqrt(3) * (_APRON + _BLEND + BLOCK)  # between centres of blocks, in cubes
    far = ndimage.distance_transform_edt(empty) * BLOCK > reach if np.isfinite(near_mm) else np.zeros_like(empty)
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


def _cells(
    points: Float64[Array, "n 3"], origin: Float64[Array, 3], edge_mm: float, shape: tuple[int, ...]
) -> tuple[Int64[Array, " k"], ...]:
    """Blocks that hold any of the points."""
    cell = np.floor((points - origin) / edge_mm).astype(np.int64)
    return tuple(cell[((cell >= 0) & (cell < shape)).all(axis=1)].T)


def _followed(
    sample: Sampler,
    origin: Float64[Array, 3],
    cube_mm: float,
    outside: Bool[Array, "x y z"],
    wanted: Bool[Array, "x y z"],
    *,
    barred: Bool[Array, "x y z"] | None = None,
    progress: Progress = no_progress,
) -> tuple[Int32[Array, "x y z"], Float32[Array, "b 8 8 8"]]:
    """Evaluate the blocks wanted, then those into which the surface leads, but for barred ones: index and values."""
    index = np.full(outside.shape, -1, dtype=np.int32)
    parts = [np.zeros((0, BLOCK, BLOCK, BLOCK), dtype=np.float32)]
    count = 0
    while True:
        new = np.argwhere(wanted & (index < 0) if barred is None else wanted & (index < 0) & ~barred)
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
    """All values of the blocks low ≤ block < high as one array; blocks beyond the grid are outside."""
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
    """Blocks not yet evaluated whose sign differs somewhere from the touching face of one just evaluated."""
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


class Isosurface:
    """Marching cubes (Lewiner) on the field of a grid, smoothed by a Gaussian of `smoothing` cubes.

    Chunks of 8³ blocks are meshed one at a time and joined at the vertices that they share. Values within a
    hundredth of a cube of the level are moved off it, so that every vertex lies strictly inside a cube's edge. The
    chunks' pieces are kept, so that healing a place redoes its surroundings only. Towards far blocks the field is
    led over into the coarse one, so that fine and coarse cubes agree where they meet.
    """

    def __init__(self, grid: BlockGrid, *, smoothing: float, progress: Progress = no_progress) -> None:
        self._grid = grid
        self._smoothing = smoothing
        self._healed = np.zeros((0, 4))
        coarse = _off_level(_smooth(grid.coarse, min(smoothing, _COARSE_SMOOTHING)), grid.cube_mm * FAR_CUBES)
        self._coarse = self._without_saddles(coarse)
        shape = np.array(grid.index.shape)
        self._pieces: dict[tuple[int, ...], OpenMesh | None] = {}
        chunks = list(np.ndindex(*(-(-shape // _CHUNK))))
        for number, chunk in enumerate(chunks):
            progress(number / len(chunks))
            first = np.array(chunk) * _CHUNK
            box = tuple(slice(max(a - 1, 0), a + _CHUNK + 1) for a in first)
            if (grid.index[box] >= 0).any():
                self._pieces[chunk] = self._piece(chunk, self._healed)
        self._far = self._far_piece() if grid.far.any() else None

    def heal(self, points: Float64[Array, "n 3"], *, reach_mm: float = 6.0, sigma_mm: float = 2.0) -> None:
        """Lead the field over into the coarse one within `reach_mm` of the points, and less so up to twice that far.

        There the coarse field is smoothed by a Gaussian of `sigma_mm`. Places healed before stay so. Only what the new
        points reach is redone.
        """
        self._healed = np.concatenate([np.column_stack([points, np.full(len(points), reach_mm)]), self._healed])
        touched = self._smoothed_coarse(points, reach_mm, sigma_mm)
        for chunk in self._pieces:
            close = self._reaching(chunk)
            if close[: len(points)].any():
                self._pieces[chunk] = self._piece(chunk, self._healed[close])
        if touched:
            self._far = self._far_piece()

    def _reaching(self, chunk: tuple[int, ...]) -> Bool[Array, " n"]:
        """Which of the healed places reach into a chunk."""
        edge = BLOCK * self._grid.cube_mm
        low = self._grid.origin + np.array(chunk) * _CHUNK * edge
        high = self._grid.origin + self._last(chunk) * edge
        at, reach = self._healed[:, :3], 2 * self._healed[:, 3:]
        return np.asarray(((at > low - reach) & (at < high + reach)).all(axis=1))

    def _smoothed_coarse(self, points: Float64[Array, "n 3"], reach_mm: float, sigma_mm: float) -> bool:
        """Smooth the coarse field around the points; whether any far block is reached."""
        step, shape = self._grid.cube_mm * FAR_CUBES, np.array(self._coarse.shape)
        self._coarse, touched = self._coarse.copy(), False
        for point in points:
            middle = (point - self._grid.origin) / step
            low = np.maximum(np.floor(middle - 2 * reach_mm / step).astype(int), 0)
            high = np.minimum(np.ceil(middle + 2 * reach_mm / step).astype(int) + 1, shape)
            window = tuple(slice(a, b) for a, b in zip(low, high, strict=True))
            field = self._coarse[window]
            place = np.array([[*point, reach_mm]])
            strength = _nearness(self._grid.origin + low * step, field.shape, step, place)
            self._coarse[window] = _off_level(field + strength * (_smooth(field, sigma_mm / step) - field), step)
            ends = zip(low * FAR_CUBES // BLOCK, high * FAR_CUBES // BLOCK + 1, strict=True)
            touched |= bool(self._grid.far[tuple(slice(a, b) for a, b in ends)].any())
        self._coarse = self._without_saddles(self._coarse)
        return touched

    def _without_saddles(self, coarse: Float32[Array, "p q r"]) -> Float32[Array, "p q r"]:
        far = _repeated(self._grid.far, BLOCK // FAR_CUBES)
        return _without_saddles(coarse, far, self._grid.cube_mm * FAR_CUBES)

    def mesh(self) -> TriangleMesh | None:
        """Join the pieces; faces counter-clockwise seen from outside, world frame, mm.

        None where fine and coarse cubes do not fit together: a saddle that both decide differently.
        """
        near = joined([piece for piece in self._pieces.values() if piece is not None], _CHUNK * BLOCK)
        whole = near if self._far is None else stitched(near, self._far, BLOCK, FAR_CUBES)
        if whole is None:
            return None
        vertices = self._grid.origin + whole.vertices * self._grid.cube_mm
        return TriangleMesh(vertices=vertices, faces=whole.faces.astype(np.int32))

    def _last(self, chunk: tuple[int, ...]) -> Int64[Array, 3]:
        return np.minimum((np.array(chunk) + 1) * _CHUNK, self._grid.index.shape)

    def _piece(self, chunk: tuple[int, ...], heal: Float64[Array, "n 4"]) -> OpenMesh | None:
        """Vertices, in cubes from the grid's origin, and faces of one chunk; None where no surface passes."""
        grid = self._grid
        blocks = tuple(slice(a, b) for a, b in zip(np.array(chunk) * _CHUNK, self._last(chunk), strict=True))
        wide = tuple(slice(max(axis.start - 1, 0), axis.stop + 1) for axis in blocks)
        used = ndimage.find_objects((grid.index[wide] >= 0).astype(np.uint8))[0]  # a surface fills few of the blocks
        first = np.array([max(w.start + u.start - 1, b.start) for w, u, b in zip(wide, used, blocks, strict=True)])
        last = np.array([min(w.start + u.stop + 1, b.stop) for w, u, b in zip(wide, used, blocks, strict=True)])
        if (first >= last).any():
            return None
        field = _blurred(grid.dense(first - 1, last + 1), self._smoothing)
        field = _off_level(self._led_over(field, first, last, heal), grid.cube_mm)
        far = grid.far[tuple(slice(a, b) for a, b in zip(first, last, strict=True))]
        return marched(field, ~_repeated(far, BLOCK), first * BLOCK, 1)

    def _led_over(
        self,
        field: Float32[Array, "x y z"],
        first: Int64[Array, 3],
        last: Int64[Array, 3],
        heal: Float64[Array, "n 4"],
    ) -> Float32[Array, "x y z"]:
        """The field of the blocks first ≤ block < last, turned into the coarse one where healed and towards far blocks.

        How much is told at the coarse cubes' corners, and linear between, as the coarse field itself.
        """
        times = BLOCK // FAR_CUBES
        low, high = np.maximum(first - 2, 0), np.minimum(last + 2, self._grid.far.shape)
        far = self._grid.far[tuple(slice(a, b) for a, b in zip(low, high, strict=True))]
        if not far.any() and not len(heal):
            return field
        cells = _repeated(far, times)
        touching = np.zeros(np.array(cells.shape) + 1, dtype=bool)
        for corner in np.ndindex(2, 2, 2):
            touching[tuple(slice(c, c + n) for c, n in zip(corner, cells.shape, strict=True))] |= cells
        steps = ndimage.distance_transform_cdt(~touching, metric="chessboard")
        steps = np.where(steps < 0, _APRON + _BLEND, FAR_CUBES * steps)  # -1 where nothing is far
        inner = tuple(slice((a - c) * times, (b - c) * times + 1) for a, b, c in zip(first, last, low, strict=True))
        share = np.clip((_APRON + _BLEND - steps[inner]) / _BLEND, 0.0, 1.0).astype(np.float32)
        cube_mm = self._grid.cube_mm
        corner_mm = self._grid.origin + first * BLOCK * cube_mm
        share = np.maximum(share, _nearness(corner_mm, share.shape, cube_mm * FAR_CUBES, heal))
        coarse = self._coarse[tuple(slice(a * times, b * times + 1) for a, b in zip(first, last, strict=True))]
        for axis in range(3):
            coarse, share = _interpolated(coarse, axis), _interpolated(share, axis)
        return field + share * (coarse - field)

    def _far_piece(self) -> OpenMesh:
        grid = self._grid
        found = marched(self._coarse, _repeated(grid.far, BLOCK // FAR_CUBES), np.zeros(3, np.int64), FAR_CUBES)
        return found or OpenMesh(vertices=np.zeros((0, 3)), faces=np.zeros((0, 3), dtype=np.int64))


def marched(
    field: Float32[Array, "x y z"], cells: Bool[Array, "x1 y1 z1"], first: Int64[Array, 3], step: int
) -> OpenMesh | None:
    """Marching cubes on the chosen cells; vertices in fine cubes, the field's first corner at `first`."""
    from skimage.measure import marching_cubes

    if field.min() > 0 or field.max() < 0:
        return None
    chosen = np.zeros(field.shape, dtype=bool)
    chosen[1:, 1:, 1:] = cells  # a cell is asked for by its last corner
    if not _crossed(field, cells):
        return None
    found, triangles = marching_cubes(field, 0.0, gradient_direction="descent", mask=chosen)[:2]  # type: ignore[no-untyped-call]
    return OpenMesh(vertices=found.astype(np.float64) * step + first, faces=triangles.astype(np.int64))


def _crossed(field: Float32[Array, "x y z"], cells: Bool[Array, "x1 y1 z1"]) -> bool:
    """Whether the level passes through any of the cells."""
    positive = field > 0
    some, every = np.zeros(cells.shape, dtype=bool), np.ones(cells.shape, dtype=bool)
    for corner in np.ndindex(2, 2, 2):
        at = positive[tuple(slice(c, c + n) for c, n in zip(corner, cells.shape, strict=True))]
        some |= at
        every &= at
    return bool((cells & some & ~every).any())


def _repeated(blocks: Bool[Array, "x y z"], times: int) -> Bool[Array, "x2 y2 z2"]:
    return blocks.repeat(times, axis=0).repeat(times, axis=1).repeat(times, axis=2)


def _interpolated(values: Float32[Array, "x y z"], axis: int) -> Float32[Array, "x2 y2 z2"]:
    """Linear interpolation to `FAR_CUBES` steps along one axis; exact at the corners given."""
    values = np.moveaxis(values, axis, 0)
    between = np.arange(FAR_CUBES, dtype=np.float32)[:, None, None] / np.float32(FAR_CUBES)
    fine = values[:-1, None] + between * (values[1:] - values[:-1])[:, None]
    return np.moveaxis(np.concatenate([fine.reshape(-1, *values.shape[1:]), values[-1:]]), 0, axis)


def _off_level(field: Float32[Array, "x y z"], cube_mm: float) -> Float32[Array, "x y z"]:
    """Move values within a hundredth of a cube of the level off it."""
    clearance = np.float32(_LEVEL_CLEARANCE * cube_mm)
    return np.where(np.abs(field) < clearance, np.copysign(clearance, field), field)


def _without_saddles(
    field: Float32[Array, "x y z"], far: Bool[Array, "x1 y1 z1"], cube_mm: float
) -> Float32[Array, "x y z"]:
    """Turn corners of faces between far and near cubes from inside to outside, until signs alternate around none.

    Such a face is cut twice, and fine and coarse cubes may disagree which two of its four crossings belong together.
    The weaker of its two inner corners turns; never back, so that this ends.
    """
    field = field.copy()
    saddles = True
    while saddles:
        saddles = False
        for axis in range(3):
            cells, values = np.moveaxis(far, axis, 0), np.moveaxis(field, axis, 0)
            plane, row, column = np.nonzero(cells[1:] != cells[:-1])
            corners = (
                (plane + 1)[:, None].repeat(4, axis=1),
                row[:, None] + [0, 0, 1, 1],
                column[:, None] + [0, 1, 1, 0],
            )
            around = values[corners]
            alternate = ((around > 0) != np.roll(around > 0, 1, axis=1)).all(axis=1)
            weaker = np.where(around < 0, around, -np.inf)[alternate].argmax(axis=1)
            values[tuple(index[alternate, weaker] for index in corners)] = _LEVEL_CLEARANCE * cube_mm
            saddles |= bool(alternate.any())
    return field


def _smooth(field: Float32[Array, "x y z"], sigma: float) -> Float32[Array, "x y z"]:
    smooth: Float32[Array, "x y z"] = ndimage.gaussian_filter(field, sigma, mode="nearest") if sigma > 0 else field
    return smooth


def _blurred(values: Float32[Array, "x y z"], sigma: float) -> Float32[Array, "x2 y2 z2"]:
    """Gaussian of a chunk with a block's margin around it; the margin is taken off, but for one layer of corners."""
    keep = tuple(slice(BLOCK - _APRON, size - BLOCK + 1 + _APRON) for size in values.shape)
    field = values[keep]
    if sigma > 0:
        field = ndimage.gaussian_filter(field, sigma, mode="nearest", truncate=_APRON / sigma)
    inner: Float32[Array, "x2 y2 z2"] = field[_APRON:-_APRON, _APRON:-_APRON, _APRON:-_APRON]
    return inner


def _nearness(
    low: Float64[Array, 3], shape: tuple[int, ...], step_mm: float, places: Float64[Array, "n 4"]
) -> Float32[Array, "x y z"]:
    """1 within the reach of any of the places (x, y, z, reach, mm), falling to 0 at twice that distance."""
    strength = np.zeros(shape, dtype=np.float32)
    axes = [low[axis] + np.arange(shape[axis]) * step_mm for axis in range(3)]
    for *point, reach_mm in places:
        x, y, z = ((axis - at) ** 2 for axis, at in zip(axes, point, strict=True))
        distance = np.sqrt(x[:, None, None] + y[:, None] + z).astype(np.float32)
        np.maximum(strength, np.clip(2.0 - distance / np.float32(reach_mm), 0.0, 1.0), out=strength)
    return strength


def tunnel_places(mesh: TriangleMesh, cell_mm: float) -> Float64[Array, "n 3"]:
    """Where the tunnels and handles of a closed mesh are, mm: cells whose total curvature is that of a handle.

    By Gauss and Bonnet the angles missing from 2π at the vertices sum to 2π·(V − E + F); a handle takes 4π, which no
    saddle of a body does within a cell a few millimetres wide.
    """
    double_area = 2 * np.linalg.norm(mesh.face_vectors(), axis=1)
    angles = np.empty(mesh.faces.shape)
    for start in range(0, len(mesh.faces), _FACES_AT_ONCE):
        part = slice(start, start + _FACES_AT_ONCE)
        a, b, c = (mesh.vertices[mesh.faces[part, corner]] for corner in range(3))
        for corner, (at, left, right) in enumerate(((a, b, c), (b, c, a), (c, a, b))):
            angles[part, corner] = np.arctan2(double_area[part], np.einsum("ij,ij->i", left - at, right - at))
    defect = 2 * np.pi - np.bincount(mesh.faces.ravel(), angles.ravel(), minlength=len(mesh.vertices))
    cell = np.floor((mesh.vertices - mesh.vertices.min(axis=0)) / cell_mm).astype(np.int64)
    extent = cell.max(axis=0) + 1
    flat = (cell[:, 0] * extent[1] + cell[:, 1]) * extent[2] + cell[:, 2]
    order = np.argsort(flat, kind="stable")
    starts = np.flatnonzero(np.diff(flat[order], prepend=-1))
    total = np.add.reduceat(defect[order], starts)
    keys = flat[order][starts][total < -np.pi]
    cells = np.stack([keys // (extent[1] * extent[2]), keys // extent[2] % extent[1], keys % extent[2]], axis=1)
    return mesh.vertices.min(axis=0) + (cells + 0.5) * cell_mm


def joined(pieces: list[OpenMesh], period: int) -> OpenMesh:
    """Join the vertices that two pieces share: they lie on the same cube edge, on a plane every `period` cubes."""
    if not pieces:
        return OpenMesh(vertices=np.zeros((0, 3)), faces=np.zeros((0, 3), dtype=np.int64))
    starts = np.cumsum([0] + [len(piece.vertices) for piece in pieces])
    vertices = np.concatenate([piece.vertices for piece in pieces])
    faces = np.concatenate([piece.faces + start for piece, start in zip(pieces, starts[:-1], strict=True)])
    border = np.flatnonzero((vertices % period == 0).any(axis=1))
    _, first, inverse = np.unique(edge_keys(vertices[border], 1), return_index=True, return_inverse=True)
    stands_for = np.arange(len(vertices))
    stands_for[border] = border[first][inverse]
    kept = stands_for == np.arange(len(vertices))
    number = (np.cumsum(kept) - 1)[stands_for]
    return OpenMesh(vertices=vertices[kept], faces=number[faces])


def largest_part(mesh: TriangleMesh) -> TriangleMesh:
    """Return the connected part that encloses the largest volume: no crumbs, and no cavities (theirs is negative)."""
    count, label = mesh.components()
    if count <= 1:
        return mesh
    part = label[mesh.faces[:, 0]]
    corner = (mesh.vertices - mesh.vertices.mean(axis=0))[mesh.faces[:, 0]]
    volume = np.bincount(part, np.einsum("ij,ij->i", corner, mesh.face_vectors()), minlength=count)
    return mesh.submesh(part == np.argmax(volume))
