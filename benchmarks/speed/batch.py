"""What a batch costs beside the measuring itself, and how well it keeps machines busy.

    python -m benchmarks.speed.batch --sessions 2 --out build/batch
    python -m benchmarks.speed.batch --current 10000 --out build/batch
    python -m benchmarks.speed.batch --simulated 64 1000

--sessions N: N copies of a small virtual session, measured one by one by `mammometry run`, then by a batch on one and
on two cores. Wall time on a machine that others use is no measure, so beside the ratio of wall times stands the ratio
that two free cores would give: sessions at work at the same time, on average, times processor seconds a session alone
over those in company.
--current N: time of a batch over N sessions that are all current: links to one measured session, so their files lie in
the system's cache.
--simulated N…: N workers of `benchmarks.speed.crowd`.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import shutil
import subprocess
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from benchmarks.speed.crowd import share_busy
from mammometry.batch import record
from mammometry.settings import Settings
from mammometry.simulate.recipe import SessionRecipe
from mammometry.simulate.session import write_session

_RECIPE = SessionRecipe(rig="reference:front", subject="plaster_2", scale=0.1, poses=8)
_SETTINGS = "[surface.extract]\ncube_mm = 1.0\n"  # coarse, so that a session takes seconds (coarser ones lose the rim)
_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS", "MAMMOMETRY_CORES")
_RATE = 12.0  # tasks that end in a second: what one process with all simulated workers keeps up with


@dataclass(frozen=True, slots=True, kw_only=True)
class Took:
    """Time of a command."""

    wall_s: float
    processor_s: float
    """Of the command and of all processes that it started."""
    at_work_s: float = 0.0
    """Sum of the sessions' own wall times; of a batch."""
    busy_s: float = 0.0
    """From the first session's begin to the last one's end; of a batch."""


