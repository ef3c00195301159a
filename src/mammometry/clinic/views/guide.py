"""Help, in the words of the clinic."""

from __future__ import annotations

from django.http import HttpRequest, HttpResponse
from django.shortcuts import render


def guide(request: HttpRequest) -> HttpResponse:
    """All help on one page."""
    return render(request, "clinic/help.html")
