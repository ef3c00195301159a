"""Limits of size and time for the bodies of requests, in front of any application."""

import asyncio
import time
from collections.abc import Mapping
from contextlib import suppress
from typing import Any

from mammometry.web.replies import Application, Receive, Refused, Scope, Send, refuse

_READ_AWAY_BYTES = 1024 * 1024  # of a refused body; more ends the connection
_BYTES_PER_S = 10_000  # slowest allowed line: a tenth of a weak telephone network's


class Limited:
    """An ASGI application behind limits. A `Refused` that it raises is answered.

    Args:
        application: the limited one.
        body_bytes: largest body of a request.
        request_s: seconds for a body, in addition to those of its bytes on a slow line.
    """

    def __init__(self, application: Application, *, body_bytes: int, request_s: float) -> None:
        self._application, self._body_bytes, self._request_s = application, body_bytes, request_s

    async def granted(self, scope: Scope) -> int:
        """Largest body of a request, bytes."""
        return self._body_bytes

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer an ASGI request."""
        if scope["type"] != "http":
            return  # neither web sockets nor anything else
        body = _Body(receive, self._request_s)
        begun = False

        async def noted_send(message: Mapping[str, Any]) -> None:
            nonlocal begun
            begun = True
            await send(message)

        try:
            body.most = await self.granted(scope)
            stated = dict(scope["headers"]).get(b"content-length", b"0")
            if not stated.isdigit() or int(stated) > body.most:
                raise body.too_large
            await self._application(scope, body.receive, noted_send)
        except Refused as refused:
            if not begun:
                await body.read_away()
                await refuse(scope, send, refused)


class _Body:
    """A request's body, counted and timed while it is received.

    Args:
        receive: the server's.
        seconds: allowed time, in addition to that of its bytes on a slow line.
    """

    def __init__(self, receive: Receive, seconds: float) -> None:
        self._receive, self._seconds = receive, seconds
        self._begun_s = time.monotonic()
        self._read = 0
        self._whole = False
        self.most = 0

    @property
    def too_large(self) -> Refused:
        """Refusal of a body that is larger than its route allows."""
        return Refused(f"The request is larger than {self.most} bytes.", 413)

    async def receive(self) -> Mapping[str, Any]:
        """Pass on the next message.

        Raises:
            Refused: more than allowed, or not received in time.
        """
        message = await self._next()
        if self._read > self.most:
            raise self.too_large
        return message

    async def read_away(self) -> None:
        """Read on for a while and discard.

        Closing a connection with unread bytes resets it, and the other side never sees the answer.
        """
        enough = self._read + _READ_AWAY_BYTES
        with suppress(Refused):
            while not self._whole and self._read < enough:
                await self._next()

    async def _next(self) -> Mapping[str, Any]:
        if self._whole:
            return await self._receive()  # waits until the other side has closed
        left_s = self._begun_s + self._seconds + self._read / _BYTES_PER_S - time.monotonic()
        try:
            message = await asyncio.wait_for(self._receive(), max(left_s, 0.0))
        except TimeoutError:
            raise Refused("The request came too slowly. Try again on a better line.", 408) from None
        self._read += len(message.get("body", b""))
        self._whole = not message.get("more_body", False)
        return message
