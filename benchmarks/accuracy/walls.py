"""Every chest wall on torsos of known volume, with the same skin and boundary.

    python -m benchmarks.accuracy.walls
    python -m benchmarks.accuracy.walls --families woman leaning-woman --bodies 9 --first 1000

No photographs: the skin is the simulator's own, as far as cameras in front would see it, the boundary the true one, the
true wall the skin of the same body without the breast. Prints bias, standard deviation, worst error, relative error and
the spread of the left/right ratio for every wall, and what the interval's constants would be on these torsos alone.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.accuracy.women import FAMILIES
from mammometry.geometry.arrays import Array, Float64
from mammometry.geometry.mesh import TriangleMesh
from mammometry.measure.boundary.boundary import Boundary
from mammometry.measure.settings import MeasureSettings
from mammometry.measure.wall import chest_wall
from mammometry.measure.wall.open_breast import open_breasts
from mammometry.measure.wall.registry import TORSO_WALLS
from mammometry.simulate.subjects.registry import make_subject
from mammometry.simulate.subjects.solid import SubjectSolid, rig_from_solid
from mammometry.surface.repair.repair import Provenance, RepairedSurface

SIDES = ("left", "right")
_SEEN_COSINE = -0.3
_EDGE_MM = 2.0


@dataclass(frozen=True)
class TrueTorso:
    """A torso of the simulator in front of the cameras."""

    solid: SubjectSolid
    """Placed; its frame is the rig's: x to the patient's left, y up, z towards the cameras."""
    surface: RepairedSurface
    """Its skin; the back is marked as invented."""
    boundaries: tuple[Boundary, ...]
    """True ones, left and right."""


def true_torso(name: str, seed: int, *, edge_mm: float = _EDGE_MM) -> TrueTorso:
    """A torso or a woman, with the skin that cameras in front would see."""
    solid = make_subject(name, seed, edge_mm=edge_mm)
    solid = solid.placed(rig_from_solid(solid, seed))
    return TrueTorso(solid=solid, surface=as_seen(solid.mesh), boundaries=true_boundaries(solid, solid.mesh.vertices))


def as_seen(mesh: TriangleMesh, least_cosine: float = _SEEN_COSINE) -> RepairedSurface:
    """A closed mesh as a repaired surface; what faces away from the cameras is invented."""
    facing = np.zeros((len(mesh.vertices), 3))
    for corner in range(3):
        np.add.at(facing, mesh.faces[:, corner], mesh.face_vectors())
    facing /= np.maximum(np.linalg.norm(facing, axis=1, keepdims=True), 1e-12)
    provenance = np.where(facing[:, 2] > least_cosine, Provenance.MEASURED, Provenance.INVENTED).astype(np.uint8)
    n = len(mesh.vertices)
    return RepairedSurface(
        mesh=mesh,
        provenance=provenance,
        sigma_mm=np.full(n, 0.1, dtype=np.float32),
        pair_bits=np.ones(n, dtype=np.int32),
        pair_names=("front",),
        convergence=np.zeros(1),
    )


def true_boundaries(solid: SubjectSolid, vertices: Float64[Array, "n 3"]) -> tuple[Boundary, ...]:
    """Curves at which skin and chest wall separate."""
    return tuple(
        Boundary(name=name, points_world=vertices[solid.breasts[name].boundary], method="true")  # type: ignore[arg-type]
        for name in SIDES
    )


def walls_of(subject: TrueTorso, settings: MeasureSettings = MeasureSettings()) -> Iterator[dict[str, object]]:
    """Rows of breasts and walls, with error, base and skin."""
    for breast in open_breasts(subject.boundaries, subject.surface, settings):
        boundary = breast.boundary
        truth = subject.solid.closed_breast(boundary.name).volume_mm3() / 1000
        for wall in chest_wall.fit_all(breast):
            yield {
                "torso": subject.solid.name,
                "side": boundary.name,
                "wall": wall.kind,
                "true_cc": truth,
                "volume_cc": wall.closed.volume_mm3() / 1000,
                "base_cm2": wall.mesh.area_mm2() / 100,
            }


def table(rows: list[dict[str, object]]) -> Iterator[str]:
    """The comparison in Markdown, one row per wall, and the interval's constants by these torsos."""
    yield "| wall | breasts | bias cc | SD cc | worst cc | error % | SD of ln(right/left) % | 95 % of error/base mm |"
    yield "| --- " * 8 + "|"
    found: dict[str, dict[tuple[str, str], tuple[float, float, float]]] = {}
    for row in rows:
        truth, volume, base = (float(row[name]) for name in ("true_cc", "volume_cc", "base_cm2"))  # type: ignore[arg-type]
        found.setdefault(str(row["wall"]), {})[str(row["torso"]), str(row["side"])] = (truth, volume, base)
    for wall, breasts in found.items():
        truth, volume, base = np.array(list(breasts.values())).T
        error = volume - truth
        ratios = np.array(list(_ratio_errors(breasts).values()))
        yield (
            f"| {wall} | {len(error)} | {error.mean():+.1f} | {error.std(ddof=1):.1f} | "
            f"{error[np.argmax(np.abs(error))]:+.1f} | {100 * (error / truth).mean():+.1f} ± "
            f"{100 * (error / truth).std(ddof=1):.1f} | {100 * ratios[:, 0].std(ddof=1):.1f} | "
            f"{10 * np.quantile(np.abs(error) / base, 0.95):.1f} |"
        )
    default = next(iter(found))
    unshared = np.array(list(_ratio_errors(found[default]).values()))
    left, right = (
        np.array([volume - truth for (_, side), (truth, volume, _) in found[default].items() if side == name])
        for name in SIDES
    )
    volumes_cc = np.array(list(found[default].values()))[:, 0]
    yield ""
    common = float(np.corrcoef(left, right)[0, 1])
    yield (
        f"breasts of {volumes_cc.min():.0f} to {volumes_cc.max():.0f} cc; {default}: errors of both sides correlate "
        f"{common:.2f}; 95 % of what they do not share {np.quantile(unshared[:, 1], 0.95):.2f} mm"
    )
    holds = [
        abs(volume - truth) <= TORSO_WALLS[default].off_u95_mm(base) * base / 10
        for truth, volume, base in found[default].values()
    ]
    yield f"the interval's wall term alone holds the truth in {100 * np.mean(holds):.1f} % of {len(holds)} breasts"


