"""Every chest wall on torsos of exactly known volume: what each makes of the same skin and the same boundary.

    python -m benchmarks.accuracy.walls

No photographs: the skin is the simulator's own, as far as cameras in front would see it, the boundary the true one (or
with --boundary found by itself), the true wall the skin of the same body without the breast. Prints bias, standard
deviation, worst error, relative error and the spread of the left/right ratio for every wall, and the constants of the
interval (`measure.settings`): of a volume, of both sides' difference, of the boundary.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mammometry.geometry.arrays import Array, Float64
from mammometry.geometry.mesh import TriangleMesh
from mammometry.measure import chest_wall
from mammometry.measure.boundary import Boundary
from mammometry.measure.settings import MeasureSettings
from mammometry.simulate.solid import Solid, rig_from_solid
from mammometry.simulate.torso import torso, torso_shape
from mammometry.surface.repair import Provenance, RepairedSurface

SIDES = ("left", "right")
_SEEN_COSINE = -0.3
_EDGE_MM = 2.0


@dataclass(frozen=True)
class TrueTorso:
    """A torso of the simulator as it stands before the cameras."""

    solid: Solid
    """Placed; its frame is the rig's: x to the patient's left, y up, z towards the cameras."""
    surface: RepairedSurface
    """Its skin; the back is marked as invented."""
    boundaries: tuple[Boundary, ...]
    """True ones, left and right."""


def true_torso(name: str, seed: int, *, edge_mm: float = _EDGE_MM) -> TrueTorso:
    """Make a torso and say which of its skin cameras in front would see."""
    solid = torso(torso_shape(name, seed), name=name, seed=seed, edge_mm=edge_mm)
    solid = solid.placed(rig_from_solid(solid, seed))
    return TrueTorso(solid=solid, surface=as_seen(solid.mesh), boundaries=true_boundaries(solid, solid.mesh.vertices))


def as_seen(mesh: TriangleMesh) -> RepairedSurface:
    """A closed mesh as a repaired surface; what faces away from the cameras is invented."""
    facing = np.zeros((len(mesh.vertices), 3))
    for corner in range(3):
        np.add.at(facing, mesh.faces[:, corner], mesh.face_vectors())
    facing /= np.maximum(np.linalg.norm(facing, axis=1, keepdims=True), 1e-12)
    provenance = np.where(facing[:, 2] > _SEEN_COSINE, Provenance.MEASURED, Provenance.INVENTED).astype(np.uint8)
    n = len(mesh.vertices)
    return RepairedSurface(
        mesh=mesh,
        provenance=provenance,
        sigma_mm=np.full(n, 0.1, dtype=np.float32),
        pair_bits=np.ones(n, dtype=np.int32),
        pair_names=("front",),
        convergence=np.zeros(1),
    )


def true_boundaries(solid: Solid, vertices: Float64[Array, "n 3"]) -> tuple[Boundary, ...]:
    """The curves where skin and chest wall part."""
    return tuple(
        Boundary(name=name, points_world=vertices[solid.breasts[name].boundary], method="true")  # type: ignore[arg-type]
        for name in SIDES
    )


def walls_of(subject: TrueTorso, settings: MeasureSettings = MeasureSettings()) -> Iterator[dict[str, object]]:
    """One row a breast and wall: its error, its base, its skin."""
    for boundary in subject.boundaries:
        truth = subject.solid.closed_breast(boundary.name).volume_mm3() / 1000
        for wall in chest_wall.fit_all(boundary, subject.surface, settings, boundaries=subject.boundaries):
            yield {
                "torso": subject.solid.name,
                "side": boundary.name,
                "wall": wall.kind,
                "true_cc": truth,
                "volume_cc": wall.closed.volume_mm3() / 1000,
                "base_cm2": wall.mesh.area_mm2() / 100,
            }


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--torsos", type=int, default=36)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, default=None, help="rows of every breast and wall, JSON")
    arguments = parser.parse_args()
    rows: list[dict[str, object]] = []
    for number in range(1, arguments.torsos + 1):
        rows += walls_of(true_torso(f"torso_{number}", arguments.seed))
    if arguments.out is not None:
        arguments.out.write_text(json.dumps(rows))


if __name__ == "__main__":
    main()
