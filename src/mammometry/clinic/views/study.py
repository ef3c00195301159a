"""Pooled figures under pseudonyms.

The cohort, agreement of repeated visits, a table to take along.
"""

from __future__ import annotations

import datetime
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from django.db.models import QuerySet
from django.http import HttpRequest, HttpResponse
from django.shortcuts import render
from django.utils import timezone

from mammometry.base.csv_cells import CsvWriter
from mammometry.clinic import results
from mammometry.clinic.confirmations import CHANGED, confirmation_of, is_changed
from mammometry.clinic.consents import research_consent
from mammometry.clinic.models import Visit
from mammometry.study.agreement import LEAST_SUBJECTS, PairedMeasurements, agreement

_COLUMNS = (
    "pseudonym",
    "day",
    "years",
    "side",
    "definition",
    "volume_cc",
    "low_cc",
    "high_cc",
    "refused",
    "state",
    "confirmed",
    "confirmed_on",
    "rig",
    "software",
)


@dataclass(frozen=True, slots=True)
class Row:
    """One breast at one visit, without a name."""

    pseudonym: str
    day: datetime.date
    years: int | None
    """Of age."""
    side: str
    definition: str
    volume_cc: float | None
    low_cc: float | None
    high_cc: float | None
    refused: str
    state: str
    """Of the visit. An unmeasured change of a boundary or landmark is said, and no number is given."""
    confirmed: bool
    confirmed_on: datetime.date | None
    """None: not confirmed."""
    rig: str
    software: str


def study(request: HttpRequest) -> HttpResponse:
    """Cohort and agreement."""
    rows = list(cohort(_from(request), _until(request), confirmed="confirmed" in request.GET))
    within_days = _whole(request.GET.get("within", ""), 1, 365)
    pairs = repeated(rows, within_days)
    found = None
    if len({name for name, *_ in pairs}) >= LEAST_SUBJECTS:
        first, second = (np.array([pair[k] for pair in pairs]) for k in (1, 2))
        found = agreement(
            PairedMeasurements(
                names=tuple(name for name, *_ in pairs), reference=first, measured=second,
                reference_name="first", measured_name="second", unit="cc",
            )
        )  # fmt: skip
    volumes = np.array([row.volume_cc for row in rows if row.volume_cc is not None])
    context = {
        "rows": rows[:500],
        "more": max(0, len(rows) - 500),
        "patients": len({row.pseudonym for row in rows}),
        "visits": len({(row.pseudonym, row.day) for row in rows}),
        "measured": len(volumes),
        "refused": sum(row.volume_cc is None for row in rows),
        "median_cc": float(np.median(volumes)) if len(volumes) else None,
        "quartiles_cc": tuple(map(float, np.quantile(volumes, [0.25, 0.75]))) if len(volumes) else None,
        "agreement": found,
        "pairs": len(pairs),
        "least": LEAST_SUBJECTS,
        "within": within_days,
        "left_out": without_consent(request).count(),
        "left_out_patients": without_consent(request).values("patient").distinct().count(),
        "asked": request.GET,
        "query": request.GET.urlencode(),
    }
    return render(request, "clinic/study.html", context)


def study_csv(request: HttpRequest) -> HttpResponse:
    """The cohort as a table.

    Pseudonyms only.
    """
    response = HttpResponse(content_type="text/csv; charset=utf-8")
    response["Content-Disposition"] = f'attachment; filename="cohort_{timezone.localdate():%Y-%m-%d}.csv"'
    writer = CsvWriter(response)
    writer.row(_COLUMNS)
    for row in cohort(_from(request), _until(request), confirmed="confirmed" in request.GET):
        writer.row(_cell(getattr(row, name)) for name in _COLUMNS)
    return response


