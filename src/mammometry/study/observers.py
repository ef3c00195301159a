"""Scatter between observers' drawings: volumes, and curves by region.

The variance components are those of a one-way analysis of variance within each breast, pooled over breasts: MS_W for
repeats by one observer, MS_B for the observers' means, with n₀ drawings per observer (Searle, Casella and McCulloch,
Variance Components, 1992, chapter 3, for unequal numbers).
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import scipy  # scipy.stats, which takes half a second to import, is imported on first use
from scipy.spatial import cKDTree

from mammometry.base.value import value
from mammometry.geometry import Array, Float64, Int64, TriangleMesh
from mammometry.geometry.curves import closed_length_mm, points_along
from mammometry.study.agreement import IntervalEstimate
from mammometry.study.icc import IntraclassCorrelation, intraclass_correlations

REGIONS = ("lateral", "upper", "medial", "lower")
WHOLE = "whole curve"
_STEP_MM = 1.0  # spacing of a curve's points for distances
_DETECTABLE_95 = 1.96 * math.sqrt(2)  # ratio of minimal detectable change to standard error of measurement
_LONGEST_NUMBER = 16  # most digits of a repeat's name that is sorted as a number
_ICC = "ICC(2,1)"  # absolute agreement of single measurements, random observers


@value(eq=False)
class ObservedCurve:
    """One curve around one breast, and the resulting volume."""

    breast: str
    """Subject and side, such as "anna, left"."""
    observer: str
    """Person who drew it."""
    repeat: str
    """Number or name of this drawing among those of the same observer and breast."""
    volume_cc: float
    """Volume in front of a wall, of the same kind for all drawings, cc."""
    base_cm2: float
    """Area of that wall within the curve, cm²."""
    lateral_up_mm: Float64[Array, "n 3"]
    """The closed curve, mm: towards the armpit, towards the head, straight ahead. All curves of a breast have one
    origin."""


@value(eq=False)
class DrawnSurface:
    """A surface and all curves drawn on it."""

    name: str
    """Name of its file, without the suffix."""
    mesh: TriangleMesh
    """Mesh in the file's frame, mm."""
    frame: Float64[Array, "3 3"]
    """Body frame; rows are the patient's left, the head, and straight ahead."""
    curves: tuple[tuple[str, Float64[Array, "n 3"]], ...]
    """Observer and closed curve, mm."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Scatter:
    """Scatter of single measurements of one breast."""

    sem: IntervalEstimate
    """Standard error of measurement (standard deviation of one measurement), cc."""
    df: float
    """Degrees of freedom of `sem`."""
    percent: float
    """`sem` in % of the mean volume."""

    @property
    def mdc(self) -> IntervalEstimate:
        """Minimal detectable change at 95 %, cc: 1.96 √2 times the standard error of measurement."""
        low, high = self.sem.interval
        return IntervalEstimate(
            value=_DETECTABLE_95 * self.sem.value, interval=(_DETECTABLE_95 * low, _DETECTABLE_95 * high)
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class Apart:
    """Distance between two curves around one breast by region, over all pairs of drawings."""

    pairs: int
    mean_mm: float
    """Mean distance, mm."""
    q95_mm: float
    """95th percentile, mm."""
    across_mm: float
    """Standard uncertainty of a curve across its direction, mm: RMS distance / √2 (see also `measure.observers`)."""


@value
class ObserverStudy:
    """Agreement between observers' drawings."""

    breasts: tuple[str, ...]
    observers: tuple[str, ...]
    drawings: int
    mean_cc: float
    """Mean of all volumes, cc."""
    within: Scatter | None
    """Scatter of drawings by the same observer. None without repeats."""
    between: Scatter | None
    """Scatter of drawings by any observers. None if no breast was drawn by two observers."""
    icc_between: IntraclassCorrelation | None
    """ICC(2,1) of first drawings, breasts by observers. None unless the same two observers drew two breasts."""
    icc_within: Mapping[str, IntraclassCorrelation]
    """Observer → ICC(2,1) of repeats, breasts by repeats, for those who drew two breasts twice."""
    apart_within: Mapping[str, Apart]
    """Region → distance between curves by one observer. Empty without repeats."""
    apart_between: Mapping[str, Apart]
    """Region → distance between curves by two observers. Empty with one observer."""


