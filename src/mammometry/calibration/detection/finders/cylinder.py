"""Find a dotted cylinder in photographs, with consistent column numbers.

In one photograph, columns are counted from the first one seen. The labels beyond the last row are not decoded. Instead,
the unrolled label strips of two photographs are correlated at all offsets of whole columns. Photographs are then
numbered along the tree of the best pairs. The first column is arbitrary; it only rotates the world about the axis.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from mammometry.base.errors import CalibrationError
from mammometry.base.normal import MAD
from mammometry.base.photograph import Photograph
from mammometry.calibration.features.board_map import fit_polynomial, monomials
from mammometry.calibration.features.dots import ROUNDS, SIZE_OFF, mark_size, measure_dots
from mammometry.calibration.features.lattice import find_dots, index_lattice
from mammometry.calibration.features.pixels import Cause, FoundPoints, enlarge, grey_bytes, linear_luma, reduced
from mammometry.calibration.targets.kinds.cylinder import DottedCylinderTarget
from mammometry.geometry.arrays import Array, Bool, Float32, Float64, Int64, UInt8

_MAP_ROUNDS = 4
"""Fits of projection and lens in turn. Assumed; their effect has not been measured."""
_LEAST = 24
"""Fewest dots for a map: 48 equations for 31 unknowns, eleven of the projection and twenty of the lens."""
_FORM_TOLERANCE = 0.05
"""Largest distance of a dot from its place, as a share of the pitch: irregular prints and wrapped sheets reach it."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CylinderMap:
    """A smooth map from the unrolled surface, mm, to the photograph, pixels.

    Unrolled coordinates are along the arc and along the axis.
    """

    target: DottedCylinderTarget
    projection: Float64[Array, "3 4"]
    """To ideal pixels, those of a lens without distortion."""
    to_ideal: Float64[Array, "10 2"]
    to_distorted: Float64[Array, "10 2"]
    centre_px: Float64[Array, 2]
    scale_px: float

    def image(self, unrolled_mm: Float64[Array, "*n 2"]) -> Float64[Array, "*n 2"]:
        """Distorted pixels of points of the surface."""
        ideal = _project(self.projection, self.target.on_surface(unrolled_mm[..., 0], unrolled_mm[..., 1]))
        return ideal + monomials((ideal - self.centre_px) / self.scale_px) @ self.to_distorted

    def jacobian(self, unrolled_mm: Float64[Array, "*n 2"]) -> Float64[Array, "*n 2 2"]:
        """Derivative of uv by unrolled coordinates, pixels per mm. Column j belongs to coordinate j."""
        step_mm = 0.2
        steps = np.eye(2) * step_mm
        columns = [(self.image(unrolled_mm + step) - self.image(unrolled_mm - step)) / (2 * step_mm) for step in steps]
        return np.stack(columns, axis=-1)

    def facing(self, unrolled_mm: Float64[Array, "*n 2"]) -> Float64[Array, "*n"]:
        """Cosine between the surface's outward normal and the camera direction."""
        centre_mm = -np.linalg.solve(self.projection[:, :3], self.projection[:, 3])
        points = self.target.on_surface(unrolled_mm[..., 0], unrolled_mm[..., 1])
        towards = centre_mm - points
        towards /= np.linalg.norm(towards, axis=-1, keepdims=True)
        outward = points[..., :2] / self.target.radius_mm
        cosine: Float64[Array, "*n"] = (towards[..., :2] * outward).sum(axis=-1)
        return cosine


