"""Whether the server runs."""

from __future__ import annotations

from django.http import HttpRequest, HttpResponse


def alive(request: HttpRequest) -> HttpResponse:
    """Say that the server runs, for whoever watches it."""
    return HttpResponse("ok\n", content_type="text/plain")
