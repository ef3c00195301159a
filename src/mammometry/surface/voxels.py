"""Isosurface of a field that is evaluated near the surface only, so that cost grows with area, not with volume.

Space is cut in blocks of 8³ cubes. A block is evaluated when the field changes sign between its centre and a
neighbour's, when measured data lie in it, or when an evaluated neighbour's face shows the other sign: the surface is
followed until it closes. The rest is inside or outside as its centre says.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from mammometry.geometry.arrays import Array, Bool, Float32, Float64, Int32, Int64, read_only
from mammometry.geometry.mesh import TriangleMesh
from mammometry.progress import Progress, no_progress

BLOCK = 8
_CHUNK = 8
_APRON = 3
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

    def __post_init__(self) -> None:
        for field in ("origin", "index", "outside", "values"):
            object.__setattr__(self, field, read_only(getattr(self, field)))

    def dense(self, low: Int64[Array, 3], high: Int64[Array, 3]) -> Float32[Array, "x y z"]:
        """All values of the blocks low ≤ block < high as one array; blocks beyond the grid are outside."""
        window = tuple(slice(max(a, 0), b) for a, b in zip(low, high, strict=True))
        pads = [(max(-a, 0), max(b - n, 0)) for a, b, n in zip(low, high, self.index.shape, strict=True)]
        index = np.pad(self.index[window], pads, constant_values=-1)
        outside = np.pad(self.outside[window], pads, constant_values=True)
        blocks = np.where(outside, np.float32(self.truncation_mm), np.float32(-self.truncation_mm))
        filled = np.broadcast_to(blocks[..., None, None, None], (*index.shape, BLOCK, BLOCK, BLOCK)).copy()
        known = index >= 0
        filled[known] = self.values[index[known]]
        x, y, z = index.shape
        return filled.transpose(0, 3, 1, 4, 2, 5).reshape(x * BLOCK, y * BLOCK, z * BLOCK)


def sample_blocks(
    sample: Sampler,
    low: Float64[Array, 3],
    high: Float64[Array, 3],
    seeds: Float64[Array, "n 3"],
    *,
    cube_mm: float,
    truncation_mm: float,
    progress: Progress = no_progress,
) -> BlockGrid:
    """Evaluate the field in all blocks between two corners, mm, through which the surface passes."""
    edge = BLOCK * cube_mm
    shape = np.maximum(np.ceil((high - low) / edge).astype(int), 1) + 2
    origin = (low + high) / 2 - shape * edge / 2
    centres = origin + (np.indices(shape).reshape(3, -1).T + 0.5) * edge
    outside = sample(centres, 1, cube_mm).reshape(shape) > 0
    outside[[0, -1]] = outside[:, [0, -1]] = outside[:, :, [0, -1]] = True
    progress(0.2)

    cross = ndimage.generate_binary_structure(3, 3)
    wanted = ndimage.binary_dilation(outside, cross) & ndimage.binary_dilation(~outside, cross)
    if len(seeds):
        cell = np.floor((seeds - origin) / edge).astype(int)
        cell = cell[((cell >= 0) & (cell < shape)).all(axis=1)]
        wanted[tuple(cell.T)] = True

    index = np.full(shape, -1, dtype=np.int32)
    parts: list[Float32[Array, "b 8 8 8"]] = []
    count = 0
    while True:
        new = np.argwhere(wanted & (index < 0))
        if not len(new):
            break
        index[tuple(new.T)] = np.arange(count, count + len(new), dtype=np.int32)
        values = sample(origin + new * edge, BLOCK, cube_mm)
        parts.append(values)
        count += len(new)
        wanted = _neighbours_across_sign_changes(new, values > 0, index, outside)
        progress(min(0.9, 0.2 + 0.1 * len(parts)))
    values = np.concatenate(parts) if parts else np.zeros((0, BLOCK, BLOCK, BLOCK), dtype=np.float32)
    progress(1.0)
    return BlockGrid(
        origin=origin, cube_mm=cube_mm, index=index, outside=outside, values=values, truncation_mm=truncation_mm
    )


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
    chunks' pieces are kept, so that healing a place redoes its surroundings only.
    """

    def __init__(self, grid: BlockGrid, *, smoothing: float, progress: Progress = no_progress) -> None:
        self._grid = grid
        self._smoothing = smoothing
        self._healed = np.zeros((0, 3))
        shape = np.array(grid.index.shape)
        self._pieces: dict[tuple[int, ...], tuple[Float64[Array, "n 3"], Int64[Array, "m 3"]] | None] = {}
        chunks = list(np.ndindex(*(-(-shape // _CHUNK))))
        for number, chunk in enumerate(chunks):
            progress(number / len(chunks))
            first = np.array(chunk) * _CHUNK
            box = tuple(slice(max(a - 1, 0), a + _CHUNK + 1) for a in first)
            if (grid.index[box] >= 0).any():
                self._pieces[chunk] = self._piece(chunk, np.zeros((0, 3)), 0.0)

    def heal(self, points: Float64[Array, "n 3"], reach_mm: float = 6.0) -> None:
        """Smooth three times as much within `reach_mm` of the points, mm, and less so up to twice that far.

        Places healed before stay so. Only the chunks that the new points reach are redone.
        """
        self._healed = np.concatenate([points, self._healed])
        for chunk in self._pieces:
            low, high = self._bounds(chunk)
            within = (self._healed > low - 2 * reach_mm) & (self._healed < high + 2 * reach_mm)
            close = np.asarray(within.all(axis=1))
            if close[: len(points)].any():
                self._pieces[chunk] = self._piece(chunk, self._healed[close], reach_mm)

    def mesh(self) -> TriangleMesh:
        """Join the pieces; faces counter-clockwise seen from outside, world frame, mm."""
        vertices, faces, count = [], [], 0
        for piece in self._pieces.values():
            if piece is not None:
                vertices.append(piece[0])
                faces.append(piece[1] + count)
                count += len(piece[0])
        if not vertices:
            return TriangleMesh(vertices=np.zeros((0, 3)), faces=np.zeros((0, 3), dtype=np.int32))
        return _joined(np.concatenate(vertices), np.concatenate(faces), self._grid)

    def _last(self, chunk: tuple[int, ...]) -> Int64[Array, 3]:
        return np.minimum((np.array(chunk) + 1) * _CHUNK, self._grid.index.shape)

    def _bounds(self, chunk: tuple[int, ...]) -> tuple[Float64[Array, 3], Float64[Array, 3]]:
        """World positions of a chunk's first and last corner, mm."""
        edge = BLOCK * self._grid.cube_mm
        origin = self._grid.origin
        return origin + np.array(chunk) * _CHUNK * edge, origin + self._last(chunk) * edge

    def _piece(
        self, chunk: tuple[int, ...], heal: Float64[Array, "n 3"], reach_mm: float
    ) -> tuple[Float64[Array, "n 3"], Int64[Array, "m 3"]] | None:
        """Vertices, in cubes from the grid's origin, and faces of one chunk; None where no surface passes."""
        from skimage.measure import marching_cubes

        grid, first, last = self._grid, np.array(chunk) * _CHUNK, self._last(chunk)
        values = grid.dense(first - 1, last + 1)
        field = _blurred(values, self._smoothing, _APRON)
        if len(heal):
            strength = _nearness(self._bounds(chunk)[0], field.shape, grid.cube_mm, heal, reach_mm)
            field = field + strength * (_blurred(values, 3 * max(self._smoothing, 1.0), BLOCK - 1) - field)
        if field.min() > 0 or field.max() < 0:
            return None
        clearance = np.float32(_LEVEL_CLEARANCE * grid.cube_mm)
        field = np.where(np.abs(field) < clearance, np.copysign(clearance, field), field)
        found, triangles = marching_cubes(field, 0.0, gradient_direction="descent")[:2]  # type: ignore[no-untyped-call]
        return found.astype(np.float64) + first * BLOCK, triangles.astype(np.int64)


def _blurred(values: Float32[Array, "x y z"], sigma: float, radius: int) -> Float32[Array, "x2 y2 z2"]:
    """Gaussian of a chunk with a block's margin around it; the margin is taken off, but for one layer of corners."""
    keep = tuple(slice(BLOCK - radius, size - BLOCK + 1 + radius) for size in values.shape)
    field = values[keep]
    if sigma > 0:
        field = ndimage.gaussian_filter(field, sigma, mode="nearest", truncate=radius / sigma)
    inner: Float32[Array, "x2 y2 z2"] = field[radius:-radius, radius:-radius, radius:-radius]
    return inner


def _nearness(
    low: Float64[Array, 3], shape: tuple[int, ...], cube_mm: float, points: Float64[Array, "n 3"], reach_mm: float
) -> Float32[Array, "x y z"]:
    """1 within `reach_mm` of any of the points, falling to 0 at twice that distance, at a chunk's corners."""
    strength = np.zeros(shape, dtype=np.float32)
    axes = [low[axis] + np.arange(shape[axis]) * cube_mm for axis in range(3)]
    for point in points:
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


def _joined(vertices: Float64[Array, "n 3"], faces: Int64[Array, "m 3"], grid: BlockGrid) -> TriangleMesh:
    """Join the vertices that two chunks share: they lie on the same cube edge."""
    steps = np.int64(2000)
    extent = (np.array(grid.index.shape, dtype=np.int64) * BLOCK + 2) * steps
    keys = np.rint(vertices * steps).astype(np.int64) + steps
    flat = (keys[:, 0] * extent[1] + keys[:, 1]) * extent[2] + keys[:, 2]
    _, first, inverse = np.unique(flat, return_index=True, return_inverse=True)
    faces = inverse[faces]
    proper = (faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])
    return TriangleMesh(vertices=grid.origin + vertices[first] * grid.cube_mm, faces=faces[proper].astype(np.int32))


def largest_part(mesh: TriangleMesh) -> TriangleMesh:
    """Return the connected part that encloses the largest volume: no crumbs, and no cavities (theirs is negative)."""
    count, label = mesh.components()
    if count <= 1:
        return mesh
    part = label[mesh.faces[:, 0]]
    corner = (mesh.vertices - mesh.vertices.mean(axis=0))[mesh.faces[:, 0]]
    volume = np.bincount(part, np.einsum("ij,ij->i", corner, mesh.face_vectors()), minlength=count)
    return mesh.submesh(part == np.argmax(volume))