def fit_cylinder_map(
    target: DottedCylinderTarget, unrolled_mm: Float64[Array, "n 2"], uv: Float64[Array, "n 2"]
) -> tuple[CylinderMap, Bool[Array, " n"]] | None:
    """Fit the map robustly. Also returns the mask of dots that it explains. None if it explains too few."""
    points = target.on_surface(unrolled_mm[:, 0], unrolled_mm[:, 1])
    used = np.ones(len(uv), bool)
    if len(uv) < _LEAST:
        return None
    centre_px = uv.mean(axis=0)
    scale_px = float(np.abs(uv - centre_px).max())
    to_ideal, to_distorted = np.zeros((10, 2)), np.zeros((10, 2))
    for round_ in range(_MAP_ROUNDS):
        if used.sum() < max(_LEAST, 0.5 * len(uv)):
            return None
        ideal = uv + monomials((uv - centre_px) / scale_px) @ to_ideal
        projection = _direct_linear(points[used], ideal[used])
        projected = _project(projection, points)
        if round_:
            to_ideal = fit_polynomial((uv[used] - centre_px) / scale_px, projected[used] - uv[used], 10)
            argument = (projected[used] - centre_px) / scale_px
            to_distorted = fit_polynomial(argument, uv[used] - projected[used], 10)
        fitted = CylinderMap(
            target=target,
            projection=projection,
            to_ideal=to_ideal,
            to_distorted=to_distorted,
            centre_px=centre_px,
            scale_px=scale_px,
        )
        error = np.linalg.norm(fitted.image(unrolled_mm) - uv, axis=1)
        pitch_px = np.abs(np.linalg.det(fitted.jacobian(unrolled_mm))) ** 0.5 * target.row_pitch_mm
        used = error < np.maximum(5.0 * MAD * np.median(error), _FORM_TOLERANCE * pitch_px)
    return fitted, used


def _direct_linear(points: Float64[Array, "n 3"], uv: Float64[Array, "n 2"]) -> Float64[Array, "3 4"]:
    """Projective camera by the normalised direct linear transform. Positive depth, unit third row."""
    middle, spread = points.mean(axis=0), float(np.abs(points - points.mean(axis=0)).max())
    centre, scale = uv.mean(axis=0), float(np.abs(uv - uv.mean(axis=0)).max())
    homogeneous = np.column_stack([(points - middle) / spread, np.ones(len(points))])
    image = (uv - centre) / scale
    zero = np.zeros_like(homogeneous)
    rows = np.concatenate(
        [
            np.column_stack([homogeneous, zero, -image[:, :1] * homogeneous]),
            np.column_stack([zero, homogeneous, -image[:, 1:] * homogeneous]),
        ]
    )
    _, vectors = np.linalg.eigh(rows.T @ rows)
    to_points = np.diag([1 / spread, 1 / spread, 1 / spread, 1.0])
    to_points[:3, 3] = -middle / spread
    from_image = np.array([[scale, 0, centre[0]], [0, scale, centre[1]], [0, 0, 1.0]])
    projection = from_image @ vectors[:, 0].reshape(3, 4) @ to_points
    projection /= np.linalg.norm(projection[2, :3])
    depth = np.column_stack([points, np.ones(len(points))]) @ projection[2]
    return projection if np.median(depth) > 0 else -projection


def _project(projection: Float64[Array, "3 4"], points: Float64[Array, "*n 3"]) -> Float64[Array, "*n 2"]:
    homogeneous = points @ projection[:, :3].T + projection[:, 3]
    return homogeneous[..., :2] / homogeneous[..., 2:]


_SEARCH_WIDTHS = 3
"""Factor on the width of the searched image, compared with boards: dots near the limb are narrow."""
_NEIGHBOURHOODS = (0.04, 0.12)
"""Neighbourhoods whose mean a dot must be darker than, image widths: larger than a dot, smaller than the cylinder."""
_MIN_FACING = 0.5
"""Dots seen at more than 60° are excluded: form errors of the target have their full effect there."""
_START_FACING = 0.3
"""Least cosine between a dot's normal and the line of sight while the cylinder is located. Below `_MIN_FACING`,
because the first position is inexact."""
_START_HALF = 0.18
"""Starting half side of a dot of unknown size, in pitches. Assumed."""
_MIN_ROW_DOTS = 3
"""Fewest dots that make a row: two are always on a line."""
_LABEL_HEIGHTS = (0.4, 1.4)
"""The labels' strip beyond the last row, in row pitches."""
_STRIP_SAMPLES = 24
"""Samples of the strip per column pitch, and over its height."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CylinderView(FoundPoints):
    """The dots in one photograph. Columns count from 0 at the leftmost dot that faces the camera."""

    target: DottedCylinderTarget
    columns: Int64[Array, " n"]
    """Column of each dot. May exceed the target's last one."""
    labels: Float32[Array, "s w"]
    """Darkness of the strip beyond the last row, 0…1, unrolled: `_STRIP_SAMPLES` samples per column."""
    label_weight: Float32[Array, " w"]
    """Visibility of each sample of the strip: 0 facing away, 1 facing the camera."""
    first_label_column: int
    """Column whose dots are in the middle of the strip's first `_STRIP_SAMPLES`."""

    def starting_at(self, first_column: int) -> FoundPoints:
        """Dots with final ids, given the final number of this view's column 0."""
        around = self.target.dots[1]
        ids = self.ids // around * around + (first_column + self.columns) % around
        order = np.argsort(ids)
        return FoundPoints(ids=ids[order], uv=self.uv[order], covariance_px2=self.covariance_px2[order])


