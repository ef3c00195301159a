"""The command line in a process of its own, one command after the other, each with what it said and its peak of memory.

    {"arguments": ["info", "SESSION"], "said": "FILE"}  →  {"code": 0, "peak_mb": 310.2}

In a process of its own a crash of a library, a loop without end or a bomb ends nobody else; started once, for the
imports take longer than most commands. What is said lands in the file.
"""

import json
import os
import re
import resource
import sys
from pathlib import Path

_MOST_BYTES = 16 << 30  # of addresses: a guard of the machine, not the limit that is tested


def peak_mb() -> float:
    """Largest resident memory since it was last forgotten."""
    found = re.search(r"VmHWM:\s+(\d+) kB", Path("/proc/self/status").read_text())
    assert found is not None
    return int(found[1]) / 1024


def serve() -> None:
    """Read orders from standard input until it ends."""
    resource.setrlimit(resource.RLIMIT_AS, (_MOST_BYTES, _MOST_BYTES))
    from mammometry.cli import main

    answers = os.fdopen(os.dup(1), "w")
    for line in sys.stdin:
        order = json.loads(line)
        said = os.open(order["said"], os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
        os.dup2(said, 1)
        os.dup2(said, 2)
        os.close(said)
        Path("/proc/self/clear_refs").write_text("5")  # forget the peak of memory
        main.hush_libraries()
        code = main.run(order["arguments"])
        sys.stdout.flush()
        sys.stderr.flush()
        answers.write(json.dumps({"code": code, "peak_mb": peak_mb()}) + "\n")
        answers.flush()


if __name__ == "__main__":
    serve()
