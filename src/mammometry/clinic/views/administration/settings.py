"""The clinic's settings, for administrators to read."""

from __future__ import annotations

from django.http import HttpRequest, HttpResponse
from django.shortcuts import render

from mammometry.clinic.site import the_clinic


def settings(request: HttpRequest) -> HttpResponse:
    """What clinic.toml says, without secrets."""
    database = "SQLite, in the clinic's folder" if the_clinic().database == "sqlite" else "PostgreSQL"
    return render(request, "clinic/settings.html", {"clinic": the_clinic(), "database": database})
