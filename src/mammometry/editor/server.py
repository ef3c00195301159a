"""Server of the local page, which measures drawn curves and saves changes into the session.

It listens only on 127.0.0.1, and requires a one-time key (`auth`).
"""

import io
import re
import socket
from collections.abc import Awaitable, Callable
from html import escape
from typing import Any

from django.conf import settings
from django.core.asgi import get_asgi_application
from django.core.handlers.asgi import ASGIHandler, ASGIRequest
from django.http import HttpRequest, HttpResponse, HttpResponseBase, JsonResponse
from django.urls import URLPattern, path
from pydantic import ValidationError

from mammometry.api.job import Job
from mammometry.base.errors import MammometryError
from mammometry.editor.auth import HOST, OneTimeLogin, entrance, local_page, sealed
from mammometry.editor.page import EditorPage, refusal, resource

Application = Callable[[Any, Any, Any], Awaitable[None]]
"""An ASGI application: scope, receive, send."""


def editor_app(opened: Callable[[], Job], login: OneTimeLogin, *, author: str | None = None) -> Application:
    """Application of the page for one session or scan.

    Args:
        opened: opens it, first for the page and again for each measurement. Its surface is computed if not current.
        login: controls access.
        author: name of the person who draws. Without it the page asks.

    Raises:
        MammometryError: the surface cannot be computed, or the subject has no boundaries.
    """
    return guarded_app(_routes(_LocalPage(opened, author), login), login)


def guarded_app(routes: tuple[URLPattern, ...], login: OneTimeLogin) -> Application:
    """Application of a local page.

    Args:
        routes: of the page, including `login.enter` (`entrance_route`).
        login: controls access.
    """
    handler = _handler()

    class Request(ASGIRequest):
        urlconf = routes  # type: ignore[assignment]  # of this server; Django takes the routes themselves too

    handler.request_class = Request

    async def application(scope: Any, receive: Any, send: Any) -> None:
        refused = login.refusal(ASGIRequest(scope, io.BytesIO()))  # by its headers, before the body is read
        if refused is None:
            await handler(scope, receive, send)
        else:
            await handler.send_response(sealed(refused), send)

    return application


def serve(opened: Callable[[], Job], *, ready: Callable[[str, str], None], author: str | None = None) -> None:
    """Serve the page until interrupted.

    Args:
        opened: as for `editor_app`.
        ready: called when the page can be opened, with a one-time address, and the address of a local file that opens
            the page without revealing the key to other users of this computer.
        author: as for `editor_app`.

    Raises:
        MammometryError: as for `editor_app`.
    """
    login = OneTimeLogin()
    listen(editor_app(opened, login, author=author), login, ready=ready)


def listen(app: Application, login: OneTimeLogin, *, ready: Callable[[str, str], None]) -> None:
    """Serve a local page until interrupted.

    Args:
        app: from `guarded_app`.
        login: of the same page.
        ready: as for `serve`.
    """
    import uvicorn

    with socket.socket(socket.AF_INET, socket.SOCK_STREAM) as listener:
        listener.bind((HOST, 0))
        listener.listen()  # from now on browsers wait
        address = f"http://{HOST}:{listener.getsockname()[1]}"
        server = uvicorn.Server(
            uvicorn.Config(app, log_config=None, log_level="warning", access_log=False, lifespan="off")
        )
        with local_page(address, login.new_key()) as file:
            ready(f"{address}/enter#{login.new_key()}", file.as_uri())
            server.run(sockets=[listener])


def _handler() -> ASGIHandler:
    """Django with only our views, without database, sessions and login."""
    if not settings.configured:
        settings.configure(ROOT_URLCONF=(), MIDDLEWARE=[], USE_I18N=False, DATABASES={}, LOGGING_CONFIG=None)
    return get_asgi_application()


class _LocalPage:
    """The page of a session that this computer measures."""

    def __init__(self, opened: Callable[[], Job], author: str | None) -> None:
        self._opened, self._author = opened, author
        self.page = EditorPage(opened(), author=author)

    def measure(self) -> None:
        """Measure with the current drawing, and write the report."""
        job = self._opened()
        job.run()
        self.page = EditorPage(job, author=self._author)


def _routes(local: _LocalPage, login: OneTimeLogin) -> tuple[URLPattern, ...]:
    def saved(request: HttpRequest) -> dict[str, Any]:
        _, changed = local.page.save(request.body)
        return {"saved": len(changed), **local.page.items()}

    def measured(request: HttpRequest) -> dict[str, Any]:
        local.measure()
        return local.page.items()

    def finished(request: HttpRequest) -> dict[str, Any]:
        local.page.finish(request.body)
        return local.page.items()

    def document(request: HttpRequest) -> HttpResponse:
        styles = [resource("mammometry.report", name) for name in ("report.css", "viewer.css")]
        return html_page(
            resource("mammometry.editor", "editor.html"),
            local.page.title,
            style="".join([*styles, resource("mammometry.editor", "editor.css")]),
            script=resource("mammometry.report", "editor.js"),
        )

    return (
        entrance_route(login),
        path("", page_view(GET=document)),
        path("drawing", page_view(GET=lambda request: local.page.drawing())),
        path("items", page_view(GET=lambda request: local.page.items())),
        path("measure", page_view(POST=lambda request: local.page.measure(request.body))),
        path("save", page_view(POST=saved)),
        path("run", page_view(POST=measured)),
        path("finish", page_view(POST=finished)),
    )


def entrance_route(login: OneTimeLogin) -> URLPattern:
    """Route on which a key is exchanged for the cookie."""
    return path("enter", page_view(GET=lambda request: entrance(), POST=login.enter))


def page_view(**by_method: Callable[[HttpRequest], HttpResponse | dict[str, Any]]) -> Callable[..., HttpResponseBase]:
    """View that answers only the given methods. Errors become messages."""

    def view(request: HttpRequest) -> HttpResponseBase:
        answer = by_method.get(request.method or "")
        if answer is None:
            return sealed(JsonResponse({"error": f"This address does not answer {request.method}."}, status=405))
        try:
            reply = answer(request)
        except (MammometryError, ValidationError) as error:
            status, words = refusal(error)
            return sealed(JsonResponse(words, status=status))
        return sealed(reply if isinstance(reply, HttpResponse) else JsonResponse(reply))

    return view


def html_page(template: str, title: str, *, style: str, script: str) -> HttpResponse:
    """A page in one file.

    Args:
        template: HTML with places for ``title``, ``style`` and ``script`` in double braces.
        title: any text.
        style: CSS.
        script: JavaScript.
    """
    parts = {"title": escape(title), "style": style, "script": script.replace("</", "<\\/")}
    return HttpResponse(re.sub(r"{{ (\w+) }}", lambda place: parts[place[1]], template))
