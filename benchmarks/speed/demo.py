"""Time of the first and second demo, of a run with nothing to do and of ``--help``.

    python -m benchmarks.speed.demo --out build/demo [--only first second run help]

Each is a process of its own. For the first one kernels are looked for in an empty folder, as on a fresh installation
from source. "references" are processor seconds over those of the reference work (`benchmarks.speed.reference`).
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import time
from pathlib import Path

from benchmarks.speed.reference import beside

_KINDS = ("first", "second", "run", "help")


def timed(kind: str, out: Path) -> tuple[float, float]:
    """Seconds by the clock and of the processor, children included."""
    session, kernels = out / "session", out / "kernels"
    environment = os.environ | {"NUMBA_CACHE_DIR": str(kernels)}
    if kind == "first":
        shutil.rmtree(kernels, ignore_errors=True)
    if kind in ("first", "second"):
        shutil.rmtree(session, ignore_errors=True)
    arguments = {"run": ["run", str(session), "--quiet"], "help": ["--help"]}.get(
        kind, ["demo", str(session), "--quiet"]
    )
    wall, before = time.monotonic(), os.times()
    subprocess.run(
        [sys.executable, "-m", "mammometry", *arguments], env=environment, check=True, stdout=subprocess.DEVNULL
    )
    after = os.times()
    processor = after.children_user + after.children_system - before.children_user - before.children_system
    return time.monotonic() - wall, processor


def main() -> None:
    """Print a table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("build/demo"))
    parser.add_argument("--only", choices=_KINDS, nargs="+", default=_KINDS)
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    print("| | wall s | processor s | references |\n| --- | --- | --- | --- |")
    for kind in arguments.only:
        with beside() as reference:
            wall, processor = timed(kind, arguments.out)
        print(f"| {kind} | {wall:.1f} | {processor:.1f} | {processor / reference.processor_s:.1f} |", flush=True)


if __name__ == "__main__":
    main()
