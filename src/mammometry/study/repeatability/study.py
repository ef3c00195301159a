"""Repeatability from repeated captures: errors, detectable change, correlation."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy  # scipy.stats, which takes half a second to import, is imported on first use

from mammometry.base.value import value
from mammometry.geometry.arrays import Array, Float64
from mammometry.study.agreement import IntervalEstimate
from mammometry.study.repeatability.components import Components, chi_square_bounds, components
from mammometry.study.repeatability.design import SUBJECT, Design, Reading, design, volumes_of
from mammometry.study.repeatability.limits import RepeatedLimits, repeated_limits
from mammometry.study.repeatability.plan import DETECTABLE

SIZES_CC = ((0.0, 250.0), (250.0, 500.0), (500.0, math.inf))
"""Classes of volumes of breasts, cc: small, medium and large. By definition."""
MOVED_MM = 4.0
"""Spread of a woman's length between captures above which it is listed, mm. Breathing in moves a nipple by as much
(Wang et al., Aesthetic Plastic Surgery 43 (2019) 53)."""
_FAR = 50.0  # logarithm of a ratio of variances that replaces infinity


@dataclass(frozen=True, slots=True, kw_only=True)
class Component:
    """One random effect."""

    name: str
    levels: int
    sd_cc: IntervalEstimate
    """Standard deviation by REML, cc."""
    variance_cc2: float
    moments_cc2: float
    """Variance by the analysis of variance, cc². It may be negative. NaN for a table that is not balanced."""
    share: float
    """Of the variance of all effects but the breast; of the breast's effects, NaN."""


class _Scatter:
    """Detectable change from a standard error of measurement."""

    __slots__ = ()
    sem_cc: IntervalEstimate

    @property
    def detectable_cc(self) -> IntervalEstimate:
        """Smallest detectable change, cc: 1.96 √2 SEM. Two repetitions have limits of agreement of ± this."""
        low, high = self.sem_cc.interval
        return IntervalEstimate(value=DETECTABLE * self.sem_cc.value, interval=(DETECTABLE * low, DETECTABLE * high))


@dataclass(frozen=True, slots=True, kw_only=True)
class Repetition(_Scatter):
    """Scatter of one measurement if some conditions change and others do not."""

    level: str
    """What changes (see `design`)."""
    effects: tuple[str, ...]
    sem_cc: IntervalEstimate
    """Standard error of measurement, cc."""
    df: float
    """Its degrees of freedom."""
    cv_percent: IntervalEstimate
    """Coefficient of variation, %: √(exp s² − 1), with s from the logarithms."""
    detectable_percent: IntervalEstimate
    """Smallest detectable increase, %: exp(1.96 √2 s) − 1."""
    icc: IntervalEstimate
    """Share of the variance that two measurements at this level have in common: the intraclass correlation for absolute
    agreement of single measurements with all effects random, ICC(A,1). For a new capture by the same rater, ICC(1)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SizeClass(_Scatter):
    """Scatter of repeated captures of breasts in one class of size."""

    from_cc: float
    to_cc: float
    breasts: int
    sem_cc: IntervalEstimate
    """Standard error of a new capture, cc."""
    cv_percent: IntervalEstimate
    """Coefficient of variation, %, from the logarithms."""
    detectable_percent: IntervalEstimate
    """Smallest detectable increase, %."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ConditionChange:
    """A condition that was not the same in all captures of a woman."""

    woman: str
    condition: str
    found: tuple[str, ...]
    """Values that occurred, or the smallest and the largest length."""


@value
class RepeatabilityStudy:
    """All results about the repeatability of volumes."""

    women: int
    breasts: int
    captures: int
    readings: int
    mean_cc: float
    balanced: bool
    merged: tuple[tuple[str, str], ...]
    """Effects that the design cannot separate from another effect."""
    components: tuple[Component, ...]
    repetitions: tuple[Repetition, ...]
    """From the narrowest to the widest."""
    sizes: tuple[SizeClass, ...]
    size_trend_p: float
    """p value of Kendall's correlation of scatter and size. Below 0.05, use percentages. NaN: unknown."""
    limits: tuple[RepeatedLimits, ...]
    """For each pair of raters, devices and readers, cc."""
    limits_percent: tuple[RepeatedLimits, ...]
    """The same from the logarithms, in per cent of the first one's volume."""
    changes: tuple[ConditionChange, ...]


