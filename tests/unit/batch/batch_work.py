"""What the tests have tasks do: functions that a process of its own can import."""

import os
import signal
import time
from pathlib import Path

from mammometry.base.errors import MeasureError


def square(tell, number):
    tell("count", 0.5)
    return number**2


def fail(tell, number):
    raise MeasureError("left", found=f"{number}", expected="another number", remedy="Choose one")


def stumble(tell):
    raise RuntimeError("first line\nsecond line")


def die(tell, notes):
    """End as by the system's want of memory, and note that it was tried."""
    with Path(notes).open("a") as file:
        file.write("tried\n")
    os.kill(os.getpid(), signal.SIGKILL)


def die_once(tell, notes):
    if not Path(notes).exists():
        Path(notes).write_text("died")
        os.kill(os.getpid(), signal.SIGKILL)
    return "lived"


def swell(tell, megabytes, notes):
    with Path(notes).open("a") as file:
        file.write("tried\n")
    held = bytearray(megabytes << 20)
    held[::4096] = b"1" * len(held[::4096])
    time.sleep(30)
    return len(held)


def wait(tell, seconds, notes):
    """Take its time; note beginning and end."""
    with Path(notes).open("a") as file:
        file.write("began\n")
    tell("wait", 0.1)
    time.sleep(seconds)
    with Path(notes).open("a") as file:
        file.write("ended\n")
    return seconds


def environment(tell, names):
    return {name: os.environ.get(name) for name in names}
