"""Access to the page: a one-time key is exchanged for a cookie, and all other requests are refused.

The key is never in the arguments of a program, because other users of the computer can read those.
"""

import os
import secrets
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from html import escape
from pathlib import Path
from typing import TypeVar
from urllib.parse import parse_qs, urlsplit

from django.http import HttpRequest, HttpResponse, HttpResponseBase, JsonResponse

HOST = "127.0.0.1"
LARGEST_BYTES = 1 << 20  # a drawing has about 20 kB
_NAMES = (HOST, "localhost")
_HEADERS = {
    "Cache-Control": "no-store",
    "Referrer-Policy": "no-referrer",
    "X-Frame-Options": "DENY",
    "X-Content-Type-Options": "nosniff",
    "Cross-Origin-Resource-Policy": "same-origin",
}
_FORM = "application/x-www-form-urlencoded"
_Response = TypeVar("_Response", bound=HttpResponseBase)


class OneTimeLogin:
    """Keys and cookie of one server."""

    def __init__(self, command: str = "edit") -> None:
        self._command = f"mammometry {command}"
        self._keys: set[str] = set()
        self._cookie = secrets.token_urlsafe(32)

    def new_key(self) -> str:
        """A new one-time key."""
        key = secrets.token_urlsafe(24)
        self._keys.add(key)
        return key

    def refusal(self, request: HttpRequest) -> HttpResponse | None:
        """Refusal of a request, or None if it is allowed.

        A request that changes data needs the cookie and must come from our own page, according to the browser.
        """
        host = request.headers.get("host", "")
        if host.rsplit(":", 1)[0] not in _NAMES:
            return HttpResponse(status=404)
        entering = request.path == "/enter"
        if request.method == "POST":
            wrong = self._wrong_post(request, own=None if entering else f"http://{host}")
            if wrong is not None:
                return _refused(request, *wrong)
        elif request.method != "GET":
            return _refused(request, 405, "Only GET and POST are answered.")
        if not entering and not self._is_inside(request):
            return _refused(request, 403, f"Open the address that “{self._command}” printed in its terminal.")
        return None

    def _is_inside(self, request: HttpRequest) -> bool:
        """Whether the request has the cookie."""
        given = request.COOKIES.get(_cookie_name(request), "")
        return secrets.compare_digest(given.encode(), self._cookie.encode())

    def _wrong_post(self, request: HttpRequest, own: str | None) -> tuple[int, str] | None:
        headers = request.headers
        length = headers.get("content-length", "")
        if not length.isdecimal():
            return 411, "The request does not state its length."
        if int(length) > LARGEST_BYTES:
            return 413, f"The request is larger than {LARGEST_BYTES >> 20} MB. A drawing is much smaller."
        kind = headers.get("content-type", "").split(";")[0].strip().lower()
        if kind != (_FORM if own is None else "application/json"):
            return 415, f"The request is not JSON but {kind or 'of no stated type'}."
        if own is not None and (
            headers.get("origin") != own or headers.get("sec-fetch-site", "same-origin") != "same-origin"
        ):
            return 403, "The request comes from another page."
        return None

    def enter(self, request: HttpRequest) -> HttpResponse:
        """Exchange a key for the cookie."""
        key = parse_qs(request.body.decode("ascii", "replace")).get("key", [""])[0]
        held = next((own for own in self._keys if secrets.compare_digest(own.encode(), key.encode())), None)
        if held is None and not self._is_inside(request):  # a logged-in user may open the link again
            sentence = f"This link is unknown or was used before. Stop “{self._command}” and start it again."
            return _refused(request, 403, sentence)
        self._keys.discard(held or "")
        # Not a redirection: after a link from another page, browsers would follow it without the cookie.
        answer = HttpResponse(_document('<meta http-equiv="refresh" content="0;url=/">', "Opening …"))
        answer.set_cookie(_cookie_name(request), self._cookie, httponly=True, samesite="Strict", path="/")
        return answer


def sealed(response: _Response) -> _Response:
    """The response with headers that forbid storing it or framing its page."""
    for name, value in _HEADERS.items():
        response[name] = value
    return response


def entrance() -> HttpResponse:
    """Page of the printed address, which moves the key from the address bar into a form and sends it."""
    return HttpResponse(
        _document(
            "",
            '<form method="post" action="/enter"><label>Key: <input name="key" autocomplete="off"></label> '
            "<button>Open</button></form><script>const key = location.hash.slice(1);"
            'history.replaceState(null, "", "/enter");'
            "if (key) { document.forms[0].key.value = key; document.forms[0].submit(); }</script>",
        )
    )


@contextmanager
def local_page(address: str, key: str) -> Iterator[Path]:
    """Temporary file, readable only by its owner, that sends a key when a browser opens it.

    Args:
        address: of the server: ``http://127.0.0.1:PORT``.
        key: one-time key.
    """
    assert urlsplit(address).hostname in _NAMES
    handle, name = tempfile.mkstemp(prefix="mammometry-edit-", suffix=".html")  # readable only by its owner
    path = Path(name)
    try:
        with os.fdopen(handle, "w", encoding="utf-8") as file:
            file.write(
                _document(
                    "",
                    f'<form method="post" action="{address}/enter"><input type="hidden" name="key" value="{key}">'
                    "<button>Open the page</button></form><script>document.forms[0].submit();</script>",
                )
            )
        yield path
    finally:
        path.unlink(missing_ok=True)


def _document(head: str, body: str) -> str:
    return (
        f'<!doctype html><html lang="en"><head><meta charset="utf-8"><title>mammometry</title>{head}</head>'
        f"<body>{body}</body></html>"
    )


def _cookie_name(request: HttpRequest) -> str:
    """Name of the cookie, with the port: browsers share cookies between servers of one computer."""
    return f"mammometry-{request.get_port()}"


def _refused(request: HttpRequest, status: int, sentence: str) -> HttpResponse:
    """A refusal: a page for a browser's navigation, JSON for programs and the page's own script."""
    if "text/html" not in request.headers.get("accept", ""):
        return JsonResponse({"error": sentence}, status=status)
    body = f"<h1>This page cannot be opened</h1><p>{escape(sentence)}</p>"
    return HttpResponse(_document("<style>body { font: 1.1rem sans-serif; margin: 3rem }</style>", body), status=status)
