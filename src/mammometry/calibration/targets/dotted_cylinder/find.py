"""Find a dotted cylinder in one photograph. Columns are counted from the first one seen."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mammometry.base.photograph import Photograph
from mammometry.calibration.features.dots import measure_dots
from mammometry.calibration.features.found_points import Cause, FoundPoints
from mammometry.calibration.features.lattice import find_dots, index_lattice
from mammometry.calibration.features.mark_size import mark_size
from mammometry.calibration.features.pixels import enlarge, grey_bytes, linear_luma, reduced
from mammometry.calibration.targets.dotted_cylinder.unrolled import CylinderMap, fit_cylinder_map
from mammometry.calibration.targets.kinds.cylinder import DottedCylinderTarget
from mammometry.geometry.arrays import Array, Float32, Float64, Int64, UInt8

_SEARCH_WIDTHS = 3
"""Factor on the width of the searched picture compared with boards: dots near the limb are narrow."""
_NEIGHBOURHOODS = (0.04, 0.12)
"""Neighbourhoods in which a dot is darker than the mean, picture widths: larger than a dot, smaller than the cylinder.
"""
_MIN_FACING = 0.5
"""Dots seen more aslant than 60° are left out: the target's own form errors show there in full."""
_START_FACING = 0.3
"""Least cosine between a dot's normal and the line of sight while the cylinder is located. Chosen by eye."""
_START_HALF = 0.18
"""Starting half side of a dot of unknown size, in pitches. Chosen by eye."""
_MIN_ROW_DOTS = 3
"""Fewest dots that make a row. Chosen by eye."""
_ROUNDS = 2
"""Measurements, each with the map of the one before. Chosen by eye."""
_SIZE_OFF = 0.1
"""Share by which dots may differ from their stated size: rulers and ink err by .5 mm of a small dot."""
_LABEL_HEIGHTS = (0.4, 1.4)
"""The labels' strip beyond the last row, in row pitches."""
_STRIP_SAMPLES = 24
"""Samples of the strip per column pitch, and over its height."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CylinderView(FoundPoints):
    """The dots in one photograph. Columns count from 0 at the leftmost dot that faces the camera."""

    target: DottedCylinderTarget
    columns: Int64[Array, " n"]
    """Column of each dot. May run on beyond the target's last one."""
    labels: Float32[Array, "s w"]
    """Darkness of the strip beyond the last row, 0…1, unrolled: `_STRIP_SAMPLES` of its columns per column of dots."""
    label_weight: Float32[Array, " w"]
    """Visibility of each place of the strip: 0 if it faces away, 1 if it faces the camera."""
    first_label_column: int
    """Column, in this view's numbering, with its dots in the middle of the strip's first `_STRIP_SAMPLES`."""

    def starting_at(self, first_column: int) -> FoundPoints:
        """Dots by their final ids, given the number of column 0. Column 0 is this view's."""
        around = self.target.dots[1]
        ids = self.ids // around * around + (first_column + self.columns) % around
        order = np.argsort(ids)
        return FoundPoints(ids=ids[order], uv=self.uv[order], covariance_px2=self.covariance_px2[order])


def find_cylinder(
    photograph: Photograph, target: DottedCylinderTarget, *, search_width_px: int
) -> CylinderView | Cause | None:
    """Find the dots and measure their centres.

    None where the cylinder is not seen with all its rows, the cause where its dots have another size. The
    cylinder must stand upright in the picture within about 40°, its labelled end up.
    """
    small, scale = reduced(grey_bytes(photograph), _SEARCH_WIDTHS * search_width_px)
    starts = (_locate(small, scale, target, neighbourhood) for neighbourhood in _NEIGHBOURHOODS)
    start = next((found for found in starts if found is not None), None)
    if start is None:
        return None
    linear = linear_luma(photograph)
    pitch_mm = np.array([target.column_pitch_mm, target.row_pitch_mm])
    half_mm = target.dot_mm / 2 if target.dot_mm else _START_HALF * float(pitch_mm.min())
    cylinder, last_row, (first, last) = start
    row, column = (grid.ravel() for grid in np.mgrid[0 : last_row + 1, first : last + 1])
    unrolled = np.stack([column, row], axis=1) * pitch_mm
    if target.dot_mm is not None:
        nearest_mm = float(pitch_mm.min())
        facing = unrolled[cylinder.facing(unrolled) > _MIN_FACING]
        size = mark_size(linear, cylinder.image, facing, shape="square", reach_mm=nearest_mm / 2)
        if size is not None and size.contradicts(half_mm, _SIZE_OFF):
            pitch_key = "row_pitch_mm" if target.row_pitch_mm == nearest_mm else "column_pitch_mm"
            return size.cause(("dot_mm", target.dot_mm), (pitch_key, nearest_mm))
    for round_ in range(_ROUNDS):
        faces = cylinder.facing(unrolled) > _MIN_FACING
        places = unrolled[faces]
        dots = measure_dots(
            linear,
            cylinder.image,
            places,
            shape="square",
            half_mm=half_mm,
            pitch_mm=(float(pitch_mm[0]), float(pitch_mm[1])),
        )
        if dots.ok.sum() < 2 * _MIN_ROW_DOTS:
            return None
        if target.dot_mm is None:
            half_mm = 0.5 * float(np.sqrt(np.median(dots.mass_mm2[dots.ok])))
        fitted = fit_cylinder_map(target, places[dots.ok], dots.uv[dots.ok])
        if fitted is None:
            return None
        if round_ < _ROUNDS - 1:
            cylinder = fitted[0]
    # A dot far from where its neighbours put it was covered or smeared; a row that was printed aslant is not.
    error_px = np.linalg.norm(cylinder.image(places) - dots.uv, axis=1)
    size_px = np.sqrt(np.abs(np.linalg.det(cylinder.jacobian(places)))) * 2 * half_mm
    good = dots.ok & (error_px < 0.2 * size_px)
    if good.sum() < 2 * _MIN_ROW_DOTS:
        return None
    lattice = np.rint(places[good] / pitch_mm).astype(np.int64)
    leftmost = int(lattice[:, 0].min())
    labels, weight = _unroll_labels(linear, cylinder, first, last)
    columns, around = lattice[:, 0] - leftmost, target.dots[1]
    ids = lattice[:, 1] * around + columns % around
    order = np.argsort(ids)
    return CylinderView(
        target=target,
        ids=ids[order],
        columns=columns[order],
        uv=dots.uv[good][order],
        covariance_px2=dots.covariance_px2[good][order],
        labels=labels,
        label_weight=weight,
        first_label_column=first - leftmost,
    )


