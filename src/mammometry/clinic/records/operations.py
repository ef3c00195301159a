"""A patient's operations on the time line, and retention of injected fat."""

import datetime
import math
from collections.abc import Sequence
from dataclasses import dataclass

from django.utils import timezone

from mammometry.clinic.models import Comparison, Operation, Visit
from mammometry.clinic.records.charts import ChartEvent
from mammometry.clinic.records.comparability import is_between, why_apart
from mammometry.clinic.records.comparing import is_current
from mammometry.clinic.records.results import SideResult, VisitResult

_ORDINALS = ("first", "second", "third", "fourth", "fifth", "sixth", "seventh", "eighth", "ninth", "tenth")
_PHASES = {
    Operation.Kind.MASTECTOMY: "mastectomy",
    Operation.Kind.CONSERVING: "breast-conserving surgery",
    Operation.Kind.EXPANDER: "insertion of the expander",
    Operation.Kind.FILLING: "filling",
    Operation.Kind.IMPLANT: "implant",
    Operation.Kind.FLAP: "flap",
    Operation.Kind.GRAFT: "fat graft",
    Operation.Kind.REDUCTION: "reduction or lift",
    Operation.Kind.AUGMENTATION: "augmentation",
    Operation.Kind.OTHER: "operation",
}


def phase_of(visit: Visit, operations: Sequence[Operation]) -> str:
    """Time of a visit relative to operations, such as "after the second filling".

    Empty without operations.
    """
    if not operations:
        return ""
    done = [operation for operation in operations if not operation.is_after(visit)]
    if not done:
        return "before the operation"
    last = max(done, key=lambda operation: operation.day)
    days = sorted({operation.day for operation in operations if operation.kind == last.kind})
    place = days.index(last.day)
    which = "" if len(days) == 1 else f"{_ORDINALS[place] if place < len(_ORDINALS) else f'{place + 1}th'} "
    return f"after the {which}{_PHASES[Operation.Kind(last.kind)]}"


def events(operations: Sequence[Operation]) -> list[ChartEvent]:
    """Operations as marks of the time line, one per day, earliest first."""
    by_day: dict[datetime.date, list[Operation]] = {}
    for operation in sorted(operations, key=lambda operation: operation.day):
        by_day.setdefault(operation.day, []).append(operation)
    return [
        ChartEvent(
            timezone.make_aware(datetime.datetime.combine(day, datetime.time(12))),
            f"{day.day} {day:%b %Y}: {'; '.join(_short(operation) for operation in rows)}",
        )
        for day, rows in by_day.items()
    ]


def _short(operation: Operation) -> str:
    return f"{operation.get_kind_display()}, {operation.get_side_display().lower()}"


def sides_of(operations: Sequence[Operation], day: datetime.date) -> str:
    """Sides that were operated on until a day, as text. Empty if no operation is entered."""
    sides = {operation.side for operation in operations if operation.day <= day}
    if Operation.Side.BOTH in sides or {"left", "right"} <= sides:
        return "both sides"
    return next(iter(sides), "")


