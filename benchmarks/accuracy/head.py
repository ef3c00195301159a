"""Direction of the head: upright bodies must be measured, and inverted ones noticed.

    python -m benchmarks.accuracy.head --seeds 100-189
    python -m benchmarks.accuracy.head --seeds 300-344 --mounds

No photographs: the skin is the simulator's own, where some pair of the reference rig sees it. Patients are drawn by
their seed (held-out seeds are skipped); arms are in turn as drawn, raised, at the sides and on a frame, and every third
group of four is seen by cameras on their sides. `--mounds` rebuilds both breasts as mounds without fold instead, so
that breasts say nothing. Each body is outlined as it stands, and by the same cameras as though they hung upside down.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from benchmarks.accuracy.clinic import _numbers as numbers
from mammometry.base.errors import MeasureError
from mammometry.geometry.arrays import Array, Float64
from mammometry.geometry.camera import Rig
from mammometry.geometry.mesh import TriangleMesh
from mammometry.measure.boundary.boundary import outline_torso
from mammometry.measure.trunk.body import rig_frame
from mammometry.simulate.disturbances.draw import draw, is_held_out
from mammometry.simulate.disturbances.exposure import turned, with_cameras
from mammometry.simulate.disturbances.registry import disturbed
from mammometry.simulate.recipe import Disturbance, Situation
from mammometry.simulate.rigs.build import REFERENCE, build_rig
from mammometry.simulate.subjects.registry import make_subject
from mammometry.simulate.subjects.solid import rig_from_solid
from mammometry.simulate.subjects.torso_shape import SIDES, TorsoShape
from mammometry.study.rays import RayScene, seen_by_pairs
from mammometry.surface.repair.repair import Provenance, RepairedSurface

_ARMS = ("", "raised", "sides", "frame")
"""In turn; as drawn where empty."""
_ON_SIDE_EVERY = 3
_SCALE, _EDGE_MM = 0.15, 3.0
_MOUNDS_CC = (80.0, 400.0)
_ANSWERS = ("head up", "not shown", "refused: head", "refused: else")


@dataclass(frozen=True)
class Body:
    """One body as the pairs see it."""

    name: str
    surface: RepairedSurface
    upright: Float64[Array, "3 3"]
    """Frame of cameras that are mounted as session.toml says."""


def both_mounds(shape: TorsoShape, *, situation: Situation, seed: int) -> TorsoShape:
    """Rebuild each side by the disturbance that rebuilds one."""
    first = disturbed(shape, "patient", situation, seed)
    done = next(side for side in SIDES if first.breasts[side].fullness == 0.0)
    other = next(side for side in SIDES if side != done)
    lacking = replace(shape, breasts={**shape.breasts, other: replace(shape.breasts[other], removed=True)})
    second = disturbed(lacking, "patient", situation, seed + 1)  # the side that is removed is rebuilt
    return replace(first, breasts={done: first.breasts[done], other: second.breasts[other]})


def bodies(seeds: list[int], mounds: bool) -> Iterator[Body]:
    """Make the bodies of the seeds that are not held out."""
    for seed in seeds:
        if is_held_out(seed):
            continue
        rng = np.random.default_rng([seed, 19])
        patient = list(draw(seed, 0).disturbances)
        if mounds:
            build = str(rng.choice(["", "thin", "obese"]))
            patient = [Disturbance(name="mound", size=f"{rng.uniform(*_MOUNDS_CC):.3g}")]
            patient += [Disturbance(name="build", size=build)] if build else []
        arms = _ARMS[seed % len(_ARMS)]
        if arms:
            patient = [one for one in patient if one.name != "arms"] + [Disturbance(name="arms", size=arms)]
        situation = Situation(disturbances=tuple(patient))
        make = both_mounds if mounds else partial(disturbed, stage="patient")
        try:
            solid = make_subject("torso", seed, edge_mm=_EDGE_MM, reshape=partial(make, situation=situation, seed=seed))
        except ValueError as error:  # not every body can be made
            print(error)
            continue
        solid = solid.placed(rig_from_solid(solid, seed))
        rig = build_rig(REFERENCE, _SCALE, seed)
        upright = rig_frame(rig)
        if (seed // len(_ARMS)) % _ON_SIDE_EVERY == _ON_SIDE_EVERY - 1:
            rig = with_cameras(rig, lambda camera: turned(camera, np.array([0.0, 0.0, math.pi / 2])))
        yield Body(name=f"{seed}: {situation}", surface=as_pairs_see(solid.mesh, rig), upright=upright)


def as_pairs_see(mesh: TriangleMesh, rig: Rig) -> RepairedSurface:
    """A closed mesh as a repaired surface; what no pair sees is invented."""
    seen = np.any(list(seen_by_pairs(RayScene(mesh), rig)[1].values()), axis=0)
    n = len(mesh.vertices)
    return RepairedSurface(
        mesh=mesh,
        provenance=np.where(seen, Provenance.MEASURED, Provenance.INVENTED).astype(np.uint8),
        sigma_mm=np.full(n, 0.1, dtype=np.float32),
        pair_bits=np.ones(n, dtype=np.int32),
        pair_names=("any",),
        convergence=np.zeros(1),
    )


def answer(surface: RepairedSurface, frame: Float64[Array, "3 3"]) -> str:
    """What is said of the head, one of `_ANSWERS`."""
    try:
        found = outline_torso(surface, frame)
    except MeasureError as error:
        return _ANSWERS[2 if "head at the lower end" in str(error) else 3]
    unsure = any("head-not-shown" in boundary.remarks for boundary in found.boundaries)
    return _ANSWERS[1 if unsure else 0]


def main() -> None:
    """Make the bodies, ask each twice, print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=numbers, default=numbers("100-189"))
    parser.add_argument("--mounds", action="store_true", help="both breasts are mounds without fold")
    arguments = parser.parse_args()
    said: dict[str, list[str]] = {"upright": [], "turned over": []}
    for body in bodies(arguments.seeds, arguments.mounds):
        for way, turn in (("upright", np.eye(3)), ("turned over", np.diag([-1.0, -1.0, 1.0]))):
            said[way].append(answer(body.surface, turn @ body.upright))
        print(f"{body.name}: {said['upright'][-1]}; turned over: {said['turned over'][-1]}", flush=True)
    print("\n| cameras | bodies | " + " | ".join(_ANSWERS) + " |\n" + "| --- " * (2 + len(_ANSWERS)) + "|")
    for way, answers in said.items():
        counts = " | ".join(str(answers.count(one)) for one in _ANSWERS)
        print(f"| {way} | {len(answers)} | {counts} |")


if __name__ == "__main__":
    main()