def _locate(
    small: UInt8[Array, "h w"], scale: Float64[Array, 2], target: DottedCylinderTarget, neighbourhood: float
) -> tuple[CylinderMap, int, tuple[int, int]] | None:
    """Locate the cylinder from blobs alone.

    Returns its map, last row, and first and last columns that may be seen.
    """
    blobs = find_dots(small, neighbourhood)
    points, places = index_lattice(blobs)
    uv = enlarge(blobs[points], scale)
    pitch_mm = np.array([target.column_pitch_mm, target.row_pitch_mm])
    for _ in range(2):
        unrolled = places[:, ::-1] * pitch_mm
        found = fit_cylinder_map(target, unrolled, uv)
        if found is None:
            return None
        cylinder, used = found
        used &= cylinder.facing(unrolled) > _START_FACING
        uv, places = uv[used], places[used]
        if not len(places):
            return None
        count = np.bincount(places[:, 0])
        full = np.flatnonzero(count >= _MIN_ROW_DOTS)
        if not len(full) or full[-1] - full[0] + 1 != target.dots[0]:
            return None
        keep = (places[:, 0] >= full[0]) & (places[:, 0] <= full[-1])
        uv, places = uv[keep], places[keep] - np.array([full[0], 0])
    columns = places[:, 1]
    return cylinder, target.dots[0] - 1, (int(columns.min()) - 1, int(columns.max()) + 1)


def _unroll_labels(
    linear: Float32[Array, "h w"], cylinder: CylinderMap, first: int, last: int
) -> tuple[Float32[Array, "s k"], Float32[Array, " k"]]:
    target = cylinder.target
    across = first - 0.5 + (np.arange((last - first + 1) * _STRIP_SAMPLES) + 0.5) / _STRIP_SAMPLES
    low, high = _LABEL_HEIGHTS
    up = target.dots[0] - 1 + low + (high - low) * (np.arange(_STRIP_SAMPLES) + 0.5) / _STRIP_SAMPLES
    arc, height = np.meshgrid(across * target.column_pitch_mm, up * target.row_pitch_mm)
    unrolled = np.stack([arc, height], axis=-1)
    uv = cylinder.image(unrolled)
    column, row = np.floor(uv[..., 0]).astype(np.int64), np.floor(uv[..., 1]).astype(np.int64)
    inside = (column >= 0) & (row >= 0) & (column < linear.shape[1] - 1) & (row < linear.shape[0] - 1)
    column, row = np.where(inside, column, 0), np.where(inside, row, 0)
    fx, fy = uv[..., 0] - column, uv[..., 1] - row
    value = (linear[row, column] * (1 - fx) + linear[row, column + 1] * fx) * (1 - fy)
    value += (linear[row + 1, column] * (1 - fx) + linear[row + 1, column + 1] * fx) * fy
    facing = cylinder.facing(unrolled)
    seen = (inside & (facing > _START_FACING)).all(axis=0)
    white = np.maximum(np.percentile(value, 90, axis=0), 1e-6)
    darkness = np.where(seen, np.clip(1.0 - value / white, 0.0, 1.0), 0.0)
    return darkness.astype(np.float32), np.where(seen, facing.min(axis=0), 0.0).astype(np.float32)
