"""Work in a second process, beside this one's.

Python computes in one thread at a time, and some libraries keep their memory for good. A second process does what can
be done beside, and ends with this one, however this one ends: its standard input closes then.
"""

from __future__ import annotations

import os
import pickle
import queue
import subprocess
import sys
import threading
import traceback
from collections.abc import Callable
from contextlib import suppress
from types import TracebackType
from typing import IO, Any, Self, TypeVar

from mammometry.base.machine.cores import CORES
from mammometry.base.machine.memory import return_freed_arrays

_R = TypeVar("_R")


class NotDone(Exception):
    """The second process could not do it. Its text says why."""


class Ended(NotDone):
    """The block has ended, and nobody waits for the result."""


class SecondProcess:
    """A process that calls functions, one after another.

    It begins with the block and ends with it, in the middle of a call if need be. Ctrl-C at the terminal is this
    process's to answer.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._ended = False

    def __enter__(self) -> Self:
        self._process = subprocess.Popen(
            [sys.executable, "-P", "-m", "mammometry.base.second_process"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            env=os.environ | {CORES: "1"},  # this process has the others
            start_new_session=True,
        )
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, where: TracebackType | None
    ) -> None:
        self._ended = True
        self._process.kill()
        self._process.wait()
        for pipe in (self._process.stdin, self._process.stdout):
            assert pipe is not None
            with suppress(OSError):  # what was not read there any more
                pipe.close()

    def call(self, function: Callable[..., _R], *arguments: Any) -> _R:
        """Call a function there, and wait for what it returns.

        The function is defined in a module. Arguments and result can be pickled.

        Raises:
            NotDone: it raised something, or the process is gone.
            Ended: the block has ended meanwhile.
        """
        orders, answers = self._process.stdin, self._process.stdout
        assert orders is not None
        assert answers is not None
        with self._lock:
            try:
                # Pickled twice: whoever reads an order is not hindered by what is in it.
                pickle.dump(pickle.dumps((function, arguments), protocol=pickle.HIGHEST_PROTOCOL), orders)
                orders.flush()
                done, answer = pickle.load(answers)
            except (OSError, ValueError, EOFError, pickle.UnpicklingError) as error:
                lost = Ended if self._ended else NotDone
                raise lost(f"the second process is gone ({type(error).__name__})") from None
        if not done:
            raise NotDone(answer)
        result: _R = answer
        return result


def main() -> None:
    """Do the orders of standard input until it closes."""
    return_freed_arrays()
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # what libraries print is no answer
    orders: queue.SimpleQueue[bytes] = queue.SimpleQueue()
    threading.Thread(target=_read, args=(sys.stdin.buffer, orders), daemon=True).start()
    while True:
        answer: tuple[bool, Any]
        try:
            function, arguments = pickle.loads(orders.get())
            answer = True, function(*arguments)
        except Exception:
            answer = False, traceback.format_exc()
        pickle.dump(answer, answers, protocol=pickle.HIGHEST_PROTOCOL)
        answers.flush()
        del answer


def _read(pipe: IO[bytes], orders: queue.SimpleQueue[bytes]) -> None:
    """Take orders, and end this process with the other one."""
    try:
        while True:
            orders.put(pickle.load(pipe))
    finally:
        os._exit(0)


if __name__ == "__main__":
    main()
