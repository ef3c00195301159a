"""Time of the built-in renderer: eight full-size pictures, and the demo's session.

    python -m benchmarks.speed.simulate

Every kernel is compiled by a small session beforehand. Prints wall-clock and processor seconds beside the limits.
"""

from __future__ import annotations

import argparse
import os
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

from mammometry.simulate.disturbances.exposure import plain_exposure
from mammometry.simulate.recipe import SessionRecipe
from mammometry.simulate.rigs.build import flashes
from mammometry.simulate.rigs.rig_file import make_rig
from mammometry.simulate.session import write_session
from mammometry.simulate.studio import Arrangement, Studio, photograph
from mammometry.simulate.subjects.registry import make_subject
from mammometry.simulate.subjects.solid import rig_from_solid


def _timed(work: Callable[[], object]) -> tuple[float, float]:
    wall, processor = time.monotonic(), time.process_time()
    work()
    return time.monotonic() - wall, time.process_time() - processor


def main() -> None:
    """Measure and print both."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scale", type=float, default=1.0, help="of the capture's 4504 × 3000 pixel images")
    scale = parser.parse_args().scale
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        write_session(folder / "warm", SessionRecipe(scale=0.05, poses=1))

        def capture() -> None:
            (folder / "capture").mkdir()
            solid = make_subject("plaster_5", 7, edge_mm=max(0.4, 0.7 * 0.25 / scale))
            studio = Studio()
            arrangement = Arrangement(
                exposure=plain_exposure(make_rig("reference", scale, 7), flashes(), studio.film),
                lights=flashes(),
                rig_from_target={},
                solid=solid,
                rig_from_solid=rig_from_solid(solid, 7),
            )
            photograph(folder / "capture", arrangement, studio, seed=7)

        print(f"{len(os.sched_getaffinity(0))} cores\n")
        print("| what | wall s | processor s | limit s |\n| --- | --- | --- | --- |")
        for what, limit, work in (
            (f"a capture of eight pictures at scale {scale:g}", 60, capture),
            ("the demo's session", 15, lambda: write_session(folder / "demo")),
        ):
            wall, processor = _timed(work)
            print(f"| {what} | {wall:.1f} | {processor:.1f} | {limit} on two cores |", flush=True)


if __name__ == "__main__":
    main()