_COMPARED = ("measured wall", "named wall", "closed solid")
"""Definitions of the breast whose volumes may be subtracted, because they include no invisible part of the chest."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Retention:
    """Share of injected fat that remains at a visit, or the reason for having no figure."""

    operation: Operation
    side: str
    after: Visit | None = None
    percent: float | None = None
    interval_percent: tuple[float, float] | None = None
    """95 % interval, without the uncertainty of the injected volume."""
    why: str = ""
    """Reason for having no figure, in one sentence. Empty: there is a figure."""


def retentions(operations: Sequence[Operation], results: Sequence[VisitResult]) -> list[Retention]:
    """Retention of each fat graft, newest first, by side and visit.

    Args:
        operations: all operations of one patient.
        results: newest measurements of the patient's visits.
    """
    rows = sorted(results, key=lambda result: result.visit.taken_at)
    grafts = sorted(
        (operation for operation in operations if operation.kind == Operation.Kind.GRAFT),
        key=lambda operation: operation.day,
    )
    return [
        retention
        for graft in reversed(grafts)
        for side in (("left", "right") if graft.side == Operation.Side.BOTH else (graft.side,))
        for retention in _of_side(graft, side, operations, rows)
    ]


def _of_side(
    graft: Operation, side: str, operations: Sequence[Operation], results: Sequence[VisitResult]
) -> list[Retention]:
    """Retention of one graft on one side, at each visit until that side is operated on again."""
    if not graft.volume_cc:
        return [Retention(operation=graft, side=side, why="The injected volume is not entered.")]
    others = [
        operation
        for operation in operations
        if operation.pk != graft.pk and operation.side in (side, Operation.Side.BOTH)
    ]
    measured = [(result.visit, volume) for result in results if (volume := _volume(result, side)) is not None]
    before = [(visit, volume) for visit, volume in measured if graft.is_after(visit)]
    if not before:
        return [Retention(operation=graft, side=side, why="There is no measured visit before it.")]
    first, was = before[-1]
    after = [(visit, volume) for visit, volume in measured if not graft.is_after(visit)]
    alone = [pair for pair in after if not any(is_between(other, first, pair[0]) for other in others)]
    if not alone:
        why = (
            "There was another operation on this side between the visits."
            if after
            else "There is no measured visit after it."
        )
        return [Retention(operation=graft, side=side, why=why)]
    return [_retained(graft, side, (first, was), pair) for pair in alone]


def _retained(
    graft: Operation, side: str, before: tuple[Visit, SideResult], after: tuple[Visit, SideResult]
) -> Retention:
    (first, was), (visit, now) = before, after
    assert graft.volume_cc is not None
    compared = _comparison(first, visit, side)
    if apart := why_apart(now.basis, was.basis, measured_alike=compared is not None):
        why = f"The visits before and after it are not comparable: {apart}."
        return Retention(operation=graft, side=side, after=visit, why=why)
    change, interval = compared or _difference(was, now)
    share = 100.0 / graft.volume_cc
    return Retention(
        operation=graft, side=side, after=visit, percent=share * change,
        interval_percent=None if interval is None else (share * interval[0], share * interval[1]),
    )  # fmt: skip


def _comparison(before: Visit, after: Visit, side: str) -> tuple[float, tuple[float, float] | None] | None:
    """Change between two visits and its interval, cc. None if their newest results have no comparison."""
    row = Comparison.objects.filter(before=before, after=after, state=Comparison.State.DONE).first()
    if row is None:
        return None
    row.before, row.after = before, after  # with their measurements, which have been read already
    if not is_current(row):
        return None
    breast = row.table.get("breasts", {}).get(side)
    if breast is None or breast.get("change_cc") is None:
        return None
    interval = breast.get("change_interval_cc")
    return breast["change_cc"], None if interval is None else (interval[0], interval[1])


def _difference(was: SideResult, now: SideResult) -> tuple[float, tuple[float, float] | None]:
    """Difference of two volumes with independent errors, cc."""
    assert was.volume_cc is not None
    assert now.volume_cc is not None
    change = now.volume_cc - was.volume_cc
    if was.interval_cc is None or now.interval_cc is None:
        return change, None
    down = math.hypot(now.volume_cc - now.interval_cc[0], was.interval_cc[1] - was.volume_cc)
    up = math.hypot(now.interval_cc[1] - now.volume_cc, was.volume_cc - was.interval_cc[0])
    return change, (change - down, change + up)


def _volume(result: VisitResult, side: str) -> SideResult | None:
    """One breast's result in the first definition that may be subtracted. None if there is none."""
    rows = [row for breast in result.sides if breast.side == side for row in (breast, *breast.others)]
    ranked = [row for name in _COMPARED for row in rows if row.definition == name and row.volume_cc is not None]
    return ranked[0] if ranked else None
