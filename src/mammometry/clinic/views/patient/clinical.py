"""What people enter beside photographs: operations, consents, a visit's circumstances and conclusions."""

from __future__ import annotations

import uuid

from django.contrib import messages
from django.http import HttpRequest, HttpResponse
from django.shortcuts import get_object_or_404, redirect, render
from django.utils import timezone

from mammometry.clinic.clinical_forms import (
    CircumstancesForm,
    ConclusionForm,
    ConsentForm,
    OperationForm,
    WithdrawalForm,
)
from mammometry.clinic.models import Conclusion, Consent, Operation, Patient, Visit
from mammometry.clinic.records.confirmations import CHANGED_SENTENCE, is_changed
from mammometry.clinic.views.patient import visits
from mammometry.clinic.views.who import person_of

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


def circumstances(request: HttpRequest, visit: uuid.UUID) -> HttpResponse:
    """Change why the patient came and how she held herself."""
    shown = get_object_or_404(Visit, pk=visit)
    if request.method == "POST":
        form = CircumstancesForm(request.POST, instance=shown)
        if form.is_valid():
            shown.save(update_fields=["occasion", "posture"])
            messages.success(request, "Occasion and posture are changed.")
        else:
            messages.error(request, "Choose occasion and posture from the lists.")
    return redirect("visit", visit=visit)


def conclude(request: HttpRequest, visit: uuid.UUID) -> HttpResponse:
    """Sign a conclusion on the newest result of a visit. What cannot be signed is shown again."""
    shown = get_object_or_404(Visit, pk=visit)
    if request.method != "POST":
        return redirect("visit", visit=visit)
    measurement, newest = shown.measurements.first(), shown.conclusions.first()
    form = ConclusionForm(request.POST)
    if measurement is None:
        messages.error(request, "This visit is not measured yet. Measure it first.")
    elif request.POST.get("measurement") != str(measurement.pk):
        messages.error(request, "The visit was measured again meanwhile. Look at the new result, then sign.")
    elif is_changed(shown):
        messages.error(request, CHANGED_SENTENCE)
    elif not form.is_valid():
        messages.error(request, "Write the conclusion first, in up to 4,000 characters.")
    elif newest is not None and (newest.text, newest.measurement_id) == (form.cleaned_data["text"], measurement.pk):
        messages.info(request, "This conclusion is signed already. Nothing was changed.")
    else:
        text = form.cleaned_data["text"]
        Conclusion.objects.create(visit=shown, measurement=measurement, text=text, by=person_of(request))
        messages.success(request, "The conclusion is signed.")
        return redirect("visit", visit=visit)
    return visits.visit(request, visit, draft=request.POST.get("text", ""))


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
