"""Repeatability of a virtual telephone or rig: virtual women who are captured again, each time placed anew.

    python -m benchmarks.accuracy.repeatability --women 9700-9711 --captures 3
    python -m benchmarks.accuracy.repeatability --women 9700-9705 --captures 2 --rig

Before every capture a woman stands anew: her trunk leans, her arms hang and her chest is filled a little differently.
Breathing in moves a breast by 2.3 mm forward and a nipple by 4.1 mm up (Wang et al., Aesthetic Plastic Surgery 43
(2019) 53); a woman who is asked to breathe out is assumed to scatter by a quarter of that. The scatter of lean and arms
is assumed: half of what the benchmark of dates assumes between two visits. Her volume stays the same. Each capture is a
scan by the virtual telephone, or a session of the virtual rig that is calibrated anew each time, from photographs to
volumes, and is measured without any drawing. Women of numbers below 9000 are for development. These are
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
from mammometry.api.job import open_session
from mammometry.base.errors import MammometryError
from mammometry.base.machine.cores import available_cores
from mammometry.geometry.mesh_files.ply import write_ply
from mammometry.simulate.disturbances.registry import disturbed
from mammometry.simulate.recipe import SessionRecipe, parse_situation
from mammometry.simulate.scan import QUALITIES, scan
from mammometry.simulate.session import write_session
from mammometry.simulate.subjects.registry import make_subject
from mammometry.simulate.subjects.solid import SubjectSolid
from mammometry.simulate.subjects.torso_shape import TorsoShape
from mammometry.study.repeatability.design import Reading
from mammometry.study.repeatability.study import repeatability
from mammometry.study.repeatability.tables import repeatability_tables

_EDGE_MM, _RIG_EDGE_MM = 2.0, 1.2  # of the triangles on the breasts
_SCALE = 0.15  # of the rig's photographs, of 4504 × 3000 pixels
_LEAN_DEG = 2.0  # standard deviation of the lean of one woman; half of that between dates (benchmarks.accuracy.dates)
_ARM_DEG = 4.0  # likewise of her arms
_BREATH = 0.006  # of the chest's depth: a quarter of 2.3 mm of a half depth of about 100 mm


def captures(woman: int, count: int, rig: bool = False) -> list[Reading]:
    """Capture a woman several times and measure both breasts. Refused captures are printed and left out."""
    found: list[Reading] = []
    for capture in range(count):
        rng = np.random.default_rng([woman, capture, 60])

        def placed(shape: TorsoShape, rng: np.random.Generator = rng) -> TorsoShape:
            if not rig:  # before a rig she leans forward, as the shape is drawn
                shape = disturbed(shape, stage="patient", situation=parse_situation("posture=standing"), seed=woman)
            arms = rng.normal(0.0, _ARM_DEG, 2)
            return posed(shape, rng.normal(0.0, _LEAN_DEG), (arms[0], arms[1]), rng.normal(0.0, _BREATH))

        try:
            solid = make_subject(f"torso_{woman}", 0, edge_mm=_RIG_EDGE_MM if rig else _EDGE_MM, reshape=placed)
        except ValueError as error:  # the simulator cannot make every one
            print(woman, capture, error, flush=True)
            continue
        volumes = by_rig(solid, woman, capture) if rig else by_telephone(solid, capture)
        if isinstance(volumes, str):
            print(woman, capture, volumes, flush=True)
            continue
        found += [
            Reading(woman=str(woman), side=side, capture=str(capture), volume_cc=volume)
            for side, volume in volumes.items()
        ]
    return found


def by_telephone(solid: SubjectSolid, seed: int) -> dict[str, float] | str:
    """Volumes from a scan by the virtual telephone, cc, or why there are none."""
    made = scan(solid, QUALITIES["telephone"], seed)
    with tempfile.TemporaryDirectory(prefix="mammometry-repeatability-") as folder:
        path = Path(folder) / "scan.ply"
        write_ply(path, made.mesh, made.ply_colours, comments=())
        row = measured(path, report=False)
    return row["refused"] or {side: own["volume_cc"] for side, own in row["sides"].items()}


def by_rig(solid: SubjectSolid, woman: int, capture: int) -> dict[str, float] | str:
    """Volumes from photographs by the virtual rig, calibrated anew, cc, or why there are none."""
    recipe = SessionRecipe(subject=f"torso_{woman}", seed=100 * woman + capture, scale=_SCALE)
    with tempfile.TemporaryDirectory(prefix="mammometry-repeatability-") as folder:
        session = Path(folder) / "session"
        write_session(session, recipe, subject=solid, truth=False)
        try:
            return dict(open_session(session).run(report=False).volumes_cc)
        except MammometryError as error:
            return str(error)


def _all(women: range, count: int, rig: bool, workers: int) -> Iterator[Reading]:
    with ProcessPoolExecutor(workers, mp_context=multiprocessing.get_context("spawn")) as pool:
        for found in pool.map(captures, women, [count] * len(women), [rig] * len(women)):
            yield from found


def main() -> None:
    """Capture, measure, analyse, print the tables."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--women", default="9700-9711", help="first and last")
    parser.add_argument("--captures", type=int, default=3, help="of each woman")
    parser.add_argument("--rig", action="store_true", help="by the virtual rig instead of the telephone")
    parser.add_argument("--workers", type=int, default=available_cores())
    arguments = parser.parse_args()
    first, _, last = arguments.women.partition("-")
    readings = tuple(
        _all(range(int(first), int(last or first) + 1), arguments.captures, arguments.rig, arguments.workers)
    )
    found = repeatability(readings)
    device = "rig" if arguments.rig else "telephone"
    women, breasts = f"{found.women} virtual women", f"{found.breasts} breasts of {found.mean_cc:.0f} cc on average"
    print(f"{women}, {breasts}, {found.captures} captures by a virtual {device}", end="\n\n")
    for table in repeatability_tables(found)[:5]:
        print(table.as_markdown())


if __name__ == "__main__":
    main()
