"""Access to pages. A view is mounted with its roles, or not at all.

`guarded` wraps a view. It checks the role and the second factor, makes each change and its audit entry one transaction,
processes a form only once even if it is sent twice, answers a form whose record has changed, and records in the audit
who saw which patient's, visit's or rig's page.
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
"""Default limit for the body of a request, bytes."""
_SAFE = ("GET", "HEAD", "OPTIONS")
View = Callable[..., HttpResponseBase] | Callable[..., Awaitable[HttpResponseBase]]


@dataclass(frozen=True, slots=True, kw_only=True)
class Access:
    """Who may use a route, and its limits."""

    roles: frozenset[Role] | None
    """Allowed roles; None: anyone, logged in or not."""
    body_bytes: int = BODY_BYTES
    """Largest body of a request, bytes."""
    atomic: bool = True
    """Whether a change and its audit entry are one transaction. False for long bodies, which would hold the lock too
    long."""
    audited: bool = True
    """Whether opening it is recorded in the audit."""
    first_factor: bool = False
    """Whether it can be opened before the second factor is set up."""


def route(where: str, view: View, name: str, roles: frozenset[Role] | None, **others: Any) -> URLPattern:
    """Return a line of the table of routes.

    Args:
        where: path in Django's notation, such as ``visits/<uuid:visit>/``; with a leading ``^`` a regular expression.
            Parameters named patient, visit, rig, calibration, check, job, upload, measurement or person determine the
                subject of the audit's entry.
        view: function or coroutine function.
        name: for ``reverse``.
        roles: who may open it; None: anyone, logged in or not.
        others: the other fields of `Access`.
    """
    mount: Any = re_path if where.startswith("^") else path
    made: URLPattern = mount(where, guarded(view, Access(roles=roles, **others)), name=name)
    return made


def guarded(view: View, access: Access) -> View:
    """Wrap a view so that access is checked. The rule is in its attribute ``access``."""
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
            except StaleRecord as stale:  # nothing was saved: the exception has ended the transaction
                response = stale_page(request, stale.form)
        if access.audited:
            record_view(request, response, kwargs)
        return response

    synchronous.access = access  # type: ignore[attr-defined]
    return synchronous


def refused(request: HttpRequest, access: Access) -> HttpResponseBase | None:
    """Answer for a person without access: the login page, the second factor's page, or 401 for a script.

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
    """Whether a script sent the request. It is answered with JSON, never with a page or the login.

    All scripts send this header (``viewer/src/clinic/request.ts``).
    """
    return "HX-Request" in request.headers or request.headers.get("Accept", "").startswith(
        ("application/json", "text/event-stream")
    )
