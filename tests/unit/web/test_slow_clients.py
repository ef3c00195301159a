"""Who sends nothing, or a byte now and then, is disconnected by the server of each local page."""

import socket
import time
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast
from urllib.parse import urlsplit

import pytest
from tests.local_server import dribbled, running

from mammometry.capture.page import Goal, capture_app
from mammometry.editor import server
from mammometry.web import local
from mammometry.web.local import OneTimeLogin, local_app

REQUEST_S = 0.6
BYTE_S = 0.1
HEAD = "GET /enter HTTP/1.1\r\nHost: {}\r\n"
POST = (
    "POST /enter HTTP/1.1\r\nHost: {0}\r\nOrigin: http://{0}\r\nContent-Type: application/json\r\n"
    "Content-Length: 1000\r\n\r\n"
)


@pytest.fixture(params=["edit", "capture"])
def address(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    """HOST:PORT of a page, as `listen` serves it but with a shorter limit."""
    monkeypatch.setattr(local, "REQUEST_S", REQUEST_S)
    login = OneTimeLogin()
    rig = SimpleNamespace(rigged=SimpleNamespace(file=SimpleNamespace(rig=SimpleNamespace(name="rig"))), look=None)
    monkeypatch.setattr(server, "EditorPage", lambda job, author: None)
    capture = capture_app(cast(Any, rig), Goal(session=Path("s")), login)
    app = capture if request.param == "capture" else server.editor_app(lambda: cast(Any, None), login)
    with running(app, request_s=REQUEST_S) as address:
        yield urlsplit(address).netloc


def test_a_slow_answer_is_waited_for_and_the_next_too() -> None:
    """The second request comes before the first is answered, so no byte follows it."""
    login = OneTimeLogin()

    def page(body: bytes) -> str:
        time.sleep(2 * REQUEST_S)
        return "page"

    app = local_app({"GET /": page}, login)
    with running(app, request_s=REQUEST_S) as address:
        netloc = urlsplit(address).netloc
        body = login.new_key().encode()
        head = f"Host: {netloc}\r\nOrigin: {address}\r\nContent-Type: application/json\r\n"
        with socket.create_connection(cast(Any, netloc.split(":")), timeout=10) as line:
            line.sendall(f"POST /enter HTTP/1.1\r\n{head}Content-Length: {len(body)}\r\n\r\n".encode() + body)
            cookie = line.recv(65536).split(b"set-cookie: ")[1].split(b";")[0].decode()
            line.sendall(f"GET / HTTP/1.1\r\nHost: {netloc}\r\nCookie: {cookie}\r\n\r\n".encode() * 2)
            passed, answer = dribbled(line, "", byte_s=1.0)
    assert answer.count(b"HTTP/1.1 200") == 2
    assert passed > 4 * REQUEST_S


@pytest.mark.requirement("R-SEC-4")
@pytest.mark.parametrize(
    ("at_once", "then", "status"),
    [
        ("", "", None),  # silent
        ("", HEAD + "X-Long: " + "a" * 100, None),
        (HEAD + "\r\n", HEAD + "X-Long: " + "a" * 100, 200),  # the second request
        (POST, "a" * 200, 408),
    ],
    ids=["silent", "head", "second-head", "body"],
)
def test_a_slow_client_is_disconnected(address: str, at_once: str, then: str, status: int | None) -> None:
    host, port = address.split(":")
    with socket.create_connection((host, int(port)), timeout=10) as line:
        line.sendall(at_once.format(address).encode())
        passed, answer = dribbled(line, then.format(address), BYTE_S)
    assert REQUEST_S / 2 < passed < REQUEST_S + 3
    assert (int(answer.split(b" ")[1]) if answer else None) == status
    assert answer.count(b"HTTP/1.1 ") == (0 if status is None else 1)
