"""Doubts about a torso: wrong scales that are refused or warned of, hands on a breast, and false alarms.

    python -m benchmarks.accuracy.doubts --bodies ../shared/data/scans --women 8001-8008

Each shared scan is measured as it is and with its lengths × 0.7, × 1.5, × 2.54 and / 2.54; each virtual woman bare and
with a hand on one breast, as a telephone scans her.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Literal

import numpy as np

from mammometry.api.mesh import MeshFiles, MeshJob
from mammometry.base.errors import MeasureError
from mammometry.geometry import Array, TriangleMesh, UInt8
from mammometry.io.meshes.foreign import read_foreign
from mammometry.io.meshes.own import write_ply
from mammometry.job.stages import measure
from mammometry.simulate.disturbances.registry import disturbed
from mammometry.simulate.recipe import parse_situation
from mammometry.simulate.scan import QUALITIES, scan
from mammometry.simulate.subjects.hand import with_hand
from mammometry.simulate.subjects.registry import make_subject

_FACTORS = (1.0, 0.7, 1.5, 2.54, 1 / 2.54)
_BUILDS = ("arms=raised", "arms=sides", "build=obese", "build=thin", "ptosis=2")
_EDGE_MM = 2.5  # of the bodies' triangles, on the breasts


def found(mesh: TriangleMesh, colours: UInt8[Array, "n 3"]) -> str:
    """Size and overlaps of a torso in mm, or its refusal, in words."""
    with tempfile.TemporaryDirectory(prefix="mammometry-doubts-") as folder:
        path = Path(folder) / "a.ply"
        write_ply(
            path, mesh, {name: np.ascontiguousarray(colours[:, k]) for k, name in enumerate(("red", "green", "blue"))}
        )
        try:
            job = MeshJob(MeshFiles(mesh=path, units="mm", automatic=True), Path(folder) / "out")
            size, overlaps = job.plan[measure.size](), job.plan[measure.overlaps]()
        except MeasureError as error:
            return f"refused: {error}"
    verdict = "too " + size.words if size.is_impossible else size.words if size.is_rare else "usual"
    lengths = ", ".join(f"{name} {mm:.0f} mm" for name, mm in size.lengths_mm.items())
    grooves = ", ".join(
        f"{side.name} {side.groove_cm2:.1f} cm²{' COVERED' if side.is_covered else ''}" for side in overlaps
    )
    return f"size {verdict} ({size.deviations:+.1f}: {lengths}); grooves {grooves}"


def of_woman(number: int) -> Iterator[str]:
    """One virtual woman, bare and with a hand on a breast."""
    situation = f"posture=standing,{_BUILDS[number % len(_BUILDS)]}"
    reshape = partial(disturbed, stage="patient", situation=parse_situation(situation), seed=number)
    bare = make_subject(f"torso_{number}", 0, edge_mm=_EDGE_MM, reshape=reshape)
    rng = np.random.default_rng(number)
    side: Literal["left", "right"] = "left" if rng.random() < 0.5 else "right"
    inwards_deg = 180.0 if side == "left" else 0.0
    turn_deg = float(rng.uniform(-80, 40)) * (1 if side == "left" else -1)
    shift_mm = (float(rng.uniform(-15, 15)), float(rng.uniform(-25, 10)))
    covered = with_hand(bare, side, fingers_deg=inwards_deg + turn_deg, shift_mm=shift_mm)
    for name, solid in (("bare", bare), (f"hand on the {side}", covered)):
        made = scan(solid, QUALITIES["telephone"], number)
        yield f"woman {number}, {situation}, {name}: {found(made.mesh, made.colours)}"


def main() -> None:
    """Print a line for each mesh."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--bodies", type=Path, default=None, help="folder of the shared scans")
    parser.add_argument("--factors", type=float, nargs="*", default=_FACTORS)
    parser.add_argument("--women", default="", help="first and last, as 8001-8008")
    arguments = parser.parse_args()
    for path in [] if arguments.bodies is None else sorted(arguments.bodies.glob("*.ply")):
        foreign = read_foreign(path, "m" if path.stem.endswith("_scan") else "mm")
        for factor in arguments.factors:
            mesh = foreign.mesh.mapped(lambda points, times=factor: points * times)  # type: ignore[misc]
            print(f"{path.stem} × {factor:.3g}: {found(mesh, foreign.colours)}", flush=True)
    first, _, last = arguments.women.partition("-")
    for number in range(int(first), int(last or first) + 1) if first else ():
        for line in of_woman(number):
            print(line, flush=True)


if __name__ == "__main__":
    main()
