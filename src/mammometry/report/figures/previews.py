"""The previews of each stage: PNG pictures, by name, each with its caption inside (`canvas.caption_of`).

The names are those of the files in ``results/<stage>/``. The report shows the same pictures.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial

from mammometry.base.photograph import Photograph
from mammometry.calibration.adjust.bundle import Calibration
from mammometry.calibration.judge.expected_error import expected_error
from mammometry.geometry.arrays import Array
from mammometry.geometry.camera import Rig
from mammometry.geometry.mesh import TriangleMesh
from mammometry.matching.foreground import Foreground
from mammometry.matching.match import DisparityMap
from mammometry.measure.boundary.boundary import Boundary
from mammometry.measure.shape.symmetry import Symmetry
from mammometry.measure.volume.volume import VolumeMeasurement
from mammometry.report.figures import calibration as calibration_figures
from mammometry.report.figures import canvas
from mammometry.report.figures import matching as matching_figures
from mammometry.report.figures import measure as measure_figures
from mammometry.report.figures import surface as surface_figures
from mammometry.report.figures import symmetry as symmetry_figures
from mammometry.report.figures.shading import Scene, front_frame, standard_views
from mammometry.surface.dents import ValidPatches
from mammometry.surface.range_image import RangeImage
from mammometry.surface.repair import RepairedSurface
from mammometry.surface.texture import TexturedMesh

ORDER = (
    *("rig", "detections", "residuals", "residual-field", "expected-error"),
    *("foreground", "rectified", "disparity", "confidence"),
    *("range", "dents", "repair", "provenance", "convergence", "views"),
)
"""Names of the previews in the order in which a reader wants them; those of the measure stage depend on the breasts."""


def preview_calibration(
    rig: Rig, calibration: Calibration | None, photographs: Mapping[tuple[str, str], Photograph]
) -> dict[str, bytes]:
    """Pictures of the calibrate stage.

    Args:
        rig: the calibrated rig.
        calibration: how it was calibrated; None where the cameras came ready-made.
        photographs: (pose, camera) → photograph of the target; one a camera is read.
    """
    if calibration is None:
        return {"rig": calibration_figures.rig(rig)}
    return {
        "rig": calibration_figures.rig(rig, calibration.world_from_target, calibration.target_points),
        "detections": calibration_figures.detections(calibration, photographs),
        "residuals": calibration_figures.residuals(calibration),
        "residual-field": calibration_figures.residual_field(calibration),
        "expected-error": calibration_figures.expected_error(expected_error(calibration)),
    }


def preview_matching(
    rig: Rig,
    photographs: Mapping[str, Photograph],
    foregrounds: Mapping[str, Foreground],
    disparities: Mapping[str, DisparityMap],
) -> dict[str, bytes]:
    """Pictures of the match stage.

    Args:
        rig: the calibrated rig.
        photographs: camera → photograph of the subject.
        foregrounds: camera → its foreground.
        disparities: pair → its disparity map. All are looked up once: at full size they are large.
    """
    with ThreadPoolExecutor(2) as pool:
        photographs = dict(zip(foregrounds, pool.map(partial(_small, photographs), foregrounds), strict=True))
        foregrounds = {camera: matching_figures.thinned_foreground(foregrounds[camera]) for camera in foregrounds}
        disparities = {pair: matching_figures.thinned_map(disparities[pair]) for pair in disparities}
    shares = matching_figures.matched_shares(rig, foregrounds, disparities)
    return {
        "foreground": matching_figures.foreground(photographs, foregrounds),
        "rectified": matching_figures.rectified(rig, photographs, disparities),
        "disparity": matching_figures.disparity(disparities, shares),
        "confidence": matching_figures.confidence(disparities),
    }


def preview_surface(
    rig: Rig,
    ranges: Mapping[str, RangeImage],
    valid: ValidPatches,
    first: TriangleMesh,
    repaired: RepairedSurface,
    textured: TexturedMesh,
) -> dict[str, bytes]:
    """Pictures of the surface stage.

    Args:
        rig: the calibrated rig, for the directions to look from.
        ranges: pair → its range image.
        valid: what was kept of them.
        first: the first mesh.
        repaired: the repaired mesh.
        textured: the same with its colours.
    """
    scene = Scene(repaired.mesh)
    views = standard_views(repaired.mesh, front_frame(rig))
    return {
        "range": surface_figures.range_images(ranges),
        "dents": surface_figures.dents(ranges, valid),
        "repair": surface_figures.repair(first, scene, views),
        "provenance": surface_figures.provenance(repaired, scene, views),
        "convergence": surface_figures.convergence(repaired),
        "views": surface_figures.textured(textured, scene, views),
    }


def preview_measure(
    rig: Rig,
    measurements: Sequence[VolumeMeasurement],
    textured: TexturedMesh,
    boundaries: Sequence[Boundary] = (),
    symmetry: Symmetry | None = None,
) -> dict[str, bytes]:
    """Pictures of the measure stage: one overview, one of both sides, and two of each breast.

    Args:
        rig: the calibrated rig, for the directions to look from.
        measurements: one a breast.
        textured: the whole surface with its colours.
        boundaries: for the points that each boundary was found from; optional.
        symmetry: left against mirrored right; None where there is none.
    """
    if not measurements:
        return {}
    left = measure_figures.patient_left(measurements)
    evidence: dict[str, Array] = {
        boundary.name: boundary.evidence_world for boundary in boundaries if len(boundary.evidence_world)
    }
    pictures = {"overview": measure_figures.overview(rig, measurements, textured, evidence=evidence)}
    if symmetry is not None:
        pictures["symmetry"] = symmetry_figures.symmetry_map(rig, measurements, symmetry)
    for measured in measurements:
        pictures[f"closed-{measured.name}"] = measure_figures.closed(rig, measured, patient_left_world=left)
        pictures[f"sections-{measured.name}"] = measure_figures.sections(rig, measured, patient_left_world=left)
    return pictures


def _small(photographs: Mapping[str, Photograph], name: str) -> Photograph:
    """A small copy of a photograph: they are read from disk each time they are looked up, and are large."""
    return Photograph(name=name, pixels=canvas.reduced(photographs[name], matching_figures.LARGEST_WIDTH_PX))