def _ratio_errors(breasts: dict[tuple[str, str], tuple[float, float, float]]) -> dict[str, tuple[float, float]]:
    """Torso → error of ln(right/left), and that over √((A/V)² + (A/V)²), mm."""
    errors = {}
    for name in dict.fromkeys(key[0] for key in breasts):
        if not all((name, side) in breasts for side in SIDES):
            continue  # the wall did not fit one of both
        (true_left, left, base_left), (true_right, right, base_right) = (breasts[name, side] for side in SIDES)
        error = float(np.log(right / left) - np.log(true_right / true_left))
        errors[name] = (error, 10 * abs(error) / float(np.hypot(base_left / left, base_right / right)))
    return errors


def main() -> None:
    """Make the torsos, print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--bodies", type=int, default=36, help="of each family")
    parser.add_argument("--first", type=int, default=1, help="number of the first one")
    parser.add_argument("--families", nargs="+", default=["torso"], choices=("torso", *FAMILIES))
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, default=None, help="JSON: rows of every breast and wall; taken if there")
    arguments = parser.parse_args()
    rows: list[dict[str, object]] = []
    if arguments.out is not None and arguments.out.is_file():
        rows = json.loads(arguments.out.read_text())
    there = {row["torso"] for row in rows}
    for family in arguments.families:
        for number in range(arguments.first, arguments.first + arguments.bodies):
            name = f"{family}_{number}"
            if name in there:
                continue
            try:
                rows += walls_of(true_torso(name, arguments.seed))
            except ValueError as error:  # the simulator cannot make every woman
                print(error)
            if arguments.out is not None:
                arguments.out.write_text(json.dumps(rows))
    for family in arguments.families:
        print(f"\n{family}\n")
        print("\n".join(table([row for row in rows if str(row["torso"]).rpartition("_")[0] == family])))


if __name__ == "__main__":
    main()
