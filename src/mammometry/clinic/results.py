"""Results of visits as pages show them."""

from __future__ import annotations

import datetime
from collections.abc import Iterable
from dataclasses import dataclass

from mammometry.clinic.changes import Interval, VolumeChange, volume_change
from mammometry.clinic.charts import Reading
from mammometry.clinic.models import Measurement, Visit, Volume

SIDES = ("left", "right", "model")


@dataclass(frozen=True, slots=True)
class SideResult:
    """One breast at one visit."""

    side: str
    title: str
    definition: str
    volume_cc: float | None
    interval_cc: Interval | None
    refused: str


@dataclass(frozen=True, slots=True)
class VisitResult:
    """The newest measurement of a visit."""

    visit: Visit
    measurement: Measurement
    sides: tuple[SideResult, ...]
    difference: SideResult | None


@dataclass(frozen=True, slots=True)
class Step:
    """From one visit to the next, one breast."""

    side: str
    title: str
    before: Visit
    after: Visit
    change: VolumeChange


def latest(visits: Iterable[Visit]) -> list[VisitResult]:
    """Newest measurement of each visit that has one, in the order of the visits."""
    found = []
    for visit in visits:
        measurement = next(iter(visit.measurements.all()), None)  # the newest first
        if measurement is not None:
            found.append(visit_result(visit, measurement))
    return found


def visit_result(visit: Visit, measurement: Measurement) -> VisitResult:
    """One measurement as pages show it; the breast by the clinic's first definition."""
    volumes = list(measurement.volumes.all())
    first = {each.side: _side(each) for each in reversed(volumes)}
    return VisitResult(
        visit=visit,
        measurement=measurement,
        sides=tuple(first[side] for side in SIDES if side in first),
        difference=first.get("difference"),
    )


def readings(results: Iterable[VisitResult]) -> list[Reading]:
    """Volumes for the time line."""
    made = []
    for result in results:
        for side in result.sides:
            if side.volume_cc is None:
                continue
            low, high = side.interval_cc or (side.volume_cc, side.volume_cc)
            date = f"{result.visit.taken_at:%-d %b %Y}"
            words = f"{side.title}, {date}: {side.volume_cc:.0f} cc (95 %: {low:.0f} to {high:.0f})"
            made.append(Reading(side.side, result.visit.taken_at, side.volume_cc, low, high, words))
    return made


def steps(results: Iterable[VisitResult]) -> list[Step]:
    """Changes from each visit to the next one with a volume of the same breast and definition, the newest first."""
    before: dict[tuple[str, str], tuple[Visit, SideResult]] = {}
    made: list[Step] = []
    for result in sorted(results, key=lambda each: each.visit.taken_at):
        for side in result.sides:
            if side.volume_cc is None:
                continue
            key = side.side, side.definition
            if key in before:
                earlier, was = before[key]
                assert was.volume_cc is not None
                change = volume_change(was.volume_cc, was.interval_cc, side.volume_cc, side.interval_cc)
                made.append(Step(side.side, side.title, earlier, result.visit, change))
            before[key] = result.visit, side
    return made[::-1]


def age(born: datetime.date | None, at: datetime.date) -> int | None:
    """Full years."""
    if born is None:
        return None
    return at.year - born.year - ((at.month, at.day) < (born.month, born.day))


def _side(volume: Volume) -> SideResult:
    interval = None
    if volume.low_cc is not None and volume.high_cc is not None:
        interval = volume.low_cc, volume.high_cc
    titles = {"left": "Left breast", "right": "Right breast", "model": "Model", "difference": "Difference"}
    return SideResult(
        side=volume.side, title=titles.get(volume.side, volume.side), definition=volume.definition,
        volume_cc=volume.volume_cc, interval_cc=interval, refused=volume.refused,
    )  # fmt: skip