def find_cylinder(
    target: DottedCylinderTarget, photograph: Photograph, search_width_px: int
) -> CylinderView | Cause | None:
    """Find the dots and measure their centres.

    None if the cylinder is not seen with all its rows, a cause if its dots have another size. The cylinder must be
    upright in the image within about 40°, its labelled end up.
    """
    small, scale = reduced(grey_bytes(photograph), _SEARCH_WIDTHS * search_width_px)
    starts = (_locate(small, scale, target, neighbourhood) for neighbourhood in _NEIGHBOURHOODS)
    start = next((found for found in starts if found is not None), None)
    if start is None:
        return None
    linear = linear_luma(photograph)
    pitch_mm = np.array([target.column_pitch_mm, target.row_pitch_mm])
    half_mm = target.dot_mm / 2 if target.dot_mm else _START_HALF * float(pitch_mm.min())
    cylinder, (first, last) = start
    row, column = (grid.ravel() for grid in np.mgrid[0 : target.dots[0], first : last + 1])
    unrolled = np.stack([column, row], axis=1) * pitch_mm
    if target.dot_mm is not None:
        nearest_mm = float(pitch_mm.min())
        facing = unrolled[cylinder.facing(unrolled) > _MIN_FACING]
        size = mark_size(linear, cylinder.image, facing, shape="square", reach_mm=nearest_mm / 2)
        if size is not None and size.contradicts(half_mm, SIZE_OFF):
            pitch_key = "row_pitch_mm" if target.row_pitch_mm == nearest_mm else "column_pitch_mm"
            return size.cause(("dot_mm", target.dot_mm), (pitch_key, nearest_mm))
    for round_ in range(ROUNDS):
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
        fitted = fit_cylinder_map(target, places[dots.ok], dots.uv[dots.ok])
        if fitted is None:
            return None
        if target.dot_mm is None:
            half_mm = 0.5 * float(np.sqrt(np.median(dots.mass_mm2[dots.ok])))
        if round_ < ROUNDS - 1:
            cylinder = fitted[0]
    # A dot far from its neighbours' prediction was covered or smeared; a row that was printed askew is not far.
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
) -> tuple[CylinderMap, tuple[int, int]] | None:
    """Locate the cylinder from blobs: its map, and the first and last columns that may be visible."""
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
        count = np.bincount(places[:, 0])
        full = np.flatnonzero(count >= _MIN_ROW_DOTS)
        if not len(full) or full[-1] - full[0] + 1 != target.dots[0]:
            return None
        keep = (places[:, 0] >= full[0]) & (places[:, 0] <= full[-1])
        uv, places = uv[keep], places[keep] - np.array([full[0], 0])
    columns = places[:, 1]
    return cylinder, (int(columns.min()) - 1, int(columns.max()) + 1)


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


_MIN_COMMON_COLUMNS = 2
"""Fewest columns that both photographs must show: a single label may resemble another."""
_MIN_CORRELATION = 0.5
"""Least correlation of two strips with the same labels. Assumed; its effect has not been measured."""
_MIN_MARGIN = 0.1
"""The best offset must correlate by this much more than the next."""
_WIGGLE = 3
"""Largest shift of the labels from their predicted position, samples (an eighth of a column)."""


def numbered_alike(found: Mapping[str, FoundPoints]) -> Mapping[str, FoundPoints]:
    """Number the columns of all photographs consistently. Points from a table keep their ids.

    Raises:
        CalibrationError: a photograph's labels match no other's, or there are more columns than on the target.
    """
    views = {name: seen for name, seen in found.items() if isinstance(seen, CylinderView)}
    starts = number_columns(views)
    return {**found, **{name: view.starting_at(starts[name]) for name, view in views.items()}}


