"""Limits on the number and size of requests, by address and login, and the threads that answer them."""

import asyncio
import time
from collections.abc import AsyncIterator, Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from importlib import import_module
from typing import Any

from asgiref.sync import iscoroutinefunction, sync_to_async
from django.conf import settings
from django.core import signals
from django.core.exceptions import RequestAborted
from django.core.handlers.asgi import ASGIHandler, get_script_prefix
from django.core.handlers.base import BaseHandler
from django.db import connections
from django.http import FileResponse, HttpResponseBase, StreamingHttpResponse
from django.http.cookie import parse_cookie
from django.urls import Resolver404, resolve, set_script_prefix

from mammometry.clinic.config import RateLimits
from mammometry.clinic.web.access import BODY_BYTES
from mammometry.web.limits import Limited
from mammometry.web.replies import Application, Receive, Refused, Scope, Send

_BURST_S = 10.0  # longest burst, in seconds' worth of requests
_ADDRESSES = 10_000  # largest number of addresses that are remembered
_ANYBODYS_BYTES = 8 << 20  # largest body without login: larger than a piece of a photograph
_PROXY_HEADERS = (b"x-forwarded-for", b"x-forwarded-port", b"x-forwarded-host", b"forwarded")
"""Headers that anybody can send. The server has already moved those of a trusted proxy into the scope."""


class ClinicLimited(Limited):
    """An ASGI application with the clinic's limits on requests.

    Args:
        application: the application to protect.
        limits: the clinic's limits.
        clock: current time, s.
    """

    def __init__(
        self, application: Application, limits: RateLimits, clock: Callable[[], float] = time.monotonic
    ) -> None:
        super().__init__(application, body_bytes=BODY_BYTES, request_s=limits.request_s)
        self._rate = float(limits.requests_per_second)
        self._clock = clock
        self._spent: dict[str, tuple[float, float]] = {}

    async def granted(self, scope: Scope) -> int:
        """Largest body of a request, bytes.

        Raises:
            Refused: too many requests came from the address.
        """
        scope["headers"] = [(name, value) for name, value in scope["headers"] if name not in _PROXY_HEADERS]
        if not self._may_ask((scope.get("client") or ("",))[0]):
            raise Refused("Too many requests. Wait a few seconds.", 429, Retry_After="5")
        most = _granted(scope["path"])
        if most > _ANYBODYS_BYTES and not await sync_to_async(_is_logged_in)(scope["headers"]):
            return BODY_BYTES
        return most

    def _may_ask(self, address: str) -> bool:
        """Whether an address may send a request now (token bucket)."""
        now = self._clock()
        if len(self._spent) > _ADDRESSES:
            self._spent = {key: spent for key, spent in self._spent.items() if now - spent[1] < _BURST_S}
        spent, then = self._spent.get(address, (0.0, now))
        spent = max(spent - (now - then) * self._rate, 0.0)
        allowed = spent + 1.0 <= self._rate * _BURST_S
        self._spent[address] = (spent + 1.0 if allowed else spent, now)
        return allowed


def _granted(path: str) -> int:
    try:
        access = getattr(resolve(path).func, "access", None)
    except Resolver404:
        access = None
    return BODY_BYTES if access is None else int(access.body_bytes)


def _is_logged_in(headers: Any) -> bool:
    """Whether a request belongs to a login session. Its rights are checked later."""
    held = parse_cookie(dict(headers).get(b"cookie", b"").decode("latin-1")).get(settings.SESSION_COOKIE_NAME)
    if held is None:
        return False
    store = import_module(settings.SESSION_ENGINE).SessionStore(held)
    try:
        return "_auth_user_id" in store
    finally:
        connections.close_all()


_THREADS = 16
"""Number of requests answered in parallel. Each may wait for a disk or hold a photograph, and they share the
interpreter.
"""


class Threaded(ASGIHandler):
    """Runs synchronous views in a fixed set of threads."""

    def __init__(self) -> None:
        BaseHandler.__init__(self)
        self.load_middleware(is_async=False)
        self._threads = ThreadPoolExecutor(_THREADS, thread_name_prefix="clinic")

    async def handle(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer one request. Its body is read first, so that a slow connection does not block a thread."""
        try:
            body = await self.read_body(receive)
        except RequestAborted:  # the browser has disconnected
            return
        with body:
            response = await self._within(self._answer, scope, body)
        if isinstance(response, StreamingHttpResponse) and not response.is_async:
            response.streaming_content = self._parts(iter(response.streaming_content))  # type: ignore[arg-type]
        try:
            await self.send_response(response, send)
        finally:
            if response.streaming:
                await self._within(response.close)

    def _answer(self, scope: Scope, body: Any) -> HttpResponseBase:
        set_script_prefix(get_script_prefix(scope))
        signals.request_started.send(sender=type(self), scope=scope)
        request, unreadable = self.create_request(dict(scope), body)
        response: Any = unreadable if request is None else self.get_response(request)
        assert isinstance(response, HttpResponseBase)
        response._handler_class = type(self)  # type: ignore[attr-defined]  # sender of the signal that it has ended
        if isinstance(response, FileResponse):
            response.block_size = self.chunk_size
        if not response.streaming:
            response.close()  # keeps the content, and frees the database before a slow client has received it
        return response

    async def _parts(self, content: Iterator[bytes]) -> AsyncIterator[bytes]:
        while (part := await self._within(next, content, None)) is not None:
            yield part

    async def _within(self, what: Any, *arguments: Any) -> Any:
        return await asyncio.get_running_loop().run_in_executor(self._threads, what, *arguments)


class Dispatcher:
    """Django as an ASGI application. Coroutine views run on the event loop, all others in threads."""

    def __init__(self) -> None:
        self._threaded = Threaded()
        self._asynchronous = ASGIHandler()
        # Their threads end with the requests, and would leave connections open.
        signals.request_finished.connect(_close_all, sender=ASGIHandler)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer an ASGI request."""
        try:
            streams = iscoroutinefunction(resolve(scope["path"]).func)
        except Resolver404:
            streams = False
        await (self._asynchronous if streams else self._threaded)(dict(scope), receive, send)


def _close_all(**_: object) -> None:
    connections.close_all()
