"""Repeatability of a virtual telephone: virtual women who are captured again, each time placed anew.

    python -m benchmarks.accuracy.repeatability --women 9700-9711 --captures 3

Before every capture a woman stands anew: her trunk leans, her arms hang and her chest is filled a little differently.
Breathing in moves a breast by 2.3 mm forward and a nipple by 4.1 mm up (Wang et al., Aesthetic Plastic Surgery 43
(2019) 53); a woman who is asked to breathe out is assumed to scatter by a quarter of that. The scatter of lean and arms
is assumed: half of what the benchmark of dates assumes between two visits. Her volume stays the same. Each capture is a
scan by the virtual telephone, measured without any drawing. Women of numbers below 9000 are for development. These are
virtual women: clothes, skin marks and persons who hold the telephone are missing.
"""

from __future__ import annotations

import argparse
import multiprocessing
import tempfile
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import numpy as np

from benchmarks.accuracy.dates import posed
from benchmarks.accuracy.scans import measured
from mammometry.base.machine.cores import available_cores
from mammometry.geometry.mesh_files.ply import write_ply
from mammometry.simulate.disturbances.registry import disturbed
from mammometry.simulate.recipe import parse_situation
from mammometry.simulate.scan import QUALITIES, scan
from mammometry.simulate.subjects.registry import make_subject
from mammometry.simulate.subjects.torso_shape import TorsoShape
from mammometry.study.repeatability.design import Reading
from mammometry.study.repeatability.study import repeatability
from mammometry.study.repeatability.tables import repeatability_tables

_EDGE_MM = 2.0  # of the triangles on the breasts
_LEAN_DEG = 2.0  # standard deviation of the lean of one woman; half of that between dates (benchmarks.accuracy.dates)
_ARM_DEG = 4.0  # likewise of her arms
_BREATH = 0.006  # of the chest's depth: a quarter of 2.3 mm of a half depth of about 100 mm


def captures(woman: int, count: int) -> list[Reading]:
    """Capture a woman several times and measure both breasts. Refused captures are printed and left out."""
    found: list[Reading] = []
    for capture in range(count):
        rng = np.random.default_rng([woman, capture, 60])

        def placed(shape: TorsoShape, rng: np.random.Generator = rng) -> TorsoShape:
            standing = disturbed(shape, stage="patient", situation=parse_situation("posture=standing"), seed=woman)
            arms = rng.normal(0.0, _ARM_DEG, 2)
            return posed(standing, rng.normal(0.0, _LEAN_DEG), (arms[0], arms[1]), rng.normal(0.0, _BREATH))

        try:
            solid = make_subject(f"torso_{woman}", 0, edge_mm=_EDGE_MM, reshape=placed)
        except ValueError as error:  # the simulator cannot make every one
            print(woman, capture, error, flush=True)
            continue
        made = scan(solid, QUALITIES["telephone"], capture)
        with tempfile.TemporaryDirectory(prefix="mammometry-repeatability-") as folder:
            path = Path(folder) / "scan.ply"
            write_ply(path, made.mesh, made.ply_colours, comments=())
            row = measured(path, report=False)
        if row["refused"]:
            print(woman, capture, row["refused"], flush=True)
        found += [
            Reading(woman=str(woman), side=side, capture=str(capture), volume_cc=own["volume_cc"])
            for side, own in row["sides"].items()
        ]
    return found


def _all(women: range, count: int, workers: int) -> Iterator[Reading]:
    with ProcessPoolExecutor(workers, mp_context=multiprocessing.get_context("spawn")) as pool:
        for found in pool.map(captures, women, [count] * len(women)):
            yield from found


def main() -> None:
    """Capture, measure, analyse, print the tables."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--women", default="9700-9711", help="first and last")
    parser.add_argument("--captures", type=int, default=3, help="of each woman")
    parser.add_argument("--workers", type=int, default=available_cores())
    arguments = parser.parse_args()
    first, _, last = arguments.women.partition("-")
    readings = tuple(_all(range(int(first), int(last or first) + 1), arguments.captures, arguments.workers))
    found = repeatability(readings)
    women, breasts = f"{found.women} virtual women", f"{found.breasts} breasts of {found.mean_cc:.0f} cc on average"
    print(f"{women}, {breasts}, {found.captures} captures by a virtual telephone", end="\n\n")
    for table in repeatability_tables(found)[:5]:
        print(table.as_markdown())


if __name__ == "__main__":
    main()
