"""Where a session's time goes: each stage's functions as a flame graph, and its memory over time.

    pip install py-spy
    python -m benchmarks.speed.where SESSION --out build/where

Copies the session, forgets the results of each stage in turn and makes them again in a process of its own, which py-spy
looks into a hundred times a second, compiled code included as its caller. Memory is the process's, ten times a second.
Kernels are compiled before. Shares of time say the same on a loaded machine; seconds do not, so processor seconds stand
beside the wall's.
"""

from __future__ import annotations

import argparse
import json
import shutil
import subprocess
import sys
import threading
import time
from collections import defaultdict
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import psutil

from benchmarks.speed.reference import beside
from mammometry.job.products import Stage

STAGES: tuple[Stage, ...] = ("match", "surface", "measure")
_RATE = 100  # samples a second
_MEMORY_S = 0.1  # between two looks at the memory
_ROWS = 12  # functions listed for each stage
_LEAST = 0.004  # of a stage's samples, below which a frame is not drawn
_DEEPEST = 40  # frames drawn one below the other
_LINE = 300  # characters that fit across the picture
_HANDED_ON = (
    "job/graph",
    "job/stages",
    "io/results/store",
    "api/job",
    "benchmarks",
)  # call the stages, and take nothing themselves


@dataclass
class Frame:
    """A function as it was called from another, with all samples below it."""

    samples: int = 0
    below: dict[str, Frame] = field(default_factory=dict)


def stacks(raw: str) -> list[tuple[list[str], int]]:
    """Read py-spy's raw format: ``outer;inner;… count``, our own functions only."""
    found = []
    for line in raw.splitlines():
        names, _, count = line.rpartition(" ")
        ours = [_short(name) for name in names.split(";") if "/mammometry/" in name]
        ours = [name for name in ours if not name.startswith(_HANDED_ON)] or ours[-1:]
        if ours:
            found.append((ours, int(count)))
    return found


def _short(name: str) -> str:
    """``part (…/mammometry/measure/wall/open_breast.py)`` as ``measure/wall/open_breast: part``."""
    function, _, path = name.partition(" (")
    return f"{path.rpartition('mammometry/')[2].partition('.py')[0]}: {function}"


def tree(samples: Iterable[tuple[list[str], int]]) -> Frame:
    """All stacks laid on one another."""
    root = Frame()
    for names, count in samples:
        here = root
        here.samples += count
        for name in names:
            here = here.below.setdefault(name, Frame())
            here.samples += count
    return root


def shares(samples: Iterable[tuple[list[str], int]]) -> list[tuple[str, float, float]]:
    """Functions by the share of the samples that they themselves took, with what they called beside it."""
    own, whole, total = defaultdict[str, int](int), defaultdict[str, int](int), 0
    for names, count in samples:
        total += count
        own[names[-1]] += count
        for name in set(names):
            whole[name] += count
    most = sorted(own, key=lambda name: -own[name])[:_ROWS]
    return [(name, own[name] / total, whole[name] / total) for name in most]


def make_stage(session: Path, stage: Stage, out: Path) -> None:
    """Make one stage's results, and write what it took: in a process of its own."""
    import mammometry as mm

    job, process, memory, done = mm.open_session(session), psutil.Process(), list[tuple[float, float]](), False
    wall, processor = time.monotonic(), time.process_time()

    def watch() -> None:
        while not done:
            memory.append((time.monotonic() - wall, process.memory_info().rss / 2**20))
            time.sleep(_MEMORY_S)

    watcher = threading.Thread(target=watch, daemon=True)
    watcher.start()
    job.ensure(stage)
    done = True
    watcher.join()
    took = {"wall_s": time.monotonic() - wall, "processor_s": time.process_time() - processor, "memory_mb": memory}
    out.write_text(json.dumps(took))