def command(arguments: Sequence[str]) -> Took:
    """Run mammometry on one thread a process, and take the time of it and of all that it starts."""
    before, begun = resource.getrusage(resource.RUSAGE_CHILDREN), time.monotonic()
    process = subprocess.Popen(
        [sys.executable, "-m", "mammometry", *arguments, "--json"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=os.environ | dict.fromkeys(_THREADS, "1"),
    )
    assert process.stdout is not None
    began: dict[str, float] = {}
    ended: dict[str, float] = {}
    for line in process.stdout:
        said = json.loads(line) if line.startswith('{"event"') else {}
        if said.get("event") == "stage":
            began.setdefault(said["session"], time.monotonic())
        elif said.get("event") == "ended":
            ended[said["session"]] = time.monotonic()
    _, complaints = process.communicate()
    wall, after = time.monotonic() - begun, resource.getrusage(resource.RUSAGE_CHILDREN)
    if process.returncode:
        raise SystemExit(complaints)
    return Took(
        wall_s=wall,
        processor_s=after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime,
        at_work_s=sum(ended[name] - began[name] for name in ended),
        busy_s=max(ended.values()) - min(began.values()) if ended else 0.0,
    )


def prepared(out: Path) -> tuple[Path, Path]:
    """A small session that a batch has measured, and the settings, unless they are there."""
    session, settings = out / "made" / "session", out / "settings.toml"
    out.mkdir(parents=True, exist_ok=True)
    settings.write_text(_SETTINGS)
    if not (session / "session.toml").is_file():
        write_session(session, _RECIPE)
    command(["batch", str(session), "--settings", str(settings), "--out", str(out / "first")])
    return session, settings


def throughput(out: Path, count: int) -> str:
    """Markdown: `count` sessions by `run`, and by a batch on one and on two cores."""
    session, settings = prepared(out)
    runs = {}
    for name in ("warm", "run", "one", "two"):
        folder = out / name
        shutil.rmtree(folder, ignore_errors=True)
        for number in range(1 if name == "warm" else count):
            shutil.copytree(session, folder / f"{number:03d}", ignore=shutil.ignore_patterns("results", "truth"))
    command(["run", str(out / "warm" / "000"), "--settings", str(settings)])  # kernels are compiled
    alone = [command(["run", str(out / "run" / f"{n:03d}"), "--settings", str(settings)]) for n in range(count)]
    runs["run"] = Took(wall_s=sum(each.wall_s for each in alone), processor_s=sum(each.processor_s for each in alone))
    for name, cores in (("one", 1), ("two", 2)):
        # The measured session goes along: from its record the batch knows how much memory the others need.
        places = [str(session), str(out / name)]
        runs[name] = command(
            ["batch", *places, "--settings", str(settings), "--out", str(out / f"{name}-out"), "--at-once", str(cores)]
        )
    lines = [
        "| | wall s | processor s | a session: wall s | processor s | sessions at work at once |",
        "| --- | --- | --- | --- | --- | --- |",
    ]
    words = {"run": f"{count} times `mammometry run`", "one": "batch, one core", "two": "batch, two cores"}
    for name, took in runs.items():
        together = f"{took.at_work_s / took.busy_s:.2f}" if took.busy_s else "1"
        each = f"{took.wall_s / count:.1f} | {took.processor_s / count:.1f}"
        lines.append(f"| {words[name]} | {took.wall_s:.1f} | {took.processor_s:.1f} | {each} | {together} |")
    one, two, run = runs["one"], runs["two"], runs["run"]
    at_once = two.at_work_s / two.busy_s / (one.at_work_s / one.busy_s)
    free = at_once * one.processor_s / two.processor_s
    lines += [
        "",
        f"Two cores to one: {one.busy_s / two.busy_s:.2f} by wall time; {free:.2f} where both cores are free.",
        f"Overhead of a batch on one core: {(one.processor_s - run.processor_s) / count:+.2f} processor s and "
        f"{(one.wall_s - run.wall_s) / count:+.2f} wall s a session, all of the command counted; "
        f"{(one.busy_s - run.wall_s) / count:+.2f} wall s without its beginning and end.",
    ]
    return "\n".join(lines)


def current(out: Path, count: int) -> str:
    """Time of a batch of `count` sessions that are current."""
    session, settings = prepared(out)
    folder = out / "current"
    key = record.key_of(Settings.from_toml(_SETTINGS))
    for number in range(count):
        if not (folder / f"{number:06d}" / "results" / record.RECORD).exists():
            shutil.rmtree(folder / f"{number:06d}", ignore_errors=True)
            shutil.copytree(session, folder / f"{number:06d}", copy_function=os.link)
    files = len(record.stats_of(folder / "000000"))
    if record.look_up(folder / f"{count - 1:06d}", key)[1] is not True:
        raise SystemExit(f"the copies are not current: remove {folder}")
    began = time.monotonic()
    for number in range(count):
        record.look_up(folder / f"{number:06d}", key)
    looked = time.monotonic() - began
    took = command(["batch", str(folder), "--settings", str(settings), "--out", str(out / "current-out")])
    size = (out / "current-out" / "batch.html").stat().st_size / 1e6
    return (
        f"{count} current sessions of {files} files: {took.wall_s:.1f} s ({took.processor_s:.1f} processor s). "
        f"Looking at them one by one takes {looked:.1f} s of it. The page has {size:.1f} MB."
    )


def simulated(counts: Sequence[int], cores: int, each: int, rate: float) -> str:
    """Markdown: a row for each number of simulated workers."""
    lines = [
        "| workers × cores | tasks, mean s | all at work after s | ideal s, took s | busy %, until the last one begins "
        "| by tenths of the time % | scheduler: MB after 1, 25, 50, 75, 100 % | ms a task | failed |",
        "| --- | --- | --- | --- | --- | --- | --- | --- | --- |",
    ]
    for count in counts:
        found = share_busy(count, cores, each, rate)
        memory = ", ".join(f"{found[f'mb_{part}']:.0f}" for part in (1, 25, 50, 75, 100))
        tenths = " ".join(f"{100 * part:.0f}" for part in found["busy_by_tenth"])
        busy = f"{100 * found['busy']:.1f}, {100 * found['busy_until_last_began']:.1f}"
        lines.append(
            f"| {count} × {cores} | {found['tasks']}, {found['mean_s']:.1f} | {found['filled_after_s']:.1f} | "
            f"{found['asked_s']:.0f}, {found['took_s']:.0f} | {busy} | {tenths} | {memory} | "
            f"{found['scheduler_cpu_ms_a_task']:.1f} | {found['failed']} |"
        )
        print(lines[-1], file=sys.stderr, flush=True)
    return "\n".join(lines)


def main() -> None:
    """Measure and print tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("build/batch"))
    parser.add_argument("--sessions", type=int, metavar="N", help="small sessions that are measured")
    parser.add_argument("--current", type=int, metavar="N", help="sessions that are current")
    parser.add_argument("--simulated", type=int, nargs="+", metavar="N", help="simulated workers")
    parser.add_argument("--cores", type=int, default=2, help="of each simulated worker")
    parser.add_argument("--each", type=int, default=6, help="tasks for each core of simulated workers")
    parser.add_argument("--rate", type=float, default=_RATE, help="simulated tasks that end in a second")
    options = parser.parse_args()
    tables = []
    if options.sessions:
        tables.append(throughput(options.out, options.sessions))
    if options.current:
        tables.append(current(options.out, options.current))
    if options.simulated:
        tables.append(simulated(options.simulated, options.cores, options.each, options.rate))
    print(f"{len(os.sched_getaffinity(0))} cores\n\n" + "\n\n".join(tables))


if __name__ == "__main__":
    main()
