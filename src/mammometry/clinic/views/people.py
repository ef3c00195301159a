"""People, for administrators.

Who may log in, with which roles. And the clinic's settings to read.
"""

from __future__ import annotations

import uuid

from django.contrib import messages
from django.http import HttpRequest, HttpResponse
from django.shortcuts import get_object_or_404, redirect, render

from mammometry.clinic.accounts.people import invitation
from mammometry.clinic.forms import PersonForm
from mammometry.clinic.models import Person
from mammometry.clinic.site import the_clinic


def people(request: HttpRequest) -> HttpResponse:
    """Everybody who works here."""
    return render(request, "clinic/people.html", {"people": Person.objects.all()})


def person_new(request: HttpRequest) -> HttpResponse:
    """Enter somebody, and show the link by which a password is set."""
    form = PersonForm(request.POST or None, initial={"is_active": True})
    if request.method == "POST" and form.is_valid():
        made: Person = form.save(commit=False)
        made.set_unusable_password()
        made.save()
        return _invited(request, made)
    return render(request, "clinic/person_form.html", {"form": form})


def person_edit(request: HttpRequest, person: uuid.UUID) -> HttpResponse:
    """Change somebody's roles or name, or close the account."""
    shown = get_object_or_404(Person, pk=person)
    form = PersonForm(request.POST or None, instance=shown)
    if request.method == "POST" and form.is_valid():
        if shown.pk == request.user.pk and (
            "administrator" not in form.cleaned_data["roles"] or not form.cleaned_data["is_active"]
        ):
            form.add_error(
                "roles", "You cannot take the administrator's role from yourself. Let another administrator do it."
            )
        else:
            form.save()
            messages.success(request, "The entry is changed.")
            return redirect("people")
    return render(request, "clinic/person_form.html", {"form": form, "person": shown})


def person_invite(request: HttpRequest, person: uuid.UUID) -> HttpResponse:
    """Make a new link, for somebody who lost the password."""
    shown = get_object_or_404(Person, pk=person)
    return _invited(request, shown) if request.method == "POST" else redirect("person-edit", person=person)


def settings(request: HttpRequest) -> HttpResponse:
    """What clinic.toml says, without secrets."""
    return render(request, "clinic/settings.html", {"clinic": the_clinic(), "database": _database()})


def _invited(request: HttpRequest, person: Person) -> HttpResponse:
    link = request.build_absolute_uri(invitation(person))
    return render(request, "clinic/invited.html", {"person": person, "link": link})


def _database() -> str:
    return "SQLite, in the clinic's folder" if the_clinic().database == "sqlite" else "PostgreSQL"
