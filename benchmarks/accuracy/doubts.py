"""Doubts about a torso: wrong scales, hands on a breast, and false alarms.

    python -m benchmarks.accuracy.doubts --bodies ../shared/data/scans --women 8001-8008
    python -m benchmarks.accuracy.doubts --women 8101-8112 --any-hand

Each shared scan is measured as it is and with its lengths × 0.7, × 1.5, × 2.54 and / 2.54; each virtual woman bare and
with a hand on one breast, as a telephone scans her. A side counts as covered where the hand lies over at least 20 cm²
within the breast's true border, and as bare where it lies over none. `--any-hand` draws hands that those of the limits
were not: thin and thick ones, from any direction, near the border too.
"""

from __future__ import annotations

import argparse
import tempfile
from collections import defaultdict
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Literal

import numpy as np

from benchmarks.hand import HAND_MM, with_hand
from mammometry.api.mesh import MeshFiles, MeshJob
from mammometry.base.errors import MeasureError
from mammometry.geometry import Array, Float64, TriangleMesh, UInt8
from mammometry.geometry.mesh_files.ply import write_ply
from mammometry.io.meshes.foreign import read_foreign
from mammometry.job.stages import measure
from mammometry.measure.boundary.breasts import within_outline
from mammometry.measure.boundary.overlap import Overlap
from mammometry.simulate.disturbances.registry import disturbed
from mammometry.simulate.recipe import parse_situation
from mammometry.simulate.scan import QUALITIES, scan
from mammometry.simulate.subjects.registry import make_subject

_FACTORS = (1.0, 0.7, 1.5, 2.54, 1 / 2.54)
_BUILDS = ("arms=raised", "arms=sides", "build=obese", "build=thin", "ptosis=2")
_COVERED_CM2 = 20.0  # of a hand within a border, from which it changes the volume by 20 cc or more
_STEP_MM = 4.0  # squares in which a hand's area is counted; its own grid has 3
_EDGE_MM = 2.5  # of the bodies' triangles, on the breasts


@dataclass
class Tally:
    """Sides by what lies on them and by what was found."""

    sides: dict[tuple[str, bool], int] = field(default_factory=lambda: defaultdict(int))
    """("covered", "bare" or "touched"; whether a warning came) → number of sides."""

    def add(self, covered_cm2: float, overlap: Overlap) -> None:
        """Count one side."""
        kind = "covered" if covered_cm2 >= _COVERED_CM2 else "touched" if covered_cm2 > 0 else "bare"
        self.sides[kind, overlap.is_covered] += 1

    def table(self) -> str:
        """Rows of what lies on a side, and how many of these sides are warned of."""
        counts = {kind: (self.sides[kind, True], self.sides[kind, False]) for kind in ("covered", "touched", "bare")}
        rows = [f"| {kind} | {said} of {said + silent} |" for kind, (said, silent) in counts.items()]
        return "\n".join(["| side | warned of |", "| --- | --- |", *rows])


def found(
    mesh: TriangleMesh, colours: UInt8[Array, "n 3"], covered_cm2: Mapping[str, float], tally: Tally | None = None
) -> str:
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
    if tally is not None:
        for side in overlaps:
            tally.add(covered_cm2.get(side.name, 0.0), side)
    verdict = "too " + size.words if size.is_impossible else size.words if size.is_rare else "usual"
    verdict = verdict if size.lengths_mm else "unknown"
    lengths = ", ".join(f"{name} {mm:.0f} mm" for name, mm in size.lengths_mm.items())
    grooves = ", ".join(
        f"{side.name} {side.groove_cm2:.1f} cm²{' COVERED' if side.is_covered else ''}"
        + (f" (hand over {covered_cm2[side.name]:.0f} cm²)" if covered_cm2.get(side.name) else "")
        for side in overlaps
    )
    return f"size {verdict} ({size.deviations:+.1f}: {lengths}); grooves {grooves}"


def of_woman(number: int, tally: Tally, *, any_hand: bool) -> Iterator[str]:
    """One virtual woman, bare and with a hand on a breast."""
    situation = f"posture=standing,{_BUILDS[number % len(_BUILDS)]}"
    reshape = partial(disturbed, stage="patient", situation=parse_situation(situation), seed=number)
    bare = make_subject(f"torso_{number}", 0, edge_mm=_EDGE_MM, reshape=reshape)
    rng = np.random.default_rng(number)
    side: Literal["left", "right"] = "left" if rng.random() < 0.5 else "right"
    inwards_deg = 180.0 if side == "left" else 0.0
    turn_deg = float(rng.uniform(-80, 40)) * (1 if side == "left" else -1)
    shift_mm = (float(rng.uniform(-15, 15)), float(rng.uniform(-25, 10)))
    thick_mm = HAND_MM
    if any_hand:
        turn_deg, thick_mm = float(rng.uniform(-120, 120)), float(rng.uniform(20, 30))
        shift_mm = (float(rng.uniform(-45, 45)), float(rng.uniform(-45, 45)))
    covered = with_hand(bare, side, fingers_deg=inwards_deg + turn_deg, shift_mm=shift_mm, thick_mm=thick_mm)
    hand = covered.mesh.vertices[len(bare.mesh.vertices) :]
    hand_cm2 = {name: _hand_cm2(hand, bare.mesh.vertices[breast.boundary]) for name, breast in bare.breasts.items()}
    for name, solid, lies in (("bare", bare, {}), (f"hand on the {side}", covered, hand_cm2)):
        made = scan(solid, QUALITIES["telephone"], number)
        yield f"woman {number}, {situation}, {name}: {found(made.mesh, made.colours, lies, tally)}"


def _hand_cm2(hand: Float64[Array, "n 3"], border: Float64[Array, "k 3"]) -> float:
    """Area within a breast's border over which a hand lies, seen from the front, cm²."""
    columns = np.unique(np.floor(hand[:, :2] / _STEP_MM), axis=0) * _STEP_MM
    return float(within_outline(columns, border[:, :2]).sum()) * _STEP_MM**2 / 100


def main() -> None:
    """Print a line for each mesh."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--bodies", type=Path, default=None, help="folder of the shared scans")
    parser.add_argument("--factors", type=float, nargs="*", default=_FACTORS)
    parser.add_argument("--women", default="", help="first and last, as 8001-8008")
    parser.add_argument("--any-hand", action="store_true", help="hands from any direction, thin and thick")
    arguments = parser.parse_args()
    for path in [] if arguments.bodies is None else sorted(arguments.bodies.glob("*.ply")):
        foreign = read_foreign(path, "m" if path.stem.endswith("_scan") else "mm")
        for factor in arguments.factors:
            mesh = foreign.mesh.mapped(lambda points, times=factor: points * times)  # type: ignore[misc]
            print(f"{path.stem} × {factor:.3g}: {found(mesh, foreign.colours, {})}", flush=True)
    tally = Tally()
    first, _, last = arguments.women.partition("-")
    for number in range(int(first), int(last or first) + 1) if first else ():
        for line in of_woman(number, tally, any_hand=arguments.any_hand):
            print(line, flush=True)
    if first:
        print(tally.table())


if __name__ == "__main__":
    main()
