"""People who log in: entered, changed and let in again by administrators."""

from __future__ import annotations

import uuid

from allauth.account.views import password_change
from allauth.mfa.models import Authenticator
from axes.utils import reset
from django.contrib import messages
from django.http import HttpRequest, HttpResponse
from django.shortcuts import get_object_or_404, redirect, render
from django.views.decorators.http import require_POST

from mammometry.clinic.accounts.people import invitation
from mammometry.clinic.forms import PersonForm
from mammometry.clinic.models import Person
from mammometry.clinic.views.who import person_of

_LINK = "invitation"  # key of the session under which a link waits until it is shown


def people(request: HttpRequest) -> HttpResponse:
    """Everybody, those who may log in first."""
    with_factor = set(Authenticator.objects.filter(type=Authenticator.Type.TOTP).values_list("user_id", flat=True))
    rows = [(person, person.pk in with_factor) for person in Person.objects.order_by("-is_active", "username")]
    return render(request, "clinic/people.html", {"rows": rows})


def person_new(request: HttpRequest) -> HttpResponse:
    """Enter somebody, and lead to the page that shows the link to hand over."""
    form = PersonForm(request.POST or None)
    if request.method == "POST" and form.is_valid():
        person = form.save(commit=False)
        person.set_unusable_password()
        person.save()
        return _with_link(request, person)
    return render(request, "clinic/person.html", {"form": form})


def person_edit(request: HttpRequest, person: uuid.UUID) -> HttpResponse:
    """Change somebody's name, roles or login."""
    shown = get_object_or_404(Person, pk=person)
    form = PersonForm(request.POST or None, instance=shown, own=shown.pk == request.user.pk)
    if request.method == "POST" and form.is_valid():
        form.save()
        messages.success(request, "Saved.")
        return redirect("people")
    waiting = request.session.pop(_LINK, {})
    context = {
        "form": form,
        "person": get_object_or_404(Person, pk=person),  # as saved: the form changes its own
        "link": waiting.get("link") if waiting.get("person") == str(shown.pk) else None,
        "second_factor": Authenticator.objects.filter(user=shown, type=Authenticator.Type.TOTP).exists(),
    }
    return render(request, "clinic/person.html", context)


@require_POST
def invite(request: HttpRequest, person: uuid.UUID) -> HttpResponse:
    """Make a new link to set a password."""
    return _with_link(request, get_object_or_404(Person, pk=person))


@require_POST
def reset_second_factor(request: HttpRequest, person: uuid.UUID) -> HttpResponse:
    """Forget somebody's authenticator and codes."""
    shown = get_object_or_404(Person, pk=person)
    Authenticator.objects.filter(user=shown).delete()
    messages.success(request, f"{shown} sets up a second factor at the next login.")
    return redirect("person", person=shown.pk)


@require_POST
def let_in(request: HttpRequest, person: uuid.UUID) -> HttpResponse:
    """Forget somebody's wrong passwords."""
    shown = get_object_or_404(Person, pk=person)
    reset(username=shown.username)
    messages.success(request, f"{shown} may try again.")
    return redirect("person", person=shown.pk)


def own_password(request: HttpRequest) -> HttpResponse:
    """Change one's own password, unless the hospital's own login keeps it."""
    if not person_of(request).has_usable_password():
        about = {"title": "No password here", "sentence": "You log in with the hospital’s own login. Change it there."}
        return render(request, "clinic/refusal.html", about)
    response: HttpResponse = password_change(request)
    return response


def _with_link(request: HttpRequest, person: Person) -> HttpResponse:
    """Lead to the person's page, which shows the link once."""
    request.session[_LINK] = {"person": str(person.pk), "link": request.build_absolute_uri(invitation(person))}
    return redirect("person", person=person.pk)
