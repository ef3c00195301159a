"""Time and peak memory of every stage at four image sizes, and of every product of one session.

    python -m benchmarks.speed.whole_job --out build/speed
    python -m benchmarks.speed.whole_job SESSION --out build/speed

The first renders a capture of its own at 1/16, 1/4, all and 4 times the reference rig's pixels (a plaster breast;
`--scales` for others), with its true cameras for a calibration, and runs the job in a process of its own after a
warm-up at a small size. "Processor" counts all cores' seconds and all processes: on a machine that others use, too, it
is the steadier figure. Then `mammometry run` by itself, which calibrates nothing here, but draws beside and writes the
report. The growth exponent is the slope of log(time) over log(pixels): 1 where time is proportional to the pixels.

The second makes everything of a copy of the session anew, calibration and report included, and prints what each product
took. Products that are made side by side share the processor seconds and the memory that stand beside them. Then
`mammometry run` of that copy, nothing looked into.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import resource
import shutil
import subprocess
import sys
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import psutil

from benchmarks.speed.reference import beside
from mammometry.base.progress import Progress, no_progress
from mammometry.io.cameras.own import cameras_table
from mammometry.job.products import Key, Stage
from mammometry.simulate.recipe import SessionRecipe
from mammometry.simulate.session import write_session

SCALES = (0.25, 0.5, 1.0, 2.0)  # of the sides: 1/16, 1/4, all and 4 times the pixels
STAGES: tuple[Stage, ...] = ("match", "surface", "measure")
_WARM = 0.1
_LOOK_S = 0.2  # between two looks at the memory
_LOOK_OFTEN_S = 0.02  # the same, within the process
PIXELS = 8 * 4504 * 3000
"""Of the reference rig's eight photographs together."""


def make_session(folder: Path, scale: float, subject: str) -> Path:
    """Render a session with ready-made cameras, unless it is there."""
    if not (folder / "session.toml").is_file():
        made = write_session(folder, SessionRecipe(subject=subject, scale=scale, poses=1))
        (folder / "cameras.json").write_text(json.dumps(cameras_table(made.rig.cameras)))
    return folder


def run_stages(folder: Path, stages: Sequence[Stage] = STAGES) -> dict[str, dict[str, float]]:
    """Make every product of a session again, and take time and memory stage by stage."""
    import mammometry as mm

    job = mm.open_session(folder)
    rows: dict[str, dict[str, float]] = {}
    for stage in stages:
        wall, processor = time.monotonic(), sum(os.times()[:4])
        job.ensure(stage)
        rows[stage] = {
            "wall_s": time.monotonic() - wall,
            "processor_s": sum(os.times()[:4]) - processor,
            "peak_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
        }
    return rows


def measured(folder: Path, warm: Path, stages: Sequence[Stage] = STAGES) -> dict[str, dict[str, float]]:
    """The same in a process of its own, whose kernels are loaded by a small session first."""
    for old in (warm, folder):
        _forget(old / "results")
    command = [sys.executable, "-m", "benchmarks.speed.whole_job", "--stages", str(warm), str(folder), *stages]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        raise SystemExit(done.stderr.strip() or done.stdout.strip())
    rows: dict[str, dict[str, float]] = json.loads(done.stdout.splitlines()[-1])
    return rows


def whole_run(folder: Path) -> dict[str, float]:
    """`mammometry run`, with report: seconds, and the greatest memory of all its processes together and of one.

    Memory that processes share counts once in the first (proportional set size), where the system tells it.
    """
    _forget(folder / "results")
    wall, spent, peak, largest = time.monotonic(), os.times(), 0.0, 0.0
    command = [sys.executable, "-m", "mammometry", "run", str(folder), "--quiet"]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL) as process:
        while process.poll() is None:
            together, alone = memory_mb(process.pid)
            peak, largest = max(peak, together), max(largest, alone)
            time.sleep(_LOOK_S)
    if process.returncode:
        raise SystemExit(f"mammometry run {folder} ended with {process.returncode}")
    after = os.times()
    processor = after.children_user + after.children_system - spent.children_user - spent.children_system
    return {"wall_s": time.monotonic() - wall, "processor_s": processor, "peak_mb": peak, "largest_mb": largest}


def memory_mb(pid: int) -> tuple[float, float]:
    """Memory of a process and of those that it started: all together, and the largest one, MB."""
    total = largest = 0.0
    with suppress(psutil.Error):
        whole = psutil.Process(pid)
        for each in [whole, *whole.children(recursive=True)]:
            with suppress(psutil.Error):
                full = each.memory_full_info()
                total += getattr(full, "pss", full.rss) / 1e6
                largest = max(largest, full.rss / 1e6)
    return total, largest


def make_products(folder: Path) -> list[dict[str, Any]]:
    """Run a session, and take time and memory of each product, in the order in which they are done."""
    import mammometry as mm

    rows, memory, done = list[dict[str, Any]](), dict[str, float](), threading.Event()
    begun, process = time.monotonic(), psutil.Process()

    def look() -> None:
        while not done.wait(_LOOK_OFTEN_S):
            now = process.memory_info().rss / 1e6
            for name in list(memory):
                if name in memory:
                    memory[name] = max(memory[name], now)

    @contextmanager
    def watch(key: Key) -> Iterator[Progress]:
        name = f"{key.stage}: {key.product}"
        wall, processor = time.monotonic(), time.process_time()
        memory[name] = process.memory_info().rss / 1e6
        yield no_progress
        row = {"product": name, "begins_s": wall - begun, "wall_s": time.monotonic() - wall}
        rows.append(row | {"processor_s": time.process_time() - processor, "peak_mb": memory.pop(name)})

    looking = threading.Thread(target=look, daemon=True)
    looking.start()
    mm.open_session(folder, watch=watch).run()
    done.set()
    looking.join()
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 / 1e6
    whole = {"product": "all", "begins_s": 0.0, "wall_s": time.monotonic() - begun}
    return [*rows, whole | {"processor_s": time.process_time(), "peak_mb": peak}]


