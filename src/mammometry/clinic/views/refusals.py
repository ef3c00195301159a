"""Pages for what is refused, missing or broken."""

from __future__ import annotations

import logging
from typing import Any

from django.http import HttpRequest, HttpResponse, JsonResponse
from django.shortcuts import render
from django.template.loader import render_to_string

from mammometry.base.errors import MammometryError, StorageError
from mammometry.base.extras import MissingLibraryError
from mammometry.clinic.audit import record_refusal
from mammometry.clinic.site import the_clinic
from mammometry.clinic.web.access import is_program

_LOG = logging.getLogger(__name__)


def _page(request: HttpRequest, status: int, title: str, sentence: str) -> HttpResponse:
    if is_program(request):
        return JsonResponse({"error": sentence}, status=status)
    return render(request, "clinic/refusal.html", {"title": title, "sentence": sentence}, status=status)


def bad_request(request: HttpRequest, exception: Exception | None = None) -> HttpResponse:
    """400."""
    return _page(request, 400, "This request cannot be read", "Go back and try again.")


def forbidden(request: HttpRequest, exception: Exception | None = None) -> HttpResponse:
    """403: logged in, without the role. The audit has an entry of it."""
    record_refusal(request)
    sentence = "Your role does not open this page. Ask the clinic's administrator if it should."
    return _page(request, 403, "Not for your role", sentence)


def missing(request: HttpRequest, exception: Exception | None = None) -> HttpResponse:
    """404."""
    return _page(request, 404, "Not here", "There is no such page. It may have been erased.")


def not_now(request: HttpRequest, error: MammometryError) -> HttpResponse:
    """409: the visit stands in its own way, or 503: the disk does."""
    if isinstance(error, StorageError):
        _LOG.error("%s", error)
    words = str(error).replace(f"{the_clinic().folder}/", "")
    return _page(request, 503 if isinstance(error, StorageError) else 409, "Not now", words)


def not_installed(request: HttpRequest, error: MissingLibraryError) -> HttpResponse:
    """501: the server lacks a library that this page needs."""
    return _page(request, 501, "Not installed", str(error))


def broken(request: HttpRequest) -> HttpResponse:
    """500: a defect of ours, or no database. So the page asks nothing of it, not even who is logged in."""
    sentence = "Something went wrong on our side. It is in the log. Nothing that was saved is lost."
    if is_program(request):
        return JsonResponse({"error": sentence}, status=500)
    about = {"title": "A defect", "sentence": sentence, "clinic_name": the_clinic().name}
    return HttpResponse(render_to_string("clinic/refusal.html", about), status=500)


def forged(request: HttpRequest, reason: str = "") -> HttpResponse:
    """403: a form without a valid token.

    It is from another site or from before the last login. A script gets a new token (`account-token`) and repeats.
    """
    sentence = "Load the page again and repeat what you did."
    if is_program(request):
        return JsonResponse({"error": f"This page is out of date. {sentence}", "stale": True}, status=403)
    return _page(request, 403, "This form is out of date", sentence)


def locked_out(request: HttpRequest, response: Any = None, credentials: Any = None, *_: Any) -> HttpResponse:
    """429: too many wrong passwords."""
    minutes = the_clinic().limits.wait_minutes
    sentence = (
        f"Too many wrong passwords for this name. Wait {minutes} minutes, or ask the administrator to let you in."
    )
    return _page(request, 429, "Locked out for a while", sentence)
