"""Disagreement of pairs, in cells: distances on common skin, and vertical disparities."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from mammometry.base.machine.cores import map_in_threads
from mammometry.base.value import value
from mammometry.geometry import Array, Camera, Float64, Int64
from mammometry.matching.dense.match import DisparityMap
from mammometry.surface.ranges.range_image import RangeImage, thinned_camera
from mammometry.surface.ranges.visibility import LEAST_COSINE, CommonSkin, ComparedView, common_skin
from mammometry.surface.settings import TAPER_MM

_CELL_MM = 16.0
"""Edge of the cells, mm: several matching windows, so that errors of two cells are nearly independent. Not critical."""
_SPACING_MM = 0.8  # distance between the data that are compared; limits time
_FEWEST_DATA = 6  # fewest data in a cell for a median; not critical
OTHER_SKIN_MM = 4.0
"""Distance from which two pairs see different skin, such as an arm in front of the trunk, mm: more than any motion that
is corrected (`StillnessSettings.most_mm`)."""
_INSIDE = 0.99  # weight (`RangeImage.trust`) of data away from the edge
_MEDIAN_FACTOR = 1.2533  # standard deviation of a median over the mean's, √(π/2)
_ROW_CELLS = 6  # cells along each side of a pair's image: the vertical disparity has only six terms
_FEWEST_ROWS = 50  # fewest pixels in such a cell for a median; not critical


@value(eq=False)
class Differences:
    """Median distance between two pairs' surfaces in each cell of common skin."""

    first: str
    second: str
    """Names of the pairs."""
    points: Float64[Array, "n 3"]
    """World frame, mm."""
    normals: Float64[Array, "n 3"]
    """Outward, world frame."""
    distance_mm: Float64[Array, " n"]
    """Distance of the first surface in front of the second, along the normal."""
    scatter_mm: Float64[Array, " n"]
    """Standard deviation of that median from the scatter within the cell. Data are assumed to be independent."""
    expected_mm: Float64[Array, " n"]
    """Median expected standard deviation of both pairs' data."""


@value(eq=False)
class RowErrors:
    """Median vertical disparity of a pair in each cell of its image."""

    points: Float64[Array, "n 3"]
    """Points of the skin, world frame, mm."""
    angle_rad: Float64[Array, " n"]
    """Angle of the right ray to the epipolar plane (`shifts.Shifts.vertical_rad`)."""
    pixel_rad: float
    """Angle of a pixel of the rectified image at full resolution."""


def differences(range_images: Sequence[RangeImage], other_skin_mm: float = OTHER_SKIN_MM) -> tuple[Differences, ...]:
    """Distances between any two views on skin that both see well. Views without common skin are left out.

    Args:
        range_images: one for each pair.
        other_skin_mm: distance from which two views are assumed to see different skin.
    """

    def prepared(image: RangeImage) -> ComparedView:
        return ComparedView.of(_thinned(image.keeping(image.trust(TAPER_MM) > _INSIDE)))

    def compared(both: tuple[ComparedView, ComparedView]) -> Differences | None:
        view, other = both
        forth = _well_seen(common_skin(view, other), 1.0, other_skin_mm)
        back = _well_seen(common_skin(other, view), -1.0, other_skin_mm)
        return _in_cells(view.image.name, other.image.name, *map(np.concatenate, zip(forth, back, strict=True)))

    views = map_in_threads(prepared, range_images)
    found = map_in_threads(compared, list(itertools.combinations(views, 2)))
    return tuple(both for both in found if both is not None)


def _thinned(image: RangeImage) -> RangeImage:
    """Every few rows and columns. The windows for normals are wider."""
    step = max(1, int(_SPACING_MM / image.pixel_mm())) if image.valid.any() else 1
    thin = (slice(None, None, step), slice(None, None, step))
    return replace(
        image,
        camera=thinned_camera(image.camera, step),
        range_mm=np.ascontiguousarray(image.range_mm[thin]),
        sigma_mm=np.ascontiguousarray(image.sigma_mm[thin]),
        confidence=np.ascontiguousarray(image.confidence[thin]),
        valid=np.ascontiguousarray(image.valid[thin]),
    )


def _well_seen(
    common: CommonSkin, sign: float, other_skin_mm: float
) -> tuple[Float64[Array, "n 3"], Float64[Array, "n 3"], Float64[Array, " n"], Float64[Array, " n"]]:
    well = (common.own_cosine > LEAST_COSINE) & (np.abs(common.distance_mm) < other_skin_mm)
    return common.points[well], common.normals[well], sign * common.distance_mm[well], common.sigma_mm[well]


