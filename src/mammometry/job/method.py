"""The whole method on one page, from photographs to volumes.

Each line enters a product: the function that computes it, and the products that it is computed from. Nothing is
computed here. `graph.Plan` computes a product, or reads it back, when its value is needed. The functions are in
`job.stages`, one file per stage. The decorator of each states what else is in the product's key: version, settings,
inputs of the session.

To replace the function of a line, or to add a line (docs/how-to/extend.md)::

    mm.open_session("SESSION", given={match.disparity: mine})
    mm.open_session("SESSION", method=longer)
"""

from collections.abc import Iterable, Mapping
from typing import Any, TypeVar

from mammometry.job.graph import Plan
from mammometry.job.products import Definition, Product
from mammometry.job.stages import calibrate, match, measure, surface

T = TypeVar("T")


def method(plan: Plan) -> None:
    """Enter all products of a session, or of a scan whose surface is given."""
    inputs = plan.inputs
    pairs, subject = inputs.pair_names, inputs.subject_kind

    # Calibrate: from photographs of a target to cameras. Paper 2.2.
    calibration = None
    if plan.plans("calibrate") and inputs.calibrates:
        seen = {pose: plan(calibrate.observation, item=pose) for pose in inputs.poses}
        lenses = {camera: plan(calibrate.lens_observation, item=camera) for camera in inputs.intrinsics_photographs}
        calibration = plan(calibrate.calibration, seen, lenses)
    cameras = plan(calibrate.cameras, calibration)

    # Match: from photographs and cameras to the subject's outlines and to disparities. Paper 2.3.
    plan(match.names, cameras)
    photographs = {camera: plan(match.photograph, item=camera) for camera in inputs.photographs}
    subjects = None if inputs.all_masks_given else plan(match.subjects, cameras)
    foregrounds = {
        camera: plan(match.foreground, photograph, None if camera in inputs.masks else subjects, item=camera)
        for camera, photograph in photographs.items()
    }
    rectified = {
        pair: plan(match.rectified, cameras, of(both, photographs), of(both, foregrounds), subjects, item=pair)
        for pair, both in pairs.items()
    }
    disparities = {pair: plan(match.disparity, rectified[pair], item=pair) for pair in pairs}
    rows = {pair: plan(match.vertical_residual, disparities[pair], item=pair) for pair in pairs}

    # Surface: from disparities to the closed, coloured surface. Paper 2.4 to 2.6.
    ranges = {pair: plan(surface.range_image, disparities[pair], item=pair) for pair in pairs}
    motion = plan(surface.stillness, cameras, calibration, ranges, rows, subjects)
    walk = plan(surface.walk_motion, cameras, ranges, rows) if inputs.walk is not None else None
    corrected = plan(surface.corrected_cameras, cameras, motion, walk)
    moved = plan(surface.moved_ranges, cameras, motion, walk, ranges)
    kept = plan(surface.keep_masks, cameras, moved, subjects)
    strands = plan(surface.strands, cameras, ranges) if subject == "torso" else None
    data = plan(surface.valid_patches, moved, kept, strands)
    occluded = plan(surface.occlusions, corrected, data, foregrounds)
    outlines = plan(surface.walk_outlines, corrected, data, foregrounds) if inputs.walk is not None else foregrounds
    solid = plan(surface.solid, corrected, data, outlines, occluded, subjects)
    first = plan(surface.initial_surface, data, solid)
    repaired = plan(surface.repaired, first, data)
    plan(surface.model, corrected, repaired)
    mesh = plan(surface.mesh, corrected, repaired)

    # Measure: from the surface to boundaries, volumes and lengths. An open surface has none.
    if subject == "surface":
        return
    is_torso = subject == "torso"
    sides = plan(measure.sides, corrected, repaired) if measure.are_breasts_sought(inputs, plan.settings) else None
    boundaries = plan(measure.boundaries, corrected, repaired, sides, foregrounds)
    body = plan(measure.body, corrected, repaired, sides, boundaries) if is_torso else None
    breasts = plan(measure.breasts, repaired, boundaries, body)
    size = plan(measure.size, repaired, breasts, body) if is_torso else None
    covers = plan(measure.overlaps, repaired, boundaries) if is_torso else None
    views = plan(measure.views, corrected, data, foregrounds) if pairs and not is_torso else None
    evidence = plan(measure.evidence, corrected, views, calibration, motion, walk)
    volumes = plan(measure.measurements, breasts, size, covers, evidence)
    if is_torso:
        plan(measure.absent, repaired, sides, breasts, body, volumes, covers)
        plan(measure.lacking, repaired, volumes, body)
    landmarks = plan(measure.landmarks, mesh, boundaries, volumes, body)
    plan(measure.symmetry, corrected, mesh, volumes, body)
    plan(measure.dimensions, corrected, mesh, volumes, body, landmarks, boundaries)


def of(cameras: Iterable[str], products: Mapping[str, Product[T] | None]) -> dict[str, Product[T] | None]:
    """Products of these cameras. Cameras without a product are left out."""
    return {camera: products[camera] for camera in cameras if camera in products}


def versions() -> dict[str, int]:
    """Kind of product → version of its function."""
    known = (value for stage in (calibrate, match, surface, measure) for value in vars(stage).values())
    declared: list[Definition[Any]] = [value for value in known if isinstance(value, Definition)]
    return {kind.name.partition("/")[0]: kind.version for kind in declared if kind.version is not None}