def observer_study(drawings: Sequence[ObservedCurve]) -> ObserverStudy:
    """Agreement between observers' drawings, in the order of `repeat` (numbers first, 2 before 10).

    Raises:
        ValueError: no breast was drawn twice, or a drawing is duplicated.
    """
    table: dict[str, dict[str, dict[str, ObservedCurve]]] = {}
    for drawing in sorted(drawings, key=lambda drawing: _order(drawing.repeat)):
        own = table.setdefault(drawing.breast, {}).setdefault(drawing.observer, {})
        if drawing.repeat in own:
            raise ValueError(f"two drawings {drawing.repeat} of {drawing.breast} by {drawing.observer}")
        own[drawing.repeat] = drawing
    if len(drawings) == len(table):
        raise ValueError("no breast was drawn twice")
    mean_cc = float(np.mean([drawing.volume_cc for drawing in drawings]))
    groups = [
        [np.array([drawing.volume_cc for drawing in own.values()]) for own in persons.values()]
        for persons in table.values()
    ]
    within, between = scatter_of(groups)
    pairs = [pair for persons in table.values() for pair in _pairs(persons)]
    return ObserverStudy(
        breasts=tuple(table),
        observers=tuple(dict.fromkeys(drawing.observer for drawing in drawings)),
        drawings=len(drawings),
        mean_cc=mean_cc,
        within=within,
        between=between,
        icc_between=_icc([{name: _volumes(own)[0] for name, own in persons.items()} for persons in table.values()]),
        icc_within=_icc_of_repeats(table),
        apart_within=_apart([pair for pair in pairs if pair[0].observer == pair[1].observer]),
        apart_between=_apart([pair for pair in pairs if pair[0].observer != pair[1].observer]),
    )


def _order(repeat: str) -> tuple[bool, int, str]:
    number = int(repeat) if repeat.isdecimal() and len(repeat) < _LONGEST_NUMBER else None
    return (number is None, number or 0, repeat)


def scatter_of(groups: Sequence[Sequence[Float64[Array, " _"]]]) -> tuple[Scatter | None, Scatter | None]:
    """Scatter within observers and between any observers, pooled over breasts.

    Args:
        groups: breast → observer → volumes from that observer's drawings, cc.
    """
    mean_cc = float(np.mean(np.concatenate([own for persons in groups for own in persons])))
    repeats_df = sum(len(own) - 1 for persons in groups for own in persons)
    persons_df = sum(len(persons) - 1 for persons in groups)
    ss_within = sum(float(((own - own.mean()) ** 2).sum()) for persons in groups for own in persons)
    ms_within = ss_within / repeats_df if repeats_df else 0.0
    within = _scatter(ms_within, repeats_df, mean_cc) if repeats_df else None
    if not persons_df:
        return within, None
    ss_between, n0 = 0.0, 0.0
    for persons in groups:
        counts = np.array([len(own) for own in persons])
        means = np.array([own.mean() for own in persons])
        ss_between += float((counts * (means - (counts * means).sum() / counts.sum()) ** 2).sum())
        n0 += float(counts.sum() - (counts**2).sum() / counts.sum())
    ms_between, n0 = ss_between / persons_df, n0 / persons_df
    if ms_between <= ms_within:  # observers differ no more than repeats, so all drawings are equivalent
        df = persons_df + repeats_df
        return within, _scatter((ss_between + ss_within) / df, df, mean_cc)
    share = 1 / n0
    variance = share * ms_between + (1 - share) * ms_within
    parts = (share * ms_between) ** 2 / persons_df
    parts += ((1 - share) * ms_within) ** 2 / repeats_df if repeats_df else 0.0
    return within, _scatter(variance, variance**2 / parts if parts else float(persons_df), mean_cc)


