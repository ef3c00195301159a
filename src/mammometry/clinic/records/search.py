"""The one search for patients, of all pages."""

from __future__ import annotations

import datetime
from collections.abc import Iterable
from dataclasses import dataclass

from django.db.models import Count, Max, Q, QuerySet
from django.utils import timezone

from mammometry.clinic.models import Patient, Visit
from mammometry.clinic.records.search_words import read_query

MANY = 50
"""Rows that a search shows; more are not read."""
_NEWEST = 8  # patients that are offered before anything is typed


@dataclass(frozen=True, slots=True)
class Match:
    """A patient who answers a search."""

    patient: Patient
    visit_count: int
    last_visit: datetime.datetime | None


def search(text: str) -> QuerySet[Patient]:
    """Patients who match every word and day that was typed.

    Words are parts of names, record numbers and pseudonyms, in any order. Case, accents and hyphens do not matter.
    A day finds who was born or photographed on it.
    """
    query = read_query(text)
    patients = Patient.objects.all()
    if text.strip() and not query.days and not query.words:
        return patients.none()
    for word in query.words:
        patients = patients.filter(search_words__contains=word)
    for days, typed in query.days:
        photographed = Visit.objects.filter(_on(days)).values("patient")
        patients = patients.filter(Q(born__in=days) | Q(pk__in=photographed) | Q(search_words__contains=typed))
    return patients


def matches(text: str, *, leave_out: Patient | None = None) -> list[Match]:
    """The first matches by name, at most one more than `MANY`.

    Args:
        text: what was typed.
        leave_out: the patient who is not looked for.
    """
    return _with_visits(_without(search(text), leave_out)[: MANY + 1])


def newest(*, leave_out: Patient | None = None) -> list[Match]:
    """The patients who were entered last, offered before anything is typed."""
    return _with_visits(_without(Patient.objects.order_by("-created"), leave_out)[:_NEWEST])


def _without(patients: QuerySet[Patient], leave_out: Patient | None) -> QuerySet[Patient]:
    return patients if leave_out is None else patients.exclude(pk=leave_out.pk)


def _with_visits(patients: Iterable[Patient]) -> list[Match]:
    rows = list(patients)
    visits = Visit.objects.filter(patient__in=rows).order_by().values("patient")
    counted = {
        row["patient"]: (row["number"], row["last"])
        for row in visits.annotate(number=Count("pk"), last=Max("taken_at"))
    }
    return [Match(row, *counted.get(row.pk, (0, None))) for row in rows]


def _on(days: Iterable[datetime.date]) -> Q:
    within = Q(pk=None)
    for day in days:
        begin = timezone.make_aware(datetime.datetime.combine(day, datetime.time()))
        within |= Q(taken_at__gte=begin, taken_at__lt=begin + datetime.timedelta(days=1))
    return within