def repeatability(readings: Sequence[Reading]) -> RepeatabilityStudy:
    """Analyse repeated captures.

    Raises:
        ValueError: see `design` and `components`; or a volume is not positive.
    """
    volumes = volumes_of(readings)
    if not (volumes > 0).all():
        raise ValueError("a volume that is not positive")
    planned = design(readings)
    found, of_logarithms = (components(values, planned.groups) for values in (volumes, np.log(volumes)))
    cells: dict[tuple[str, ...], list[float]] = {}
    for one in readings:
        cells.setdefault(one.cell, []).append(one.volume_cc)
    repeated = [np.array(own) for own in cells.values() if len(own) > 1]
    return RepeatabilityStudy(
        women=len({one.woman for one in readings}),
        breasts=len({one.breast for one in readings}),
        captures=len({(one.woman, one.device, one.rater, one.day, one.capture) for one in readings}),
        readings=len(readings),
        mean_cc=float(volumes.mean()),
        balanced=planned.balanced,
        merged=planned.merged,
        components=tuple(_component(planned, found, place) for place in range(len(planned.effects))),
        repetitions=tuple(
            _repetition(level, planned, places, found, of_logarithms)
            for level, places in planned.levels_of_repetition().items()
        ),
        sizes=tuple(_by_size(repeated)),
        size_trend_p=_trend_p(repeated),
        limits=tuple(_limits(readings, volumes)),
        limits_percent=tuple(map(_in_percent, _limits(readings, np.log(volumes)))),
        changes=tuple(condition_changes(readings)),
    )


def _component(planned: Design, found: Components, place: int) -> Component:
    sd, interval, _ = found.deviation([place])
    error = float(sum(variance for effect, variance in zip(planned.effects, found.variances, strict=True)
                      if effect not in SUBJECT))  # fmt: skip
    name, variance = planned.effects[place], float(found.variances[place])
    return Component(
        name=name,
        levels=planned.levels[place],
        sd_cc=IntervalEstimate(value=sd, interval=interval),
        variance_cc2=variance,
        moments_cc2=float(found.moments[place]) if planned.balanced else math.nan,
        share=math.nan if name in SUBJECT or not error else variance / error,
    )


def _repetition(
    level: str, planned: Design, places: tuple[int, ...], found: Components, of_logarithms: Components
) -> Repetition:
    sem, interval, df = found.deviation(places)
    relative, bounds, _ = of_logarithms.deviation(places)
    return Repetition(
        level=level,
        effects=tuple(planned.effects[place] for place in places),
        sem_cc=IntervalEstimate(value=sem, interval=interval),
        df=df,
        cv_percent=_mapped(_cv, relative, bounds),
        detectable_percent=_mapped(_increase, relative, bounds),
        icc=_icc(found, places),
    )


def _mapped(function: Callable[[float], float], value: float, bounds: tuple[float, float]) -> IntervalEstimate:
    """Apply an increasing function to an estimate and its interval."""
    return IntervalEstimate(value=function(value), interval=(function(bounds[0]), function(bounds[1])))


def _cv(deviation: float) -> float:
    return 100 * math.sqrt(math.expm1(deviation**2)) if deviation < 10 else math.inf  # larger values overflow


def _increase(deviation: float) -> float:
    return 100 * math.expm1(DETECTABLE * deviation) if deviation < 10 else math.inf  # larger values overflow


def _icc(found: Components, places: tuple[int, ...]) -> IntervalEstimate:
    """Common variance over the whole variance, with an interval by MOVER (Zou 2013) of its logarithm."""
    common = [place for place in range(len(found.variances)) if place not in places]
    shared, error = found.sum_of(common), found.sum_of(places)
    if not shared or not error:
        return IntervalEstimate(value=shared / (shared + error) if shared + error else math.nan, interval=(0.0, 1.0))
    (own_low, own_high), (low, high) = found.interval_of(common), found.interval_of(places)
    reaches = (
        math.hypot(_log_ratio(high, error), _log_ratio(shared, own_low)),
        math.hypot(_log_ratio(error, low), _log_ratio(own_high, shared)),
    )
    ratio = error / shared
    return IntervalEstimate(
        value=1 / (1 + ratio),
        interval=(1 / (1 + ratio * math.exp(reaches[0])), 1 / (1 + ratio * math.exp(-reaches[1]))),
    )


