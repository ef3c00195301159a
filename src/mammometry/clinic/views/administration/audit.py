"""The audit: filters, entries, one entry, and what is filtered as CSV."""

from __future__ import annotations

from typing import Any
from urllib.parse import urlencode

from auditlog.models import LogEntry
from django import forms
from django.http import HttpRequest, HttpResponse
from django.shortcuts import get_object_or_404, render

from mammometry.clinic import audit_entries
from mammometry.clinic.audit_entries import KINDS, AuditFilter
from mammometry.clinic.models import Person


class AuditForm(forms.Form):
    """Which entries are shown."""

    kind = forms.ChoiceField(
        label="What", required=False, choices=[("", "everything"), *((key, words) for key, words in KINDS.items())]
    )
    person = forms.ModelChoiceField(
        label="Who", required=False, queryset=Person.objects.order_by("username"), empty_label="everybody"
    )
    patient = forms.CharField(
        label="Patient’s pseudonym",
        required=False,
        max_length=8,
        widget=forms.TextInput(attrs={"placeholder": "P-…", "autocomplete": "off"}),
    )
    since = forms.DateField(label="From", required=False, widget=forms.DateInput(attrs={"type": "date"}))
    until = forms.DateField(label="Until", required=False, widget=forms.DateInput(attrs={"type": "date"}))

    def chosen(self) -> AuditFilter:
        """Return the filter. A form that cannot be read filters nothing."""
        if not self.is_valid():
            values: dict[str, Any] = {}
        else:
            values = self.cleaned_data
        person = values.get("person")
        return AuditFilter(
            person=None if person is None else person.pk,
            since=values.get("since"),
            until=values.get("until"),
            patient=values.get("patient", "").strip().upper(),
            kind=values.get("kind", ""),
        )


def audit(request: HttpRequest) -> HttpResponse:
    """Entries of the audit, the newest first."""
    form = AuditForm(request.GET)
    before = request.GET.get("before", "")
    entries, older = audit_entries.entry_page(form.chosen(), int(before) if _is_number(before) else None)
    query = {name: value for name, value in request.GET.items() if name in form.fields and value}
    context = {
        "form": form,
        "entries": entries,
        "query": urlencode(query),
        "older": urlencode({**query, "before": older}) if older is not None else None,
        "is_newest": not before,
        "is_filtered": bool(query),
    }
    return render(request, "clinic/audit.html", context)


def audit_csv(request: HttpRequest) -> HttpResponse:
    """What is filtered, as CSV."""
    text = audit_entries.audit_csv(AuditForm(request.GET).chosen())
    headers = {"Content-Disposition": 'attachment; filename="audit.csv"'}
    return HttpResponse(text, content_type="text/csv; charset=utf-8", headers=headers)


def audit_entry(request: HttpRequest, entry: int) -> HttpResponse:
    """One entry with all that it holds."""
    row = get_object_or_404(LogEntry, pk=entry)
    names = {person.pk: str(person) for person in Person.objects.all()}
    return render(request, "clinic/audit_entry.html", {"entry": audit_entries.in_words(row, names)})


def _is_number(text: str) -> bool:
    return text.isascii() and text.isdigit() and len(text) < 19  # a 64-bit key has at most 19 digits
