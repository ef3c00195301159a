"""Where one arrives after the login."""

from __future__ import annotations

from django.http import HttpRequest, HttpResponse
from django.shortcuts import render


def home(request: HttpRequest) -> HttpResponse:
    """What this person may do."""
    return render(request, "clinic/home.html")


def alive(request: HttpRequest) -> HttpResponse:
    """Say that the server runs, for whoever watches it."""
    return HttpResponse("ok\n", content_type="text/plain")
