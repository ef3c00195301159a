"""Functions shared by views: the logged-in person, JSON for scripts, error pages."""

import errno
import json
import logging
import sqlite3
import sys
from collections.abc import Callable
from functools import wraps
from typing import Any
from uuid import UUID

from django.contrib import messages
from django.core.exceptions import PermissionDenied
from django.http import Http404, HttpRequest, HttpResponse, HttpResponseBase, JsonResponse
from django.middleware.csrf import get_token
from django.shortcuts import get_object_or_404, render
from django.template.loader import render_to_string

from mammometry.base.errors import BusyError, MammometryError, StorageError
from mammometry.base.extras import MissingLibraryError
from mammometry.clinic.audit import record_refusal
from mammometry.clinic.audit_entries import change_of
from mammometry.clinic.intake.places import UploadError
from mammometry.clinic.models import Calibration, Comparison, DailyCheck, Patient, Person, Visit
from mammometry.clinic.record_form import RecordForm
from mammometry.clinic.roles import CARE, RIGS
from mammometry.clinic.site import the_clinic
from mammometry.clinic.templatetags.pages import on_pages
from mammometry.clinic.web.access import is_program
from mammometry.clinic.web.security import report_policy
from mammometry.web.replies import Refused


def json_view(*methods: str) -> Callable[[Callable[..., HttpResponseBase]], Callable[..., HttpResponseBase]]:
    """Decorate a view that allows the given methods and answers errors as JSON."""

    def wrapped(view: Callable[..., HttpResponseBase]) -> Callable[..., HttpResponseBase]:
        @wraps(view)
        def answer(request: HttpRequest, *args: Any, **kwargs: Any) -> HttpResponseBase:
            if request.method not in methods:
                return JsonResponse(
                    {"error": f"Only {', '.join(methods)}."}, status=405, headers={"Allow": ", ".join(methods)}
                )
            try:
                return view(request, *args, **kwargs)
            except (Refused, UploadError) as error:
                return JsonResponse({"error": str(error)}, status=error.status)
            except MammometryError as error:
                return JsonResponse({"error": on_pages(str(error))}, status=507 if _is_of_disk(error) else 409)

        return answer

    return wrapped


def json_body(request: HttpRequest) -> dict[str, Any]:
    """The request's JSON object. Empty if there is none.

    Raises:
        Refused: it is not a JSON object.
    """
    if not request.body:
        return {}
    try:
        table = json.loads(request.body)
    except (ValueError, RecursionError):
        table = None
    if not isinstance(table, dict):
        raise Refused("The request is no JSON object.", 400)
    return table


def text_of(table: dict[str, Any], name: str, *, most: int = 200) -> str:
    """A text value of the request. Empty if it is missing.

    Raises:
        Refused: it is not a text, or is too long.
    """
    value = table.get(name)
    if value is None:
        return ""
    if not isinstance(value, str) or len(value) > most:
        raise Refused(f"{name} is no text of at most {most} characters.", 400)
    return value


def require_care(request: HttpRequest, target: object) -> None:
    """Refuse patients' data to people who only manage rigs, and visits in the bin to everybody.

    Raises:
        PermissionDenied: the target is a visit or a comparison, and this person may not see patients.
        Http404: the target is a visit in the bin.
    """
    if isinstance(target, Visit | Comparison) and not request.user.has_role(*CARE):  # type: ignore[union-attr]  # logged in
        raise PermissionDenied
    if isinstance(target, Visit) and target.binned_at is not None:
        raise Http404


def require_photographer(request: HttpRequest, target: object) -> None:
    """Refuse changes of a board's photographs to people without the role. Includes `require_care`.

    Raises:
        PermissionDenied: the target is a calibration or daily check, and this person does not manage rigs.
        Http404: the target is a visit in the bin.
    """
    require_care(request, target)
    if isinstance(target, Calibration | DailyCheck) and not request.user.has_role(*RIGS):  # type: ignore[union-attr]  # logged in
        raise PermissionDenied


def visit_or_404(key: UUID) -> Visit:
    """A visit that is not in the bin, with its patient, rig and calibration."""
    visit: Visit = get_object_or_404(Visit.objects.select_related("patient", "rig", "calibration"), pk=key)
    return visit


def form_page(
    request: HttpRequest, template: str, form: Any, done: str, goes_on: Callable[[Any], HttpResponse], **context: object
) -> HttpResponse:
    """A page with the form of one row. A valid form is saved, and the page redirects."""
    if request.method == "POST" and form.is_valid():
        row = form.save()
        messages.success(request, done)
        return goes_on(row)
    return render(request, template, {"form": form, **context})


def stale_page(request: HttpRequest, form: RecordForm) -> HttpResponse:
    """Answer 409: another person changed the record. Shows both versions, field by field."""
    row: Any = form.instance
    row = getattr(row, "visit", row)  # of a conclusion
    about = {
        "form": form, "newest": change_of(form.instance), "address": request.path,
        "patient": row if isinstance(row, Patient) else getattr(row, "patient", None),
    }  # fmt: skip
    return render(request, "clinic/stale.html", about, status=409)


def download(content: bytes | str, name: str, content_type: str) -> HttpResponse:
    """Response with a file to download."""
    headers = {"Content-Disposition": f'attachment; filename="{name}"'}
    return HttpResponse(content, content_type=content_type, headers=headers)


