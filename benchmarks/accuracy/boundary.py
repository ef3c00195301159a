"""The automatic boundary on torsos with a known one, compared with the earlier level rule.

    python -m benchmarks.accuracy.boundary

No photographs: the skin is the simulator's own, as far as cameras in front would see it, with noise along its normals,
and the frame that tells head from foot is tilted at random. Prints for both rules how many breasts were outlined and
could be cut out, the distance of the curve from the true boundary, and the error of the volume with the default wall;
and that error from the true boundary, which is the wall's own. The level rule ends a breast where it stands out less
than 2 mm from the thorax, and draws the boundary 8 mm further out.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from scipy.ndimage import gaussian_filter1d, median_filter
from scipy.spatial.transform import Rotation

from benchmarks.accuracy.walls import SIDES, TrueTorso, as_seen, true_torso
from mammometry.base.errors import MeasureError
from mammometry.geometry.arrays import Array, Float64
from mammometry.geometry.mesh import TriangleMesh
from mammometry.geometry.nearest import closest_on_mesh
from mammometry.measure.boundary.boundary import Boundary
from mammometry.measure.boundary.breasts import Breasts, Outline, find_breasts
from mammometry.measure.boundary.prominence import breast_middles
from mammometry.measure.boundary.protocol import NEEDED, outline_by_protocol
from mammometry.measure.landmarks.landmarks import picked_landmarks
from mammometry.measure.settings import ProtocolJoin
from mammometry.measure.trunk.skin_map import dense_samples, lay_flat
from mammometry.measure.trunk.thorax import seen_faces
from mammometry.measure.wall import chest_wall
from mammometry.measure.wall.open_breast import OpenBreast
from mammometry.study.evaluation import compare_boundaries
from mammometry.surface.repair.repair import RepairedSurface

_VANISH_MM, _MARGIN_MM, _RISE_MM, _REACH_MM, _DIRECTIONS = 2.0, 8.0, 1.5, 120.0, 72
JOINS: tuple[ProtocolJoin, ...] = ("arc", "geodesic")
_AHEAD = np.array([0.0, 0.0, 1.0])


def noisy(subject: TrueTorso, noise_mm: float, rng: np.random.Generator) -> RepairedSurface:
    """The torso's skin, every vertex moved along its normal."""
    mesh = subject.solid.mesh
    moved = mesh.vertices + mesh.vertex_normals() * rng.normal(0.0, noise_mm, len(mesh.vertices))[:, None]
    return as_seen(TriangleMesh(vertices=moved, faces=mesh.faces))


def by_level(surface: RepairedSurface, breasts: Breasts) -> tuple[Boundary, ...]:
    """The rule that the crease replaced, on the same thorax, relief and middles."""
    thorax = breasts.thorax
    relief = lay_flat(thorax, dense_samples(surface.mesh.submesh(seen_faces(surface))))
    angles = np.arange(_DIRECTIONS) * 2 * np.pi / _DIRECTIONS
    rays = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    steps = np.arange(2.0, _REACH_MM, 2.0)
    found = []
    for name, middle in breast_middles(relief, thorax.trunk).items():
        if middle is None:
            continue
        profile = relief.at(middle.flat + rays[:, None] * steps[:, None], relief.smooth_mm(2.0))
        fallen = np.where(profile < np.maximum.accumulate(profile, axis=1) / 2, profile, np.inf)
        ended = (profile < _VANISH_MM) | (profile > np.minimum.accumulate(fallen, axis=1) + _RISE_MM)
        last = np.where(ended.any(axis=1), np.argmax(ended, axis=1), len(steps) - 1)
        fallen[steps[None] > steps[last][:, None]] = np.inf
        valley = np.where(np.isfinite(fallen).any(axis=1), np.argmin(fallen, axis=1), last)
        reach = np.asarray(median_filter(steps[valley], size=5, mode="wrap")) + _MARGIN_MM
        flat = middle.flat + rays * np.asarray(gaussian_filter1d(reach, 2.0, mode="wrap"))[:, None]
        radius = thorax.radius_mm(flat) + relief.at(flat, relief.bulge_mm)
        world = thorax.trunk.world(np.concatenate([flat, radius[:, None]], axis=1))
        on_skin = closest_on_mesh(world, surface.mesh).points
        found.append(Boundary(name=name, points_world=on_skin, method="level"))
    return tuple(found)


def by_crease(breasts: Breasts) -> tuple[Boundary, ...]:
    """The rule in use."""
    return tuple(
        Boundary(name=name, points_world=outline.points_world, method="crease")  # type: ignore[arg-type]
        for name, outline in zip(SIDES, (breasts.left, breasts.right), strict=True)
        if isinstance(outline, Outline)
    )


