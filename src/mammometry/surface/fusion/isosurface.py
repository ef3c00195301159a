"""Closed surface of a field on a grid of cubes, meshed chunk by chunk on all cores.

A coarse isosurface is joined to a fine one (`stitched`) where their border is on cube faces. Both are marching cubes of
fields that agree on those faces: there the fine field is the bilinear interpolation of the coarse one. So each crossed
edge of a coarse cube has a vertex in both meshes. Between two such vertices, the fine mesh's border follows the coarse
triangle's side in several steps, which are inserted into the coarse triangle.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from mammometry.base.machine.cores import available_cores
from mammometry.base.progress import Progress, no_progress
from mammometry.geometry import Array, Bool, Float32, Float64, Int32, Int64, TriangleMesh, mesh_kernels, read_only
from mammometry.surface.fusion.marching import march, without_saddles
from mammometry.surface.fusion.voxels import BLOCK, FAR_CUBES, TRANSITION, BlockGrid


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class OpenMesh:
    """Vertices and faces of a part of a surface. Vertices are in fine cubes from the grid's origin."""

    vertices: Float64[Array, "n 3"]
    faces: Int32[Array, "m 3"]


def stitched(fine: OpenMesh, coarse: OpenMesh, step: int) -> OpenMesh | None:
    """One closed mesh of both parts. None if their borders do not match.

    A coarse cube is `step` fine ones wide.
    """
    border_of_fine, _ = _border(fine)
    border_of_coarse, sides = _border(coarse)
    ends = np.unique(border_of_fine)
    ends = ends[(fine.vertices[ends] % step == 0).sum(axis=1) == 2]  # on edges of coarse cubes
    own = np.unique(border_of_coarse)
    order = np.argsort(edge_keys(fine.vertices[ends], step))
    keys, wanted = edge_keys(fine.vertices[ends], step)[order], edge_keys(coarse.vertices[own], step)
    at = np.minimum(np.searchsorted(keys, wanted), max(len(keys) - 1, 0))
    if len(keys) != len(wanted) or not np.array_equal(keys[at], wanted):
        return None

    number = np.empty(len(coarse.vertices), dtype=np.int32)
    alone = np.ones(len(coarse.vertices), dtype=bool)
    alone[own] = False
    number[alone] = len(fine.vertices) + np.arange(int(alone.sum()), dtype=np.int32)
    number[own] = ends[order][at]
    faces = number[coarse.faces]
    chains = _chains(border_of_fine, set(ends.tolist()))
    if chains is None or len(chains) != len(border_of_coarse):
        return None

    outlines: dict[int, dict[tuple[int, int], list[int]]] = {}
    for (start, end), side in zip(number[border_of_coarse].tolist(), sides.tolist(), strict=True):
        steps = chains.get((end, start))
        if steps is None:
            return None
        outlines.setdefault(side, {})[start, end] = steps[::-1]
    vertices = np.concatenate([fine.vertices, coarse.vertices[alone]])
    fans, middles = _fans(faces, outlines, vertices)
    plain = np.ones(len(faces), dtype=bool)
    plain[list(outlines)] = False
    return OpenMesh(
        vertices=np.concatenate([vertices, middles]), faces=np.concatenate([fine.faces, faces[plain], fans])
    )


