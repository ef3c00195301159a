"""Bodies that are too large and callers that ask too often are refused before Django reads anything."""

import asyncio
import json
import time
from collections.abc import Callable, Mapping
from typing import Any

import pytest
from django.conf import settings
from django.test import Client
from django.urls import reverse

from mammometry.clinic.config import ClinicConfig, RateLimits
from mammometry.clinic.roles import Role
from mammometry.clinic.web import requests
from mammometry.clinic.web.access import BODY_BYTES
from mammometry.clinic.web.requests import ClinicLimited
from mammometry.web.replies import Scope

Message = dict[str, Any]


class Inner:
    """Reads the whole body, as Django does, and remembers what it saw."""

    def __init__(self) -> None:
        self.bodies: list[int] = []
        self.headers: list[tuple[bytes, bytes]] = []

    async def __call__(self, scope: Scope, receive: Any, send: Any) -> None:
        read, more = 0, True
        while more:
            message = await receive()
            read += len(message.get("body", b""))
            more = message.get("more_body", False)
        self.bodies.append(read)
        self.headers = scope["headers"]
        await send({"type": "http.response.start", "status": 200, "headers": []})
        await send({"type": "http.response.body", "body": b""})


def ask(
    application: ClinicLimited,
    chunks: list[bytes],
    headers: list[tuple[bytes, bytes]] | None = None,
    client: str = "10.0.0.1",
    path: str = "/",
) -> int:
    """One request; its status."""
    waiting = [
        {"type": "http.request", "body": chunk, "more_body": number < len(chunks) - 1}
        for number, chunk in enumerate(chunks)
    ]
    sent: list[Message] = []

    async def receive() -> Message:
        return waiting.pop(0)

    async def send(message: Mapping[str, Any]) -> None:
        sent.append(dict(message))

    scope: Message = {"type": "http", "path": path, "headers": headers or [], "client": (client, 4711)}
    asyncio.run(application(scope, receive, send))
    return int(sent[0]["status"])


def limited(inner: Inner, per_second: int = 1000, clock: Any = lambda: 0.0) -> ClinicLimited:
    return ClinicLimited(inner, RateLimits(requests_per_second=per_second), clock=clock)


def test_a_body_up_to_the_limit_is_passed_on() -> None:
    inner = Inner()
    assert ask(limited(inner), [b"x" * (BODY_BYTES - 1), b"y"]) == 200
    assert inner.bodies == [BODY_BYTES]


def test_a_body_that_says_it_is_too_large_is_not_read() -> None:
    inner = Inner()
    assert ask(limited(inner), [b""], [(b"content-length", str(BODY_BYTES + 1).encode())]) == 413
    assert inner.bodies == []


