"""Limits of requests.

How much an address may ask for, and how large a request may be.

Django reads a request's whole body before it knows whom it is from, so the body is counted here, against what the table
of routes grants for its path.
"""

from __future__ import annotations

import time
from collections.abc import Awaitable, Callable, Mapping, MutableMapping
from typing import Any

from django.urls import Resolver404, resolve

from mammometry.clinic.access import BODY_BYTES
from mammometry.clinic.config import Limits

Scope = MutableMapping[str, Any]
Receive = Callable[[], Awaitable[Mapping[str, Any]]]
Send = Callable[[Mapping[str, Any]], Awaitable[None]]
_BURST_S = 10.0  # seconds' worth of requests that may come at once
_ADDRESSES = 10_000  # remembered at most
_READ_AWAY_BYTES = 1024 * 1024  # of a refused body; who sends more sees a connection that ends
_PROXY_HEADERS = (b"x-forwarded-for", b"x-forwarded-port", b"x-forwarded-host", b"forwarded")
"""Anybody can send them. What a trusted proxy says is in the scope already, put there by the server."""


class TooLarge(Exception):
    """A body is longer than its route grants."""


class Limited:
    """An ASGI application behind limits.

    Args:
        application: what is behind them.
        limits: the clinic's.
        clock: seconds.
    """

    def __init__(self, application: Any, limits: Limits, clock: Callable[[], float] = time.monotonic) -> None:
        self._application = application
        self._rate = float(limits.requests_per_second)
        self._clock = clock
        self._spent: dict[str, tuple[float, float]] = {}

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer one request."""
        if scope["type"] != "http":
            return  # neither web sockets nor anything else
        scope["headers"] = [(name, value) for name, value in scope["headers"] if name not in _PROXY_HEADERS]
        if not self._may_ask((scope.get("client") or ("",))[0]):
            return await _refuse(send, 429, "Too many requests. Wait a few seconds.", retry_after_s=5)
        most = _granted(scope["path"])
        stated = dict(scope["headers"]).get(b"content-length", b"0")
        if not stated.isdigit() or int(stated) > most:
            await _read_away(receive)
            return await _refuse(send, 413, f"The request is larger than {most} bytes.")
        begun = False

        async def counted_send(message: Mapping[str, Any]) -> None:
            nonlocal begun
            begun = True
            await send(message)

        read = 0

        async def counted_receive() -> Mapping[str, Any]:
            nonlocal read
            message = await receive()
            read += len(message.get("body", b""))
            if read > most:
                raise TooLarge
            return message

        try:
            await self._application(scope, counted_receive, counted_send)
        except TooLarge:
            if not begun:
                await _read_away(receive)
                await _refuse(send, 413, f"The request is larger than {most} bytes.")
        return None

    def _may_ask(self, address: str) -> bool:
        """Whether an address may ask now, by a token bucket.

        It fills with time. Each request takes one.
        """
        now = self._clock()
        if len(self._spent) > _ADDRESSES:
            self._spent = {key: each for key, each in self._spent.items() if now - each[1] < _BURST_S}
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


async def _read_away(receive: Receive) -> None:
    """Read on for a while and keep nothing.

    Who closes a connection with unread bytes resets it, and the other side never sees the answer.
    """
    read = 0
    while read < _READ_AWAY_BYTES:
        message = await receive()
        read += len(message.get("body", b""))
        if not message.get("more_body", False):
            return


async def _refuse(send: Send, status: int, sentence: str, retry_after_s: int | None = None) -> None:
    body = sentence.encode()
    headers = [
        (b"content-type", b"text/plain; charset=utf-8"),
        (b"content-length", str(len(body)).encode()),
        (b"connection", b"close"),
        (b"x-content-type-options", b"nosniff"),
    ]
    if retry_after_s is not None:
        headers.append((b"retry-after", str(retry_after_s).encode()))
    await send({"type": "http.response.start", "status": status, "headers": headers})
    await send({"type": "http.response.body", "body": body})