def _scatter(variance: float, df: float, mean_cc: float) -> Scatter:
    """A standard deviation with its χ² interval."""
    sd = math.sqrt(variance)
    low, high = (float(np.sqrt(df / scipy.stats.chi2.ppf(q, df))) for q in (0.975, 0.025))
    return Scatter(
        sem=IntervalEstimate(value=sd, interval=(sd * low, sd * high)), df=float(df), percent=100 * sd / mean_cc
    )


def _volumes(own: Mapping[str, ObservedCurve]) -> list[float]:
    return [drawing.volume_cc for drawing in own.values()]


def _icc(rows: Sequence[Mapping[str, float]]) -> IntraclassCorrelation | None:
    """ICC(2,1) for the raters who rated all breasts."""
    common = [name for name in rows[0] if all(name in row for row in rows)]
    if len(rows) < 2 or len(common) < 2:
        return None
    ratings = np.array([[row[name] for name in common] for row in rows])
    return next(form for form in intraclass_correlations(ratings) if form.shrout_fleiss == _ICC)


def _icc_of_repeats(table: Mapping[str, Mapping[str, Mapping[str, ObservedCurve]]]) -> dict[str, IntraclassCorrelation]:
    found = {}
    for observer in dict.fromkeys(name for persons in table.values() for name in persons):
        own = [_volumes(persons[observer]) for persons in table.values() if observer in persons]
        rows = [dict(zip(map(str, range(len(row))), row, strict=True)) for row in own if len(row) > 1]
        icc = _icc(rows) if rows else None
        if icc is not None:
            found[observer] = icc
    return found


def _pairs(persons: Mapping[str, Mapping[str, ObservedCurve]]) -> Iterator[tuple[ObservedCurve, ObservedCurve]]:
    return itertools.combinations([drawing for own in persons.values() for drawing in own.values()], 2)


def _apart(pairs: Sequence[tuple[ObservedCurve, ObservedCurve]]) -> dict[str, Apart]:
    if not pairs:
        return {}
    found = [distances_by_region_mm(*pair) for pair in pairs]
    distances: dict[str, Float64[Array, " n"]] = {
        region: np.concatenate([by_region[region] for by_region in found]) for region in REGIONS
    }
    distances[WHOLE] = np.concatenate(list(distances.values()))
    return {
        region: Apart(
            pairs=len(pairs),
            mean_mm=float(values.mean()),
            q95_mm=float(np.quantile(values, 0.95)),
            across_mm=float(np.sqrt(np.mean(values**2) / 2)),
        )
        for region, values in distances.items()
        if len(values)
    }


def distances_by_region_mm(first: ObservedCurve, second: ObservedCurve) -> dict[str, Float64[Array, " n"]]:
    """Distances of the points of each curve from the other curve, mm, by region.

    The region of a point is its direction from the centre of both curves, as seen from the front.
    """
    curves = [evenly(drawing.lateral_up_mm) for drawing in (first, second)]
    middle = (curves[0].mean(axis=0) + curves[1].mean(axis=0)) / 2
    taken: dict[str, list[Float64[Array, " n"]]] = {region: [] for region in REGIONS}
    for own, other in (curves, curves[::-1]):
        away = np.asarray(cKDTree(other).query(own)[0])
        which = regions_of(own - middle)
        for index, region in enumerate(REGIONS):
            taken[region].append(away[which == index])
    return {region: np.concatenate(arrays) for region, arrays in taken.items()}


def regions_of(from_middle_mm: Float64[Array, "n 3"]) -> Int64[Array, " n"]:
    """Index into `REGIONS` for directions from a breast's centre, by quarters."""
    turn = np.arctan2(from_middle_mm[:, 1], from_middle_mm[:, 0])
    return np.asarray(np.round(turn / (np.pi / 2)).astype(np.int64) % 4)


def evenly(curve: Float64[Array, "n 3"]) -> Float64[Array, "m 3"]:
    """Resample a closed curve at about 1 mm."""
    return points_along(curve, np.arange(0.0, closed_length_mm(curve), _STEP_MM))