@pytest.mark.requirement("R-SEC-4")
def test_a_body_in_pieces_is_stopped_at_the_limit() -> None:
    inner = Inner()
    assert ask(limited(inner), [b"x" * 1024] * (BODY_BYTES // 1024 + 5)) == 413
    assert inner.bodies == []


def test_large_bodies_are_read_from_people_who_are_logged_in_alone(
    shared_database: None, clinic: ClinicConfig, client_of: Callable[..., Client]
) -> None:
    """They are kept on the disk before anybody asks who sends them."""
    inner, path = Inner(), reverse("scan-new")
    chunks = [bytes(2 * BODY_BYTES)]
    cookies = client_of(Role.TECHNICIAN).cookies
    inside = "; ".join(f"{name}={each.value}" for name, each in cookies.items()).encode()
    name = settings.SESSION_COOKIE_NAME.encode()
    for cookie in (b"", b"a=b; ;=", name + b"=" + b"a" * 32, name + b"=\xff"):
        assert ask(limited(inner), chunks, [(b"cookie", cookie)], path=path) == 413
    assert ask(limited(inner), chunks, [(b"cookie", inside)], path=path) == 200
    assert inner.bodies == [2 * BODY_BYTES]


@pytest.mark.parametrize("length", [b"-1", b"1e3", b"0x10", b"", "٣".encode()])
def test_a_length_that_is_no_number_is_refused(length: bytes) -> None:
    assert ask(limited(Inner()), [b""], [(b"content-length", length)]) == 413


@pytest.mark.requirement("R-SEC-4")
def test_who_asks_too_often_waits_and_others_do_not() -> None:
    now = 0.0
    application = limited(Inner(), per_second=2, clock=lambda: now)
    assert [ask(application, [b""]) for _ in range(20)] == [200] * 20  # ten seconds' worth at once
    assert ask(application, [b""]) == 429
    assert ask(application, [b""], client="10.0.0.2") == 200
    now = 1.0
    assert [ask(application, [b""]) for _ in range(3)] == [200, 200, 429]


def test_a_caller_cannot_say_that_it_is_somebody_else() -> None:
    inner = Inner()
    ask(limited(inner), [b""], [(b"x-forwarded-for", b"1.2.3.4"), (b"x-forwarded-host", b"evil"), (b"accept", b"*/*")])
    assert inner.headers == [(b"accept", b"*/*")]


def test_what_is_remembered_of_callers_is_bounded() -> None:
    now = 0.0
    application = limited(Inner(), clock=lambda: now)
    for number in range(10_050):
        now += 0.01
        application._may_ask(f"10.{number}")
    assert len(application._spent) <= 10_001


def test_a_web_socket_is_not_answered() -> None:
    inner = Inner()
    asyncio.run(limited(inner)({"type": "websocket", "path": "/", "headers": []}, None, None))  # type: ignore[arg-type]
    assert inner.bodies == []


@pytest.mark.slow
def test_a_body_that_does_not_come_is_not_waited_for() -> None:
    inner = Inner()
    sent: list[Message] = []

    async def receive() -> Message:
        await asyncio.sleep(60)
        raise AssertionError

    async def send(message: Mapping[str, Any]) -> None:
        sent.append(dict(message))

    scope: Message = {"type": "http", "path": "/", "headers": [], "client": ("10.0.0.1", 4711)}
    application = ClinicLimited(inner, RateLimits(request_s=1))
    begun = time.monotonic()
    asyncio.run(application(scope, receive, send))
    assert sent[0]["status"] == 408
    assert time.monotonic() - begun < 10
    assert inner.bodies == []


@pytest.mark.slow
def test_a_large_body_has_longer_on_a_slow_line(monkeypatch: pytest.MonkeyPatch) -> None:
    """Ten pieces of 10 kB, one each 150 ms: longer than the second that a small one has."""
    inner = Inner()
    pieces = 10

    async def receive() -> Message:
        nonlocal pieces
        await asyncio.sleep(0.15)
        pieces -= 1
        return {"type": "http.request", "body": b"x" * 10_000, "more_body": pieces > 0}

    async def send(message: Mapping[str, Any]) -> None:
        pass

    monkeypatch.setattr(requests, "_granted", lambda path: 1_000_000)
    scope: Message = {"type": "http", "path": "/", "headers": [], "client": ("10.0.0.1", 4711)}
    asyncio.run(ClinicLimited(inner, RateLimits(request_s=1))(scope, receive, send))
    assert inner.bodies == [100_000]


def test_a_script_reads_why_it_was_refused() -> None:
    sent: list[Message] = []

    async def send(message: Mapping[str, Any]) -> None:
        sent.append(dict(message))

    async def receive() -> Message:
        return {"type": "http.request", "body": b"", "more_body": False}

    headers = [(b"accept", b"application/json"), (b"content-length", b"9" * 20)]
    scope: Message = {"type": "http", "path": "/", "headers": headers, "client": ("10.0.0.1", 4711)}
    asyncio.run(limited(Inner())(scope, receive, send))
    assert sent[0]["status"] == 413
    assert json.loads(sent[1]["body"])["error"]
