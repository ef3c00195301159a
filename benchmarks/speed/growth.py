"""How time and memory grow with pairs, subjects and cores. With pixels: `benchmarks.speed.whole_job`.

    python -m benchmarks.speed.growth --out build/growth
    python -m benchmarks.speed.growth --out build/growth --only cores

Virtual captures at a quarter of the reference size, with their true cameras. Pairs stand on an arc before the subject.
"Processor" counts all cores' seconds: on a machine that others use it is the steadier figure. The exponent is the
slope of log(processor seconds) over log(number), by least squares: 1 where time is proportional to it.

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
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from benchmarks.speed.reference import beside
from benchmarks.speed.whole_job import make_session, measured
from mammometry.api.job import Job, open_session
from mammometry.base.cores import CORES
from mammometry.io.cameras.own import cameras_table
from mammometry.simulate.recipe import SessionRecipe
from mammometry.simulate.session import write_session

SCALE = 0.25  # of the sides: a sixteenth of the pixels
PAIRS = (1, 2, 4, 8, 12)
SUBJECTS = (1, 2, 4)
CAST = "plaster_5"
_WIDEST_DEG, _BELOW_DEG = 65.0, 18.0  # the arc on which pairs stand, and how far they look up
_WARM = 0.1


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


def with_pairs(out: Path) -> dict[int, dict[str, float]]:
    """Match and surface with more and more pairs."""
    warm, rows = make_session(out / "warm", _WARM, CAST), {}
    for pairs in PAIRS:
        folder, rig = out / f"pairs_{pairs}", out / f"arc_{pairs}.toml"
        rig.write_text(rig_of(pairs), encoding="utf-8")
        if not (folder / "session.toml").is_file():
            made = write_session(folder, SessionRecipe(rig=str(rig), subject=CAST, scale=SCALE, poses=1))
            (folder / "cameras.json").write_text(json.dumps(cameras_table(made.rig.cameras)))
        rows[pairs] = _sum(measured(folder, warm, stages=("match", "surface")))
    return rows


def with_subjects(out: Path) -> dict[int, dict[str, float]]:
    """A batch of more and more subjects: one process each, so no peak of one."""
    rows = {}
    for subjects in SUBJECTS:
        folders = [make_session(out / f"subject_{k}", SCALE, CAST) for k in range(subjects)]
        to = [f"--{name}={out / f'{name}_{subjects}'}" for name in ("results", "out")]
        for old in ("results", "out"):
            shutil.rmtree(out / f"{old}_{subjects}", ignore_errors=True)
        wall, spent = time.monotonic(), os.times()
        subprocess.run(
            [sys.executable, "-m", "mammometry", "batch", *map(str, folders), *to], check=True, capture_output=True
        )
        after = os.times()
        processor = after.children_user + after.children_system - spent.children_user - spent.children_system
        rows[subjects] = {"wall_s": time.monotonic() - wall, "processor_s": processor, "peak_mb": float("nan")}
    return rows


def with_cores(out: Path) -> tuple[dict[int, dict[str, float]], Job]:
    """All stages on one core, two, four, eight: as many as there are."""
    warm, session = make_session(out / "warm", _WARM, CAST), make_session(out / "subject_0", SCALE, CAST)
    there = sorted(os.sched_getaffinity(0))
    rows = {}
    for cores in (1, 2, 4, 8):
        if cores <= len(there):
            os.sched_setaffinity(0, there[:cores])
            os.environ[CORES] = str(cores)
            rows[cores] = _sum(measured(session, warm))
    os.sched_setaffinity(0, there)
    del os.environ[CORES]
    return rows, open_session(session)


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


def _sum(stages: Mapping[str, Mapping[str, float]]) -> dict[str, float]:
    rows = stages.values()
    return {
        "wall_s": sum(row["wall_s"] for row in rows),
        "processor_s": sum(row["processor_s"] for row in rows),
        "peak_mb": max(row["peak_mb"] for row in rows),
    }


def table(what: str, rows: Mapping[int, Mapping[str, float]]) -> str:
    """Markdown: a row a number, and the exponent."""
    lines = [f"| {what} | wall s | processor s | peak MB |", "| --- | --- | --- | --- |"]
    for number, row in rows.items():
        peak = f"{row['peak_mb']:.0f}" if np.isfinite(row["peak_mb"]) else "–"
        lines.append(f"| {number} | {row['wall_s']:.1f} | {row['processor_s']:.1f} | {peak} |")
    spent = [row["processor_s"] for row in rows.values()]
    slope = np.polyfit(np.log(list(rows)), np.log(spent), 1)[0] if len(rows) > 1 else float("nan")
    return "\n".join([*lines, "", f"exponent {slope:.2f}"])


def main() -> None:
    """Make the captures, run, and print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("build/growth"))
    parser.add_argument("--only", choices=("pairs", "subjects", "cores"))
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    with beside() as reference:
        print_tables(arguments)
    print(f"\n{reference}")


def print_tables(arguments: argparse.Namespace) -> None:
    """Measure and print what was asked for."""
    if arguments.only in (None, "pairs"):
        print(table("pairs", with_pairs(arguments.out)), end="\n\n", flush=True)
    if arguments.only in (None, "subjects"):
        print(table("subjects", with_subjects(arguments.out)), end="\n\n", flush=True)
    if arguments.only in (None, "cores"):
        rows, job = with_cores(arguments.out)
        whole, longest = plan_bound(job)
        print(table("cores", rows))
        bound = f"longest path {longest:.1f} s: at most {whole / longest:.1f} times"
        print(f"\nproducts one after the other {whole:.1f} s, {bound}")


if __name__ == "__main__":
    main()
