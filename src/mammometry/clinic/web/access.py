"""Access to pages. A view is mounted with its roles, or not at all.

`guarded` wraps a view: it checks the role and the second factor, makes each change and its audit entry one transaction,
processes a form once even if it is sent twice, answers a form whose record has changed, and records in the audit who
saw the page of which patient, visit or rig.
"""

from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from functools import wraps
from typing import Any, cast
from urllib.parse import urlencode

from asgiref.sync import iscoroutinefunction, sync_to_async
from django.core.exceptions import PermissionDenied
from django.http import HttpRequest, HttpResponseBase, HttpResponseRedirect, JsonResponse
from django.urls import URLPattern, path, re_path, reverse

from mammometry.clinic.roles import Role

BODY_BYTES = 256 * 1024
"""Default for the largest body of a request."""
_SAFE = ("GET", "HEAD", "OPTIONS")
View = Callable[..., HttpResponseBase] | Callable[..., Awaitable[HttpResponseBase]]


@dataclass(frozen=True, slots=True, kw_only=True)
class Access:
    """A route's conditions and grants."""

    roles: frozenset[Role] | None
    """Allowed roles; None: anyone, logged in or not."""
    body_bytes: int = BODY_BYTES
    """Largest body of a request, bytes."""
    atomic: bool = True
    """Whether a change is one transaction with its audit entry. False for long bodies, which would hold the lock."""
    audited: bool = True
    """Whether opening it is recorded in the audit."""
    first_factor: bool = False
    """Whether it can be opened before the second factor is set up."""


def route(where: str, view: View, name: str, roles: frozenset[Role] | None, **others: Any) -> URLPattern:
    """A line of the table of routes.

    Args:
        where: path in Django's notation, such as ``visits/<uuid:visit>/``; with a leading ``^`` a regular expression.
            Parameters named patient, visit, rig, calibration, check, job, upload, measurement or person are what the
            audit's entry is about.
        view: function or coroutine function.
        name: for ``reverse``.
        roles: who may open it; None for anyone, logged in or not.
        others: the other fields of `Access`.
    """
    mount: Any = re_path if where.startswith("^") else path
    made: URLPattern = mount(where, guarded(view, Access(roles=roles, **others)), name=name)
    return made


def guarded(view: View, access: Access) -> View:
    """A view that checks access, which is in ``view.access``."""
    from mammometry.clinic.audit import record_view
    from mammometry.clinic.record_form import StaleRecord
    from mammometry.clinic.views.responses import stale_page
    from mammometry.clinic.web.once import once

    if iscoroutinefunction(view):

        @wraps(view)
        async def asynchronous(request: HttpRequest, *args: Any, **kwargs: Any) -> HttpResponseBase:
            refusal = await sync_to_async(refused)(request, access)
            if refusal is not None:
                return refusal
            response: HttpResponseBase = await view(request, *args, **kwargs)
            if access.audited:
                await sync_to_async(record_view)(request, response, kwargs)
            return response

        asynchronous.access = access  # type: ignore[attr-defined]
        return asynchronous

    act = cast(Callable[..., HttpResponseBase], view)

    @wraps(view)
    def synchronous(request: HttpRequest, *args: Any, **kwargs: Any) -> HttpResponseBase:
        refusal = refused(request, access)
        if refusal is not None:
            return refusal
        if request.method in _SAFE:
            response = act(request, *args, **kwargs)
        else:
            try:
                response = once(request, lambda: act(request, *args, **kwargs), atomic=access.atomic)
            except StaleRecord as stale:  # nothing was saved, because it has left the transaction
                response = stale_page(request, stale.form)
        if access.audited:
            record_view(request, response, kwargs)
        return response

    synchronous.access = access  # type: ignore[attr-defined]
    return synchronous


def refused(request: HttpRequest, access: Access) -> HttpResponseBase | None:
    """Answer without access: a login page, the second factor's page, 401 for a program.

    Raises:
        PermissionDenied: logged in, without the role.
    """
    if access.roles is None:
        return None
    person = request.user
    if not person.is_authenticated:
        if is_program(request):
            return JsonResponse({"error": "Log in first."}, status=401)
        return HttpResponseRedirect(f"{reverse('account_login')}?{urlencode({'next': request.get_full_path()})}")
    if access.roles.isdisjoint(person.roles):
        raise PermissionDenied
    if not access.first_factor and person.lacks_second_factor(request):
        if is_program(request):
            return JsonResponse({"error": "Set up the second factor first."}, status=403)
        return HttpResponseRedirect(reverse("mfa_activate_totp"))
    return None


def is_program(request: HttpRequest) -> bool:
    """Whether a page's script asks, which is answered in JSON, never by a page or the login.

    All scripts send this header (``viewer/src/clinic/request.ts``).
    """
    return "HX-Request" in request.headers or request.headers.get("Accept", "").startswith(
        ("application/json", "text/event-stream")
    )
