"""The administrators' first page: what needs them now."""

from __future__ import annotations

import datetime

from django.http import HttpRequest, HttpResponse
from django.shortcuts import render
from django.utils import timezone

from mammometry.clinic.audit import FAILED_LOGIN, REFUSED
from mammometry.clinic.audit_entries import AuditFilter, entries
from mammometry.clinic.first_day import first_day_of
from mammometry.clinic.maintenance import backups
from mammometry.clinic.maintenance.disk import cached_usage
from mammometry.clinic.models import Person
from mammometry.clinic.site import the_clinic
from mammometry.clinic.views.who import person_of

_DAYS = 7  # of failed logins and refused pages


def overview(request: HttpRequest) -> HttpResponse:
    """People, backups, disk and what the audit shows of the last days."""
    people = [person for person in Person.objects.all() if person.is_active]
    since = timezone.localdate() - datetime.timedelta(days=_DAYS - 1)
    context = {
        "first_day": first_day_of(person_of(request)),
        "people": len(people),
        "without_password": [person for person in people if person.waits_for_password],
        "backups": backups.state_of(the_clinic()),
        "disk": cached_usage(the_clinic()),
        "failed_logins": entries(AuditFilter(kind=FAILED_LOGIN, since=since)).count(),
        "refused": entries(AuditFilter(kind=REFUSED, since=since)).count(),
        "days": _DAYS,
        "since": since,
    }
    return render(request, "clinic/administration.html", context)
