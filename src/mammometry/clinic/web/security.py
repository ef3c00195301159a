"""Security middleware: headers, expiry of sessions, and refusal of views without roles."""

import base64
import hashlib
import re
import time
from collections.abc import Callable
from typing import Any
from urllib.parse import urlsplit

from asgiref.sync import iscoroutinefunction
from django.contrib.auth import logout
from django.core.exceptions import PermissionDenied
from django.http import HttpRequest, HttpResponse, HttpResponseBase
from django.utils.decorators import sync_and_async_middleware

from mammometry.clinic.site import the_clinic
from mammometry.clinic.web.once import ACCEPTED

Response = Callable[[HttpRequest], HttpResponseBase]
_SCRIPT = re.compile(rb"<script(?![^>]*\ssrc=)[^>]*>(.*?)</script>", re.DOTALL | re.IGNORECASE)
_STAMP_S = 60  # how often a session's time of last use is written


def page_policy() -> str:
    """Content security policy of our own pages: nothing inline, nothing from elsewhere."""
    openid = the_clinic().openid
    leave = ""
    if openid is not None:
        parts = urlsplit(openid.server)
        leave = f" {parts.scheme}://{parts.netloc}"
    return (
        "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data: blob:; font-src 'self'; "
        "connect-src 'self'; worker-src 'self' blob:; frame-src 'self'; manifest-src 'self'; base-uri 'none'; "
        f"frame-ancestors 'self'; form-action 'self'{leave}"
    )


def report_policy(page: bytes) -> str:
    """Policy of a report. It is one file with its own scripts, which are allowed by their digests.

    It is sandboxed: it has no cookies and cannot call the clinic.
    """
    digests = [base64.b64encode(hashlib.sha256(script).digest()).decode() for script in _SCRIPT.findall(page)]
    scripts = " ".join(f"'sha256-{digest}'" for digest in digests) or "'none'"
    return (
        f"default-src 'none'; script-src {scripts} blob:; style-src 'unsafe-inline'; img-src data: blob:; "
        "font-src data:; connect-src data: blob:; worker-src blob:; base-uri 'none'; form-action 'none'; "
        "frame-ancestors 'self'; sandbox allow-scripts allow-downloads"
    )


@sync_and_async_middleware
def Headers(get_response: Any) -> Any:  # named like the other middleware
    """Headers of every answer. Views that answer with a report set their own Content-Security-Policy."""

    def put(response: HttpResponseBase) -> HttpResponseBase:
        response.headers.setdefault("Content-Security-Policy", page_policy())
        response.headers.setdefault(
            "Permissions-Policy", "camera=(self), microphone=(), geolocation=(), payment=(), usb=()"
        )
        response.headers.setdefault("Cross-Origin-Resource-Policy", "same-origin")
        response.headers.setdefault("X-Frame-Options", "SAMEORIGIN")
        response.headers.setdefault("X-Robots-Tag", "noindex")
        if not response.headers.get("Cache-Control"):
            response.headers["Cache-Control"] = "no-store"  # so that a shared computer stores no patient's page
        return response

    if iscoroutinefunction(get_response):

        async def asynchronous(request: HttpRequest) -> HttpResponseBase:
            return put(await get_response(request))

        return asynchronous

    def synchronous(request: HttpRequest) -> HttpResponseBase:
        return put(get_response(request))

    return synchronous


class Expiry:
    """Ends sessions that are idle or too old."""

    sync_capable, async_capable = True, False

    def __init__(self, get_response: Response) -> None:
        self._get_response = get_response

    def __call__(self, request: HttpRequest) -> HttpResponseBase:
        """Answer a request after checking its session."""
        if request.user.is_authenticated:
            limits, now = the_clinic().limits, int(time.time())
            begun = request.session.setdefault("begun_s", now)
            used = request.session.get("used_s", now)
            if now - used > limits.idle_minutes * 60 or now - begun > limits.session_hours * 3600:
                logout(request)
            elif now - used >= _STAMP_S or "used_s" not in request.session:
                request.session["used_s"] = now
        return self._get_response(request)


class DeniedByDefault:
    """Refuses views without an access rule."""

    sync_capable, async_capable = True, False

    def __init__(self, get_response: Response) -> None:
        self._get_response = get_response

    def __call__(self, request: HttpRequest) -> HttpResponseBase:
        """Pass a request on to the next middleware."""
        return self._get_response(request)

    def process_view(self, request: HttpRequest, view: Any, args: Any, kwargs: Any) -> HttpResponse | None:
        """Refuse a view without its roles.

        Raises:
            PermissionDenied: the view has none.
        """
        if not hasattr(view, "access"):
            raise PermissionDenied
        return None


def for_all_pages(request: HttpRequest) -> dict[str, Any]:
    """Values for every template: the clinic's name and the person's roles."""
    person = getattr(request, "user", None)
    roles = list(person.roles) if person is not None and person.is_authenticated else []
    accepted = request.session.get(ACCEPTED, ()) if roles else ()
    return {"clinic_name": the_clinic().name, "roles": roles, "accepted": accepted}
