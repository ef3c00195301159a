"""Replies of all servers: security headers, and refusals as JSON or as a small page."""

import base64
import hashlib
import json
import logging
import re
from collections.abc import Awaitable, Callable, Mapping, MutableMapping
from html import escape
from typing import Any

from pydantic import ValidationError

from mammometry.base.errors import FullDiskError, MammometryError, StorageError
from mammometry.io.drawn_changes import LateError

Scope = MutableMapping[str, Any]
Receive = Callable[[], Awaitable[Mapping[str, Any]]]
Send = Callable[[Mapping[str, Any]], Awaitable[None]]
Application = Callable[[Scope, Receive, Send], Awaitable[None]]
"""An ASGI application."""
HEADERS = {
    "Cache-Control": "no-store",  # so that a shared computer stores no patient's page
    "Cross-Origin-Resource-Policy": "same-origin",
    "Permissions-Policy": "camera=(self), microphone=(), geolocation=(), payment=(), usb=()",
    "X-Content-Type-Options": "nosniff",
    "X-Robots-Tag": "noindex",
}
"""Headers of every answer, unless it sets them itself."""
_LOG = logging.getLogger(__name__)
_SCRIPT = re.compile(rb"<script(?![^>]*\ssrc=)[^>]*>(.*?)</script>", re.DOTALL | re.IGNORECASE)
_PAGE = (
    '<!doctype html><html lang="en"><meta charset="utf-8"><title>mammometry</title>'
    "<style>body {{ font: 1.1rem sans-serif; margin: 3rem }}</style>{}"
)


class Refused(Exception):
    """A request is refused. Its text is the reason, one sentence.

    Args:
        sentence: the reason.
        status: of HTTP.
        headers: more of the answer's.
    """

    def __init__(self, sentence: str, status: int = 409, **headers: str) -> None:
        super().__init__(sentence)
        self.status, self.headers = status, headers


def header(scope: Scope, name: str) -> str:
    """A request's header, empty if there is none."""
    return str(dict(scope["headers"]).get(name.encode(), b"").decode("latin-1"))


def inline_policy(page: bytes, others: str) -> str:
    """Content security policy of a page that is one file. Its scripts are allowed by their digests.

    Args:
        page: HTML.
        others: directives in addition, such as ``connect-src``.
    """
    digests = [base64.b64encode(hashlib.sha256(script).digest()).decode() for script in _SCRIPT.findall(page)]
    scripts = " ".join(f"'sha256-{digest}'" for digest in digests) or "'none'"
    return (
        f"default-src 'none'; script-src {scripts} blob:; style-src 'unsafe-inline'; img-src data: blob:; "
        f"font-src data:; worker-src blob:; base-uri 'none'; form-action 'none'; {others}"
    )


def small_page(body: str) -> str:
    """HTML of a page with one message."""
    return _PAGE.format(body)


async def reply(send: Send, content: Mapping[str, Any] | str, status: int = 200, **headers: str) -> None:
    """Send a page, which no other page may frame, or a table as JSON.

    Args:
        send: ASGI.
        content: HTML or the table.
        status: of HTTP.
        headers: more, with ``_`` for ``-``.
    """
    body = (content if isinstance(content, str) else json.dumps(content)).encode()
    named = {**HEADERS, "Content-Type": "application/json", "Referrer-Policy": "no-referrer"}
    if isinstance(content, str):
        policy = inline_policy(body, "connect-src 'self' data: blob:; frame-ancestors 'none'")
        named |= {"Content-Type": "text/html; charset=utf-8", "Content-Security-Policy": policy}
    pairs = {**named, "Content-Length": str(len(body)), **headers}.items()
    encoded = [(name.replace("_", "-").lower().encode(), value.encode()) for name, value in pairs]
    await send({"type": "http.response.start", "status": status, "headers": encoded})
    await send({"type": "http.response.body", "body": body})


async def refuse(scope: Scope, send: Send, refused: Refused) -> None:
    """Send a refusal and close the connection: a page for a browser's navigation, else JSON."""
    content: Mapping[str, Any] | str = {"error": str(refused)}
    if "text/html" in header(scope, "accept"):
        content = small_page(f"<h1>This page cannot be opened</h1><p>{escape(str(refused))}</p>")
    await reply(send, content, refused.status, Connection="close", **refused.headers)


def refusal(error: MammometryError | ValidationError) -> tuple[int, dict[str, Any]]:
    """HTTP status and JSON of an error, for the page."""
    if isinstance(error, ValidationError):
        return 422, {"error": _sentence([dict(item) for item in error.errors(include_url=False)])}
    if isinstance(error, LateError):
        return 409, {"error": error.on_page, "late": [list(item) for item in error.items]}
    if isinstance(error, StorageError):
        _LOG.error("%s", error)
        return (507 if isinstance(error, FullDiskError) else 503), {"error": str(error)}
    return 422, {"error": str(error)}


def _sentence(errors: list[dict[str, Any]]) -> str:
    """State the fault of a message, without repeating its content."""
    first = errors[0]
    where = ".".join(str(part) for part in first.get("loc", ()) if part != "body")
    return f"{where or 'The request'}: {first.get('msg', 'not as expected')}."
