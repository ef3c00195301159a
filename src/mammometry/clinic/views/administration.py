"""Administrators' pages: overview, people, audit, backups, disk, erasure."""

import datetime
import uuid
from typing import Any
from urllib.parse import urlencode

from allauth.mfa.models import Authenticator
from auditlog.models import LogEntry
from axes.utils import reset
from django import forms
from django.contrib import messages
from django.http import HttpRequest, HttpResponse
from django.shortcuts import get_object_or_404, redirect, render
from django.utils import timezone
from django.views.decorators.http import require_POST

from mammometry.base.errors import MammometryError
from mammometry.clinic import audit_entries
from mammometry.clinic.accounts import invitation
from mammometry.clinic.audit import FAILED_LOGIN, REFUSED
from mammometry.clinic.audit_entries import KINDS, AuditFilter, entries
from mammometry.clinic.forms import FIRST_DAY, PersonForm
from mammometry.clinic.jobs import queue
from mammometry.clinic.maintenance.backups import remove_leftovers, state_of
from mammometry.clinic.maintenance.disk import cached_usage, folder_bytes
from mammometry.clinic.maintenance.patient import copies, erase_patient, rows_of
from mammometry.clinic.models import Job, Patient, Person, Upload, Visit
from mammometry.clinic.records.notes import texts_of
from mammometry.clinic.roles import CARE
from mammometry.clinic.site import the_clinic
from mammometry.clinic.views.responses import download, person_of
from mammometry.clinic.views.today import first_day_of

_DAYS = 7  # number of days of failed logins and refused pages


def overview(request: HttpRequest) -> HttpResponse:
    """People, backups, disk and recent refusals."""
    people = [person for person in Person.objects.all() if person.is_active]
    since = timezone.localdate() - datetime.timedelta(days=_DAYS - 1)
    context = {
        "first_day": first_day_of(person_of(request)),
        "people": len(people),
        "without_password": [person for person in people if person.waits_for_password],
        "backups": state_of(the_clinic()),
        "gave_up": queue.gave_up(),
        "disk": cached_usage(the_clinic()),
        "failed_logins": entries(AuditFilter(kind=FAILED_LOGIN, since=since)).count(),
        "refused": entries(AuditFilter(kind=REFUSED, since=since)).count(),
        "days": _DAYS,
        "since": since,
    }
    return render(request, "clinic/administration.html", context)


class AuditForm(forms.Form):
    """Filter of the shown entries."""

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
        """The filter. An invalid form filters nothing."""
        values: dict[str, Any] = self.cleaned_data if self.is_valid() else {}
        person = values.get("person")
        return AuditFilter(
            person=None if person is None else person.pk,
            since=_within(values.get("since")),
            until=_within(values.get("until")),
            patient=values.get("patient", "").strip().upper(),
            kind=values.get("kind", ""),
        )


def _within(day: datetime.date | None) -> datetime.date | None:
    """Limit a day to a clinic's possible dates."""
    last = timezone.localdate() + datetime.timedelta(days=1)
    return None if day is None else min(max(day, FIRST_DAY), last)


def audit(request: HttpRequest) -> HttpResponse:
    """Entries of the audit, newest first."""
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
    """The filtered entries as CSV."""
    text = audit_entries.audit_csv(AuditForm(request.GET).chosen())
    return download(text, "audit.csv", "text/csv; charset=utf-8")


def audit_entry(request: HttpRequest, entry: int) -> HttpResponse:
    """One entry with all its data."""
    row = get_object_or_404(LogEntry, pk=entry)
    names = {person.pk: str(person) for person in Person.objects.all()}
    texts = texts_of(row) if person_of(request).has_role(*CARE) else {}
    return render(request, "clinic/audit_entry.html", {"entry": audit_entries.in_words(row, names, texts)})


def _is_number(text: str) -> bool:
    return text.isascii() and text.isdigit() and len(text) < 19  # 64-bit keys have at most 19 digits


def erase(request: HttpRequest) -> HttpResponse:
    """Ask for a pseudonym, show what would be deleted, and erase it when the pseudonym is typed again."""
    typed = (request.POST if request.method == "POST" else request.GET).get("pseudonym", "").strip().upper()
    patient = Patient.everything.filter(pseudonym=typed, merged_into=None).first() if typed else None
    context: dict[str, Any] = {"typed": typed}
    if patient is not None:
        context |= what_goes(patient)
    elif typed:
        context["wrong"] = "No patient has this pseudonym."
    if request.method == "POST" and patient is not None:
        if request.POST.get("again", "").strip().upper() != typed:
            context["wrong_again"] = "The pseudonyms differ. Nothing was erased."
        else:
            try:
                kept = copies(the_clinic(), patient)
                visits = erase_patient(the_clinic(), patient, person_of(request))
                context = {"erased": typed, "visits": visits, "copies": kept}
            except MammometryError as error:
                context["wrong_again"] = str(error)
    return render(request, "clinic/erase.html", context)


