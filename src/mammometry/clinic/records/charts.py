"""Charts on the clinic's pages: positions of points and lines, drawn as SVG by a template."""

import datetime
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import groupby

import numpy as np

_LEFT, _RIGHT, _TOP, _BOTTOM = 46.0, 14.0, 14.0, 30.0  # margins around the plot for its labels, px
_STEPS = (1, 2, 5)  # steps between ticks, times a power of ten
_TICKS = 5  # most ticks of an axis: more are hard to read
_LEAST_SPAN = 0.2  # least range of the axis relative to the values: noise must not fill the chart
_APART_PX = 5.0  # distance between series on one date, so that their intervals can be told apart
_HALF_PX = 5.0  # half-size of a mark
_DATE_PX = 78.0  # width of a date's label


@dataclass(frozen=True, slots=True)
class ChartReading:
    """One number with its interval, at one date."""

    series: str
    """For example ``left``. It is also the template's class for the series."""
    at: datetime.datetime
    value: float
    low: float
    high: float
    words: str
    """Text for the tooltip and screen readers."""
    line: str = ""
    """Readings of a series with the same `line` are joined."""
    is_apart: bool = False
    """Whether it is not comparable with the newest reading of its series. `words` then has the reason."""


@dataclass(frozen=True, slots=True)
class Spot:
    """A reading's position on the chart, px."""

    series: str
    x: float
    y: float
    low_y: float
    high_y: float
    words: str
    line: str = ""
    is_apart: bool = False

    @property
    def corner_x(self) -> float:
        """Left edge of the square that marks the reading, px."""
        return self.x - _HALF_PX

    @property
    def corner_y(self) -> float:
        """Upper edge of the square that marks the reading, px."""
        return self.y - _HALF_PX


@dataclass(frozen=True, slots=True)
class Tick:
    """A label of an axis and its position, px."""

    at: float
    words: str


@dataclass(frozen=True, slots=True)
class Way:
    """Line through a series: the points of an SVG polyline."""

    series: str
    points: str


@dataclass(frozen=True, slots=True)
class ChartEvent:
    """An event on a day, such as an operation."""

    at: datetime.datetime
    words: str


@dataclass(frozen=True, slots=True)
class ChartMark:
    """An event on the chart: a vertical line with a number, which a list below the chart explains."""

    number: int
    x: float
    words: str


@dataclass(frozen=True, slots=True, kw_only=True)
class TimeLine:
    """Layout of numbers over dates."""

    width: float
    height: float
    left: float
    right: float
    bottom: float
    spots: tuple[Spot, ...]
    ways: tuple[Way, ...]
    levels: tuple[Tick, ...]
    dates: tuple[Tick, ...]
    top: float
    marks: tuple[ChartMark, ...] = ()


def time_line(
    readings: Sequence[ChartReading], *, width: float, height: float, events: Sequence[ChartEvent] = ()
) -> TimeLine | None:
    """Lay out readings over their dates.

    Args:
        readings: in any order.
        events: in any order; those outside the readings' time are left out.
        width: of the chart, px.
        height: of the chart, px.

    Returns:
        The chart; None without readings.
    """
    if not readings:
        return None
    low, high = min(reading.low for reading in readings), max(reading.high for reading in readings)
    missing = _LEAST_SPAN * max(abs(low), abs(high)) - (high - low)
    if missing > 0:
        low, high = low - missing / 2, high + missing / 2
    levels = round_levels(low, high)
    low, high = min(low, levels[0]), max(high, levels[-1])
    right, bottom = width - _RIGHT, height - _BOTTOM
    first, last = min(reading.at for reading in readings), max(reading.at for reading in readings)
    span_s = (last - first).total_seconds()
    names = sorted({reading.series for reading in readings})
    inner = _DATE_PX / 2  # labels at both ends stay inside the chart

    def x_of(at: datetime.datetime) -> float:
        fraction = (at - first).total_seconds() / span_s if span_s else 0.5
        return round(float(_LEFT + inner + fraction * (right - _LEFT - 2 * inner)), 1)

    def y_of(value: float) -> float:
        return round(float(bottom - (value - low) / (high - low) * (bottom - _TOP)), 1)

    shown = [event for event in events if first <= event.at <= last]
    spots = []
    for reading in sorted(readings, key=lambda reading: (reading.series, reading.at)):
        aside = _APART_PX * (names.index(reading.series) - (len(names) - 1) / 2)
        spots.append(
            Spot(
                reading.series,
                x_of(reading.at) + aside,
                y_of(reading.value),
                y_of(reading.low),
                y_of(reading.high),
                reading.words,
                reading.line,
                reading.is_apart,
            )
        )
    ways = [
        Way(name, " ".join(f"{spot.x:g},{spot.y:g}" for spot in group))
        for (name, _), group in groupby(sorted(spots, key=_line), key=_line)
    ]
    return TimeLine(
        width=width,
        height=height,
        left=_LEFT,
        right=right,
        bottom=bottom,
        spots=tuple(spots),
        ways=tuple(ways),
        levels=tuple(Tick(y_of(level), f"{level:g}") for level in levels),
        dates=tuple(_date_ticks(sorted({reading.at for reading in readings}), x_of)),
        top=_TOP,
        marks=tuple(
            ChartMark(number, x_of(event.at), event.words)
            for number, event in enumerate(sorted(shown, key=lambda event: event.at), start=1)
        ),
    )


def _line(spot: Spot) -> tuple[str, str]:
    """Series and line of a mark. Sorting by them keeps the order of dates."""
    return spot.series, spot.line


def round_levels(low: float, high: float) -> tuple[float, ...]:
    """Round numbers inside a range, for an axis."""
    size = 10.0 ** np.floor(np.log10((high - low) / _TICKS))
    step = next(k * size for k in (*_STEPS, 10) if (high - low) / (k * size) <= _TICKS)
    return tuple(float(np.round(k * step, 10)) for k in range(int(np.ceil(low / step)), int(np.floor(high / step)) + 1))


def _date_ticks(dates: Sequence[datetime.datetime], x_of: Callable[[datetime.datetime], float]) -> list[Tick]:
    """Dates whose labels do not overlap. The last one always has a label."""
    ticks: list[Tick] = []
    for at in reversed(dates):
        x = x_of(at)
        if not ticks or ticks[-1].at - x >= _DATE_PX:
            ticks.append(Tick(x, f"{at.day} {at:%b %Y}"))
    return ticks[::-1]
