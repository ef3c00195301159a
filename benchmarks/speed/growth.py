"""How time and memory grow with pixels, pairs, subjects and cores.

    python -m benchmarks.speed.growth --out build/growth
    python -m benchmarks.speed.growth --out build/growth --only cores --subject torso_3

Virtual captures with their true cameras, at a quarter of the reference size where the size is not what grows. Pairs
stand on an arc before the subject. "Processor" counts all cores' seconds: on a machine that others use it is the
steadier figure. References are multiples of a fixed piece of work, timed before and after each row. The exponent is the
slope of log(processor seconds) over log(number), by least squares: 1 where time is proportional to it. What does not
grow keeps it low at small numbers, so the last step's exponent stands beside it.

Rows are kept in `growth.json`; `growth.png` shows all that are there.

Cores this machine lacks are not measured. What more of them can bring is bounded by the plan: its longest path, if
every product were made on one core as soon as all that it is made from is there.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path

import numpy as np

from benchmarks.speed.reference import beside
from benchmarks.speed.whole_job import PIXELS, SCALES, make_session, measured, memory_mb
from benchmarks.speed.whole_job import table as stages_table
from mammometry.api.job import Job, open_session
from mammometry.base.machine.cores import CORES
from mammometry.io.cameras.own import cameras_table
from mammometry.simulate.recipe import SessionRecipe
from mammometry.simulate.session import write_session

SCALE = 0.25  # of the sides: a sixteenth of the pixels
PAIRS = (1, 2, 4, 8, 12)
SUBJECTS = (1, 2, 4)
CAST = "plaster_5"
_WIDEST_DEG, _BELOW_DEG = 65.0, 18.0  # the arc on which pairs stand, and how far they look up
_WARM = 0.1
_LOOK_S = 0.2  # between two looks at the memory

Row = dict[str, float]


def rig_of(pairs: int) -> str:
    """A rig of so many pairs on an arc, as a rig file."""
    lines = ["format = 1", f'name = "arc_{pairs}"', "[lens]", "size = [4504, 3000]", "focal_px = 5600"]
    below = np.radians(_BELOW_DEG)
    for number, aside in enumerate(np.radians(np.linspace(-_WIDEST_DEG, _WIDEST_DEG, pairs) if pairs > 1 else [0.0])):
        towards = [np.sin(aside) * np.cos(below), -np.sin(below), np.cos(aside) * np.cos(below)]
        along = [np.cos(aside), 0.0, -np.sin(aside)]
        lines += ["[[pairs]]", f'name = "pair{number:02}"', "distance_mm = 900", "convergence_deg = 14"]
        lines += [
            f"towards = {[round(float(x), 6) for x in towards]}",
            f"along = {[round(float(x), 6) for x in along]}",
        ]
    return "\n".join(lines) + "\n"


def with_pixels(out: Path) -> Iterator[tuple[float, Row]]:
    """All stages with larger and larger photographs: megapixels of all eight together."""
    warm, found = make_session(out / "warm", _WARM, CAST), {}
    for scale in SCALES:
        session = make_session(out / f"scale_{scale:g}", scale, CAST)
        with timed() as row:
            found[scale] = measured(session, warm)
            row |= _sum(found[scale])
        yield PIXELS * scale**2 / 1e6, row
    print(f"{stages_table(found)}\n", flush=True)


def with_pairs(out: Path) -> Iterator[tuple[float, Row]]:
    """Match and surface with more and more pairs."""
    warm = make_session(out / "warm", _WARM, CAST)
    for pairs in PAIRS:
        folder, rig = out / f"pairs_{pairs}", out / f"arc_{pairs}.toml"
        rig.write_text(rig_of(pairs), encoding="utf-8")
        if not (folder / "session.toml").is_file():
            made = write_session(folder, SessionRecipe(rig=str(rig), subject=CAST, scale=SCALE, poses=1))
            (folder / "cameras.json").write_text(json.dumps(cameras_table(made.rig.cameras)))
        with timed() as row:
            row |= _sum(measured(folder, warm, stages=("match", "surface")))
        yield pairs, row


def with_subjects(out: Path) -> Iterator[tuple[float, Row]]:
    """A batch of more and more subjects: one process each. Memory is that of all of them together."""
    for subjects in SUBJECTS:
        folders = [make_session(out / f"subject_{k}", SCALE, CAST) for k in range(subjects)]
        to = [f"--{name}={out / f'{name}_{subjects}'}" for name in ("results", "out")]
        for old in ("results", "out"):
            shutil.rmtree(out / f"{old}_{subjects}", ignore_errors=True)
        command = [sys.executable, "-m", "mammometry", "batch", *map(str, folders), *to]
        with timed() as row:
            wall, spent, peak = time.monotonic(), os.times(), 0.0
            with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as process:
                while process.poll() is None:
                    peak = max(peak, memory_mb(process.pid)[0])
                    time.sleep(_LOOK_S)
            if process.returncode:
                raise SystemExit(f"mammometry batch ended with {process.returncode}")
            after = os.times()
            processor = after.children_user + after.children_system - spent.children_user - spent.children_system
            row |= {"wall_s": time.monotonic() - wall, "processor_s": processor, "peak_mb": peak}
        yield subjects, row


def with_cores(out: Path, subject: str) -> Iterator[tuple[float, Row]]:
    """All stages on one core, two, four, eight: as many as there are. Then what the plan allows."""
    warm, session = make_session(out / "warm", _WARM, CAST), make_session(out / f"cores_{subject}", SCALE, subject)
    there = sorted(os.sched_getaffinity(0))
    for cores in (1, 2, 4, 8):
        if cores <= len(there):
            os.sched_setaffinity(0, there[:cores])
            os.environ[CORES] = str(cores)
            with timed() as row:
                row |= _sum(measured(session, warm))
            os.sched_setaffinity(0, there)
            del os.environ[CORES]
            yield cores, row
    whole, longest = plan_bound(open_session(session))
    bound = f"longest path {longest:.1f} s: at most {whole / longest:.1f} times"
    print(f"products one after the other {whole:.1f} s, {bound}\n", flush=True)


@contextmanager
def timed() -> Iterator[Row]:
    """A row to be filled; its references are added when the block has ended."""
    row: Row = {}
    with beside() as reference:
        yield row
    row["references"] = row["processor_s"] / reference.processor_s


def longest_path(seconds: Mapping[str, float], made_from: Mapping[str, Sequence[str]]) -> float:
    """Time of the slowest chain of products, s.

    Args:
        seconds: of each product's making.
        made_from: what each is made from; names without seconds take none.
    """
    ready: dict[str, float] = {}

    def done(name: str) -> float:
        if name not in ready:
            ready[name] = seconds.get(name, 0.0) + max(map(done, made_from.get(name, ())), default=0.0)
        return ready[name]

    return max(map(done, seconds), default=0.0)


def plan_bound(job: Job) -> tuple[float, float]:
    """Sum of a job's products and the longest path through them, s, by the records of its last run."""
    seconds, made_from = {}, {}
    for product in job.plan.products():
        record = job.store.record(product.key)
        if record is not None:
            seconds[product.key.product] = record.seconds
            made_from[product.key.product] = [name for name in product.key.inputs if name != product.key.product]
    return sum(seconds.values()), longest_path(seconds, made_from)


