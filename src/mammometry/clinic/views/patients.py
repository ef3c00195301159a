"""Patients: search, who they are, and all their visits over time."""

from __future__ import annotations

import datetime
import uuid

from django.contrib import messages
from django.db.models import Count, Max, Q, QuerySet
from django.http import HttpRequest, HttpResponse
from django.shortcuts import get_object_or_404, redirect, render
from django.utils import timezone

from mammometry.clinic import comparing, results
from mammometry.clinic.clinical_facts import operation_details
from mammometry.clinic.consents import holds
from mammometry.clinic.forms import PatientForm
from mammometry.clinic.models import Consent, Patient
from mammometry.clinic.operations import events, phase_of, retentions

_MANY = 50  # rows of a search; more are not read


def patients(request: HttpRequest) -> HttpResponse:
    """All patients, or those who are searched.

    By name, record number, pseudonym or day of a visit.
    """
    asked = " ".join(request.GET.get("q", "")[:100].split())
    found = search(asked).annotate(visit_count=Count("visits"), last_visit=Max("visits__taken_at"))
    rows = list(found.order_by("family_name", "given_name", "record_number")[: _MANY + 1])
    request.shown = [each.id for each in rows[:_MANY]]  # type: ignore[attr-defined]
    context = {"rows": rows[:_MANY], "more": len(rows) > _MANY, "asked": asked}
    part = request.headers.get("HX-Request") == "true"
    return render(request, "clinic/patients_rows.html" if part else "clinic/patients.html", context)


def search(asked: str) -> QuerySet[Patient]:
    """Patients who match every word of a search.

    Or who have a visit on the day that was entered.
    """
    found = Patient.objects.all()
    day = _day(asked)
    if day is not None:
        begin = timezone.make_aware(datetime.datetime.combine(day, datetime.time()))
        within = Q(visits__taken_at__gte=begin, visits__taken_at__lt=begin + datetime.timedelta(days=1))
        return Patient.objects.filter(pk__in=Patient.objects.filter(within | Q(born=day)).values("pk"))
    for word in asked.replace(",", " ").split():
        found = found.filter(
            Q(family_name__icontains=word)
            | Q(given_name__icontains=word)
            | Q(record_number__icontains=word)
            | Q(pseudonym__icontains=word)
        )
    return found


def patient(request: HttpRequest, patient: uuid.UUID) -> HttpResponse:
    """One patient: volumes over time, visits, changes, operations, consents."""
    person = get_object_or_404(Patient, pk=patient)
    visits = list(person.visits.select_related("rig").prefetch_related("measurements__volumes"))
    operations = list(person.operations.select_related("entered_by"))
    found = results.latest(visits)
    by_visit = {result.visit.id: result for result in found}
    context = {
        "patient": person,
        "visits": [(visit, by_visit.get(visit.id), phase_of(visit, operations)) for visit in visits],
        "measured": comparing.comparable(visits)[::-1],
        "readings": results.readings(found),
        "events": events(operations),
        "operations": [(operation, ", ".join(operation_details(operation))) for operation in operations],
        "retentions": retentions(operations, found),
        "consents": person.consents.select_related("entered_by"),
        "lacking": [purpose for purpose in Consent.Purpose if not holds(person, purpose)],
    }
    return render(request, "clinic/patient.html", context)


def patient_new(request: HttpRequest) -> HttpResponse:
    """Enter a patient."""
    form = PatientForm(request.POST or None)
    if request.method == "POST" and form.is_valid():
        made = form.save()
        messages.success(request, "The patient is entered.")
        return redirect("patient", patient=made.pk)
    return render(request, "clinic/patient_form.html", {"form": form})


def patient_edit(request: HttpRequest, patient: uuid.UUID) -> HttpResponse:
    """Correct who somebody is."""
    person = get_object_or_404(Patient, pk=patient)
    form = PatientForm(request.POST or None, instance=person)
    if request.method == "POST" and form.is_valid():
        form.save()
        messages.success(request, "The patient's entry is changed.")
        return redirect("patient", patient=person.pk)
    return render(request, "clinic/patient_form.html", {"form": form, "patient": person})


def _day(asked: str) -> datetime.date | None:
    for form in ("%Y-%m-%d", "%d.%m.%Y", "%d/%m/%Y"):
        try:
            return datetime.datetime.strptime(asked, form).date()
        except ValueError:
            continue
    return None
