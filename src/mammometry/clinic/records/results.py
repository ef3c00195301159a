"""Results of visits as pages show them."""

from __future__ import annotations

import datetime
from collections.abc import Iterable
from dataclasses import dataclass, replace

from mammometry.clinic.models import Measurement, Visit, Volume
from mammometry.clinic.records.confirmations import CHANGED, is_changed
from mammometry.clinic.study.charts import Reading
from mammometry.report.words.volume_words import MEANINGS

Interval = tuple[float, float]
SIDES = ("left", "right", "model")
LEADING = ("measured wall", "flat chest", "named wall", "muscle", "closed solid", "any")
"""Meanings of "the breast" in the order in which one leads a page (docs/decisions/0029)."""


@dataclass(frozen=True, slots=True)
class SideResult:
    """One breast at one visit."""

    side: str
    title: str
    definition: str
    volume_cc: float | None
    interval_cc: Interval | None
    refused: str
    others: tuple[SideResult, ...] = ()
    """The same breast in the other meanings of the word."""

    @property
    def meaning(self) -> str:
        """What is called the breast, in words."""
        return MEANINGS.get(self.definition, self.definition)


@dataclass(frozen=True, slots=True)
class VisitResult:
    """The newest measurement of a visit."""

    visit: Visit
    measurement: Measurement
    sides: tuple[SideResult, ...]
    difference: SideResult | None


def latest(visits: Iterable[Visit]) -> list[VisitResult]:
    """Newest measurement of each visit, in the order of the visits. Visits without one are left out."""
    found = []
    for visit in visits:
        measurement = next(iter(visit.measurements.all()), None)  # the newest first
        if measurement is not None:
            found.append(visit_result(visit, measurement))
    return found


def add_volumes(measurement: Measurement, volumes: Iterable[Volume]) -> None:
    """Store the volumes of a measurement, and which of each side leads."""
    leaders: dict[str, Volume] = {}
    ordered = sorted(volumes, key=lambda volume: (_rank(volume), volume.definition))
    for volume in ordered:
        volume.measurement = measurement
        volume.leads = leaders.setdefault(volume.side, volume) is volume
    Volume.objects.bulk_create(ordered)


def visit_result(visit: Visit, measurement: Measurement) -> VisitResult:
    """One measurement as pages show it.

    Without its numbers while a boundary or landmark was changed that is not measured: they are of an earlier one.
    """
    changed = is_changed(visit)
    by_side: dict[str, list[SideResult]] = {}
    for row in sorted(measurement.volumes.all(), key=_rank):
        side = _side(row)
        by_side.setdefault(row.side, []).append(_without_numbers(side) if changed else side)
    first = {side: replace(rows[0], others=tuple(rows[1:])) for side, rows in by_side.items()}
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
            date = f"{result.visit.taken_at.day} {result.visit.taken_at:%b %Y}"
            words = f"{side.title}, {date}: {side.volume_cc:.0f} cc (95 %: {low:.0f} to {high:.0f})"
            made.append(Reading(side.side, result.visit.taken_at, side.volume_cc, low, high, words))
    return made


def age(born: datetime.date | None, at: datetime.date) -> int | None:
    """Full years."""
    if born is None:
        return None
    return at.year - born.year - ((at.month, at.day) < (born.month, born.day))


def _rank(volume: Volume) -> int:
    return LEADING.index(volume.definition) if volume.definition in LEADING else len(LEADING)


def _without_numbers(side: SideResult) -> SideResult:
    return replace(side, volume_cc=None, interval_cc=None, refused=CHANGED)


def _side(volume: Volume) -> SideResult:
    interval = None
    if volume.low_cc is not None and volume.high_cc is not None:
        interval = volume.low_cc, volume.high_cc
    titles = {"left": "Left breast", "right": "Right breast", "model": "Model", "difference": "Difference"}
    return SideResult(
        side=volume.side, title=titles.get(volume.side, volume.side), definition=volume.definition,
        volume_cc=volume.volume_cc, interval_cc=interval, refused=volume.refused,
    )  # fmt: skip
