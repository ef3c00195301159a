"""Call functions in a child process: pictures beside a run, and each session of a batch.

Python computes in one thread at a time, and some libraries keep their memory for good. A child reads pickled calls
from its standard input and writes pickled messages: how far a call is, then what came of it. It ends with its parent,
however that ends: its standard input closes then. Results are written so that this is safe at any moment.
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
"""Exit code of a defect, as of the command line."""
_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS", "OPENCV_FOR_THREADS_NUM")


@dataclass(frozen=True, slots=True, kw_only=True)
class Call:
    """A function of some module, and the arguments that it is called with. All of it can be pickled.

    No `value`: the arguments are the function's own, to write to as well.
    """

    function: Callable[..., Any]
    arguments: tuple[Any, ...]


class NotDone(Exception):
    """The child could not do it. Its text says why."""


class Ended(NotDone):
    """The block has ended, and nobody waits for the result."""


class ChildProcess:
    """A process that calls functions, one after another.

    It begins with the block and ends with it, in the middle of a call if need be. Ctrl-C at the terminal is this
    process's to answer.

    Args:
        cores: that the child may take.
        errors: takes its standard error; None: this process's own.
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
            env=os.environ | limits | {"PYTHONPATH": os.pathsep.join(sys.path)},  # functions are found as here
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
            with suppress(OSError):  # what was not read there any more
                pipe.close()

    def call(self, function: Callable[..., _R], *arguments: Any) -> _R:
        """Call a function there, and wait for what it returns.

        Raises:
            NotDone: it raised something, or the process is gone.
            Ended: the block has ended meanwhile.
        """
        answer = self.answer(Call(function=function, arguments=arguments))
        if "done" not in answer:
            raise NotDone(answer["why"])
        result: _R = answer["done"]
        return result

    def answer(self, call: Call, progress: StageProgress | None = None, every_s: float = 1.0) -> dict[str, Any]:
        """Make a call, and wait for what came of it.

        Args:
            call: the call.
            progress: hears of each new stage at once, and of the current one about every so many seconds, also while
                the work reports nothing. The function is called with a `StageProgress` before the other arguments
                then.
            every_s: so many seconds.

        Returns:
            ``done`` with what the function returned; or ``failed``, ``kind``, ``code`` and ``exit_code`` of its error,
            or ``killed`` where memory was short, with ``why``. Always ``memory_mb``, the child's peak.

        Raises:
            NotDone: the process is gone.
            Ended: the block has ended meanwhile.
        """
        calls, messages = self.process.stdin, self.process.stdout
        assert calls is not None
        assert messages is not None
        with self._lock:
            try:
                # Pickled twice: whoever reads a call is not hindered by what is in it.
                order = pickle.dumps((call, None if progress is None else every_s), protocol=pickle.HIGHEST_PROTOCOL)
                pickle.dump(order, calls)
                calls.flush()
                while isinstance(message := pickle.load(messages), tuple):
                    if progress is not None:
                        progress(*message)
            except (OSError, ValueError, EOFError, pickle.UnpicklingError) as error:
                lost = Ended if self._ended else NotDone
                raise lost(f"the child process is gone ({type(error).__name__})") from None
        answer: dict[str, Any] = message
        return answer


def main() -> None:
    """Make the calls of standard input until it closes."""
    reuse_freed_memory()
    messages = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # what libraries print is no message
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
        why = "it asked for more memory than there was"
        answer = {"killed": why, "why": why}
    except Exception as error:
        text = str(error).partition("\n")[0]
        defect = f"A defect in mammometry: {type(error).__name__}: {text}. Run this session alone, with -v."
        answer = {"failed": defect, "kind": "Defect", "exit_code": _DEFECT, "why": traceback.format_exc()}
    return answer | {"memory_mb": peak_memory_mb()}


@contextmanager
def _reporting(send: Callable[[object], None], every_s: float) -> Iterator[StageProgress]:
    """Send stages and their fractions done: a new stage at once, the current one about every so many seconds."""
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
            if stage != current or fraction == 0:  # another piece of work begins
                current = stage
                ticker.close()
                report_current = ticker.enter_context(ticking(partial(send_in_time, stage), tick_s=every_s / 4))
            report_current(fraction)

    with ExitStack() as ticker:
        yield report


def _read(pipe: IO[bytes], orders: queue.SimpleQueue[bytes]) -> None:
    """Take calls, and end this process with its parent."""
    try:
        while True:
            orders.put(pickle.load(pipe))
    finally:
        os._exit(0)


if __name__ == "__main__":
    main()