def _sum(stages: Mapping[str, Row]) -> Row:
    rows = stages.values()
    return {
        "wall_s": sum(row["wall_s"] for row in rows),
        "processor_s": sum(row["processor_s"] for row in rows),
        "peak_mb": max(row["peak_mb"] for row in rows),
    }


def table(what: str, rows: Mapping[float, Row]) -> str:
    """Markdown: a row a number, and the exponents."""
    lines = [f"| {what} | wall s | processor s | references | peak MB |", "| --- " * 5 + "|"]
    for number, row in rows.items():
        times = f"{row['wall_s']:.1f} | {row['processor_s']:.1f} | {row['references']:.1f}"
        lines.append(f"| {number:.4g} | {times} | {row['peak_mb']:.0f} |")
    return "\n".join([*lines, "", f"exponent {exponent(rows):.2f}, of the last step {exponent(rows, last=2):.2f}"])


def exponent(rows: Mapping[float, Row], key: str = "processor_s", last: int = 0) -> float:
    """Slope of log(value) over log(number), of the last rows or of all."""
    numbers, values = list(rows)[-last:], [row[key] for row in rows.values()][-last:]
    return float(np.polyfit(np.log(numbers), np.log(values), 1)[0]) if len(rows) > 1 else float("nan")


def draw(found: Mapping[str, Mapping[float, Row]], path: Path) -> None:
    """Processor seconds and memory over what grows. Dashed: proportional to it."""
    from matplotlib.figure import Figure
    from matplotlib.ticker import LogLocator, NullFormatter, NullLocator, StrMethodFormatter

    figure = Figure(figsize=(4.2 * len(found), 6.4), layout="constrained")
    axes = figure.subplots(2, len(found), squeeze=False)
    for column, (what, rows) in enumerate(found.items()):
        numbers = np.array(list(rows))
        for place, (key, unit) in zip(
            axes[:, column], (("processor_s", "processor s"), ("peak_mb", "MB")), strict=True
        ):
            values = np.array([row[key] for row in rows.values()])
            place.loglog(numbers, values, "o-", label=f"exponent {exponent(rows, key):.2f}")
            place.loglog(
                numbers, values[0] * numbers / numbers[0], "--", color="0.6", linewidth=1, label="proportional"
            )
            place.set(xlabel=what, ylabel=unit, ylim=(0.5 * values.min(), 3 * values.max()))
            place.set_xticks(numbers, [f"{number:.3g}" for number in numbers])
            place.xaxis.set_minor_locator(NullLocator())
            place.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
            place.yaxis.set_major_formatter(StrMethodFormatter("{x:.0f}"))
            place.yaxis.set_minor_formatter(NullFormatter())
            place.legend(frameon=False, fontsize=8, loc="upper left")
            place.spines[["top", "right"]].set_visible(False)
    figure.savefig(path, dpi=110)


def main() -> None:
    """Make the captures, run, print the tables and draw them."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("build/growth"))
    parser.add_argument("--only", choices=("pixels", "pairs", "subjects", "cores"))
    parser.add_argument("--subject", default=CAST, help="whose plan is looked into with more cores")
    arguments = parser.parse_args()
    out: Path = arguments.out
    out.mkdir(parents=True, exist_ok=True)
    kept = out / "growth.json"
    found: dict[str, dict[float, Row]] = {}
    if kept.is_file():
        for what, rows in json.loads(kept.read_text()).items():
            found[what] = {float(number): row for number, row in rows.items()}
    cores = partial(with_cores, subject=arguments.subject)
    ways: dict[str, Callable[[Path], Iterator[tuple[float, Row]]]]
    ways = {"megapixels": with_pixels, "pairs": with_pairs, "subjects": with_subjects, "cores": cores}
    for what, way in ways.items():
        if arguments.only in (None, "pixels" if what == "megapixels" else what):
            rows = dict(way(out))
            print(table(what, rows), end="\n\n", flush=True)
            if what != "cores":
                found[what] = rows
                kept.write_text(json.dumps(found, indent=1))
    if found:
        draw({what: found[what] for what in ways if what in found}, out / "growth.png")


if __name__ == "__main__":
    main()
