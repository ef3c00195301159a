"""Who is logged in."""

from __future__ import annotations

from django.http import HttpRequest, JsonResponse
from django.middleware.csrf import get_token

from mammometry.clinic.models import Person


def person_of(request: HttpRequest) -> Person:
    """The person who is logged in. Routes with roles let in nobody else."""
    assert isinstance(request.user, Person)
    return request.user


def token(request: HttpRequest) -> JsonResponse:
    """Token for the next request of a page's script, and who is logged in: None after the session's end."""
    person = request.user.get_username() if request.user.is_authenticated else None
    return JsonResponse({"token": get_token(request), "person": person})
