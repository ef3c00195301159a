"""Pooled figures under pseudonyms. The cohort, agreement of repeated visits, a table to take along."""

from __future__ import annotations

import datetime
from itertools import islice

import numpy as np
from django.db.models import QuerySet
from django.http import HttpRequest, HttpResponse
from django.shortcuts import render
from django.utils import timezone

from mammometry.base.csv_cells import CsvWriter
from mammometry.clinic.models import Visit
from mammometry.clinic.study.cohort import left_out, measured_visits, pooled, study_rows, visits_between
from mammometry.study.agreement import LEAST_SUBJECTS, PairedMeasurements, agreement

_SHOWN = 200  # rows on the page
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


def study(request: HttpRequest) -> HttpResponse:
    """Cohort and agreement."""
    visits = _asked(request)
    everything = pooled(visits)
    within_days = _whole(request.GET.get("within", ""), 1, 365)
    pairs = everything.repeated(within_days)
    found = None
    if len({name for name, *_ in pairs}) >= LEAST_SUBJECTS:
        names, first, second = zip(*pairs, strict=True)
        found = agreement(
            PairedMeasurements(
                names=names, reference=np.array(first), measured=np.array(second),
                reference_name="first", measured_name="second", unit="cc",
            )
        )  # fmt: skip
    volumes_cc = everything.volumes_cc
    left_out_visits, left_out_patients = left_out(visits)
    context = {
        "rows": list(islice(study_rows(visits.filter(pk__in=everything.visit_keys[:_SHOWN])), _SHOWN)),
        "more": max(0, len(everything.day) - _SHOWN),
        "patients": everything.patients,
        "visits": everything.visits,
        "measured": len(volumes_cc),
        "refused": len(everything.day) - len(volumes_cc),
        "median_cc": float(np.median(volumes_cc)) if len(volumes_cc) else None,
        "quartiles_cc": tuple(map(float, np.quantile(volumes_cc, [0.25, 0.75]))) if len(volumes_cc) else None,
        "agreement": found,
        "pairs": len(pairs),
        "least": LEAST_SUBJECTS,
        "within": within_days,
        "left_out": left_out_visits,
        "left_out_patients": left_out_patients,
        "asked": request.GET,
        "query": request.GET.urlencode(),
    }
    return render(request, "clinic/study.html", context)


def study_csv(request: HttpRequest) -> HttpResponse:
    """The cohort as a table. Pseudonyms only."""
    response = HttpResponse(content_type="text/csv; charset=utf-8")
    response["Content-Disposition"] = f'attachment; filename="cohort_{timezone.localdate():%Y-%m-%d}.csv"'
    writer = CsvWriter(response)
    writer.row(_COLUMNS)
    for row in study_rows(_asked(request)):
        writer.row(_cell(getattr(row, name)) for name in _COLUMNS)
    return response


def asked_visits(request: HttpRequest) -> QuerySet[Visit]:
    """Measured visits of the asked time whose patients consent to research, by pseudonym and day."""
    return measured_visits(_asked(request)).select_related("patient", "rig")


def visits_left_out(request: HttpRequest) -> tuple[int, int]:
    """Numbers of measured visits of the asked time, and of their patients, without a consent to research."""
    return left_out(_asked(request))


def _asked(request: HttpRequest) -> QuerySet[Visit]:
    begin, end = (_day(request.GET.get(name, "")) for name in ("from", "until"))
    return visits_between(begin, end, confirmed="confirmed" in request.GET)


def _cell(value: object) -> object:
    """Numbers with one decimal."""
    return f"{value:.1f}" if isinstance(value, float) else value


def _day(text: str) -> datetime.date | None:
    try:
        return datetime.date.fromisoformat(text)
    except ValueError:
        return None


def _whole(text: str, low: int, high: int) -> int:
    return min(max(int(text), low), high) if text.isdecimal() and len(text) < 6 else low
