"""Pages of patients: search, identity, visits, and clinical data."""

import uuid
from collections.abc import Callable
from functools import wraps
from typing import Any

from django.contrib import messages
from django.http import Http404, HttpRequest, HttpResponse, HttpResponseBase
from django.shortcuts import get_object_or_404, redirect, render
from django.utils import timezone

from mammometry.clinic.forms import ConsentForm, OperationForm, OperationRemovalForm, PatientForm, WithdrawalForm
from mammometry.clinic.models import Consent, Operation, Patient
from mammometry.clinic.records import comparing, notes, results, search
from mammometry.clinic.records.clinical import holds, operation_details
from mammometry.clinic.records.operations import events, phase_of, retentions
from mammometry.clinic.views.responses import form_page, person_of


def is_part(request: HttpRequest) -> bool:
    """Whether the page's script requests only the rows."""
    return request.headers.get("HX-Request") == "true"


def search_context(request: HttpRequest, *, choosing: bool = False, leave_out: Patient | None = None) -> dict[str, Any]:
    """Context of ``patient_search.html``. The audit records the shown patients.

    Args:
        request: its parameter ``q`` is the search.
        choosing: whether a row returns to this page with the patient. Otherwise it opens the patient's page.
        leave_out: a patient to exclude.
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
    """The chosen patient. None if none is chosen yet.

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
    """Decorate a page of a patient, so that it redirects from merged records."""

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
    """All patients, or those who match a search."""
    page = "clinic/patients_rows.html" if is_part(request) else "clinic/patients.html"
    return render(request, page, search_context(request))


def patient(request: HttpRequest, patient: uuid.UUID) -> HttpResponse:
    """One patient: volumes over time, visits, changes, operations, consents."""
    person = get_object_or_404(Patient, pk=patient)
    visits = list(person.visits.select_related("rig", "repeat_of").prefetch_related("measurements__volumes"))
    operations = list(person.operations.select_related("entered_by"))
    shown_results = results.latest(visits)
    by_visit = {result.visit.id: result for result in shown_results}
    context = {
        "patient": person,
        "visits": [(visit, by_visit.get(visit.id), phase_of(visit, operations)) for visit in visits],
        "measured": comparing.comparable(visits)[::-1],
        "readings": results.readings(shown_results),
        "events": events(operations),
        "operations": [(operation, ", ".join(operation_details(operation))) for operation in operations],
        "retentions": retentions(operations, shown_results),
        "consents": person.consents.select_related("entered_by"),
        "lacking": [purpose for purpose in Consent.Purpose if not holds(person, purpose)],
    }
    return render(request, "clinic/patient.html", context)


def patient_notes(request: HttpRequest, patient: uuid.UUID) -> HttpResponse:
    """Earlier texts of notes about a patient, with author and time of each change."""
    person = get_object_or_404(Patient, pk=patient)
    return render(request, "clinic/patient_notes.html", {"patient": person, "lines": notes.history(person)})


def patient_form(request: HttpRequest, patient: uuid.UUID | None = None) -> HttpResponse:
    """Add a patient, or correct the identity."""
    person = None if patient is None else get_object_or_404(Patient, pk=patient)
    form = PatientForm(request.POST or None, instance=person)
    done = "The patient is entered." if person is None else "The patient's entry is changed."
    return form_page(request, "clinic/patient_form.html", form, done, _to_patient, patient=person)


def _to_patient(row: Patient | Operation | Consent) -> HttpResponse:
    return redirect("patient", patient=row.pk if isinstance(row, Patient) else row.patient_id)


_HELP = {
    "operation": "Make one entry for each operation. The time line and reports show it.",
    "consent": "Do not remove a withdrawn consent: enter the day of withdrawal.",
}


def operation_new(request: HttpRequest, patient: uuid.UUID) -> HttpResponse:
    """Enter an operation."""
    person = get_object_or_404(Patient, pk=patient)
    operation = Operation(patient=person, entered_by=person_of(request))
    form = OperationForm(request.POST or None, instance=operation)
    return _clinical_form(request, form, "operation", "The operation is entered.", heading="New operation")


def operation_edit(request: HttpRequest, operation: uuid.UUID) -> HttpResponse:
    """Change an operation."""
    row = get_object_or_404(Operation.objects.select_related("patient"), pk=operation)
    form = OperationForm(request.POST or None, instance=row)
    heading, done = "Change the operation", "The operation is changed."
    removal = OperationRemovalForm(instance=row)
    return _clinical_form(request, form, "operation", done, heading=heading, operation=row, removal=removal)


def operation_remove(request: HttpRequest, operation: uuid.UUID) -> HttpResponse:
    """Remove an operation that was entered by mistake. It remains in the audit."""
    row = get_object_or_404(Operation, pk=operation)
    patient = row.patient_id
    if request.method == "POST" and OperationRemovalForm(request.POST, instance=row).is_valid():
        row.delete()
        messages.success(request, "The operation is removed.")
    return redirect("patient", patient=patient)


def consent_new(request: HttpRequest, patient: uuid.UUID) -> HttpResponse:
    """Enter a consent."""
    person = get_object_or_404(Patient, pk=patient)
    consent = Consent(patient=person, entered_by=person_of(request))
    first = {"purpose": request.GET.get("purpose"), "given_on": timezone.localdate()}
    form = ConsentForm(request.POST or None, instance=consent, initial=first)
    return _clinical_form(request, form, "consent", "The consent is entered.", heading="New consent")


def consent_edit(request: HttpRequest, consent: uuid.UUID) -> HttpResponse:
    """Enter the withdrawal of a consent, or correct it."""
    row = get_object_or_404(Consent.objects.select_related("patient"), pk=consent)
    form = WithdrawalForm(request.POST or None, instance=row)
    heading = f"Consent: {row.get_purpose_display().lower()}"
    return _clinical_form(request, form, "consent", "The consent is changed.", heading=heading)


def _clinical_form(
    request: HttpRequest, form: OperationForm | ConsentForm | WithdrawalForm, about: str, done: str, **context: object
) -> HttpResponse:
    """A page with one form about a patient."""
    context |= {"patient": form.instance.patient, "help": _HELP[about]}
    return form_page(request, "clinic/clinical_form.html", form, done, _to_patient, **context)
