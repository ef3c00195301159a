"""Viewing mesh covered with photographs: each face shows its best one. No volume depends on it.

Photographs keep full resolution. Neighbouring faces with the same photograph form a chart, a piece of that photograph.
Its brightness and colour are levelled to the mean of all photographs (low frequencies only, so that no detail is
blurred). All charts are placed side by side in one picture. Along the seams one photograph fades into the next: each
photograph has a weight at every vertex, its share of the faces around, diffused over a few edges, and 0 if it does not
see all of them. Weights are linear between vertices, so both sides of a seam have the same weights and the same mean of
the photographs, and no step is visible.

The picture is compressed to a JPEG once and replaced by the decoded JPEG: memory and disk then hold the same picture.
"""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from PIL import Image
from scipy import ndimage
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from mammometry.base.machine.cores import in_bands
from mammometry.base.photograph import Photograph
from mammometry.base.progress import Progress, no_progress, part
from mammometry.base.value import value
from mammometry.geometry import Array, Bool, Float32, Float64, Int32, Int64, Rig, TriangleMesh, UInt8
from mammometry.geometry.nearest import barycentric, closest_on_mesh, closest_on_triangles
from mammometry.geometry.projection import projected
from mammometry.surface.repair.energy import graph_of_mesh, laplacian
from mammometry.surface.texture import texture_kernels
from mammometry.surface.texture.simplify import thinned
from mammometry.surface.texture.texture import UNSEEN, blended, picture_of, read_ahead, view_samples

TRIANGLES = 200_000
"""Triangles of the viewing mesh. The measured mesh keeps all of its own."""
ATLAS_PX = 8192
"""Largest width and height of the viewing mesh's picture, pixels."""
_PADDING_PX = 3  # margin around a chart's piece of photograph, for programs that interpolate between pixels
_SMOOTHING_ROUNDS = 12  # edges over which the weights are smoothed before faces choose; appearance only
_LEVEL_STEP_PX = 4  # grid on which the levelling of photographs is computed; appearance only
_LEVEL_PX = 6.0 * _LEVEL_STEP_PX  # σ of its smoothing: wider than any detail
_PLACES = 1 << 24  # different positions along a picture's side: finer than a float32
_MOST_REDUCED = 16  # largest factor by which photographs are reduced for the picture


@value(eq=False)
class Atlas:
    """A mesh for viewing, and the picture that covers it."""

    mesh: TriangleMesh
    """World frame, mm. Fewer triangles than the measured surface."""
    uv_px: Float32[Array, "m 3 2"]
    """Position of each face's corners in the picture, pixels, integers at pixel centres."""
    picture: UInt8[Array, "h w 3"]
    """sRGB-encoded. Mid grey where no camera sees the surface."""
    view: Int64[Array, " m"]
    """Number of the photograph that each face shows. −1 for none."""
    names: tuple[str, ...]
    """Cameras of these numbers."""
    jpeg: UInt8[Array, " b"] | None = None
    """Bytes of the JPEG that `picture` was decoded from. None if there is none."""

    def __post_init__(self) -> None:
        if self.uv_px.shape != (len(self.mesh.faces), 3, 2) or len(self.view) != len(self.mesh.faces):
            raise ValueError(f"{len(self.mesh.faces)} faces but {self.uv_px.shape} positions, {len(self.view)} views")

    def unwelded(self) -> tuple[Int64[Array, " n"], Int32[Array, "m 3"], Float64[Array, "n 2"]]:
        """The mesh with one vertex for each position in the picture, as drawing programs require.

        Returns:
            For each vertex, the index of the mesh's vertex; the faces; the position in the picture, 0…1 from its upper
            left corner to the right and down.
        """
        height, width = self.picture.shape[:2]
        places = (self.uv_px.reshape(-1, 2).astype(np.float64) + 0.5) / (width, height)
        rows = np.column_stack([self.mesh.faces.reshape(-1), np.rint(places * _PLACES)]).astype(np.int64)
        order = np.lexsort(rows.T[::-1])
        rows = rows[order]
        new = np.append(True, np.logical_or.reduce([np.diff(column) != 0 for column in rows.T]))[: len(rows)]
        number = np.empty(len(rows), dtype=np.int32)
        number[order] = np.cumsum(new, dtype=np.int32) - 1
        rows = rows[new]
        return rows[:, 0], number.reshape(-1, 3), rows[:, 1:] / _PLACES


