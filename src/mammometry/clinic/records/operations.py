"""Operations of a patient on the time line: after which one a visit was."""

from __future__ import annotations

import datetime
from collections.abc import Sequence

from django.utils import timezone

from mammometry.clinic.models import Operation, Visit
from mammometry.clinic.study.charts import Event

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


def is_before(visit: Visit, operation: Operation) -> bool:
    """Whether a visit's pictures were taken before an operation.

    On the day of the operation, the visit's occasion decides.
    """
    day = timezone.localtime(visit.taken_at).date()
    return day < operation.day or (day == operation.day and visit.occasion == Visit.Occasion.BEFORE)


def phase_of(visit: Visit, operations: Sequence[Operation]) -> str:
    """Say when a visit was by the operations: "after the second filling".

    Empty where no operation is entered.
    """
    if not operations:
        return ""
    done = [operation for operation in operations if not is_before(visit, operation)]
    if not done:
        return "before the operation"
    last = max(done, key=lambda operation: operation.day)
    days = sorted({operation.day for operation in operations if operation.kind == last.kind})
    place = days.index(last.day)
    which = "" if len(days) == 1 else f"{_ORDINALS[place] if place < len(_ORDINALS) else f'{place + 1}th'} "
    return f"after the {which}{_PHASES[Operation.Kind(last.kind)]}"


def events(operations: Sequence[Operation]) -> list[Event]:
    """Operations as marks of the time line, one a day, the earliest first."""
    by_day: dict[datetime.date, list[Operation]] = {}
    for operation in sorted(operations, key=lambda operation: operation.day):
        by_day.setdefault(operation.day, []).append(operation)
    return [
        Event(
            timezone.make_aware(datetime.datetime.combine(day, datetime.time(12))),
            f"{day.day} {day:%b %Y}: {'; '.join(_short(operation) for operation in rows)}",
        )
        for day, rows in by_day.items()
    ]


def _short(operation: Operation) -> str:
    return f"{operation.get_kind_display()}, {operation.get_side_display().lower()}"


def sides_of(operations: Sequence[Operation], day: datetime.date) -> str:
    """Sides of surgery until a day, in words. Empty if none is entered."""
    sides = {operation.side for operation in operations if operation.day <= day}
    if Operation.Side.BOTH in sides or {"left", "right"} <= sides:
        return "both sides"
    return next(iter(sides), "")