def cohort(begin: datetime.date | None, end: datetime.date | None, *, confirmed: bool) -> Iterator[Row]:
    """Newest measurement of each visit, by pseudonym and day."""
    visits = _between(begin, end, confirmed=confirmed).prefetch_related(
        "measurements__volumes", "measurements__confirmations"
    )
    for result in results.latest(visits):
        visit = result.visit
        day = timezone.localtime(visit.taken_at).date()
        confirmation = confirmation_of(result.measurement) if visit.state == Visit.State.CONFIRMED else None
        state = CHANGED if is_changed(visit) else str(visit.state)
        for side in result.sides:
            low, high = side.interval_cc or (None, None)
            yield Row(
                pseudonym=visit.patient.pseudonym, day=day, years=results.age(visit.patient.born, day), side=side.side,
                definition=side.definition, volume_cc=side.volume_cc, low_cc=low, high_cc=high, refused=side.refused,
                state=state, confirmed=confirmation is not None,
                confirmed_on=None if confirmation is None else timezone.localtime(confirmation.at).date(),
                rig=visit.device, software=result.measurement.software,
            )  # fmt: skip


def asked_visits(request: HttpRequest) -> QuerySet[Visit]:
    """Measured visits of the asked time, by pseudonym and day."""
    visits = _between(_from(request), _until(request), confirmed="confirmed" in request.GET)
    return visits.filter(measurements__isnull=False).distinct()


def repeated(rows: list[Row], within_days: int) -> list[tuple[str, float, float]]:
    """Volumes of breasts that were measured twice within some days.

    Name, first cc, second cc.

    One pair a breast, since pairs of one breast are not independent.
    """
    first: dict[tuple[str, str, str], Row] = {}
    pairs: dict[tuple[str, str, str], tuple[str, float, float]] = {}
    for row in rows:
        if row.volume_cc is None:
            continue
        key = row.pseudonym, row.side, row.definition
        before = first.get(key)
        if before is not None and key not in pairs and (row.day - before.day).days <= within_days:
            assert before.volume_cc is not None
            pairs[key] = f"{row.pseudonym} {row.side}", before.volume_cc, row.volume_cc
        first[key] = row
    return list(pairs.values())


def without_consent(request: HttpRequest) -> QuerySet[Visit]:
    """Measured visits of the asked time that are left out: no consent to research holds."""
    visits = _asked(_from(request), _until(request), confirmed="confirmed" in request.GET)
    return visits.filter(~research_consent(), measurements__isnull=False).distinct()


def _between(begin: datetime.date | None, end: datetime.date | None, *, confirmed: bool) -> QuerySet[Visit]:
    """Visits of patients whose consent to research holds."""
    return _asked(begin, end, confirmed=confirmed).filter(research_consent())


def _asked(begin: datetime.date | None, end: datetime.date | None, *, confirmed: bool) -> QuerySet[Visit]:
    visits = Visit.objects.filter(subject_kind=Visit.Subject.TORSO)
    if begin is not None:
        visits = visits.filter(taken_at__gte=_midnight(begin))
    if end is not None:
        visits = visits.filter(taken_at__lt=_midnight(end) + datetime.timedelta(days=1))
    if confirmed:
        visits = visits.filter(state=Visit.State.CONFIRMED)
    return visits.select_related("patient", "rig").order_by("patient__pseudonym", "taken_at")


def _cell(value: object) -> object:
    """Numbers with one decimal."""
    return f"{value:.1f}" if isinstance(value, float) else value


def _from(request: HttpRequest) -> datetime.date | None:
    return _day(request.GET.get("from", ""))


def _until(request: HttpRequest) -> datetime.date | None:
    return _day(request.GET.get("until", ""))


def _day(text: str) -> datetime.date | None:
    try:
        return datetime.date.fromisoformat(text)
    except ValueError:
        return None


def _whole(text: str, low: int, high: int) -> int:
    return min(max(int(text), low), high) if text.isdecimal() and len(text) < 6 else low


def _midnight(day: datetime.date) -> datetime.datetime:
    return timezone.make_aware(datetime.datetime.combine(day, datetime.time()))
