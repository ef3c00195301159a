"""Coverage of the uncertainty that an acceptance test states.

    python -m benchmarks.accuracy.acceptance --draws 1000
    python -m benchmarks.accuracy.acceptance --rig
    python -m benchmarks.accuracy.acceptance --balls

The first draws a ball of 145 mm and a bar of 300 mm with balls of 60 mm again and again, each time with new errors of
the device and a new reference value within the artefact's uncertainty. Prints how often the expanded uncertainty (95 %)
contains the error, with errors that are independent from point to point, and with ones that neighbouring points share.

The second tests a virtual rig with known errors, from photographs to verdict, and the third measures balls in coarse
and in finer photographs: see `acceptance_photographs`.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from benchmarks.accuracy.acceptance_photographs import print_balls, print_table
from mammometry.simulate.artefacts import DeviceErrors, shared_errors
from mammometry.simulate.subjects.artefacts import artefact_mesh
from mammometry.study.acceptance.artefacts import POSITIONS, Bar, Limits, Sphere
from mammometry.study.acceptance.evaluate import AcceptanceFinding, bar_result, sphere_result
from mammometry.study.acceptance.fits import fit_sphere, within_rule
from mammometry.study.acceptance.patches import SpherePatch
from mammometry.study.acceptance.spheres import find_sphere, find_two_spheres

BALL = Sphere(diameter_mm=145.0, diameter_std_mm=0.02, form_std_mm=0.02, source="drawn")
BAR = Bar(distance_mm=300.0, distance_std_mm=0.03, diameter_mm=60.0, diameter_std_mm=0.02, source="drawn")
ERRORS = (
    DeviceErrors(noise_mm=0.1),
    DeviceErrors(noise_mm=0.05, shared_mm=0.05, shared_over_mm=4.0),
    DeviceErrors(noise_mm=0.05, shared_mm=0.05, shared_over_mm=8.0),
)


def again(patch: SpherePatch, errors: DeviceErrors, rng: np.random.Generator) -> SpherePatch:
    """The same patch of an exact ball, measured with new errors."""
    unit = (patch.points - patch.fit.centre) / np.linalg.norm(patch.points - patch.fit.centre, axis=1, keepdims=True)
    offsets = errors.noise_mm * rng.normal(size=len(unit))
    offsets += errors.shared_mm * shared_errors(patch.points, errors.shared_over_mm, rng)
    points = patch.points + offsets[:, None] * unit
    kept = within_rule(patch.fit.deviations(points))
    return replace(patch, points=points, fit=fit_sphere(points[kept], patch.weights[kept], patch.fit))


def draws(errors: DeviceErrors, count: int) -> Iterator[AcceptanceFinding]:
    """Findings whose errors should lie within their uncertainty."""
    rng = np.random.default_rng(1)
    ball = find_sphere(artefact_mesh(BALL, POSITIONS["sphere"][0]), BALL.diameter_mm)
    ends = find_two_spheres(artefact_mesh(BAR, POSITIONS["bar"][0]), BAR.diameter_mm, BAR.distance_mm)
    for _ in range(count):
        about = replace(BALL, diameter_mm=rng.normal(BALL.diameter_mm, BALL.diameter_std_mm))
        yield sphere_result(again(ball, errors, rng), "1", about, Limits()).findings[1]
        bar = replace(
            BAR,
            distance_mm=rng.normal(BAR.distance_mm, BAR.distance_std_mm),
            diameter_mm=rng.normal(BAR.diameter_mm, BAR.diameter_std_mm),
        )
        yield from bar_result((again(ends[0], errors, rng), again(ends[1], errors, rng)), "1", bar, Limits()).findings


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--draws", type=int, default=1000)
    parser.add_argument("--rig", action="store_true", help="a virtual rig with errors put in")
    parser.add_argument("--balls", action="store_true", help="balls in coarse and in finer photographs")
    chosen = parser.parse_args()
    if chosen.rig:
        print_table()
        return
    if chosen.balls:
        print_balls()
        return
    count = chosen.draws
    print("| errors of the device | error | within ± 95 % | SD of the error, mm | mean ± 95 %, mm |")
    print("| --- | --- | --- | --- | --- |")
    for errors in ERRORS:
        found = list(draws(errors, count))
        alike = f", {errors.shared_mm:g} mm shared over {errors.shared_over_mm:g} mm" if errors.shared_mm else ""
        for quantity in ("size", "spacing", "length"):
            own = [one for one in found if one.quantity == quantity]
            inside = np.mean([abs(one.error) <= one.expanded for one in own])
            spread, stated = np.std([one.error for one in own]), np.mean([one.expanded for one in own])
            print(
                f"| {errors.noise_mm:g} mm independent{alike} | {quantity} | {100 * inside:.1f} % | {spread:.4f} | "
                f"{stated:.4f} |"
            )


if __name__ == "__main__":
    main()
