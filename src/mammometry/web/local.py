"""A page for the one person at this computer.

A one-time key is exchanged for a cookie; all other requests are refused. The server listens only on 127.0.0.1. The key
is never in the arguments of a program, because other users of the computer can read those.
"""

import asyncio
import os
import re
import secrets
import socket
import tempfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from html import escape
from importlib.resources import files
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from mammometry.base.errors import MammometryError
from mammometry.web.limits import Limited
from mammometry.web.replies import Application, Receive, Refused, Scope, Send, header, refusal, reply, small_page
from mammometry.web.server import server

HOST = "127.0.0.1"
BODY_BYTES = 1 << 20  # a drawing has about 20 kB
REQUEST_S = 30.0  # for a request, as in a clinic
Page = Callable[[bytes], Mapping[str, Any] | str]
"""Answers one method of one address: body of the request → HTML, or a table that is sent as JSON."""
_ENTRANCE = small_page(
    "<p>Opening …</p><script>const key = location.hash.slice(1);"
    'history.replaceState(null, "", "/enter");'  # the key is not left in the address bar
    'const headers = { "Content-Type": "application/json", Accept: "text/html" };'
    'fetch("/enter", { method: "POST", headers, body: JSON.stringify(key) }).then(async (answer) => {'
    'if (answer.ok) location.replace("/"); else document.body.innerHTML = await answer.text(); });</script>'
)


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

    def require(self, scope: Scope) -> None:
        """Require the cookie, and of a change that it comes from our own page, according to the browser.

        Raises:
            Refused: the request is from elsewhere.
        """
        host = header(scope, "host")
        if host.rsplit(":", 1)[0] not in (HOST, "localhost"):
            raise Refused("This address is unknown.", 404)
        if scope["method"] != "GET":
            kind = header(scope, "content-type").split(";")[0].strip().lower()
            if kind != "application/json":
                raise Refused(f"The request is not JSON but {kind or 'of no stated type'}.", 415)
            site = header(scope, "sec-fetch-site") or "same-origin"
            if header(scope, "origin") != f"http://{host}" or site != "same-origin":
                raise Refused("The request comes from another page.", 403)
        if scope["path"] != "/enter" and not self._is_inside(scope):
            raise Refused(f"Open the address that “{self._command}” printed in its terminal.", 403)

    def enter(self, scope: Scope, body: bytes) -> str:
        """Exchange a key for the cookie.

        Args:
            scope: of the request.
            body: the key as JSON.

        Returns:
            The header Set-Cookie.

        Raises:
            Refused: the key is unknown.
        """
        key = body.strip(b'"')
        held = next((own for own in self._keys if secrets.compare_digest(own.encode(), key)), None)
        if held is None and not self._is_inside(scope):  # a logged-in user may open the link again
            raise Refused(f"This link is unknown or was used before. Stop “{self._command}” and start it again.", 403)
        self._keys.discard(held or "")
        return f"{self._in_cookie(scope)}; HttpOnly; SameSite=Strict; Path=/"

    def _is_inside(self, scope: Scope) -> bool:
        """Whether the request has the cookie."""
        own = self._in_cookie(scope).encode()
        given = header(scope, "cookie").split(";")
        return any(secrets.compare_digest(pair.strip().encode(), own) for pair in given)

    def _in_cookie(self, scope: Scope) -> str:
        """The cookie with its name, which has the port: browsers share cookies between servers of one computer."""
        return f"mammometry-{header(scope, 'host').rpartition(':')[2]}={self._cookie}"


def local_app(pages: Mapping[str, Page], login: OneTimeLogin) -> Application:
    """Application of a local page.

    Args:
        pages: method and path, such as ``GET /``, → what answers it, in a thread. Errors become messages.
        login: controls access.
    """
    paths = {"/enter", *(where.split()[1] for where in pages)}

    async def application(scope: Scope, receive: Receive, send: Send) -> None:
        login.require(scope)
        body, more = b"", True
        while more:
            message = await receive()
            if message["type"] == "http.disconnect":
                return
            body, more = body + message.get("body", b""), message.get("more_body", False)
        where = f"{scope['method']} {scope['path']}"
        if where == "GET /enter":
            await reply(send, _ENTRANCE)
        elif where == "POST /enter":
            await reply(send, {}, Set_Cookie=login.enter(scope, body))
        elif where in pages:
            await reply(send, *await asyncio.to_thread(_answer, pages[where], body))
        elif scope["path"] in paths:
            raise Refused(f"This address does not answer {scope['method']}.", 405)
        else:
            raise Refused("This address is unknown.", 404)

    return Limited(application, body_bytes=BODY_BYTES, request_s=REQUEST_S)


def _answer(page: Page, body: bytes) -> tuple[Mapping[str, Any] | str, int]:
    try:
        return page(body), 200
    except (MammometryError, ValidationError) as error:
        status, words = refusal(error)
        return words, status


def listen(app: Application, login: OneTimeLogin, *, ready: Callable[[str, str], None]) -> None:
    """Serve a local page until interrupted.

    Args:
        app: from `local_app`.
        login: of the same page.
        ready: called when the page can be opened, with a one-time address, and the address of a local file that opens
            the page without revealing the key to other users of this computer.
    """
    with socket.socket(socket.AF_INET, socket.SOCK_STREAM) as listener:
        listener.bind((HOST, 0))
        listener.listen()  # from now on browsers wait
        address = f"http://{HOST}:{listener.getsockname()[1]}"
        with local_file(address, login.new_key()) as file:
            ready(_link(address, login.new_key()), file.as_uri())
            server(app, request_s=REQUEST_S, log_level="warning").run(sockets=[listener])


@contextmanager
def local_file(address: str, key: str) -> Iterator[Path]:
    """Temporary file, readable only by its owner, that opens a page with a key in a browser.

    Args:
        address: of the server: ``http://127.0.0.1:PORT``.
        key: one-time key.
    """
    handle, name = tempfile.mkstemp(prefix="mammometry-", suffix=".html")  # readable only by its owner
    path = Path(name)
    try:
        with os.fdopen(handle, "w", encoding="utf-8") as file:
            file.write(small_page(f'<meta http-equiv="refresh" content="0;url={_link(address, key)}">'))
        yield path
    finally:
        path.unlink(missing_ok=True)


def _link(address: str, key: str) -> str:
    return f"{address}/enter#{key}"  # what follows # is not sent


def html_page(template: str, title: str, *, style: str, script: str) -> str:
    """A page in one file.

    Args:
        template: HTML with places for ``title``, ``style`` and ``script`` in double braces.
        title: any text.
        style: CSS.
        script: JavaScript.
    """
    parts = {"title": escape(title), "style": style, "script": script.replace("</", "<\\/")}
    return re.sub(r"{{ (\w+) }}", lambda place: parts[place[1]], template)


def resource(package: str, name: str) -> str:
    """Text of a package's template."""
    return files(package).joinpath("templates", name).read_text(encoding="utf-8")
