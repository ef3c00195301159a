"""Who asks."""

from __future__ import annotations

from django.http import HttpRequest

from mammometry.clinic.models import Person


def person_of(request: HttpRequest) -> Person:
    """The person who is logged in.

    Routes with roles let in nobody else.
    """
    assert isinstance(request.user, Person)
    return request.user
