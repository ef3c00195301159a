"""Process a form only once, even if it is sent twice.

Each form has a random token (`form_token` of the pages' tags). The first request with a token is processed, and its
answer is stored. All others get the same answer. If two arrive at the same time, one waits for the other. If the form
is shown again because of an error, its token can be sent again.
"""

import time
from collections.abc import Callable
from datetime import timedelta
from typing import Any
from uuid import UUID

from django.db import IntegrityError, transaction
from django.db.models import QuerySet
from django.http import HttpRequest, HttpResponse, HttpResponseBase, HttpResponseRedirect, JsonResponse
from django.utils import timezone

from mammometry.clinic.models import FormToken

FIELD, HEADER = "form_token", "Form-Token"
"""Names of the token in pages and scripts."""
ACCEPTED = "accepted_forms"
"""Session key of the newest accepted tokens, so that pages delete their drafts."""
_ACCEPTED_MOST = 20  # most forms of a session whose drafts may still be in a tab
_KEPT = timedelta(days=2)  # longer than any login session
_CLEARED = 200  # old tokens that each request deletes: few, so that it is not slow
_WAIT_S, _LOOK_S = 30.0, 0.2  # wait for another request's answer to the same form, and time between two looks
_ABANDONED = timedelta(minutes=15)  # age of a request without an answer that must have died


def once(request: HttpRequest, act: Callable[[], HttpResponseBase], *, atomic: bool) -> HttpResponseBase:
    """Process a request, or repeat the first answer to the same form.

    Args:
        request: a request that changes data, with or without login.
        act: processes the request.
        atomic: whether token and change are one transaction. Otherwise the token is stored first.
    """
    token = _token_of(request)
    if token is None or not request.user.is_authenticated:
        if not atomic:
            return act()
        with transaction.atomic():
            return act()
    return _in_one_transaction(request, token, act) if atomic else _taken_first(request, token, act)


def _in_one_transaction(request: HttpRequest, token: UUID, act: Callable[[], HttpResponseBase]) -> HttpResponseBase:
    with transaction.atomic():
        row = _take(request, token)
        if row is not None:
            response = act()
            _keep(request, row, response)
            return response
    return _repeated(request, _rows(request, token).get())


def _taken_first(request: HttpRequest, token: UUID, act: Callable[[], HttpResponseBase]) -> HttpResponseBase:
    end = time.monotonic() + _WAIT_S
    while (row := _take(request, token)) is None:
        there = _rows(request, token).first()
        if there is not None and there.answer:
            return _repeated(request, there)
        if there is not None and timezone.now() - there.at > _ABANDONED:
            there.delete()
        elif time.monotonic() > end:
            return _busy()
        else:
            time.sleep(_LOOK_S)
    try:
        response = act()
    except BaseException:
        row.delete()
        raise
    _keep(request, row, response)
    return response


def _rows(request: HttpRequest, token: UUID) -> QuerySet[FormToken]:
    return FormToken.objects.filter(person_id=str(request.user.pk), token=token)


def _token_of(request: HttpRequest) -> UUID | None:
    text = request.headers.get(HEADER) or request.POST.get(FIELD, "")
    try:
        return UUID(text)
    except ValueError:
        return None


def _take(request: HttpRequest, token: UUID) -> FormToken | None:
    """Create the token's row. None if another request has or had the token."""
    old = FormToken.objects.filter(at__lt=timezone.now() - _KEPT).select_for_update(skip_locked=True)
    try:
        with transaction.atomic():
            FormToken.objects.filter(pk__in=list(old.values_list("pk", flat=True)[:_CLEARED])).delete()
            return FormToken.objects.create(person_id=str(request.user.pk), token=token)  # waits for another request
    except IntegrityError:
        return None


def _keep(request: HttpRequest, row: FormToken, response: HttpResponseBase) -> None:
    """Store an answer so that it can be repeated. If it shows the form again, the token is released."""
    if isinstance(response, HttpResponseRedirect):
        row.answer = {"location": response.url}
    elif isinstance(response, JsonResponse) and response.status_code < 300:
        row.answer = {"status": response.status_code, "json": response.content.decode()}
    else:
        row.delete()
        return
    row.save(update_fields=["answer"])
    if not request.user.is_authenticated:  # the request has logged the person out
        return
    accepted: list[str] = request.session.get(ACCEPTED, [])
    request.session[ACCEPTED] = [*accepted, str(row.token)][-_ACCEPTED_MOST:]


def _repeated(request: HttpRequest, row: FormToken) -> HttpResponseBase:
    request.session.modified = False  # the first request has stored it
    answer: dict[str, Any] = row.answer
    if "location" in answer:
        return HttpResponseRedirect(answer["location"])
    return HttpResponse(answer["json"], status=answer["status"], content_type="application/json")


def _busy() -> HttpResponseBase:
    return HttpResponse("This form is already being sent. Wait, and check whether it has arrived.", status=409)