def what_goes(patient: Patient) -> dict[str, Any]:
    """Data of a patient that erasing deletes, and data that remain."""
    remove_leftovers(the_clinic())
    rows = rows_of(patient)
    visits = [row for row in rows if isinstance(row, Visit)]
    return {
        "patient": patient,
        "visits": visits,
        "photographs": sum(isinstance(row, Upload) for row in rows),
        "rows": len(rows),
        "bytes": sum(folder_bytes(visit.folder) for visit in visits),
        "copies": copies(the_clinic(), patient),
    }


_LINK = "invitation"  # session key of a link that has not been shown yet


def people(request: HttpRequest) -> HttpResponse:
    """All people, first those who may log in."""
    with_factor = set(Authenticator.objects.filter(type=Authenticator.Type.TOTP).values_list("user_id", flat=True))
    rows = [(person, person.pk in with_factor) for person in Person.objects.order_by("-is_active", "username")]
    return render(request, "clinic/people.html", {"rows": rows})


def person_new(request: HttpRequest) -> HttpResponse:
    """Add a person, and show the page with the link."""
    form = PersonForm(request.POST or None)
    if request.method == "POST" and form.is_valid():
        person = form.save(commit=False)
        person.set_unusable_password()
        person.save()
        return _with_link(request, person)
    return render(request, "clinic/person.html", {"form": form})


def person_edit(request: HttpRequest, person: uuid.UUID) -> HttpResponse:
    """Change a person's name, roles or login."""
    shown = get_object_or_404(Person, pk=person)
    form = PersonForm(request.POST or None, instance=shown, own=shown.pk == request.user.pk)
    if request.method == "POST" and form.is_valid():
        form.save()
        messages.success(request, "Saved.")
        return redirect("people")
    waiting = request.session.pop(_LINK, {})
    context = {
        "form": form,
        "person": get_object_or_404(Person, pk=person),  # as saved, because the form changes its own instance
        "link": waiting.get("link") if waiting.get("person") == str(shown.pk) else None,
        "second_factor": Authenticator.objects.filter(user=shown, type=Authenticator.Type.TOTP).exists(),
    }
    return render(request, "clinic/person.html", context)


@require_POST
def invite(request: HttpRequest, person: uuid.UUID) -> HttpResponse:
    """Make a new link for setting a password."""
    return _with_link(request, get_object_or_404(Person, pk=person))


@require_POST
def reset_second_factor(request: HttpRequest, person: uuid.UUID) -> HttpResponse:
    """Remove a person's authenticator and codes."""
    shown = get_object_or_404(Person, pk=person)
    Authenticator.objects.filter(user=shown).delete()
    messages.success(request, f"{shown} sets up a second factor at the next login.")
    return redirect("person", person=shown.pk)


@require_POST
def let_in(request: HttpRequest, person: uuid.UUID) -> HttpResponse:
    """Remove a lock after wrong passwords."""
    shown = get_object_or_404(Person, pk=person)
    reset(username=shown.username)
    messages.success(request, f"{shown} may try again.")
    return redirect("person", person=shown.pk)


def _with_link(request: HttpRequest, person: Person) -> HttpResponse:
    """Redirect to the person's page, which shows the link once."""
    request.session[_LINK] = {"person": str(person.pk), "link": request.build_absolute_uri(invitation(person))}
    return redirect("person", person=person.pk)


def settings(request: HttpRequest) -> HttpResponse:
    """Settings of clinic.toml, without secrets."""
    database = "SQLite, in the clinic's folder" if the_clinic().database == "sqlite" else "PostgreSQL"
    return render(request, "clinic/settings.html", {"clinic": the_clinic(), "database": database})


def backup_list(request: HttpRequest) -> HttpResponse:
    """Backups, the next one, and the last restore test."""
    clinic = the_clinic()
    return render(request, "clinic/backups.html", {"state": state_of(clinic), "clinic": clinic, "busy": _is_busy()})


@require_POST
def backup_now(request: HttpRequest) -> HttpResponse:
    """Queue a backup."""
    return _begun(request, Job.Kind.BACKUP, "A backup is being made. You may leave this page.")


@require_POST
def test_now(request: HttpRequest) -> HttpResponse:
    """Queue a restore test."""
    return _begun(request, Job.Kind.RESTORE, "A restore of the newest backup is tested. You may leave this page.")


def disk(request: HttpRequest) -> HttpResponse:
    """Disk use of the clinic's files, and how long the free space will last."""
    return render(request, "clinic/disk.html", {"usage": cached_usage(the_clinic())})


def _begun(request: HttpRequest, kind: Job.Kind, sentence: str) -> HttpResponse:
    if _is_busy():
        messages.warning(request, "A backup or a test is already running.")
    else:
        queue.enqueue_upkeep(kind, person_of(request))
        messages.success(request, sentence)
    return redirect("backups")


def _is_busy() -> bool:
    """Whether a backup or restore test is due or running, also if a command started it."""
    return state_of(the_clinic()).at_work or queue.is_busy(Job.Kind.BACKUP, Job.Kind.RESTORE)
