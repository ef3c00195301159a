"""Call functions in a child process: to draw figures during a run, or for each session of a batch.

Python computes in only one thread at a time, and some libraries never free their memory. The child reads pickled calls
from its standard input, and writes pickled messages: the progress of a call, then its result. It ends when its parent
ends, because its standard input is then closed. Results are written atomically, so the child may end at any time.
"""

from __future__ import annotations

import os
import pickle
import queue
import subprocess
import sys
import threading
import time
import traceback
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from types import TracebackType
from typing import IO, Any, Self, TypeVar

from mammometry.base.errors import MammometryError
from mammometry.base.machine.cores import CORES
from mammometry.base.machine.system import own_group, peak_memory_mb, reuse_freed_memory
from mammometry.base.progress import Progress, StageProgress, no_progress, ticking

_R = TypeVar("_R")
_DEFECT = 70
"""Exit code for a defect of the program, as on the command line."""
_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS", "OPENCV_FOR_THREADS_NUM")


@dataclass(frozen=True, slots=True, kw_only=True)
class Call:
    """A function of a module and its arguments, all of which can be pickled.

    Not a `value`, because the function may change its arguments.
    """

    function: Callable[..., Any]
    arguments: tuple[Any, ...]


class CallError(Exception):
    """The call failed. The text is the reason."""


class CallCancelledError(CallError):
    """The `with` block has ended and the result is no longer needed."""


class ChildProcess:
    """A process that calls functions, one after another.

    It runs as long as the `with` block and is killed at its end, even during a call. It ignores Ctrl-C, which the
    parent handles.

    Args:
        cores: number of cores that the child may use.
        errors: file for its standard error. None: that of this process.
    """

    def __init__(self, *, cores: int = 1, errors: IO[bytes] | None = None) -> None:
        self._cores, self._errors = cores, errors
        self._lock = threading.Lock()
        self._ended = False

    def __enter__(self) -> Self:
        limits = dict.fromkeys((*_THREADS, CORES), str(self._cores))
        self.process: subprocess.Popen[bytes] = subprocess.Popen(
            [sys.executable, "-P", "-m", "mammometry.base.child_process"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._errors,
            env=os.environ | limits | {"PYTHONPATH": os.pathsep.join(sys.path)},  # for the same modules
            **own_group(),
        )
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, where: TracebackType | None
    ) -> None:
        self._ended = True
        self.process.kill()
        self.process.wait()
        for pipe in (self.process.stdin, self.process.stdout):
            assert pipe is not None
            with suppress(OSError):  # the child does not read any more
                pipe.close()

    def call(self, function: Callable[..., _R], *arguments: Any) -> _R:
        """Call a function in the child and return its result.

        Raises:
            CallError: the function raised an error, or the process has died.
            CallCancelledError: the block has ended.
        """
        answer = self.answer(Call(function=function, arguments=arguments))
        if "done" not in answer:
            raise CallError(answer["why"])
        result: _R = answer["done"]
        return result

    def answer(self, call: Call, progress: StageProgress | None = None, every_s: float = 1.0) -> dict[str, Any]:
        """Make a call and wait for its outcome.

        Args:
            call: the call.
            progress: called for each new stage at once, and for the current one every `every_s` seconds, even if the
                function reports nothing. The function then gets a `StageProgress` as its first argument.
            every_s: interval, s.

        Returns:
            ``done`` with the function's result; or ``failed``, ``kind``, ``code`` and ``exit_code`` of its error;
            or ``killed`` with ``why`` if memory ran out. Always includes ``memory_mb``, the child's peak.

        Raises:
            CallError: the process has died.
            CallCancelledError: the block has ended.
        """
        calls, messages = self.process.stdin, self.process.stdout
        assert calls is not None
        assert messages is not None
        with self._lock:
            try:
                # Pickled twice, so that the message can be read even if the call in it cannot be unpickled.
                order = pickle.dumps((call, None if progress is None else every_s), protocol=pickle.HIGHEST_PROTOCOL)
                pickle.dump(order, calls)
                calls.flush()
                while isinstance(message := pickle.load(messages), tuple):
                    if progress is not None:
                        progress(*message)
            except (OSError, ValueError, EOFError, pickle.UnpicklingError) as error:
                lost = CallCancelledError if self._ended else CallError
                raise lost(f"the child process has died ({type(error).__name__})") from None
        answer: dict[str, Any] = message
        return answer


def main() -> None:
    """Make the calls that arrive on standard input until it is closed."""
    reuse_freed_memory()
    messages = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # libraries must not write between the messages
    orders: queue.SimpleQueue[bytes] = queue.SimpleQueue()
    threading.Thread(target=_read, args=(sys.stdin.buffer, orders), daemon=True).start()
    lock = threading.Lock()

    def send(message: object) -> None:
        with lock:
            pickle.dump(message, messages, protocol=pickle.HIGHEST_PROTOCOL)
            messages.flush()

    while True:
        send(_answer(orders.get(), send))


def _answer(order: bytes, send: Callable[[object], None]) -> dict[str, Any]:
    answer: dict[str, Any]
    try:
        call, every_s = pickle.loads(order)
        if every_s is None:
            answer = {"done": call.function(*call.arguments)}
        else:
            with _reporting(send, every_s) as report:
                answer = {"done": call.function(report, *call.arguments)}
    except MammometryError as error:
        answer = {"failed": str(error), "kind": error.kind, "code": error.code}
        answer |= {"exit_code": error.exit_code, "why": str(error)}
    except MemoryError:
        why = "it ran out of memory"
        answer = {"killed": why, "why": why}
    except Exception as error:
        text = str(error).partition("\n")[0]
        defect = f"A defect in mammometry: {type(error).__name__}: {text}. Run this session alone, with -v."
        answer = {"failed": defect, "kind": "Defect", "exit_code": _DEFECT, "why": traceback.format_exc()}
    return answer | {"memory_mb": peak_memory_mb()}


@contextmanager
def _reporting(send: Callable[[object], None], every_s: float) -> Iterator[StageProgress]:
    """Send each new stage at once, and the current one every `every_s` seconds."""
    sent: dict[str, float] = {}
    lock, current = threading.Lock(), ""
    report_current: Progress = no_progress

    def send_in_time(stage: str, fraction: float) -> None:
        now = time.monotonic()
        if now - sent.get(stage, -every_s) >= every_s:
            sent[stage] = now
            send((stage, round(fraction, 3)))

    def report(stage: str, fraction: float) -> None:
        nonlocal current, report_current
        with lock:
            if stage != current or fraction == 0:  # a new stage, or a new part of the same one
                current = stage
                ticker.close()
                report_current = ticker.enter_context(ticking(partial(send_in_time, stage), tick_s=every_s / 4))
            report_current(fraction)

    with ExitStack() as ticker:
        yield report


def _read(pipe: IO[bytes], orders: queue.SimpleQueue[bytes]) -> None:
    """Read calls, and end this process when its parent ends."""
    try:
        while True:
            orders.put(pickle.load(pipe))
    finally:
        os._exit(0)


if __name__ == "__main__":
    main()
