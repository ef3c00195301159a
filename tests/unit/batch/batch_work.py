"""What the tests have tasks do: functions that a process of its own can import."""

import os
import signal
import time
from pathlib import Path

from mammometry.base.errors import MeasureError


def square(progress, number):
    progress("count", 0.5)
    return number**2


def fail(progress, number):
    raise MeasureError("left", found=f"{number}", expected="another number", remedy="Choose one")


def stumble(progress):
    raise RuntimeError("first line\nsecond line")


def die(progress, notes):
    """End as by the system's want of memory, and note that it was tried."""
    with Path(notes).open("a") as file:
        file.write("tried\n")
    os.kill(os.getpid(), signal.SIGKILL)


def die_once(progress, notes):
    if not Path(notes).exists():
        Path(notes).write_text("died")
        os.kill(os.getpid(), signal.SIGKILL)
    return "lived"


def swell(progress, megabytes, notes):
    with Path(notes).open("a") as file:
        file.write("tried\n")
    held = bytearray(megabytes << 20)
    held[::4096] = b"1" * len(held[::4096])
    time.sleep(30)
    return len(held)


def wait(progress, seconds, notes):
    """Take its time; note beginning and end."""
    with Path(notes).open("a") as file:
        file.write("began\n")
    progress("wait", 0.1)
    time.sleep(seconds)
    with Path(notes).open("a") as file:
        file.write("ended\n")
    return seconds


def environment(progress, names):
    return {name: os.environ.get(name) for name in names}