def sealed_page(page: bytes) -> HttpResponse:
    """A report's page, isolated from the clinic's by a sandbox."""
    headers = {"Content-Security-Policy": report_policy(page)}
    return HttpResponse(page, content_type="text/html; charset=utf-8", headers=headers)


_LOG = logging.getLogger(__name__)
_DISK_FULL = "53100"
"""PostgreSQL's SQLSTATE for a full disk. Its messages are in the server's language."""


def _page(request: HttpRequest, status: int, title: str, sentence: str) -> HttpResponse:
    if is_program(request):
        return JsonResponse({"error": sentence}, status=status)
    return render(request, "clinic/refusal.html", {"title": title, "sentence": sentence}, status=status)


def bad_request(request: HttpRequest, exception: Exception | None = None) -> HttpResponse:
    """Answer 400: the request is malformed."""
    return _page(request, 400, "This request cannot be read", "Go back and try again.")


def forbidden(request: HttpRequest, exception: Exception | None = None) -> HttpResponse:
    """Answer 403: the person is logged in, without the required role. Recorded in the audit."""
    record_refusal(request)
    sentence = "Your role does not open this page. Ask the clinic's administrator if it should."
    return _page(request, 403, "Not for your role", sentence)


def missing(request: HttpRequest, exception: Exception | None = None) -> HttpResponse:
    """Answer 404: the address is unknown, or its record is in the bin."""
    if _is_in_bin(request):
        sentence = "This is in the bin. For 30 days it can be taken out again, under Corrections and bin."
        return _page(request, 404, "In the bin", sentence)
    return _page(request, 404, "Not here", "There is no such page. It may have been erased.")


def _is_in_bin(request: HttpRequest) -> bool:
    """Whether the address is of a visit or patient in the bin, and this person may know about it."""
    match = request.resolver_match
    if match is None or not request.user.is_authenticated or not request.user.has_role(*CARE):
        return False
    return any(
        model.everything.filter(pk=match.kwargs[name], binned_at__isnull=False).exists()
        for name, model in (("visit", Visit), ("patient", Patient))
        if name in match.kwargs
    )


def not_now(request: HttpRequest, error: MammometryError) -> HttpResponse:
    """Answer 409 if the visit's state does not allow the request, or 503 if the disk refuses."""
    if _is_of_disk(error):
        _LOG.error("%s", error)
    words = on_pages(str(error).replace(f"{the_clinic().folder}/", ""))
    return _page(request, 503 if _is_of_disk(error) else 409, "Not now", words)


def _is_of_disk(error: MammometryError) -> bool:
    """Whether the error is the disk's. A session that another run is using is only busy."""
    return isinstance(error, StorageError) and not isinstance(error, BusyError)


def not_installed(request: HttpRequest, error: MissingLibraryError) -> HttpResponse:
    """Answer 501: the server lacks a library that this page needs."""
    return _page(request, 501, "Not installed", str(error))


def broken(request: HttpRequest) -> HttpResponse:
    """Answer 500: a defect of the program, or the database is unavailable. 507 if the disk is full.

    The page makes no query, not even for the user who is logged in.

    507: the disk is full.
    """
    title, status = "A defect", 500
    sentence = "An error occurred in the program. It is in the log. Saved data are not lost."
    if _is_full(sys.exception()):
        title, status = "The disk is full", 507
        sentence = "Your entry was not saved. Tell the administrator: the disk of the clinic’s server is full."
    if is_program(request):
        return JsonResponse({"error": sentence}, status=status)
    about = {"title": title, "sentence": sentence, "clinic_name": the_clinic().name}
    return HttpResponse(render_to_string("clinic/refusal.html", about), status=status)


def _is_full(error: BaseException | None) -> bool:
    """Whether an error is due to a full disk: an error of the system, of SQLite or of PostgreSQL."""
    while error is not None:
        if isinstance(error, OSError) and error.errno in (errno.ENOSPC, errno.EDQUOT):
            return True
        if isinstance(error, sqlite3.Error) and getattr(error, "sqlite_errorcode", 0) & 0xFF == sqlite3.SQLITE_FULL:
            return True
        if getattr(error, "sqlstate", "") == _DISK_FULL:
            return True
        error = error.__cause__ or error.__context__
    return False


def forged(request: HttpRequest, reason: str = "") -> HttpResponse:
    """Answer 403: the form has no valid token.

    It is from another site, or from before the last login. A script gets a new token (`account-token`) and tries again.
    """
    sentence = "Reload the page and repeat your entry."
    if is_program(request):
        return JsonResponse({"error": f"This page is out of date. {sentence}", "stale": True}, status=403)
    return _page(request, 403, "This form is out of date", sentence)


def locked_out(request: HttpRequest, response: Any = None, credentials: Any = None, *_: Any) -> HttpResponse:
    """Answer 429: too many wrong passwords."""
    minutes = the_clinic().limits.wait_minutes
    sentence = (
        f"Too many wrong passwords for this name. Wait {minutes} minutes, or ask the administrator to unlock you."
    )
    return _page(request, 429, "Locked out for a while", sentence)


def person_of(request: HttpRequest) -> Person:
    """The logged-in person. Routes with roles require one."""
    assert isinstance(request.user, Person)
    return request.user


def token(request: HttpRequest) -> JsonResponse:
    """Token for a script's next request, and the logged-in person: None after the session has ended."""
    person = request.user.get_username() if request.user.is_authenticated else None
    return JsonResponse({"token": get_token(request), "person": person})