def _in_cells(
    first: str,
    second: str,
    points: Float64[Array, "n 3"],
    normals: Float64[Array, "n 3"],
    apart: Float64[Array, " n"],
    sigma: Float64[Array, " n"],
) -> Differences | None:
    """Means and medians of the cells with enough points. None without such a cell."""
    if not len(points):
        return None
    cells = np.floor(points / _CELL_MM).astype(np.int64)
    cells -= cells.min(axis=0)
    number = np.ravel_multi_index(tuple(cells.T), tuple(cells.max(axis=0) + 1))
    _, number, counts = np.unique(number, return_inverse=True, return_counts=True)
    enough = counts >= _FEWEST_DATA
    if not enough.any():
        return None

    def mean(values: Float64[Array, " n"]) -> Float64[Array, " k"]:
        return np.bincount(number, values) / counts

    def median(values: Float64[Array, " n"]) -> Float64[Array, " k"]:
        ordered = values[np.lexsort((values, number))]
        begin = np.cumsum(counts) - counts
        return 0.5 * (ordered[begin + (counts - 1) // 2] + ordered[begin + counts // 2])

    normal = np.stack([mean(axis) for axis in normals.T], axis=1)[enough]
    std = np.sqrt(mean((apart - mean(apart)[number]) ** 2))
    return Differences(
        first=first,
        second=second,
        points=np.stack([mean(axis) for axis in points.T], axis=1)[enough],
        normals=normal / np.linalg.norm(normal, axis=1, keepdims=True),
        distance_mm=median(apart)[enough],
        scatter_mm=(_MEDIAN_FACTOR * std / np.sqrt(counts))[enough],
        expected_mm=median(sigma)[enough],
    )


def row_errors(disparity: DisparityMap) -> RowErrors:
    """Medians of a pair's vertical disparity over its matched image."""
    left, right = disparity.left, disparity.right
    focal_px = disparity.pair_px * float(right.matrix[1, 1])
    parts = [_in_parts(np.flatnonzero(disparity.valid.any(axis=axis))) for axis in (1, 0)]
    places, angles = [], []
    for rows, columns in itertools.product(*parts):
        valid = disparity.valid[rows, columns]
        inside = np.flatnonzero(valid)
        if len(inside) >= _FEWEST_ROWS:
            row, column = np.unravel_index(inside[len(inside) // 2], valid.shape)
            at = int(row) + rows.start, int(column) + columns.start
            point = _point(left, right, at, float(disparity.d_h_px[at]))
            places.append(point)
            angles.append(_angle(right, point, float(np.median(disparity.d_v_px[rows, columns][valid]))))
    return RowErrors(
        points=np.array(places).reshape(-1, 3), angle_rad=np.array(angles, dtype=np.float64), pixel_rad=1 / focal_px
    )


def _in_parts(used: Int64[Array, " n"]) -> list[slice]:
    """Divide rows or columns equally, from the first used one to the last."""
    if not len(used):
        return []
    edges = np.ceil(np.linspace(used[0], used[-1] + 1, _ROW_CELLS + 1)).astype(int)
    return [slice(int(first), int(last)) for first, last in itertools.pairwise(edges)]


def _point(left: Camera, right: Camera, at: tuple[int, int], d_h_px: float) -> Float64[Array, 3]:
    """Point seen by a rectified pixel and its match, world frame, mm."""
    row, column = at
    baseline_mm = float(np.linalg.norm(right.centre_world - left.centre_world))
    columns_apart = (column - left.matrix[0, 2]) - (column - d_h_px - right.matrix[0, 2])
    depth_mm = baseline_mm * left.matrix[0, 0] / columns_apart
    x, y = left.normalised_from_pixels(np.array([[float(column), float(row)]]))[0]
    point: Float64[Array, 3] = left.camera_from_world.inverse().apply(depth_mm * np.array([x, y, 1.0]))
    return point


def _angle(right: Camera, point: Float64[Array, 3], d_v_px: float) -> float:
    """Vertical disparity as an angle of rotation of the epipolar plane about the baseline."""
    x, y, z = right.camera_from_world.apply(point)
    from_baseline = float(np.hypot(y, z))
    return (
        d_v_px / float(right.matrix[1, 1]) * (z / from_baseline) ** 2 * from_baseline / float(np.linalg.norm([x, y, z]))
    )
