"""Each request in one thread, from its beginning to its end.

Django's own ASGI handler takes a request back and forth between the event loop and a new thread, for every middleware
that is not asynchronous, and opens the database anew each time. All but one of our views wait for the database, so
their requests go to threads that stay, each with its connection. What streams events stays on the event loop.
"""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Any

from asgiref.sync import iscoroutinefunction
from django.core import signals
from django.core.exceptions import RequestAborted
from django.core.handlers.asgi import ASGIHandler, get_script_prefix
from django.core.handlers.base import BaseHandler
from django.db import connections
from django.http import FileResponse, HttpResponseBase, StreamingHttpResponse
from django.urls import Resolver404, resolve, set_script_prefix

from mammometry.clinic.web.limits import Receive, Scope, Send

_THREADS = 16
"""Requests that are answered at once: each may wait for a disk or hold a photograph, and they share the interpreter."""


class Threaded(ASGIHandler):
    """Answers synchronous views, each in a thread that stays."""

    def __init__(self) -> None:
        BaseHandler.__init__(self)
        self.load_middleware(is_async=False)
        self._threads = ThreadPoolExecutor(_THREADS, thread_name_prefix="clinic")

    async def handle(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer one request. Its whole body is read first, so a slow line holds no thread."""
        try:
            body = await self.read_body(receive)
        except RequestAborted:  # the browser has gone
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
            response.close()  # its content stays; the database is free before a slow line has taken it
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
        # Its threads end with their requests, and would leave their connections behind.
        signals.request_finished.connect(_close_all, sender=ASGIHandler)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer one request."""
        try:
            streams = iscoroutinefunction(resolve(scope["path"]).func)
        except Resolver404:
            streams = False
        await (self._asynchronous if streams else self._threaded)(dict(scope), receive, send)


def _close_all(**_: object) -> None:
    connections.close_all()