def of_products(session: Path, out: Path) -> str:
    """Markdown: every product of a session, then `mammometry run`."""
    copy = out / "session"
    _forget(copy)
    shutil.copytree(session, copy, ignore=shutil.ignore_patterns("results"))
    with beside() as reference:
        done = subprocess.run(
            [sys.executable, "-m", "benchmarks.speed.whole_job", str(copy), "--products"],
            capture_output=True,
            text=True,
            check=False,
        )
        if done.returncode:
            raise SystemExit(done.stderr.strip() or done.stdout.strip())
        run = whole_run(copy)
    rows = json.loads(done.stdout.splitlines()[-1])
    (out / "products.json").write_text(json.dumps({"products": rows, "run": run, "reference": vars(reference)}))
    lines = ["| product | begins at s | wall s | processor s | references | peak MB |", "| --- " * 6 + "|"]
    for row in sorted(rows[:-1], key=lambda row: row["begins_s"]) + rows[-1:]:
        times = f"{row['begins_s']:.1f} | {row['wall_s']:.1f} | {row['processor_s']:.1f}"
        lines.append(
            f"| {row['product']} | {times} | {row['processor_s'] / reference.processor_s:.1f} | {row['peak_mb']:.0f} |"
        )
    times = f"0.0 | {run['wall_s']:.1f} | {run['processor_s']:.1f} | {run['processor_s'] / reference.processor_s:.1f}"
    lines.append(
        f"| `mammometry run`, all processes | {times} | {run['peak_mb']:.0f} ({run['largest_mb']:.0f} in one) |"
    )
    return "\n".join([*lines, "", str(reference)])


def table(rows: dict[float, dict[str, dict[str, float]]]) -> str:
    """Markdown: one row a stage, one column a size, and the exponents from the first to the last and of the last step.

    What does not depend on the size keeps the first one low. The last step has least of it.
    """
    scales = list(rows)
    pixels = {scale: PIXELS * scale * scale for scale in scales}
    head = ["stage", *(f"{pixels[scale] / 1e6:.1f} Mpx: wall s (processor s), peak MB" for scale in scales)]
    head += ["exponent", "exponent of the last step"]
    lines = [head, ["---"] * len(head)]
    sums = {"images to textured mesh": ("match", "surface"), "stages one by one": STAGES}
    whole = {"run, with report": ("run",)} if all("run" in rows[scale] for scale in scales) else {}
    for stage, parts in ({name: (name,) for name in STAGES} | sums | whole).items():
        cells, seconds = [], []
        for scale in scales:
            chosen = [rows[scale][name] for name in parts]
            wall, processor = (sum(row[key] for row in chosen) for key in ("wall_s", "processor_s"))
            cells.append(f"{wall:.1f} ({processor:.1f}), {max(row['peak_mb'] for row in chosen):.0f}")
            seconds.append(processor)
        growths = []
        for first in (0, -2) if len(scales) > 1 else ():
            more = math.log(pixels[scales[-1]] / pixels[scales[first]])
            growths.append(f"{math.log(seconds[-1] / seconds[first]) / more:.2f}")
        lines.append([stage, *cells, *(growths or ["", ""])])
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def main() -> None:
    """Render, run, print the table, write it as JSON."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("session", type=Path, nargs="?", help="print every product of this one instead")
    parser.add_argument("--out", type=Path, default=Path("build/speed"))
    parser.add_argument("--subject", default="plaster_5")
    parser.add_argument("--scales", type=float, nargs="+", default=SCALES, help="of the reference images' sides")
    parser.add_argument("--stages", nargs="+", help=argparse.SUPPRESS)
    parser.add_argument("--products", action="store_true", help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.stages:
        warm, session, *stages = arguments.stages
        run_stages(Path(warm), stages)
        print(json.dumps(run_stages(Path(session), stages)))
        return
    if arguments.products:
        print(json.dumps(make_products(arguments.session)))
        return
    arguments.out.mkdir(parents=True, exist_ok=True)
    if arguments.session:
        print(f"{len(os.sched_getaffinity(0))} cores\n\n{of_products(arguments.session, arguments.out)}")
        return
    warm = make_session(arguments.out / "warm", _WARM, arguments.subject)
    rows: dict[float, dict[str, Any]] = {}
    for scale in arguments.scales:
        session = make_session(arguments.out / f"scale_{scale:g}", scale, arguments.subject)
        with beside() as reference:
            rows[scale] = measured(session, warm)
            rows[scale]["run"] = whole_run(session)
        whole = sum(row["wall_s"] for name, row in rows[scale].items() if name != "run")
        print(f"scale {scale:g}: {whole:.1f} s; {reference}", file=sys.stderr, flush=True)
    (arguments.out / "whole_job.json").write_text(json.dumps(rows, indent=1))
    print(f"{len(os.sched_getaffinity(0))} cores\n\n{table(rows)}")


def _forget(results: Path) -> None:
    shutil.rmtree(results, ignore_errors=True)


if __name__ == "__main__":
    main()
