"""Requests: their limits, and the thread in which each is answered."""

import asyncio
import json
import time
from collections.abc import AsyncIterator, Awaitable, Callable, Iterator, Mapping, MutableMapping
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

Scope = MutableMapping[str, Any]
Receive = Callable[[], Awaitable[Mapping[str, Any]]]
Send = Callable[[Mapping[str, Any]], Awaitable[None]]
_BURST_S = 10.0  # seconds' worth of requests that may come at once
_ADDRESSES = 10_000  # remembered at most
_READ_AWAY_BYTES = 1024 * 1024  # of a refused body; more ends the connection
_ANYBODYS_BYTES = 8 << 20  # more than a piece of a photograph, which only logged-in people may send
_BYTES_PER_S = 10_000  # slowest allowed line: a tenth of a weak telephone network's
_PROXY_HEADERS = (b"x-forwarded-for", b"x-forwarded-port", b"x-forwarded-host", b"forwarded")
"""Headers that anybody can send. The server has already put those of a trusted proxy into the scope."""


class TooLarge(Exception):
    """A body is longer than its route allows."""


class TooSlow(Exception):
    """A body arrives too slowly."""


class Limited:
    """An ASGI application behind limits.

    Args:
        application: the limited one.
        limits: the clinic's.
        clock: seconds.
    """

    def __init__(self, application: Any, limits: RateLimits, clock: Callable[[], float] = time.monotonic) -> None:
        self._application = application
        self._rate = float(limits.requests_per_second)
        self._request_s = float(limits.request_s)
        self._clock = clock
        self._spent: dict[str, tuple[float, float]] = {}

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer an ASGI request."""
        if scope["type"] != "http":
            return  # neither web sockets nor anything else
        scope["headers"] = [(name, value) for name, value in scope["headers"] if name not in _PROXY_HEADERS]
        as_json = dict(scope["headers"]).get(b"accept", b"").startswith(b"application/json")
        if not self._may_ask((scope.get("client") or ("",))[0]):
            return await _refuse(send, 429, "Too many requests. Wait a few seconds.", as_json, retry_after_s=5)
        most = _granted(scope["path"])
        if most > _ANYBODYS_BYTES and not await sync_to_async(_is_logged_in)(scope["headers"]):
            most = BODY_BYTES
        stated = dict(scope["headers"]).get(b"content-length", b"0")
        body = _Body(receive, most, self._request_s)
        begun = False

        async def noted_send(message: Mapping[str, Any]) -> None:
            nonlocal begun
            begun = True
            await send(message)

        try:
            if not stated.isdigit() or int(stated) > most:
                raise TooLarge
            await self._application(scope, body.receive, noted_send)
        except TooLarge:
            if not begun:
                await body.read_away()
                await _refuse(send, 413, f"The request is larger than {most} bytes.", as_json)
        except TooSlow:
            if not begun:
                await _refuse(send, 408, "The request came too slowly. Try again on a better line.", as_json)
        return None

    def _may_ask(self, address: str) -> bool:
        """Whether an address may send a request now, by a token bucket."""
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
    """Whether a request has a login session. Its rights are checked later."""
    held = parse_cookie(dict(headers).get(b"cookie", b"").decode("latin-1")).get(settings.SESSION_COOKIE_NAME)
    if held is None:
        return False
    store = import_module(settings.SESSION_ENGINE).SessionStore(held)
    try:
        return "_auth_user_id" in store
    finally:
        connections.close_all()


class _Body:
    """A request's body, counted and timed while it is received.

    Args:
        receive: the server's.
        most: allowed bytes.
        seconds: allowed time, in addition to that of its bytes on a slow line.
    """

    def __init__(self, receive: Receive, most: int, seconds: float) -> None:
        self._receive = receive
        self._most = most
        self._seconds = seconds
        self._begun_s = time.monotonic()
        self._read = 0
        self._whole = False

    async def receive(self) -> Mapping[str, Any]:
        """Pass on the next message.

        Raises:
            TooLarge: more than allowed.
            TooSlow: not received in time.
        """
        message = await self._next()
        if self._read > self._most:
            raise TooLarge
        return message

    async def read_away(self) -> None:
        """Read on for a while and discard.

        Closing a connection with unread bytes resets it, and the other side never sees the answer.
        """
        enough = self._read + _READ_AWAY_BYTES
        try:
            while not self._whole and self._read < enough:
                await self._next()
        except TooSlow:
            return

    async def _next(self) -> Mapping[str, Any]:
        if self._whole:
            return await self._receive()  # waits until the other side has closed
        left_s = self._begun_s + self._seconds + self._read / _BYTES_PER_S - time.monotonic()
        try:
            message = await asyncio.wait_for(self._receive(), max(left_s, 0.0))
        except TimeoutError:
            raise TooSlow from None
        self._read += len(message.get("body", b""))
        self._whole = not message.get("more_body", False)
        return message


async def _refuse(send: Send, status: int, sentence: str, as_json: bool, retry_after_s: int | None = None) -> None:
    body = (json.dumps({"error": sentence}) if as_json else sentence).encode()
    headers = [
        (b"content-type", b"application/json" if as_json else b"text/plain; charset=utf-8"),
        (b"content-length", str(len(body)).encode()),
        (b"connection", b"close"),
        (b"x-content-type-options", b"nosniff"),
    ]
    if retry_after_s is not None:
        headers.append((b"retry-after", str(retry_after_s).encode()))
    await send({"type": "http.response.start", "status": status, "headers": headers})
    await send({"type": "http.response.body", "body": body})


_THREADS = 16
"""Number of requests answered in parallel: each may wait for a disk or hold a photograph, and they share the
interpreter.
"""


class Threaded(ASGIHandler):
    """Runs synchronous views in permanent threads."""

    def __init__(self) -> None:
        BaseHandler.__init__(self)
        self.load_middleware(is_async=False)
        self._threads = ThreadPoolExecutor(_THREADS, thread_name_prefix="clinic")

    async def handle(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer one request. Its body is read first, so that a slow line blocks no thread."""
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
            response.close()  # its content remains; the database is released before a slow line has received it
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
        # Its threads end with their requests, and would leak their connections.
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
