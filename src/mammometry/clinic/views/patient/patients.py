"""Patients: search, who they are, and all their visits over time."""

from __future__ import annotations

import uuid

from django.contrib import messages
from django.http import HttpRequest, HttpResponse
from django.shortcuts import get_object_or_404, redirect, render

from mammometry.clinic.forms import PatientForm
from mammometry.clinic.models import Consent, Patient
from mammometry.clinic.records import results
from mammometry.clinic.records.clinical_facts import operation_details
from mammometry.clinic.records.consents import holds
from mammometry.clinic.records.operations import events, phase_of
from mammometry.clinic.study import comparing
from mammometry.clinic.study.retention import retentions
from mammometry.clinic.views.patient.choose import is_part, search_context


def patients(request: HttpRequest) -> HttpResponse:
    """All patients, or those who are searched."""
    page = "clinic/patients_rows.html" if is_part(request) else "clinic/patients.html"
    return render(request, page, search_context(request))


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


def _is_compared(result: results.VisitResult) -> bool:
    """Whether a visit can be laid onto another: it has a volume, and photographs."""
    return not result.visit.is_scan and any(side.volume_cc is not None for side in result.sides)