def by_landmarks(subject: TrueTorso, surface: RepairedSurface, join: ProtocolJoin) -> tuple[Boundary, ...]:
    """The protocol, from the true landmarks."""
    picked = {
        name: points
        for name, points in subject.solid.landmarks.items()
        if any(name.startswith(needed) for needed in NEEDED)
    }
    marks = picked_landmarks(picked, surface.mesh, np.eye(3), sigma_mm=2.0)
    found = outline_by_protocol(marks, surface, np.eye(3), join)
    return tuple(
        Boundary(name=side, points_world=outline.points_world, method=join)  # type: ignore[arg-type]
        for side, outline in found.items()
    )


def rows_of(subject: TrueTorso, noise_mm: float, tilt_deg: float, seed: int) -> Iterator[dict[str, object]]:
    """One row a breast and rule."""
    rng = np.random.default_rng([seed, int(subject.solid.name.rpartition("_")[2])])
    surface = noisy(subject, noise_mm, rng)
    true = {edge.name: edge.points_world for edge in subject.boundaries}
    rules: dict[str, tuple[Boundary, ...]] = {"true": subject.boundaries}
    try:
        tilted = Rotation.from_rotvec(np.deg2rad(tilt_deg) * rng.uniform(-1, 1, 3)).as_matrix()
        breasts = find_breasts(surface, tilted)
        rules |= {"level": by_level(surface, breasts), "crease": by_crease(breasts)}
        rules |= {join: by_landmarks(subject, surface, join) for join in JOINS}
    except MeasureError as error:
        print(f"{subject.solid.name}: {error}")
        rules |= {rule: () for rule in ("level", "crease", *JOINS)}
    for rule, boundaries in rules.items():
        drawn = {boundary.name: boundary for boundary in boundaries}
        for side in SIDES:
            row: dict[str, object] = {"torso": subject.solid.name, "side": side, "rule": rule}
            row["true_cc"] = subject.solid.closed_breast(side).volume_mm3() / 1000
            if side in drawn:
                apart = compare_boundaries(drawn[side].points_world, true[side], _AHEAD)
                row |= {"mean_mm": apart.mean_mm, "p95_mm": apart.p95_mm, "worst_mm": apart.worst_mm}
                try:
                    wall = chest_wall.fit(OpenBreast(boundary=drawn[side], surface=surface, boundaries=boundaries))
                    row["volume_cc"] = wall.closed.volume_mm3() / 1000
                except MeasureError:
                    pass  # a curve that cannot be followed: no volume
            yield row


def table(rows: list[dict[str, object]]) -> Iterator[str]:
    """The comparison in Markdown, one row a rule."""
    yield (
        "| boundary | breasts | outlined | measured | mean distance mm | worst breast's mean mm | "
        "largest distance mm | error cc | error % | worst % |"
    )
    yield "| --- " * 10 + "|"
    for rule in ("level", "crease", *JOINS, "true"):
        own = [row for row in rows if row["rule"] == rule]
        outlined = [row for row in own if "mean_mm" in row]
        measured = [row for row in outlined if "volume_cc" in row]
        mean, worst = (_column(outlined, name) for name in ("mean_mm", "worst_mm"))
        true, volume = (_column(measured, name) for name in ("true_cc", "volume_cc"))
        error = 100 * (volume / true - 1)
        yield (
            f"| {rule} | {len(own)} | {len(outlined)} | {len(measured)} | {mean.mean():.1f} | {mean.max():.1f} | "
            f"{worst.max():.1f} | {(volume - true).mean():+.1f} ± {(volume - true).std(ddof=1):.1f} | "
            f"{error.mean():+.1f} ± {error.std(ddof=1):.1f} | {error[np.argmax(np.abs(error))]:+.1f} |"
        )


def _column(rows: list[dict[str, object]], name: str) -> Float64[Array, " n"]:
    return np.array([float(row[name]) for row in rows])  # type: ignore[arg-type]


def main() -> None:
    """Make the torsos, print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--torsos", type=int, default=24)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--noise-mm", type=float, default=0.15)
    parser.add_argument("--tilt-deg", type=float, default=8.0)
    parser.add_argument("--out", type=Path, default=None, help="JSON: rows of every breast and rule")
    arguments = parser.parse_args()
    rows: list[dict[str, object]] = []
    for number in range(1, arguments.torsos + 1):
        subject = true_torso(f"torso_{number}", arguments.seed)
        rows += rows_of(subject, arguments.noise_mm, arguments.tilt_deg, arguments.seed)
    if arguments.out is not None:
        arguments.out.write_text(json.dumps(rows))
    print("\n".join(table(rows)))


if __name__ == "__main__":
    main()
