"""Pages for correcting records and undoing corrections."""

import uuid
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from django import forms
from django.contrib import messages
from django.http import HttpRequest, HttpResponse
from django.shortcuts import get_object_or_404, redirect, render
from django.urls import reverse
from django.utils.dateparse import parse_datetime

from mammometry.base.errors import MammometryError
from mammometry.clinic.forms import DAY_AND_TIME, ask_about_day
from mammometry.clinic.models import Correction, Delivery, Patient, Visit
from mammometry.clinic.record_form import RecordForm
from mammometry.clinic.records import corrections as records
from mammometry.clinic.roles import CARE, Role
from mammometry.clinic.templatetags.pages import day, moment
from mammometry.clinic.views.patients import chosen_patient, is_part, search_context
from mammometry.clinic.views.responses import person_of, visit_or_404

_NOTHING_LOST = f"Nothing is lost: you can undo this for {records.DAYS} days under “Corrections and bin”."


class ReasonForm(forms.Form):
    """Reason for a correction."""

    reason = forms.CharField(
        label="Reason", max_length=500, widget=forms.Textarea(attrs={"rows": 2}),
        help_text="Stored with the correction.",
    )  # fmt: skip


class VisitReasonForm(RecordForm, ReasonForm):
    """Reason for moving a visit or putting it into the bin, with the version that the user saw."""

    watched = ("patient", "taken_at")

    class Meta:
        model = Visit
        fields = ()


class PatientReasonForm(RecordForm, ReasonForm):
    """Reason for putting a patient's record into the bin, with the version that the user saw."""

    watched = ("family_name", "given_name", "born", "record_number")

    class Meta:
        model = Patient
        fields = ()


class DateForm(RecordForm, ReasonForm):
    """Correct day, time and note of a visit."""

    questions: tuple[str, ...] = ()
    field_order = ("taken_at", "note", "reason")

    class Meta:
        model = Visit
        fields = ("taken_at", "note")
        labels = {"taken_at": "Day and time"}  # noqa: RUF012
        widgets = {"taken_at": DAY_AND_TIME, "note": forms.Textarea(attrs={"rows": 3})}  # noqa: RUF012

    def clean(self) -> dict[str, Any]:
        """Ask the user to confirm an unusual day."""
        values: dict[str, Any] = super().clean() or {}
        ask_about_day(self, self.instance.rig)
        return values


