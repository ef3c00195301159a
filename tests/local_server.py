"""A local page's server in a thread, and a client that is slow."""

import asyncio
import socket
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager

import uvicorn

from mammometry.web.local import HOST
from mammometry.web.replies import Application
from mammometry.web.server import server as made_server


class _QuickServer(uvicorn.Server):
    """Ends when it is asked to. uvicorn's own looks ten times a second and then waits as long for its connections."""

    async def main_loop(self) -> None:
        await self.on_tick(0)
        while not self.should_exit:
            await asyncio.sleep(0.005)

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        for connection in list(self.server_state.connections):
            connection.shutdown()
        for server in self.servers:
            server.close()
        while self.server_state.tasks:  # each closes the file that holds its request
            await asyncio.sleep(0.005)


@contextmanager
def running(app: Application, request_s: float = 30.0) -> Iterator[str]:
    """The address of a page that really listens."""
    listener = socket.socket()
    listener.bind((HOST, 0))
    listener.listen()
    server = _QuickServer(made_server(app, request_s=request_s, log_level="error").config)
    thread = threading.Thread(target=server.run, kwargs={"sockets": [listener]}, daemon=True)
    thread.start()
    try:
        yield f"http://{HOST}:{listener.getsockname()[1]}"
    finally:
        server.should_exit = True
        thread.join(10)
        listener.close()


def dribbled(line: socket.socket, text: str, byte_s: float) -> tuple[float, bytes]:
    """Send a text byte by byte; the seconds until the server ended the connection, and its answer."""
    ended = threading.Event()

    def send() -> None:
        for letter in text.encode():
            if ended.wait(byte_s):
                return
            try:
                line.sendall(bytes([letter]))
            except OSError:
                return

    sender = threading.Thread(target=send)
    begun = time.monotonic()
    sender.start()
    answer = b""
    try:
        while more := line.recv(65536):
            answer += more
    except ConnectionError:
        pass
    passed = time.monotonic() - begun
    ended.set()
    sender.join()
    return passed, answer