def _border(mesh: OpenMesh) -> tuple[Int64[Array, "e 2"], Int64[Array, " e"]]:
    """Directed sides of faces that no other face shares, and their faces."""
    n = len(mesh.vertices)
    ends = mesh_kernels.open_vertices(n, read_only(mesh.faces))
    a, b, c = ends[mesh.faces.T]
    near = np.flatnonzero((a & b) | (b & c) | (c & a))
    edges = mesh.faces[near][:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2).astype(np.int64)
    start, end = edges.T
    lonely = ends[start] & ends[end] & ~np.isin(start * n + end, end * n + start)
    return edges[lonely], near[np.flatnonzero(lonely) // 3]


def edge_keys(vertices: Float64[Array, "n 3"], step: int) -> Int64[Array, " n"]:
    """Number of the cube edge on which each vertex is, of cubes that are `step` wide."""
    low = np.floor(vertices / step).astype(np.int64)
    axis = np.argmax(vertices % step != 0, axis=1)
    keys: Int64[Array, " n"] = (((low[:, 0] << 20) + low[:, 1] << 20) + low[:, 2]) * 3 + axis
    return keys


def _chains(border: Int64[Array, "e 2"], ends: set[int]) -> dict[tuple[int, int], list[int]] | None:
    """(first, last) → vertices in between, for each part of the border between two consecutive ends."""
    following: dict[int, int] = {}
    starts = []
    for start, end in border.tolist():
        if start in ends:
            starts.append((start, end))
        elif start in following:
            return None
        else:
            following[start] = end
    chains: dict[tuple[int, int], list[int]] = {}
    for start, vertex in starts:
        between: list[int] = []
        while vertex not in ends:
            if vertex not in following:
                return None
            between.append(vertex)
            vertex = following.pop(vertex)
        if (start, vertex) in chains:
            return None
        chains[start, vertex] = between
    return None if following else chains  # a loop without an end would remain open


def _fans(
    faces: Int32[Array, "m 3"], outlines: dict[int, dict[tuple[int, int], list[int]]], vertices: Float64[Array, "n 3"]
) -> tuple[Int32[Array, "k 3"], Float64[Array, "j 3"]]:
    """Fans around the centres of faces with subdivided sides, and these centres."""
    fans: list[list[int]] = []
    middles: list[Float64[Array, 3]] = []
    for face, stepped in outlines.items():
        corners = faces[face].tolist()
        outline: list[int] = []
        for start, end in zip(corners, corners[1:] + corners[:1], strict=True):
            outline += [start, *stepped.get((start, end), [])]
        if len(outline) == 3:
            fans.append(outline)
            continue
        middle = len(vertices) + len(middles)
        middles.append(vertices[corners].mean(axis=0))
        fans += [[middle, start, end] for start, end in zip(outline, outline[1:] + outline[:1], strict=True)]
    return np.array(fans, dtype=np.int32).reshape(-1, 3), np.array(middles).reshape(-1, 3)


_CHUNK = 8  # blocks along the edge of a chunk, which one thread meshes; affects speed only
_APRON = 3  # fine cubes that the Gaussian reaches to either side
_BLEND = TRANSITION - _APRON  # fine cubes over which the fine field is blended into the coarse one
_COARSE_SMOOTHING = 0.5  # largest σ, in large cubes; not critical
_LEVEL_CLEARANCE = 0.01  # least distance of a vertex from the ends of its cube's edge, as a share of it; not critical


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Piece:
    """A chunk's part of the surface."""

    mesh: OpenMesh
    border: Int64[Array, " k"]
    """Vertices that it may share with other chunks: those on the planes between chunks."""


_EMPTY = OpenMesh(vertices=np.zeros((0, 3)), faces=np.zeros((0, 3), dtype=np.int32))


class Isosurface:
    """Marching cubes on a grid's field, smoothed by a Gaussian of `smoothing` cubes.

    Chunks of 8³ blocks are meshed in parallel and joined at their common vertices. Values within a hundredth of a cube
    of the level are moved away from it, so that every vertex is strictly inside a cube's edge. The pieces are kept, so
    that healing recomputes only the chunks around it. Towards far blocks the field is blended into the coarse one, so
    that fine and coarse cubes agree where they meet.
    """

    def __init__(self, grid: BlockGrid, *, smoothing: float, progress: Progress = no_progress) -> None:
        self._grid = grid
        self._smoothing = smoothing
        self._healed = np.zeros((0, 4))
        coarse = _off_level(_smooth(grid.coarse, min(smoothing, _COARSE_SMOOTHING)), grid.cube_mm * FAR_CUBES)
        self._coarse = self._without_saddles(coarse)
        shape = np.array(grid.index.shape)
        near = ndimage.maximum_filter(grid.index >= 0, size=3)  # smoothing spreads a block's field into its neighbours
        chunks = [chunk for chunk in np.ndindex(*(-(-shape // _CHUNK))) if near[self._blocks(chunk)].any()]
        self._pieces = self._meshed(chunks, progress)
        self._far = self._far_piece() if grid.far.any() else None

    def heal(self, points: Float64[Array, "n 3"], *, reach_mm: float, sigma_mm: float) -> None:
        """Blend the field into the coarse one near the points.

        Fully within `reach_mm`, decreasing up to twice that distance. The coarse field is smoothed there by a Gaussian
        of `sigma_mm`. Earlier healing remains. Only chunks that the new points reach are recomputed.
        """
        self._healed = np.concatenate([np.column_stack([points, np.full(len(points), reach_mm)]), self._healed])
        touched = self._smoothed_coarse(points, reach_mm, sigma_mm)
        reached = [chunk for chunk in self._pieces if self._reaching(chunk)[: len(points)].any()]
        self._pieces |= self._meshed(reached)
        if touched:
            self._far = self._far_piece()

    def _meshed(
        self, chunks: list[tuple[int, ...]], progress: Progress = no_progress
    ) -> dict[tuple[int, ...], _Piece | None]:
        """Pieces of some chunks, on all cores."""
        pieces: dict[tuple[int, ...], _Piece | None] = {}
        with ThreadPoolExecutor(available_cores()) as pool:
            for chunk, piece in zip(chunks, pool.map(self._piece, chunks), strict=True):
                pieces[chunk] = piece
                progress(len(pieces) / len(chunks))
        return pieces

    def _reaching(self, chunk: tuple[int, ...]) -> Bool[Array, " n"]:
        """Mask of the healed places that reach into a chunk."""
        edge = BLOCK * self._grid.cube_mm
        blocks = self._blocks(chunk)
        low = self._grid.origin + np.array([axis.start for axis in blocks]) * edge
        high = self._grid.origin + np.array([axis.stop for axis in blocks]) * edge
        at, reach = self._healed[:, :3], 2 * self._healed[:, 3:]
        return np.asarray(((at > low - reach) & (at < high + reach)).all(axis=1))

    def _smoothed_coarse(self, points: Float64[Array, "n 3"], reach_mm: float, sigma_mm: float) -> bool:
        """Smooth the coarse field around the points. Whether any far block is affected."""
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
        return without_saddles(coarse, far, _LEVEL_CLEARANCE * self._grid.cube_mm * FAR_CUBES)

    def mesh(self) -> TriangleMesh | None:
        """The joined pieces, world frame, mm, with faces counter-clockwise seen from outside.

        None if fine and coarse cubes do not fit together, because they treat a saddle differently.
        """
        near = _joined([piece for piece in self._pieces.values() if piece is not None])
        whole = near if self._far is None else stitched(near, self._far, FAR_CUBES)
        if whole is None:
            return None
        vertices = self._grid.origin + whole.vertices * self._grid.cube_mm
        return TriangleMesh(vertices=vertices, faces=whole.faces)

    def _blocks(self, chunk: tuple[int, ...]) -> tuple[slice, ...]:
        """The blocks of a chunk."""
        ends = zip(chunk, self._grid.far.shape, strict=True)
        return tuple(slice(number * _CHUNK, min((number + 1) * _CHUNK, count)) for number, count in ends)

    def _piece(self, chunk: tuple[int, ...]) -> _Piece | None:
        """Vertices (in cubes from the grid's origin) and faces of one chunk. None if it contains no surface."""
        grid, blocks = self._grid, self._blocks(chunk)
        wide = tuple(slice(max(axis.start - 1, 0), axis.stop + 1) for axis in blocks)
        used = ndimage.find_objects((grid.index[wide] >= 0).astype(np.uint8))[0]  # a surface fills few of the blocks
        first = np.array([max(w.start + u.start - 1, b.start) for w, u, b in zip(wide, used, blocks, strict=True)])
        last = np.array([min(w.start + u.stop + 1, b.stop) for w, u, b in zip(wide, used, blocks, strict=True)])
        if (first >= last).any():
            return None
        field = _blurred(grid.dense(first - 1, last + 1), self._smoothing)
        field = _off_level(self._blend(field, first, last, self._healed[self._reaching(chunk)]), grid.cube_mm)
        far = grid.far[tuple(slice(a, b) for a, b in zip(first, last, strict=True))]
        mesh = _marched(field, ~_repeated(far, BLOCK), first * BLOCK, 1)
        if mesh is None:
            return None
        on_plane = np.logical_or.reduce([axis % (_CHUNK * BLOCK) == 0 for axis in mesh.vertices.T])
        return _Piece(mesh=mesh, border=np.flatnonzero(on_plane))

    def _blend(
        self, field: Float32[Array, "x y z"], first: Int64[Array, 3], last: Int64[Array, 3], heal: Float64[Array, "n 4"]
    ) -> Float32[Array, "x y z"]:
        """Field of the blocks first ≤ block < last, blended into the coarse one.

        It is blended where it was healed, and towards far blocks. The share is defined at the coarse cubes' corners and
        linear in between, like the coarse field itself.
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
        steps = np.where(steps < 0, TRANSITION, FAR_CUBES * steps)  # −1 if nothing is far
        inner = tuple(slice((a - c) * times, (b - c) * times + 1) for a, b, c in zip(first, last, low, strict=True))
        share = np.clip((TRANSITION - steps[inner]) / _BLEND, 0.0, 1.0).astype(np.float32)
        cube_mm = self._grid.cube_mm
        corner_mm = self._grid.origin + first * BLOCK * cube_mm
        share = np.maximum(share, _nearness(corner_mm, share.shape, cube_mm * FAR_CUBES, heal))
        if not share.any():
            return field
        coarse = self._coarse[tuple(slice(a * times, b * times + 1) for a, b in zip(first, last, strict=True))]
        for axis in range(3):
            coarse, share = _interpolated(coarse, axis), _interpolated(share, axis)
        return field + share * (coarse - field)

    def _far_piece(self) -> OpenMesh:
        grid = self._grid
        found = _marched(self._coarse, _repeated(grid.far, BLOCK // FAR_CUBES), np.zeros(3, np.int64), FAR_CUBES)
        return found or _EMPTY


def _marched(
    field: Float32[Array, "x y z"], cells: Bool[Array, "x1 y1 z1"], first: Int64[Array, 3], step: int
) -> OpenMesh | None:
    """Marching cubes on the chosen cells. Vertices in fine cubes, the field's first corner at `first`."""
    if field.min() > 0 or field.max() < 0:
        return None
    vertices, faces = march(np.ascontiguousarray(field), cells)
    return OpenMesh(vertices=vertices * step + first, faces=faces) if len(faces) else None


def _repeated(blocks: Bool[Array, "x y z"], times: int) -> Bool[Array, "x2 y2 z2"]:
    return blocks.repeat(times, axis=0).repeat(times, axis=1).repeat(times, axis=2)


def _interpolated(values: Float32[Array, "x y z"], axis: int) -> Float32[Array, "x2 y2 z2"]:
    """Linear interpolation to `FAR_CUBES` steps along one axis. Exact at the given corners."""
    values = np.moveaxis(values, axis, 0)
    between = np.arange(FAR_CUBES, dtype=np.float32)[:, None, None] / np.float32(FAR_CUBES)
    fine = values[:-1, None] + between * (values[1:] - values[:-1])[:, None]
    return np.moveaxis(np.concatenate([fine.reshape(-1, *values.shape[1:]), values[-1:]]), 0, axis)


def _off_level(field: Float32[Array, "x y z"], cube_mm: float) -> Float32[Array, "x y z"]:
    """Move values off the level by a hundredth of a cube."""
    clearance = np.float32(_LEVEL_CLEARANCE * cube_mm)
    return np.where(np.abs(field) < clearance, np.copysign(clearance, field), field)


def _smooth(field: Float32[Array, "x y z"], sigma: float) -> Float32[Array, "x y z"]:
    smooth: Float32[Array, "x y z"] = ndimage.gaussian_filter(field, sigma, mode="nearest") if sigma > 0 else field
    return smooth


def _blurred(values: Float32[Array, "x y z"], sigma: float) -> Float32[Array, "x2 y2 z2"]:
    """Gaussian of a chunk with a margin of one block, of which one layer of corners is kept."""
    keep = tuple(slice(BLOCK - _APRON, size - BLOCK + 1 + _APRON) for size in values.shape)
    field = values[keep]
    if sigma > 0:
        field = ndimage.gaussian_filter(field, sigma, mode="nearest", truncate=_APRON / sigma)
    inner: Float32[Array, "x2 y2 z2"] = field[_APRON:-_APRON, _APRON:-_APRON, _APRON:-_APRON]
    return inner


def _nearness(
    low: Float64[Array, 3], shape: tuple[int, ...], step_mm: float, places: Float64[Array, "n 4"]
) -> Float32[Array, "x y z"]:
    """1 within reach of any place, decreasing to 0 at twice that. Places are (x, y, z, reach), mm."""
    strength = np.zeros(shape, dtype=np.float32)
    axes = [low[axis] + np.arange(shape[axis]) * step_mm for axis in range(3)]
    for *point, reach_mm in places:
        x, y, z = ((axis - at) ** 2 for axis, at in zip(axes, point, strict=True))
        distance = np.sqrt(x[:, None, None] + y[:, None] + z).astype(np.float32)
        np.maximum(strength, np.clip(2.0 - distance / np.float32(reach_mm), 0.0, 1.0), out=strength)
    return strength


def _joined(pieces: list[_Piece]) -> OpenMesh:
    """Join the common vertices of pieces, which are on the same cube edge."""
    if not pieces:
        return _EMPTY
    starts = np.cumsum([0] + [len(piece.mesh.vertices) for piece in pieces])[:-1]
    vertices = np.concatenate([piece.mesh.vertices for piece in pieces])
    faces = np.concatenate([piece.mesh.faces + np.int32(start) for piece, start in zip(pieces, starts, strict=True)])
    border = np.concatenate([piece.border + start for piece, start in zip(pieces, starts, strict=True)])
    _, first, inverse = np.unique(edge_keys(vertices[border], 1), return_index=True, return_inverse=True)
    stands_for = np.arange(len(vertices), dtype=np.int32)
    stands_for[border] = border[first][inverse]
    kept = stands_for == np.arange(len(vertices))
    number = (np.cumsum(kept, dtype=np.int32) - 1)[stands_for]
    return OpenMesh(vertices=vertices[kept], faces=number[faces])