def cover(
    surface: TriangleMesh, photographs: Mapping[str, Photograph], rig: Rig, *, progress: Progress = no_progress
) -> Atlas:
    """A surface simplified for viewing and covered with its photographs, world frame, mm."""
    mesh = thinned(surface, TRIANGLES)
    progress(0.1)
    names = tuple(name for name in photographs if name in rig.cameras)
    gains, weights, samples = view_samples(mesh, photographs, rig, progress=part(progress, 0.1, 0.5))
    view = best_views(mesh, weights)
    target = blended(weights, samples)
    photographed = [projected(rig.cameras[name], mesh.vertices)[:, :2] for name in names]
    step = 0
    while True:  # reduce photographs by means of step² pixels, until the picture is small enough for viewers
        step += 1
        pixels = [(uv + 0.5) / step - 0.5 for uv in photographed]
        sizes_wh = [(size[0] // step, size[1] // step) for size in (rig.cameras[name].size_wh for name in names)]
        charts = _charts(mesh, view, pixels, sizes_wh)
        corners, uv_px, size_wh = _laid_out(charts, len(mesh.faces))
        if max(size_wh) <= ATLAS_PX or step == _MOST_REDUCED:
            break
        step = min(-(-step * max(size_wh) // ATLAS_PX), _MOST_REDUCED) - 1
    sheet = np.full((size_wh[1], size_wh[0], 3), UNSEEN, dtype=np.uint8)
    fading = fading_pixels(mesh, view, fading_weights(mesh, view, weights > 0), uv_px, size_wh)
    mixed = np.zeros((len(fading.row), 3), dtype=np.float32)
    for k, (photograph, uv) in enumerate(zip(read_ahead(photographs, names), pixels, strict=True)):
        picture, seen = picture_of(photograph), weights[k] > 0
        shape_hw = (sizes_wh[k][1], sizes_wh[k][0])
        level = _levelling(uv[seen], (target - samples[k])[seen], shape_hw, _LEVEL_PX / step)
        shown, levelling = (picture.levels, picture.full_scale, step), (gains[k], level, _LEVEL_STEP_PX)
        for chart, (x, y) in zip(charts, corners, strict=True):
            if chart.view == k:
                cut = texture_kernels.pasted(shown, chart.low, chart.high, levelling)
                sheet[y : y + cut.shape[0], x : x + cut.shape[1]] = cut
        in_bands(partial(_mix_in, mixed, fading, k, uv, (shown, levelling)), len(mixed))
        progress(0.5 + 0.45 * (k + 1) / len(names))
    sheet[fading.row, fading.column] = np.rint(np.clip(mixed, 0.0, 1.0) * 255).astype(np.uint8)
    progress(1.0)
    return Atlas(mesh=mesh, uv_px=uv_px.astype(np.float32), picture=sheet, view=view, names=names)


def _mix_in(
    mixed: Float32[Array, "p 3"],
    fading: FadingPixels,
    k: int,
    uv: Float64[Array, "n 2"],
    how: tuple[Any, Any],
    band: slice,
) -> None:
    """Add a photograph's share to pixels that show several."""
    places = fading.shares[k, band], fading.corners[band], fading.between[band]
    texture_kernels.mix_in(mixed[band], *places, uv, *how)


def best_views(mesh: TriangleMesh, weights: Float32[Array, "k n"]) -> Int64[Array, " m"]:
    """Number of the best photograph of each face that sees all its corners. −1 for none.

    The weights are first smoothed over the mesh, so that charts become large and their borders short.
    """
    seen = weights > 0
    smooth = spread(weights.T.astype(np.float64), mesh, _SMOOTHING_ROUNDS)
    score = np.where(seen.T, np.maximum(smooth, 1e-9), -np.inf)[mesh.faces].min(axis=1)
    if not score.shape[1]:
        return np.full(len(mesh.faces), -1, dtype=np.int64)
    return np.where(np.isfinite(score.max(axis=1)), score.argmax(axis=1), -1)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Chart:
    """Connected faces that show one photograph, and their piece of it."""

    view: int
    faces: Int64[Array, " k"]
    inside: Float64[Array, "k 3 2"]
    """Positions of the faces' corners in the piece, pixels."""
    low: Int64[Array, 2]
    """First column and row of the piece in the photograph."""
    high: Int64[Array, 2]
    """Last column and row of the piece, plus one."""


def _charts(
    mesh: TriangleMesh,
    view: Int64[Array, " m"],
    pixels: Sequence[Float64[Array, "n 2"]],
    sizes_wh: Sequence[tuple[int, int]],
) -> list[_Chart]:
    """The charts of all photographs, and a last one for faces without a photograph."""
    group = _groups(mesh, view)
    charts = []
    for k, (uv, size_wh) in enumerate(zip(pixels, sizes_wh, strict=True)):
        shown = np.flatnonzero(view == k)
        for faces in _split(shown, group[shown]) if len(shown) else []:
            at = uv[mesh.faces[faces]]
            low = np.maximum(np.floor(at.min(axis=(0, 1))).astype(int) - _PADDING_PX, 0)
            high = np.minimum(np.ceil(at.max(axis=(0, 1))).astype(int) + _PADDING_PX + 1, size_wh)
            charts.append(_Chart(view=k, faces=faces, inside=at - low, low=low, high=high))
    blank = np.flatnonzero(view < 0)
    middle = np.full((len(blank), 3, 2), float(_PADDING_PX))
    low = np.zeros(2, dtype=np.int64)
    return [*charts, _Chart(view=-1, faces=blank, inside=middle, low=low, high=low + 2 * _PADDING_PX + 1)]


def _groups(mesh: TriangleMesh, view: Int64[Array, " m"]) -> Int64[Array, " m"]:
    """Number of each face's connected group with one view."""
    sides = np.sort(mesh.faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1).astype(np.int64)
    keys = sides[:, 0] * len(mesh.vertices) + sides[:, 1]
    order = np.argsort(keys, kind="stable")
    twins = np.flatnonzero(np.diff(keys[order]) == 0)
    a, b = order[twins] // 3, order[twins + 1] // 3
    same = view[a] == view[b]
    n = len(mesh.faces)
    graph = coo_matrix((np.ones(int(same.sum()), dtype=np.int8), (a[same], b[same])), shape=(n, n))
    return connected_components(graph, directed=False)[1].astype(np.int64)


def _split(items: Int64[Array, " k"], groups: Int64[Array, " k"]) -> list[Int64[Array, " j"]]:
    order = np.argsort(groups, kind="stable")
    return np.split(items[order], np.flatnonzero(np.diff(groups[order])) + 1)


def _levelling(
    uv: Float64[Array, "k 2"], difference: Float32[Array, "k 3"], shape_hw: tuple[int, ...], smooth_px: float
) -> Float32[Array, "a b 3"]:
    """Correction that levels a photograph to the mean of all, at every `_LEVEL_STEP_PX`-th pixel.

    Gaussian-weighted mean of the differences at vertices, with σ = `smooth_px`.
    """
    height, width = (-(-side // _LEVEL_STEP_PX) + 1 for side in shape_hw)
    row, column = np.clip(np.rint(uv[:, ::-1] / _LEVEL_STEP_PX).astype(int), 0, (height - 1, width - 1)).T
    flat = row * width + column
    sigma = smooth_px / _LEVEL_STEP_PX
    mass = np.bincount(flat, minlength=height * width).reshape(height, width)
    smooth_mass = np.maximum(ndimage.gaussian_filter(mass.astype(np.float64), sigma), 1e-9)
    result = np.empty((height, width, 3), dtype=np.float32)
    for channel in range(3):
        total = np.bincount(flat, difference[:, channel], minlength=height * width).reshape(height, width)
        result[..., channel] = ndimage.gaussian_filter(total, sigma) / smooth_mass
    return result


def _laid_out(
    charts: Sequence[_Chart], count: int
) -> tuple[Int64[Array, "c 2"], Float64[Array, "m 3 2"], tuple[int, int]]:
    """Arrange the charts in rows, tallest first, in a nearly square picture.

    Returns:
        Column and row of each piece's upper left corner, the positions of every face's corners, and the picture's width
        and height.
    """
    sizes = np.array([chart.high - chart.low for chart in charts])
    width = max(int(sizes[:, 0].max()), int(1.1 * np.sqrt(sizes.prod(axis=1).sum())))
    uv_px, places = np.zeros((count, 3, 2)), np.zeros((len(charts), 2), dtype=np.int64)
    x, y, shelf = 0, 0, 0
    for number in np.argsort(-sizes[:, 1], kind="stable"):
        across, height = sizes[number]
        if x + across > width:
            x, y, shelf = 0, y + shelf, 0
        places[number] = x, y
        uv_px[charts[number].faces] = charts[number].inside + places[number]
        x, shelf = x + across, max(shelf, height)
    return places, uv_px, (width, int(y + shelf))


_FADING_ROUNDS = 5  # edges over which one photograph fades into the next; appearance only
_LEAST_SHARE = 0.03  # least visible share of a photograph at a vertex; appearance only
_MARGIN_PX = 1.5  # margin around a face, for programs that interpolate between pixels
_LEAST_WEIGHT = 1e-6  # weight of a face's own photograph, which it shows where all weights are 0
_BAND_PX = 512  # rows of the picture that are processed at a time; limits memory


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FadingPixels:
    """The pixels of a covering picture that show more than one photograph."""

    row: Int32[Array, " p"]
    column: Int32[Array, " p"]
    corners: Int32[Array, "p 3"]
    """The vertices of each pixel's triangle."""
    between: Float32[Array, "p 3"]
    """Its barycentric coordinates. Slightly negative just outside the face."""
    shares: Float32[Array, "k p"]
    """Share of each photograph in each pixel. Shares of a pixel add up to 1."""


def spread(values: Float64[Array, "n k"], mesh: TriangleMesh, rounds: int) -> Float64[Array, "n k"]:
    """Diffuse values of the vertices over a few edges."""
    stiffness = laplacian(graph_of_mesh(mesh))
    degree = np.maximum(stiffness.diagonal(), 1.0)[:, None]
    for _ in range(rounds):
        values = values - 0.5 * (stiffness @ values) / degree
    return values


def fading_weights(mesh: TriangleMesh, view: Int64[Array, " m"], seen: Bool[Array, "k n"]) -> Float32[Array, "k n"]:
    """Weight of each photograph at each vertex, 0…1. Several are positive only near seams.

    Args:
        mesh: the viewing mesh.
        view: number of the photograph that each face shows, −1 for none.
        seen: whether each photograph sees each vertex.
    """
    shown = np.zeros((len(mesh.vertices), len(seen)))
    for k in range(len(seen)):
        shown[:, k] = np.bincount(mesh.faces[view == k].ravel(), minlength=len(mesh.vertices))
    share = spread(shown / np.maximum(shown.sum(axis=1, keepdims=True), 1.0), mesh, _FADING_ROUNDS)
    blind = np.zeros_like(seen)
    for k, sees in enumerate(seen):
        blind[k, mesh.faces[~sees[mesh.faces].all(axis=1)]] = True
    return np.where(blind, 0.0, np.maximum(share.T - _LEAST_SHARE, 0.0)).astype(np.float32)


def fading_pixels(
    mesh: TriangleMesh,
    view: Int64[Array, " m"],
    weights: Float32[Array, "k n"],
    uv_px: Float64[Array, "m 3 2"],
    size_wh: tuple[int, int],
) -> FadingPixels:
    """Pixels of faces that show several photographs, with all shares.

    Args:
        mesh: the viewing mesh.
        view: number of the photograph that each face shows, −1 for none.
        weights: weights from `fading_weights`.
        uv_px: positions of the faces' corners in the picture, pixels, integers at pixel centres.
        size_wh: size of the picture.
    """
    own = np.maximum(view, 0)
    elsewhere = weights.sum(axis=0)[mesh.faces] - weights[own[:, None], mesh.faces]
    faces = np.flatnonzero((view >= 0) & (elsewhere.max(axis=1) > 0))
    height, width = size_wh[1], size_wh[0]
    bands = [
        texture_kernels.deepest_triangles(uv_px[faces], first, min(first + _BAND_PX, height), width, _MARGIN_PX)
        for first in range(0, height, _BAND_PX)
    ]
    face, row, column, between = (np.concatenate(parts) for parts in zip(*bands, strict=True))
    corners = mesh.faces[faces[face]]
    shown = own[faces[face]].astype(np.int32)
    shares = texture_kernels.shares_of(weights, corners, between, shown, _LEAST_WEIGHT)
    return FadingPixels(row=row, column=column, corners=corners, between=between, shares=shares)


_QUALITY = 92  # quality of the JPEG, 1…100: keeps the viewer's file small; appearance only


def as_jpeg(atlas: Atlas) -> Atlas:
    """The atlas with the picture that its JPEG contains."""
    if atlas.jpeg is not None:
        return atlas
    buffer = io.BytesIO()
    Image.fromarray(np.asarray(atlas.picture)).save(buffer, "JPEG", quality=_QUALITY)
    jpeg = np.frombuffer(buffer.getvalue(), dtype=np.uint8)
    return replace(atlas, jpeg=jpeg, picture=_shown(jpeg))


def jpeg_of(atlas: Atlas) -> bytes:
    """The covering picture as a JPEG."""
    jpeg = as_jpeg(atlas).jpeg
    assert jpeg is not None
    return jpeg.tobytes()


def without_picture(atlas: Atlas) -> Atlas:
    """The atlas with its JPEG only, for storing."""
    return replace(as_jpeg(atlas), picture=np.zeros((0, 0, 3), dtype=np.uint8))


def with_picture(atlas: Atlas) -> Atlas:
    """The atlas with the picture that its JPEG contains.

    Raises:
        OSError: the JPEG is damaged.
    """
    return atlas if atlas.jpeg is None else replace(atlas, picture=_shown(atlas.jpeg))


def _shown(jpeg: UInt8[Array, " b"]) -> UInt8[Array, "h w 3"]:
    return np.asarray(Image.open(io.BytesIO(jpeg.tobytes()), formats=("JPEG",)).convert("RGB"))


def transferred(atlas: Atlas, mesh: TriangleMesh) -> Atlas:
    """Cover a mesh with the picture of an atlas.

    Each face belongs to the chart of the atlas's face nearest to its centre. A corner's position in the picture is that
    of its nearest face if this is in the same chart, otherwise (beyond a seam) the nearest position on the centre's
    face.

    Args:
        atlas: atlas of the viewing mesh.
        mesh: another mesh of the same surface or a part of it, mm, the same frame.

    Raises:
        ValueError: the atlas's mesh has no faces.
    """
    corners = mesh.corners()
    middle = closest_on_mesh(corners.mean(axis=1), atlas.mesh).faces
    nearest = closest_on_mesh(mesh.vertices, atlas.mesh)
    own = _places(atlas, nearest.faces, nearest.points)[mesh.faces]
    uv_px = np.empty_like(own)
    triangles, chart = atlas.mesh.corners()[middle], _picture_charts(atlas)
    for corner in range(3):
        on_middle = _places(atlas, middle, closest_on_triangles(corners[:, corner], triangles))
        same = chart[nearest.faces[mesh.faces[:, corner]]] == chart[middle]
        uv_px[:, corner] = np.where(same[:, None], own[:, corner], on_middle)
    return replace(atlas, mesh=mesh, uv_px=uv_px.astype(np.float32), view=atlas.view[middle])


def _picture_charts(atlas: Atlas) -> Int32[Array, " m"]:
    """Number of each face's chart: faces that touch each other in the picture as well."""
    origin, faces, _ = atlas.unwelded()
    start, end = faces[:, [0, 1]].ravel(), faces[:, [1, 2]].ravel()
    graph = coo_matrix((np.ones(len(start), dtype=bool), (start, end)), shape=(len(origin), len(origin)))
    chart: Int32[Array, " m"] = connected_components(graph, directed=False)[1][faces[:, 0]]
    return chart


def _places(atlas: Atlas, faces: Array, points: Float64[Array, "n 3"]) -> Float64[Array, "n 2"]:
    """Positions in the picture of points on faces, by their barycentric coordinates, pixels."""
    weights = barycentric(points, atlas.mesh.corners()[faces])
    found: Float64[Array, "n 2"] = np.einsum("nk,nkj->nj", weights, atlas.uv_px[faces].astype(np.float64))
    return found
