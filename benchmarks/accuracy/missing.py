"""Visible skin that was not measured: the pair that came furthest, and the step that lost it.

    python -m benchmarks.accuracy.missing CAPTURES [--subject torso_rail] [--scale 0.25]

CAPTURES is a folder laid out as ../shared/data/rendered, or a session of `mammometry simulate`. Looked at are the
truth's vertices that at least one pair sees (below 75° in both cameras), and that lie more than a millimetre from the
finished surface. For each such pair the datum is followed from the photograph to the surface, up to the step that lost
it. A vertex that several pairs could have measured counts for the one that came furthest. Areas are of the true skin.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.accuracy.captures import settings_for
from benchmarks.pairs import Capture, captures
from mammometry.api.job import Job, open_session
from mammometry.geometry.arrays import Array, Bool, Float64
from mammometry.geometry.camera import Camera
from mammometry.geometry.nearest import closest_on_mesh
from mammometry.geometry.transform import Transform
from mammometry.io.truth import read_truth
from mammometry.job.stages import calibrate, match, surface
from mammometry.matching.dense.crop import at_level, pasted
from mammometry.matching.dense.match import coarse_to_fine, prepare, requirements
from mammometry.matching.rectify import rectify
from mammometry.settings import Settings
from mammometry.study.accuracy import vertex_areas_mm2
from mammometry.study.rays import RayScene, inside, seen_by_pairs

_OFF_MM = 1.0
"""Distance from the surface above which skin is missing."""
STEPS = (
    "outside an outline",
    "at an outline's edge",
    "match not plausible",
    "match does not correlate",
    "match not settled",
    "left and right disagree",
    "match uncertain",
    "match on a small island",
    "match or range wrong",
    "no range, or its error too large",
    "seen at a grazing angle",
    "another pair sees through it, or a small island",
    "taken for hair",
    "measured, but the first surface is elsewhere",
    "measured, but repair moved it",
)
"""Where a datum can be lost, in the order of the method."""
_OF_REQUIREMENTS = dict(
    zip(("plausible", "correlates", "settled", "left and right agree", "certain"), STEPS[2:7], strict=True)
)


@dataclass(frozen=True)
class Missing:
    """What of one capture is missing."""

    name: str
    seen_cm2: float
    mean_mm: float
    rms_mm: float
    p95_mm: float
    complete_percent: float
    """Of the seen skin, within a millimetre."""
    areas_cm2: Mapping[str, float]
    """Step → true skin that was lost there."""
    distance_mm: Mapping[str, float]
    """Step → mean distance of that skin from the surface."""
    by_pair_cm2: Mapping[tuple[str, str], float]
    """(pair, step) → skin that the pair could have measured and lost there, whatever the others did."""


def missing(capture: Capture, settings: Settings, every: int) -> Missing:
    """Follow the missing skin of one capture."""
    job = open_session(capture.session, settings)
    job.ensure("surface", drawn=False)
    truth = read_truth(capture.truth, job.session.pair_names)
    looked_at, by_pair = seen_by_pairs(RayScene(truth.mesh), truth.rig, every=every)
    either = np.any(list(by_pair.values()), axis=0)
    at = looked_at[either]
    points = _truth_from_world(job, truth.rig_from_target).inverse().apply(truth.mesh.vertices[at])
    weights = vertex_areas_mm2(truth.mesh)[at] * every / 100
    mesh = job.plan[surface.repaired]().mesh
    away_mm = closest_on_mesh(points, mesh).distances_mm
    gone = away_mm > _OFF_MM
    first_mm = closest_on_mesh(points[gone], job.plan[surface.initial_surface]()).distances_mm
    step = np.full(int(gone.sum()), -1)
    by_pair_cm2: dict[tuple[str, str], float] = {}
    for pair, seen in by_pair.items():
        own = seen[either][gone]
        lost = np.where(own, _lost(job, pair, points[gone], first_mm), -1)
        step = np.maximum(step, lost)
        for number, name in enumerate(STEPS):
            by_pair_cm2[pair, name] = float(weights[gone][lost == number].sum())
    order = np.argsort(away_mm)
    shares = np.cumsum(weights[order]) / weights.sum()
    return Missing(
        name=capture.name,
        seen_cm2=float(weights.sum()),
        mean_mm=float(np.average(away_mm, weights=weights)),
        rms_mm=float(np.sqrt(np.average(away_mm**2, weights=weights))),
        p95_mm=float(away_mm[order][np.searchsorted(shares, 0.95)]),
        complete_percent=float(100 * np.average(~gone, weights=weights)),
        areas_cm2={name: float(weights[gone][step == number].sum()) for number, name in enumerate(STEPS)},
        distance_mm={
            name: float(np.average(away_mm[gone][step == number], weights=weights[gone][step == number]))
            for number, name in enumerate(STEPS)
            if (step == number).any()
        },
        by_pair_cm2=by_pair_cm2,
    )


def _truth_from_world(job: Job, rig_from_target: Mapping[str, Transform]) -> Transform:
    calibration = job.plan.value(calibrate.calibration)
    assert calibration is not None
    world = next(
        pose for pose, place in calibration.world_from_target.items() if np.allclose(place.matrix, np.eye(4), atol=1e-9)
    )
    return rig_from_target[world]


def _looked_up(image: Array, camera: Camera, points_world: Float64[Array, "n 3"]) -> Array:
    """Values of an image at the pixels nearest to points; 0 outside of it."""
    uv = camera.project(points_world)
    within = inside(camera, uv)
    column, row = np.rint(np.where(within[:, None], uv, 0)).astype(int).T
    return np.where(within, image[row, column], np.zeros(1, image.dtype))


def _lost(job: Job, pair: str, points: Float64[Array, "n 3"], first_mm: Float64[Array, " n"]) -> Array:
    """Number of the step at which a pair lost each point."""
    lost = np.full(len(points), -1)

    def lose(kept: Bool[Array, " n"], step: str) -> None:
        lost[(lost < 0) & ~kept] = STEPS.index(step)

    plan, inputs, rig = job.plan, job.inputs, job.plan[calibrate.cameras]().rig
    sides = inputs.pair_names[pair]
    foregrounds = [plan[match.foreground][name]() for name in sides]
    for foreground, name in zip(foregrounds, sides, strict=True):
        lose(_looked_up(foreground.mask, rig.cameras[name], points), "outside an outline")
    subjects = plan.value(match.subjects)
    rectified = rectify(
        rig.pair(pair),
        inputs.photographs[sides[0]],
        inputs.photographs[sides[1]],
        foregrounds[0],
        foregrounds[1],
        middle_world=None if subjects is None else subjects.middle_world,
    )
    disparity = plan[match.disparity][pair]()
    with ThreadPoolExecutor(2) as pool:
        begun = prepare(rectified, job.settings.matching, pool, lambda *_: None)
        found = coarse_to_fine(begun, job.settings.matching, pool, lambda *_: None)
    levels, shape = found.levels, disparity.valid.shape
    part = at_level(found.window, levels.coarsest - levels.finest, shape)
    for side, camera in zip(begun.images[0], (disparity.left, disparity.right), strict=True):
        lose(_looked_up(side.mask, camera, points), "at an outline's edge")
    for name, met in requirements(found, job.settings.matching).items():
        lose(_looked_up(pasted(met, part, shape), disparity.left, points), _OF_REQUIREMENTS[name])
    lose(_looked_up(disparity.valid, disparity.left, points), "match on a small island")
    image = plan[surface.range_image][pair]()
    lose(_looked_up(image.valid, image.camera, points), "no range, or its error too large")
    measured = _looked_up(image.range_mm, image.camera, points)
    true_mm = np.linalg.norm(points - image.camera.centre_world, axis=1)
    angles = plan[surface.keep_masks]().angles_rad[list(inputs.pair_names).index(pair)]
    cosine = np.cos(np.nan_to_num(_looked_up(angles, image.camera, points), nan=np.pi / 2))
    lose(np.abs(measured - true_mm) * np.maximum(cosine, 0.2) <= _OFF_MM, "match or range wrong")
    limit = np.radians(job.settings.surface.dents.angle_deg)
    with np.errstate(invalid="ignore"):
        lose(_looked_up(angles, image.camera, points) <= limit, "seen at a grazing angle")
    keep = plan[surface.keep_masks]().keep[list(inputs.pair_names).index(pair)]
    lose(_looked_up(keep, image.camera, points), "another pair sees through it, or a small island")
    strands = plan.value(surface.strands)
    if strands is not None:
        lose(~_looked_up(strands[pair], image.camera, points), "taken for hair")
    lose(first_mm <= _OFF_MM, "measured, but the first surface is elsewhere")
    lose(np.zeros(len(points), dtype=bool), "measured, but repair moved it")
    return lost


def table(found: Missing) -> Iterator[str]:
    """Yield Markdown: the figures, and the steps by area."""
    yield (
        f"**{found.name}**: {found.seen_cm2:.0f} cm² seen; {found.mean_mm:.2f} mm mean, {found.rms_mm:.2f} RMS, "
        f"{found.p95_mm:.2f} at 95 %; {found.complete_percent:.1f} % within {_OFF_MM:g} mm\n"
    )
    yield "| lost | cm² | % of seen | mm off | pairs, cm² |"
    yield "| --- | --- | --- | --- | --- |"
    for name, area in found.areas_cm2.items():
        own = {pair: cm2 for (pair, step), cm2 in found.by_pair_cm2.items() if step == name and cm2 > 0}
        pairs = ", ".join(f"{pair} {cm2:.1f}" for pair, cm2 in own.items())
        if area or own:
            off = f"{found.distance_mm[name]:.1f}" if name in found.distance_mm else "–"
            yield f"| {name} | {area:.1f} | {100 * area / found.seen_cm2:.2f} | {off} | {pairs} |"


def main() -> None:
    """Print a table for each capture."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("captures", type=Path, help="captures of the independent renderer, or a simulated session")
    parser.add_argument("--subject", action="append", default=[], help="one subject; may be repeated; default: all")
    parser.add_argument("--scale", type=float, default=1.0, help="of a simulated session's pictures")
    parser.add_argument("--every", type=int, default=3, help="judge every n-th true vertex")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        for capture in captures(arguments.captures, arguments.subject, Path(scratch)):
            print("\n".join(table(missing(capture, settings_for(arguments.scale), arguments.every))), flush=True)


if __name__ == "__main__":
    main()
