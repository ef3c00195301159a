"""The process of one task: ``python -m mammometry.batch.child``.

A Dask worker starts it. It reads its order from standard input and says on standard output, in JSON lines, how far it
is and what came of it. Its input stays open as long as its worker lives: when that ends, the process ends, and nothing
goes on unseen.
"""

from __future__ import annotations

import json
import os
import pickle
import sys
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, BinaryIO, TextIO

from mammometry.base.each import Tell
from mammometry.base.errors import MammometryError

_SAY_S = 1.0  # between two words on one stage: tables of many sessions are looked at, not read
_DEFECT = 70
"""Exit code of a defect, as of the command line."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Order:
    """What to do: a function of some module, called with ``(tell, *arguments)``.

    It returns plain JSON data.
    """

    function: Callable[..., Any]
    arguments: tuple[Any, ...]


def main() -> None:
    """Run one order and exit with code 0. An error is part of the answer."""
    answers = os.fdopen(os.dup(1), "w", buffering=1, encoding="utf-8")
    os.dup2(2, 1)  # what libraries print is no answer
    orders = sys.stdin.buffer
    answer: dict[str, Any]
    try:
        order: Order = pickle.load(orders)
        threading.Thread(target=_end_with, args=(orders,), daemon=True).start()
        answer = {"done": order.function(_teller(answers), *order.arguments)}
    except MammometryError as error:
        answer = {"failed": str(error), "kind": type(error).__name__, "exit_code": error.exit_code}
    except MemoryError:
        answer = {"killed": "it asked for more memory than there was"}
    except Exception as error:
        import traceback

        traceback.print_exc()
        first = str(error).partition("\n")[0]
        said = f"A defect in mammometry: {type(error).__name__}: {first}. Run this session alone, with -v."
        answer = {"failed": said, "kind": "Defect", "exit_code": _DEFECT}
    from mammometry.base.machine.memory import peak_memory_mb

    answers.write(json.dumps(answer | {"memory_mb": peak_memory_mb()}) + "\n")
    answers.flush()
    os._exit(0)  # a thread still reads


def _end_with(pipe: BinaryIO) -> None:
    """End this process when its worker is gone. Results are written so that this is safe at any moment."""
    pipe.read()
    os._exit(1)


def _teller(answers: TextIO) -> Tell:
    """Report a stage and its fraction done, at most once a second."""
    said = {"": 0.0}
    lock = threading.Lock()

    def tell(stage: str, fraction: float) -> None:
        now = time.monotonic()
        with lock:
            if now - said.get(stage, -_SAY_S) < _SAY_S:
                return
            said[stage] = now
            answers.write(json.dumps({"stage": stage, "fraction": round(fraction, 3)}) + "\n")

    return tell


if __name__ == "__main__":
    main()