def number_columns(views: Mapping[str, CylinderView]) -> Mapping[str, int]:
    """Common number of each view's column 0. The first view's is 0, unless another begins before it.

    Raises:
        CalibrationError: a photograph's labels match no other's, or there are more columns than on the target.
    """
    if not views:
        return {}
    names = list(views)
    target = views[names[0]].target
    around = target.dots[1] if target.closes else None
    pairs: list[tuple[float, int, str, str]] = []
    for k, a in enumerate(names):
        for b in names[k + 1 :]:
            offset, score = _best_offset(views[a], views[b], around)
            if score > 0:
                pairs.append((score, offset, a, b))
    start = {names[0]: 0}
    while len(start) < len(names):
        # Prim's tree: the best pair of a numbered and a new photograph.
        joining = [pair for pair in pairs if (pair[2] in start) != (pair[3] in start)]
        if not joining:
            lost = ", ".join(name for name in names if name not in start)
            raise CalibrationError(
                f"columns of the dotted cylinder in {lost}",
                found=f"labels above the top row that match none of {', '.join(start)}",
                expected="at least two labels in common with another photograph",
                remedy="Photograph the cylinder upright, with its labels and some columns seen by both cameras",
            )
        _, offset, a, b = max(joining)
        if a in start:
            start[b] = start[a] + offset
        else:
            start[a] = start[b] - offset
    return _within_target(start, views, target)


def _within_target(
    start: Mapping[str, int], views: Mapping[str, CylinderView], target: DottedCylinderTarget
) -> Mapping[str, int]:
    columns = target.dots[1]
    if target.closes:
        return {name: first % columns for name, first in start.items()}
    least = min(start.values())
    shifted = {name: first - least for name, first in start.items()}
    most = max(first + int(views[name].columns.max()) for name, first in shifted.items())
    if most >= columns:
        raise CalibrationError(
            "columns of the dotted cylinder",
            found=f"{most + 1} columns in all photographs together",
            expected=f"at most {columns}, as in [target] dots",
            remedy="Correct the number of columns in session.toml, or remove photographs of another target",
        )
    return shifted


def _best_offset(a: CylinderView, b: CylinderView, around: int | None) -> tuple[int, float]:
    """Offset of column 0 of `b` in columns of `a`, and its score. The score is 0 if ambiguous."""
    samples = len(a.labels)
    width_a, width_b = a.labels.shape[1] // samples, b.labels.shape[1] // samples
    scores: dict[int, float] = {}
    for shift in range(-width_b + _MIN_COMMON_COLUMNS, width_a - _MIN_COMMON_COLUMNS + 1):
        # Strip b is shifted so that its first column is at strip a's column `shift`.
        offset = shift + a.first_label_column - b.first_label_column
        score = _correlate(a, b, shift * samples)
        key = offset % around if around else offset
        scores[key] = max(score, scores.get(key, -1.0))
    if not scores:
        return 0, 0.0
    ranked = sorted(scores.items(), key=lambda item: -item[1])
    best, score = ranked[0]
    second = ranked[1][1] if len(ranked) > 1 else 0.0
    sure = score >= _MIN_CORRELATION and score - max(second, 0.0) >= _MIN_MARGIN
    return best, score if sure else 0.0


def _correlate(a: CylinderView, b: CylinderView, shift: int) -> float:
    """Weighted correlation of the strips where both are visible. The best within ± `_WIGGLE` samples."""
    best = -1.0
    for small in range(-_WIGGLE, _WIGGLE + 1):
        first_a, first_b = max(shift + small, 0), max(-shift - small, 0)
        length = min(a.labels.shape[1] - first_a, b.labels.shape[1] - first_b)
        part_a, part_b = slice(first_a, first_a + length), slice(first_b, first_b + length)
        weight = a.label_weight[part_a] * b.label_weight[part_b]
        if (weight > 0).sum() < _MIN_COMMON_COLUMNS * len(a.labels):
            continue
        best = max(best, _zncc(a.labels[:, part_a], b.labels[:, part_b], weight))
    return best


def _zncc(a: Float32[Array, "s w"], b: Float32[Array, "s w"], weight: Float32[Array, " w"]) -> float:
    weights = np.broadcast_to(weight, a.shape).astype(np.float64)
    weights = weights / weights.sum()
    a0, b0 = a - (weights * a).sum(), b - (weights * b).sum()
    spread = float((weights * a0 * a0).sum() * (weights * b0 * b0).sum())
    return float((weights * a0 * b0).sum() / np.sqrt(spread)) if spread > 1e-12 else -1.0