class MergeForm(PatientReasonForm):
    """Choice of the record number in a merge."""

    number = forms.ChoiceField(label="Record number to keep", widget=forms.RadioSelect)

    field_order = ("number", "reason")

    def __init__(self, *args: Any, records: tuple[Patient, Patient], **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        number = self.fields["number"]
        assert isinstance(number, forms.ChoiceField)
        number.choices = [(str(record.pk), record.record_number) for record in records]
        number.initial = str(records[0].pk)


def visit_move(request: HttpRequest, visit: uuid.UUID) -> HttpResponse:
    """Move a visit to another patient, who is searched for."""
    row = visit_or_404(visit)
    patient = chosen_patient(request, leave_out=row.patient)
    context = {**_of_visit(row), "heading": "Move this visit to another patient"}
    if patient is None:
        return _search(request, context, "Whose visit is it?", leave_out=row.patient)
    facts = [
        f"The visit of {day(row.taken_at)} and its photographs become {patient.name}’s.",
        f"Report and exports are made again under {patient.pseudonym}, without {row.patient.pseudonym}.",
        _NOTHING_LOST,
    ]
    if hasattr(row, "order"):
        facts.insert(1, "The order from the worklist stays with the former patient.")
    warnings = []
    if row.deliveries.filter(state=Delivery.State.SENT).exists():
        warnings.append("Results were sent to an archive under the former patient. Have them deleted there.")
    if row.conclusions.exists():
        warnings.append("The visit has a signed conclusion. Check that it is still valid.")
    form = VisitReasonForm(request.POST or None, instance=row)
    context |= {
        "chosen": patient, "chosen_role": "Moves to", "facts": facts, "warnings": warnings, "act": "Move the visit",
    }  # fmt: skip
    return _carried_out(
        request, form, context,
        lambda: records.move(form.instance, patient, form.cleaned_data["reason"], person_of(request)),
        f"The visit now belongs to {patient.name}.", reverse("visit", args=[row.pk]),
    )  # fmt: skip


def visit_date(request: HttpRequest, visit: uuid.UUID) -> HttpResponse:
    """Correct a visit's day, time and note."""
    form = DateForm(request.POST or None, instance=visit_or_404(visit))
    unchanged = visit_or_404(visit)  # the form changes the locked row in memory, so it is read again
    facts = ["If the day changes, the report is made again. The numbers do not change.", _NOTHING_LOST]
    context = {**_of_visit(unchanged), "heading": "Correct date and note", "facts": facts, "act": "Save"}

    def redate() -> None:
        given = form.cleaned_data
        records.redate(unchanged, given["taken_at"], given["note"], given["reason"], person_of(request))

    return _carried_out(request, form, context, redate, "The visit is corrected.", reverse("visit", args=[visit]))


def visit_bin(request: HttpRequest, visit: uuid.UUID) -> HttpResponse:
    """Put a visit into the bin."""
    row = visit_or_404(visit)
    form = VisitReasonForm(request.POST or None, instance=row)
    facts = ["The visit then disappears from all other pages, tables and exports.", _NOTHING_LOST]
    context = {
        **_of_visit(row), "heading": "Put this visit into the bin", "facts": facts, "act": "Put into the bin",
        "grave": True,
    }  # fmt: skip
    return _carried_out(
        request, form, context,
        lambda: records.put_into_bin(form.instance, form.cleaned_data["reason"], person_of(request)),
        "The visit is in the bin.", reverse("patient", args=[row.patient_id]),
    )  # fmt: skip


def patient_merge(request: HttpRequest, patient: uuid.UUID) -> HttpResponse:
    """Merge two records of one patient."""
    kept = get_object_or_404(Patient, pk=patient)
    other = chosen_patient(request, leave_out=kept)
    context = {**_of_patient(kept), "heading": "Merge with another record"}
    if other is None:
        return _search(request, context, "Which other record is of this patient?", leave_out=kept)
    facts = [
        f"{kept.name}, {kept.pseudonym}, is kept and gets all visits, operations and consents of {other.name}, "
        f"{other.pseudonym}.",
        "The other record’s address redirects to this one, and a search for either number finds it.",
        f"Visits that change their pseudonym are measured again ({other.visits.count()}).",
        _NOTHING_LOST,
    ]
    form = MergeForm(request.POST or None, instance=kept, records=(kept, other))

    def merge() -> None:
        number_of = other if form.cleaned_data["number"] == str(other.pk) else kept
        records.merge(kept, other, number_of, form.cleaned_data["reason"], person_of(request))

    context |= {
        "chosen": other, "chosen_role": "Merged into this record", "chosen_other": "Another record", "facts": facts,
        "act": "Merge the records",
    }  # fmt: skip
    return _carried_out(
        request, form, context, merge,
        "The records are merged.", reverse("patient", args=[kept.pk]),
    )  # fmt: skip


def patient_bin(request: HttpRequest, patient: uuid.UUID) -> HttpResponse:
    """Put a patient's record without visits into the bin."""
    row = get_object_or_404(Patient, pk=patient)
    form = PatientReasonForm(request.POST or None, instance=row)
    facts = ["Only a record without visits can go into the bin.", _NOTHING_LOST]
    context = {
        **_of_patient(row), "heading": "Put this record into the bin", "facts": facts, "act": "Put into the bin",
        "grave": True,
    }  # fmt: skip
    return _carried_out(
        request, form, context,
        lambda: records.put_into_bin(form.instance, form.cleaned_data["reason"], person_of(request)),
        "The record is in the bin.", reverse("patients"),
    )  # fmt: skip


def corrections(request: HttpRequest) -> HttpResponse:
    """Recent corrections that can be undone. Administrators also see older contents of the bin."""
    person = person_of(request)
    context: dict[str, Any] = {"days": records.DAYS}
    if person.has_role(*CARE):
        rows = list(records.newest())
        context["lines"] = _lines(rows)
        request.shown = [row.pk for row in rows]  # type: ignore[attr-defined]
    if person.has_role(Role.ADMINISTRATOR):
        context["left"] = records.left_in_bin()
    return render(request, "clinic/corrections.html", context)


def correction_undo(request: HttpRequest, correction: uuid.UUID) -> HttpResponse:
    """Undo a correction."""
    row = get_object_or_404(Correction, pk=correction)
    if request.method == "POST":
        try:
            records.undo(row, person_of(request))
        except MammometryError as error:
            messages.error(request, str(error))
        else:
            messages.success(request, "The correction is undone.")
    return redirect("corrections")


@dataclass(frozen=True, slots=True)
class _Line:
    """A correction as shown on the page."""

    correction: Correction
    words: str
    """Subject, and values before and after."""


def _lines(rows: list[Correction]) -> list[_Line]:
    keys = {row.after.get(name) for row in rows for name in ("patient", "into")} - {None}
    names = {str(row.pk): row.name for row in Patient.everything.filter(pk__in=keys)}
    return [_Line(row, _words(row, names)) for row in rows]


def _words(row: Correction, names: dict[str, str]) -> str:
    assert row.patient is not None
    name = row.patient.name
    visit = "" if row.visit is None else f"visit of {day(row.visit.taken_at)}"
    if row.kind == Correction.Kind.MOVED:
        return f"{visit}: from {name} to {names.get(row.after['patient'], 'an erased patient')}"
    if row.kind == Correction.Kind.MERGED:
        return f"{name} into {names.get(row.after['into'], 'an erased patient')}"
    if row.kind == Correction.Kind.DATED:
        before, after = (moment(parse_datetime(values["taken_at"])) for values in (row.before, row.after))
        return f"{name}: {before if before == after else f'{before} is now {after}'}"
    return f"{name}, {visit}" if visit else f"{name}, record {row.patient.record_number}"


def _carried_out(
    request: HttpRequest,
    form: forms.BaseForm,
    context: dict[str, Any],
    act: Callable[[], object],
    done: str,
    goes_on: str,
) -> HttpResponse:
    """Show a form. When it is submitted and valid, make the correction."""
    if request.method == "POST" and form.is_valid():
        try:
            act()
        except MammometryError as error:
            form.add_error(None, str(error))
        else:
            messages.success(request, done)
            return redirect(goes_on)
    return render(request, "clinic/correction.html", {**context, "form": form})


def _search(request: HttpRequest, context: dict[str, Any], question: str, *, leave_out: Patient) -> HttpResponse:
    search = search_context(request, choosing=True, leave_out=leave_out)
    page = "clinic/patients_rows.html" if is_part(request) else "clinic/correction.html"
    return render(request, page, {**context, **search, "question": question})


def _of_visit(visit: Visit) -> dict[str, Any]:
    words = f"{visit.patient.name}, visit of {day(visit.taken_at)}"
    return {"back": reverse("visit", args=[visit.pk]), "back_words": words}


def _of_patient(patient: Patient) -> dict[str, Any]:
    return {"back": reverse("patient", args=[patient.pk]), "back_words": patient.name}
