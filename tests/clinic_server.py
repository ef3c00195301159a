"""A clinic's server in a process of its own, as people run it."""

import http.client
import json
import os
import signal
import socket
import ssl
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path


def command(*arguments: str, timeout_s: float = 120) -> dict[str, object]:
    """Run ``mammometry clinic …`` in a process of its own; its answer."""
    words = [sys.executable, "-m", "mammometry", "clinic", *arguments, "--json"]
    done = subprocess.run(words, capture_output=True, text=True, timeout=timeout_s, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    answer: dict[str, object] = json.loads(done.stdout)
    return answer


def free_port() -> int:
    """A port that nobody listens on now."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


@contextmanager
def served(folder: Path, *options: str) -> Iterator[tuple[str, "subprocess.Popen[bytes]"]]:
    """Address and process of a clinic's server; it is ended afterwards, if it still runs."""
    port = free_port()
    words = [sys.executable, "-m", "mammometry", "clinic", "serve", str(folder), "--address", f"127.0.0.1:{port}"]
    said = folder.parent / f"server-{port}.txt"
    with said.open("wb") as file:
        process = subprocess.Popen([*words, *options], stdout=file, stderr=file, start_new_session=True)
    try:
        _await(port, process, said, tls="--tls-certificate" in options)
        yield f"127.0.0.1:{port}", process
    finally:
        if process.poll() is None:
            os.kill(process.pid, signal.SIGTERM)
            try:
                process.wait(20)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()


def _await(port: int, process: "subprocess.Popen[bytes]", said: Path, tls: bool) -> None:
    end = time.monotonic() + 60
    while time.monotonic() < end:
        assert process.poll() is None, said.read_text()
        try:
            if tls:
                context = ssl._create_unverified_context()
                connection: http.client.HTTPConnection = http.client.HTTPSConnection(
                    "127.0.0.1", port, timeout=5, context=context
                )
            else:
                connection = http.client.HTTPConnection("127.0.0.1", port, timeout=5)
            with closing(connection):
                connection.request("GET", "/alive/")
                if connection.getresponse().status == 200:
                    return
        except OSError:
            pass
        time.sleep(0.1)
    raise AssertionError(f"the server did not answer: {said.read_text()}")
