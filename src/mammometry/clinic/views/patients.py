"""Patients: search, who they are, all their visits, and what people enter beside photographs."""

from __future__ import annotations

import uuid
from collections.abc import Callable
from functools import wraps
from typing import Any

from django.contrib import messages
from django.http import Http404, HttpRequest, HttpResponse, HttpResponseBase
from django.shortcuts import get_object_or_404, redirect, render
from django.utils import timezone

from mammometry.clinic.forms import (
    ConsentForm,
    OperationForm,
    PatientForm,
    WithdrawalForm,
)
from mammometry.clinic.models import Consent, Operation, Patient
from mammometry.clinic.records import comparing, results, search
from mammometry.clinic.records.clinical import holds, operation_details
from mammometry.clinic.records.operations import events, phase_of, retentions
from mammometry.clinic.views.responses import person_of


def is_part(request: HttpRequest) -> bool:
    """Whether the page's script asks for its rows alone."""
    return request.headers.get("HX-Request") == "true"


def search_context(request: HttpRequest, *, choosing: bool = False, leave_out: Patient | None = None) -> dict[str, Any]:
    """What ``patient_search.html`` shows. The audit gets the patients who are shown.

    Args:
        request: whose ``q`` is searched for.
        choosing: whether a row leads back to this page with the patient; else it opens the patient's page.
        leave_out: a patient who is not to be chosen.
    """
    text = " ".join(request.GET.get("q", "")[:100].split())
    rows = search.matches(text, leave_out=leave_out) if text or not choosing else search.newest(leave_out=leave_out)
    shown = rows[: search.MANY]
    request.shown = [row.patient.pk for row in shown]  # type: ignore[attr-defined]
    kept = request.GET.copy()
    for name in ("q", "patient"):
        kept.pop(name, None)
    return {
        "rows": shown, "more": len(rows) > search.MANY, "asked": text, "choosing": choosing, "kept": kept,
    }  # fmt: skip


def chosen_patient(request: HttpRequest, *, leave_out: Patient | None = None) -> Patient | None:
    """The patient who was chosen. None: nobody yet.

    Raises:
        Http404: there is no such patient.
    """
    text = request.POST.get("patient") or request.GET.get("patient")
    if not text:
        return None
    try:
        patient = Patient.objects.filter(pk=uuid.UUID(text)).first()
    except ValueError:
        patient = None
    if patient is None or patient == leave_out:
        raise Http404
    return patient


def leads_on(view: Callable[..., HttpResponseBase]) -> Callable[..., HttpResponseBase]:
    """A page of a patient whose old address leads on after two records were merged."""

    @wraps(view)
    def lead(request: HttpRequest, *args: Any, **kwargs: Any) -> HttpResponseBase:
        try:
            return view(request, *args, **kwargs)
        except Http404:
            merged = Patient.everything.filter(pk=kwargs["patient"]).exclude(merged_into=None).first()
            match = request.resolver_match
            if merged is None or match is None or request.method != "GET":
                raise
            return redirect(match.view_name, **{**kwargs, "patient": merged.merged_into_id})

    return lead


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


_HELP = {
    "operation": "Enter what was done, one entry an operation. The time line shows it, and reports name it.",
    "consent": "A consent that is withdrawn is not removed: enter the day, so that the clinic can show since when.",
}


def operation_new(request: HttpRequest, patient: uuid.UUID) -> HttpResponse:
    """Enter an operation."""
    person = get_object_or_404(Patient, pk=patient)
    operation = Operation(patient=person, entered_by=person_of(request))
    form = OperationForm(request.POST or None, instance=operation)
    return _edited(request, form, person, heading="New operation", about="operation", done="The operation is entered.")


def operation_edit(request: HttpRequest, operation: uuid.UUID) -> HttpResponse:
    """Change an operation."""
    row = get_object_or_404(Operation.objects.select_related("patient"), pk=operation)
    form = OperationForm(request.POST or None, instance=row)
    heading, done = "Change the operation", "The operation is changed."
    return _edited(request, form, row.patient, heading=heading, about="operation", done=done, operation=row)


def operation_remove(request: HttpRequest, operation: uuid.UUID) -> HttpResponse:
    """Remove an operation that was entered by mistake. The audit keeps it."""
    row = get_object_or_404(Operation, pk=operation)
    patient = row.patient_id
    if request.method == "POST":
        row.delete()
        messages.success(request, "The operation is removed.")
    return redirect("patient", patient=patient)


def consent_new(request: HttpRequest, patient: uuid.UUID) -> HttpResponse:
    """Enter a consent."""
    person = get_object_or_404(Patient, pk=patient)
    consent = Consent(patient=person, entered_by=person_of(request))
    first = {"purpose": request.GET.get("purpose"), "given_on": timezone.localdate()}
    form = ConsentForm(request.POST or None, instance=consent, initial=first)
    return _edited(request, form, person, heading="New consent", about="consent", done="The consent is entered.")


def consent_edit(request: HttpRequest, consent: uuid.UUID) -> HttpResponse:
    """Enter that a consent was withdrawn, or correct it."""
    row = get_object_or_404(Consent.objects.select_related("patient"), pk=consent)
    form = WithdrawalForm(request.POST or None, instance=row)
    heading = f"Consent: {row.get_purpose_display().lower()}"
    return _edited(request, form, row.patient, heading=heading, about="consent", done="The consent is changed.")


def _edited(
    request: HttpRequest,
    form: OperationForm | ConsentForm | WithdrawalForm,
    patient: Patient,
    *,
    heading: str,
    about: str,
    done: str,
    **more: object,
) -> HttpResponse:
    """A page with one form about a patient."""
    if request.method == "POST" and form.is_valid():
        form.save()
        messages.success(request, done)
        return redirect("patient", patient=patient.pk)
    context = {"form": form, "patient": patient, "heading": heading, "help": _HELP[about], **more}
    return render(request, "clinic/clinical_form.html", context)
