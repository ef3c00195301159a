"""Match the cylinder's columns between photographs by their labels.

The labels are beyond the last row. They are not read: their unrolled strips are correlated over all offsets of whole
columns. Photographs are then numbered along the strongest tree of pairs that agree. The common start stays arbitrary:
it only turns the world about the cylinder's axis.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from mammometry.base.errors import CalibrationError
from mammometry.calibration.features.found_points import FoundPoints
from mammometry.calibration.targets.dotted_cylinder.find import CylinderView
from mammometry.calibration.targets.kinds.cylinder import DottedCylinderTarget
from mammometry.geometry.arrays import Array, Float32

_MIN_COMMON_COLUMNS = 2
"""Fewest columns that both photographs must show: one label alone may resemble another."""
_MIN_CORRELATION = 0.5
"""Least correlation of two strips with the same labels. Chosen by eye."""
_MIN_MARGIN = 0.1
"""The best offset must correlate by this much more than the next."""
_WIGGLE = 3
"""Largest shift of the labels from where the dots put them, samples (an eighth of a column)."""


def numbered_alike(found: Mapping[str, FoundPoints]) -> Mapping[str, FoundPoints]:
    """Number the columns of all photographs from a common start.

    Points from a table keep the ids they came with.

    Raises:
        CalibrationError: a photograph's labels agree with no other's, or the columns do not fit the target's number.
    """
    views = {name: seen for name, seen in found.items() if isinstance(seen, CylinderView)}
    starts = number_columns(views)
    return {**found, **{name: view.starting_at(starts[name]) for name, view in views.items()}}


def number_columns(views: Mapping[str, CylinderView]) -> Mapping[str, int]:
    """Column of each view's column 0 in a numbering common to all.

    The first view's is 0 unless another begins before.

    Raises:
        CalibrationError: a photograph's labels agree with no other's, or the columns do not fit the target's number.
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
        # Prim's tree: the surest pair that joins a new photograph to those numbered.
        joining = [pair for pair in pairs if (pair[2] in start) != (pair[3] in start)]
        if not joining:
            lost = ", ".join(name for name in names if name not in start)
            raise CalibrationError(
                f"columns of the dotted cylinder in {lost}",
                found=f"labels above the top row that agree with none of {', '.join(start)}",
                expected="a strip of labels that both photographs show, at least two of them in common",
                remedy="Photograph the cylinder upright, the labels in the picture, some columns seen by both cameras",
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
    least = min(start.values(), default=0)
    shifted = {name: first - min(least, 0) for name, first in start.items()}
    most = max((first + int(views[name].columns.max()) for name, first in shifted.items()), default=0)
    if most >= columns:
        raise CalibrationError(
            "columns of the dotted cylinder",
            found=f"{most + 1} columns in all photographs together",
            expected=f"at most {columns}, as [target] dots says",
            remedy="Correct the number of columns in session.toml, or look for photographs of another target",
        )
    return shifted


def _best_offset(a: CylinderView, b: CylinderView, around: int | None) -> tuple[int, float]:
    """Offset of column 0 of `b` in columns of `a`, and score. The score is 0 if it is not sure."""
    samples = len(a.labels)
    width_a, width_b = a.labels.shape[1] // samples, b.labels.shape[1] // samples
    scores: dict[int, float] = {}
    for shift in range(-width_b + _MIN_COMMON_COLUMNS, width_a - _MIN_COMMON_COLUMNS + 1):
        # Strip b laid so that its first column is on strip a's column `shift`.
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
    """Weighted correlation of the strips where both are seen. The best within ± `_WIGGLE` samples."""
    best = -1.0
    for small in range(-_WIGGLE, _WIGGLE + 1):
        first_a, first_b = max(shift + small, 0), max(-shift - small, 0)
        length = min(a.labels.shape[1] - first_a, b.labels.shape[1] - first_b)
        if length <= 0:
            continue
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
