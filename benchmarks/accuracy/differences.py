"""Shared errors of both breasts on virtual women: of the wall, and of a found boundary.

    python -m benchmarks.accuracy.differences --women 8 --first 500

No photographs: open fronts, as for `benchmarks.accuracy.women`. The wall's error is that of the volume within the true
boundary; the boundary's is what the found one adds. Each is divided by the interval's term for it. Prints the
correlations of left and right, about zero, which is what cancels, and about the mean, with 95 % of bootstrap draws.
Errors beyond twice the term count as twice, so that one lost border does not decide. `sources.WALL_CORRELATION` and
`BOUNDARY_CORRELATION` are held against them. Develop on numbers below 1000.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator

import numpy as np

from benchmarks.accuracy.women import FAMILIES, SIDES
from mammometry.base.errors import MammometryError
from mammometry.geometry.arrays import Array, Float64
from mammometry.geometry.mesh import TriangleMesh
from mammometry.measure import scanned
from mammometry.measure.boundary.boundary import Boundary, outline_torso
from mammometry.measure.scan_repair import RepairedScan
from mammometry.measure.settings import MeasureSettings
from mammometry.measure.trunk.body import find_body
from mammometry.measure.volume.measurement import VolumeMeasurement
from mammometry.measure.volume.sources import BOUNDARY, WALL
from mammometry.measure.volume.volumes import measure_volumes
from mammometry.measure.wall.open_breast import open_breasts
from mammometry.simulate.subjects.woman import woman_named

_UPRIGHT = np.eye(3)
_LARGEST = 2.0  # terms at 95 %, beyond which an error counts as so much
_DRAWS = 4000  # of the bootstrap
_EDGE_MM = 3.0  # of the bodies' triangles; chosen for speed


def errors_of(name: str) -> tuple[Float64[Array, 2], Float64[Array, 2]] | None:
    """Errors of the wall and of the found boundary over their terms, left and right. None if a side was not found."""
    made = woman_named(name, 0, edge_mm=_EDGE_MM)
    front = made.front()
    true = tuple(
        Boundary(name=side, points_world=made.solid.mesh.vertices[made.solid.breasts[side].boundary], method="true")  # type: ignore[arg-type]
        for side in SIDES
    )
    found = outline_torso(scanned.as_scanned(front), _UPRIGHT).boundaries
    if {boundary.name for boundary in found} != set(SIDES):
        return None
    within_true, within_found = _measured(front, true), _measured(front, found)
    flat_cc = {side: made.solid.closed_breast(side).volume_mm3() / 1000 for side in SIDES}
    wall = [(within_true[side].volume_cc - flat_cc[side]) / within_true[side].interval_terms_cc[WALL] for side in SIDES]
    boundary = [
        (within_found[side].volume_cc - within_true[side].volume_cc) / within_found[side].interval_terms_cc[BOUNDARY]
        for side in SIDES
    ]
    return np.array(wall), np.array(boundary)


def _measured(front: TriangleMesh, boundaries: tuple[Boundary, ...]) -> dict[str, VolumeMeasurement]:
    curves = [boundary.points_world for boundary in boundaries]
    surface = scanned.as_scanned(scanned.finer_scan(RepairedScan.unchanged(front), curves).mesh)
    frame = find_body(surface, _UPRIGHT, boundaries=curves).frame
    breasts = open_breasts(boundaries, surface, MeasureSettings(), frame=frame)
    return {measured.name: measured for measured in measure_volumes(breasts)}


def correlations(pairs: Float64[Array, "n 2"]) -> Iterator[str]:
    """Yield the correlation of left and right about zero and about the mean, with 95 % of bootstrap draws."""
    kept = np.clip(pairs, -_LARGEST, _LARGEST)
    rng = np.random.default_rng(0)
    for about, middle in (("zero", 0.0), ("the mean", kept.mean(axis=0))):
        shifted = kept - middle
        drawn = shifted[rng.integers(0, len(kept), (_DRAWS, len(kept)))]
        low, high = np.quantile(_correlation(drawn), (0.025, 0.975))
        yield f"{float(_correlation(shifted)):.2f} ({low:.2f} … {high:.2f}) about {about}"


def _correlation(pairs: Float64[Array, "*d n 2"]) -> Float64[Array, "*d"]:
    return np.asarray(2 * pairs.prod(axis=-1).sum(axis=-1) / (pairs**2).sum(axis=(-1, -2)))


def main() -> None:
    """Make the women, print the correlations."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--women", type=int, default=8, help="of each family")
    parser.add_argument("--first", type=int, default=500)
    parser.add_argument("--families", nargs="*", default=list(FAMILIES), choices=FAMILIES)
    arguments = parser.parse_args()
    found = []
    for family in arguments.families:
        for number in range(arguments.first, arguments.first + arguments.women):
            try:
                errors = errors_of(f"{family}_{number}")
            except (MammometryError, ValueError) as error:  # the simulator cannot make every one
                print(f"{family}_{number}: {error}".replace("\n", " "), flush=True)
                continue
            if errors is not None:
                print(f"{family}_{number}: {np.round(errors, 2).tolist()}", flush=True)
                found.append(errors)
    print("\n| error over its term | pairs | RMS | correlation | correlation |\n| --- | --- | --- | --- | --- |")
    for name, pairs in zip(("wall", "found boundary"), np.array(found).transpose(1, 0, 2), strict=True):
        print(f"| {name} | {len(pairs)} | {np.sqrt(np.mean(pairs**2)):.2f} | {' | '.join(correlations(pairs))} |")


if __name__ == "__main__":
    main()