def looked_into(session: Path, stage: Stage, out: Path) -> tuple[list[tuple[list[str], int]], dict[str, Any]]:
    """Make a stage's results again under py-spy."""
    shutil.rmtree(session / "results" / stage, ignore_errors=True)
    raw, took = out / f"{stage}.txt", out / f"{stage}.json"
    command = ["py-spy", "record", "--format", "raw", "--function", "--full-filenames", "--rate", str(_RATE)]
    inner = [sys.executable, "-m", "benchmarks.speed.where", str(session), "--stage", stage, "--out", str(took)]
    done = subprocess.run([*command, "--output", str(raw), "--", *inner], capture_output=True, text=True, check=False)
    if done.returncode or not took.is_file():
        raise SystemExit(done.stderr.strip() or done.stdout.strip())
    return stacks(raw.read_text(encoding="utf-8")), json.loads(took.read_text())


def draw(roots: dict[str, Frame], path: Path) -> None:
    """Flame graphs, hanging: callers above, width for time, a colour for each package."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(14, 4.2 * len(roots)), layout="constrained")
    for axes, (stage, root) in zip(figure.subplots(len(roots), squeeze=False)[:, 0], roots.items(), strict=True):
        for left, depth, width, name in boxes(root):
            colour = f"C{sum(name.partition('/')[0].encode()) % 10}"
            axes.barh(-depth, width, left=left, height=0.94, color=colour, alpha=0.55, edgecolor="white", linewidth=0.4)
            words = name.rpartition("/")[2]
            if width * _LINE > len(words):
                axes.text(left + width / 2, -depth, words, ha="center", va="center", fontsize=5.5, clip_on=True)
        axes.set(xlim=(0, 1), yticks=[], xlabel="share of the stage's time")
        axes.set_title(stage, loc="left")
        axes.spines[["top", "left", "right"]].set_visible(False)
    figure.savefig(path, dpi=110)


def boxes(root: Frame) -> Iterator[tuple[float, int, float, str]]:
    """Left edge, depth, width and name of each frame that is wide enough to see."""
    waiting = [(root, 0.0, 0)]
    while waiting:
        frame, left, depth = waiting.pop()
        for name, one in sorted(frame.below.items(), key=lambda item: -item[1].samples):
            width = one.samples / root.samples
            if width >= _LEAST and depth < _DEEPEST:
                yield left, depth, width, name
                waiting.append((one, left, depth + 1))
            left += width


def draw_memory(took: dict[str, dict[str, Any]], path: Path) -> None:
    """Memory of each stage over its time."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9, 3.2), layout="constrained")
    axes = figure.subplots()
    for stage, one in took.items():
        axes.plot(*zip(*one["memory_mb"], strict=True), label=stage)
    axes.set(xlabel="s", ylabel="memory, MB", ylim=(0, None))
    axes.legend(frameon=False)
    figure.savefig(path, dpi=110)


def main() -> None:
    """Run, print the tables, draw the pictures."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("session", type=Path, help="with results up to the calibration, or ready-made cameras")
    parser.add_argument("--out", type=Path, default=Path("build/where"))
    parser.add_argument("--stage", choices=STAGES, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.stage:
        make_stage(arguments.session, arguments.stage, arguments.out)
        return
    session = arguments.out / "session"
    shutil.rmtree(arguments.out, ignore_errors=True)
    shutil.copytree(arguments.session, session)
    roots, took = dict[str, Frame](), dict[str, dict[str, Any]]()
    for stage in STAGES:
        with beside() as reference:
            samples, took[stage] = looked_into(session, stage, arguments.out)
        roots[stage] = tree(samples)
        seconds = f"{took[stage]['wall_s']:.1f} s, {took[stage]['processor_s']:.1f} processor s"
        print(f"\n{stage}: {seconds}, at most {max(mb for _, mb in took[stage]['memory_mb']):.0f} MB\n")
        print(f"{reference}\n")
        print("| function | itself % | with what it calls % |\n| --- | --- | --- |")
        for name, own, whole in shares(samples):
            print(f"| `{name}` | {100 * own:.1f} | {100 * whole:.1f} |", flush=True)
    draw(roots, arguments.out / "flames.png")
    draw_memory(took, arguments.out / "memory.png")


if __name__ == "__main__":
    main()
