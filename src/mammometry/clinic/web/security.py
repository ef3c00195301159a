"""Security middleware: headers, expiry of sessions, and refusal of views without roles."""

import time
from typing import Any
from urllib.parse import urlsplit

from django.contrib.auth import logout
from django.core.exceptions import PermissionDenied
from django.http import HttpRequest, HttpResponseBase
from django.utils.deprecation import MiddlewareMixin

from mammometry.clinic.site import the_clinic
from mammometry.clinic.web.once import ACCEPTED
from mammometry.web.replies import HEADERS, inline_policy

_STAMP_S = 60  # least time between two updates of a session's time of last use


def page_policy() -> str:
    """Content security policy of our own pages: nothing inline, nothing from other servers."""
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
    """Content security policy of a report: one file, whose own scripts are allowed by their digests.

    The report is sandboxed: it has no cookies and cannot send requests to the clinic.
    """
    others = "connect-src data: blob:; frame-ancestors 'self'; sandbox allow-scripts allow-downloads"
    return inline_policy(page, others)


class Headers(MiddlewareMixin):
    """Adds security headers to every answer. Views that answer with a report set their own policy."""

    def process_response(self, request: HttpRequest, response: HttpResponseBase) -> HttpResponseBase:
        """Add headers that the answer does not have yet."""
        own = {"Content-Security-Policy": page_policy(), "X-Frame-Options": "SAMEORIGIN"}
        for name, value in {**own, **HEADERS}.items():
            response.headers.setdefault(name, value)
        return response


class Expiry(MiddlewareMixin):
    """Ends sessions that are idle or too old."""

    def process_request(self, request: HttpRequest) -> None:
        """Log the person out if the session has expired, or else update its time of last use."""
        if request.user.is_authenticated:
            limits, now = the_clinic().limits, int(time.time())
            begun = request.session.setdefault("begun_s", now)
            used = request.session.get("used_s", now)
            if now - used > limits.idle_minutes * 60 or now - begun > limits.session_hours * 3600:
                logout(request)
            elif now - used >= _STAMP_S or "used_s" not in request.session:
                request.session["used_s"] = now


class DeniedByDefault(MiddlewareMixin):
    """Refuses views without an access rule."""

    def process_view(self, request: HttpRequest, view: Any, args: Any, kwargs: Any) -> None:
        """Refuse a view that has no roles.

        Raises:
            PermissionDenied: the view has no roles.
        """
        if not hasattr(view, "access"):
            raise PermissionDenied


def for_all_pages(request: HttpRequest) -> dict[str, Any]:
    """Values for every template: the clinic's name and the person's roles."""
    person = getattr(request, "user", None)
    roles = list(person.roles) if person is not None and person.is_authenticated else []
    accepted = request.session.get(ACCEPTED, ()) if roles else ()
    return {"clinic_name": the_clinic().name, "roles": roles, "accepted": accepted}