def _log_ratio(larger: float, smaller: float) -> float:
    """Logarithm of a ratio. If a bound is 0 or infinite, `_FAR` is used."""
    return min(math.log(larger / smaller), _FAR) if smaller > 0 else _FAR


def _by_size(cells: Sequence[Float64[Array, " m"]]) -> Iterator[SizeClass]:
    for low, high in SIZES_CC:
        own = [values for values in cells if low <= values.mean() < high]
        if not own:
            continue
        sem, bounds = _within(own)
        relative, relative_bounds = _within([np.log(values) for values in own])
        yield SizeClass(
            from_cc=low,
            to_cc=high,
            breasts=len(own),
            sem_cc=IntervalEstimate(value=sem, interval=bounds),
            cv_percent=_mapped(_cv, relative, relative_bounds),
            detectable_percent=_mapped(_increase, relative, relative_bounds),
        )


def _within(own: Sequence[Float64[Array, " m"]]) -> tuple[float, tuple[float, float]]:
    """Standard deviation within groups, and its 95 % interval by χ²."""
    df = sum(len(values) - 1 for values in own)
    variance = sum(float(((values - values.mean()) ** 2).sum()) for values in own) / df
    low, high = chi_square_bounds(df)
    return math.sqrt(variance), (math.sqrt(variance * low), math.sqrt(variance * high))


def _trend_p(cells: Sequence[Float64[Array, " m"]]) -> float:
    if len(cells) < 4:
        return math.nan
    return float(scipy.stats.kendalltau([own.mean() for own in cells], [own.std(ddof=1) for own in cells]).pvalue)


def _limits(readings: Sequence[Reading], values: Float64[Array, " n"]) -> Iterator[RepeatedLimits]:
    of_woman = {one.breast: one.woman for one in readings}
    for what in ("device", "rater", "reader"):
        by_name: dict[str, dict[str, list[float]]] = {}
        for one, own in zip(readings, values.tolist(), strict=True):
            by_name.setdefault(getattr(one, what), {}).setdefault(one.breast, []).append(own)
        for first, second in itertools.combinations(by_name, 2):
            women = len({of_woman[breast] for breast in by_name[first] if breast in by_name[second]})
            found = repeated_limits(by_name[first], by_name[second], women, names=(what, first, second))
            if found is not None:
                yield found


def _in_percent(logarithms: RepeatedLimits) -> RepeatedLimits:
    """Convert limits of differences of logarithms to per cent."""

    def percent(estimate: IntervalEstimate) -> IntervalEstimate:
        return _mapped(lambda value: 100 * math.expm1(value), estimate.value, estimate.interval)

    return replace(
        logarithms,
        bias=percent(logarithms.bias),
        sd=_mapped(_cv, logarithms.sd.value, logarithms.sd.interval),
        lower=percent(logarithms.lower),
        upper=percent(logarithms.upper),
    )


def condition_changes(readings: Sequence[Reading]) -> Iterator[ConditionChange]:
    """Yield the conditions that differ between the captures of a woman.

    These are words that differ, and lengths whose spread is at least `MOVED_MM`.
    """
    found: dict[tuple[str, str], dict[str, None]] = {}
    for one in readings:
        for name, text in one.conditions:
            found.setdefault((one.woman, name), {})[text] = None
    for (woman, name), texts in found.items():
        if name.endswith("_mm"):
            lengths = sorted(texts, key=float)
            if float(lengths[-1]) - float(lengths[0]) > MOVED_MM:
                yield ConditionChange(woman=woman, condition=name, found=(lengths[0], lengths[-1]))
        elif len(texts) > 1:
            yield ConditionChange(woman=woman, condition=name, found=tuple(texts))
