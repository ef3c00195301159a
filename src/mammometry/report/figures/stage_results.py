"""Inputs for the previews of each stage, and the previews as PNG by name."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from functools import cached_property, partial
from typing import ClassVar, TypeAlias

from mammometry.base.photograph import Photograph
from mammometry.calibration.adjust.calibrated import Calibration
from mammometry.geometry import Array, Float64, Rig, TriangleMesh, UInt8
from mammometry.job.graph import Plan
from mammometry.job.inputs import Inputs
from mammometry.job.products import Stage, Uncached
from mammometry.job.stages import calibrate, match, measure, surface
from mammometry.matching.dense.match import DisparityMap
from mammometry.matching.foreground.foreground import Foreground
from mammometry.matching.quality import MatchQuality
from mammometry.measure.boundary.boundary import Boundary
from mammometry.measure.boundary.breasts import NoBreast
from mammometry.measure.shape.symmetry import Symmetry
from mammometry.measure.trunk.body import BodyDirections, Mounting
from mammometry.measure.volume.measurement import VolumeDeficit, VolumeMeasurement
from mammometry.report.figures import canvas
from mammometry.report.figures.catalogue import previews_of
from mammometry.report.figures.shading import ShadedMesh, ViewDirection, front_frame, front_of, standard_views
from mammometry.report.figures.thinning import (
    LARGEST_WIDTH_PX,
    ThinnedRange,
    matched_shares,
    thinned_foreground,
    thinned_maps,
    thinned_ranges,
)
from mammometry.surface.repair.repair import RepairedSurface
from mammometry.surface.texture.texture import TexturedMesh


@dataclass(frozen=True, kw_only=True, eq=False)
class CalibrationResult:
    """The calibrated rig, and its calibration."""

    stage: ClassVar[Stage] = "calibrate"
    rig: Rig
    calibration: Calibration | None = None
    """None for given cameras."""
    photographs: Mapping[tuple[str, str], Photograph] = field(default_factory=dict)
    """(pose, camera) → photograph of the target. Only one per camera is read."""


@dataclass(frozen=True, kw_only=True, eq=False)
class MatchingResult:
    """Photographs, foregrounds and disparities, reduced to the resolution of pictures (`thinned`)."""

    stage: ClassVar[Stage] = "match"
    rig: Rig
    photographs: Mapping[str, Photograph]
    """Camera → photograph of the subject."""
    foregrounds: Mapping[str, Foreground]
    """By camera."""
    disparities: Mapping[str, DisparityMap]
    """By pair."""
    quality: Mapping[str, MatchQuality] = field(default_factory=dict)
    """Pair → quality of the complete map."""

    @classmethod
    def thinned(
        cls,
        rig: Rig,
        photographs: Mapping[str, Photograph],
        foregrounds: Mapping[str, Foreground],
        disparities: Mapping[str, DisparityMap],
    ) -> MatchingResult:
        """Reduce everything to the resolution of pictures. Each value is looked up once, because it is large."""
        with ThreadPoolExecutor(2) as pool:
            small = dict(zip(foregrounds, pool.map(partial(_small, photographs), foregrounds), strict=True))
        maps, quality = thinned_maps(disparities)
        return cls(
            rig=rig,
            photographs=small,
            foregrounds={camera: thinned_foreground(seen) for camera, seen in foregrounds.items()},
            disparities=maps,
            quality=quality,
        )

    @cached_property
    def shares(self) -> dict[str, float]:
        """Pair → matched share of the subject in its left picture."""
        return matched_shares(self.rig, self.foregrounds, self.disparities)


@dataclass(frozen=True, kw_only=True, eq=False)
class SurfaceResult:
    """Range images and the surface made from them."""

    stage: ClassVar[Stage] = "surface"
    rig: Rig
    ranges: Sequence[ThinnedRange]
    """Data reduced to the resolution of pictures, and which of them were kept."""
    first: TriangleMesh
    repaired: RepairedSurface
    textured: TexturedMesh
    """The repaired mesh with its colours."""
    mounting: Mapping[str, Mounting] = field(default_factory=dict)
    """Camera → how it is mounted. Other cameras are upright."""

    @cached_property
    def scene(self) -> ShadedMesh:
        """The repaired mesh, ready for rendering."""
        return ShadedMesh(self.repaired.mesh)

    @cached_property
    def views(self) -> tuple[ViewDirection, ...]:
        """Standard views of the repaired mesh."""
        return standard_views(self.repaired.mesh, front_frame(self.rig, mounting=self.mounting))


@dataclass(frozen=True, kw_only=True, eq=False)
class MeasureResult:
    """The measured breasts on the whole surface."""

    stage: ClassVar[Stage] = "measure"
    rig: Rig
    """Rig from which the viewing directions are derived."""
    measurements: Sequence[VolumeMeasurement]
    """One per breast."""
    textured: TexturedMesh
    """The whole surface with its colours."""
    repaired: RepairedSurface | None = None
    """The same surface with its provenance. Without it, no part is marked as unmeasured."""
    boundaries: Sequence[Boundary] = ()
    """Boundaries with the points from which they were found. May be empty."""
    symmetry: Symmetry | None = None
    body: BodyDirections | None = None
    """Directions of the patient's body. None for a cast."""
    absent: Sequence[NoBreast] = ()
    """Sides without a breast."""
    lacking: Sequence[VolumeDeficit] = ()
    """Volume that a side lacks compared with the other."""
    sources: UInt8[Array, " n"] | None = None
    """Scans that show each vertex, as bits, if several were merged."""

    @cached_property
    def scene(self) -> ShadedMesh:
        """The whole surface, ready for rendering."""
        return ShadedMesh(self.textured.mesh)

    @cached_property
    def views(self) -> tuple[ViewDirection, ...]:
        """Standard views of the whole surface."""
        return standard_views(self.textured.mesh, self.frame, of_patient=self.body is not None)

    @cached_property
    def frame(self) -> Float64[Array, "3 3"]:
        """Right, up and towards the viewer of the front view, world frame. Rows of a rotation."""
        return front_of(self.rig, self.body)


StageResult: TypeAlias = CalibrationResult | MatchingResult | SurfaceResult | MeasureResult


def stage_result(stage: Stage, plan: Plan, inputs: Inputs, textured: TexturedMesh | None = None) -> StageResult:
    """Collect the data from which the previews of a stage are drawn.

    Args:
        stage: any stage except the report.
        plan: the complete plan of a session.
        inputs: inputs of the session; photographs are read one at a time.
        textured: the surface in the colours that may be shown; None: all of them.
    """
    rig = plan[calibrate.cameras]().rig
    if stage == "calibrate":
        calibration = plan.value(calibrate.calibration)
        return CalibrationResult(rig=rig, calibration=calibration, photographs=inputs.calibration_photographs)
    if stage == "match":
        foregrounds, disparities = Uncached(plan[match.foreground]), Uncached(plan[match.disparity])
        return MatchingResult.thinned(rig, inputs.photographs, foregrounds, disparities)
    finished = plan[surface.mesh]()
    textured = finished.textured if textured is None else textured
    if stage == "surface":
        return SurfaceResult(
            rig=rig,
            ranges=thinned_ranges(Uncached(plan[surface.range_image]), plan[surface.valid_patches].uncached()),
            first=plan[surface.initial_surface].uncached(),
            repaired=finished.repaired,
            textured=textured,
            mounting=inputs.mounting,
        )
    return MeasureResult(
        rig=rig,
        measurements=plan.value(measure.measurements) or (),
        textured=textured,
        repaired=finished.repaired,
        boundaries=plan.value(measure.boundaries) or (),
        symmetry=plan.value(measure.symmetry),
        body=plan.value(measure.body),
        absent=plan.value(measure.absent) or (),
        lacking=plan.value(measure.lacking) or (),
    )


def _small(photographs: Mapping[str, Photograph], name: str) -> Photograph:
    """A small copy of a photograph. Photographs are large, and each look-up reads the file."""
    return Photograph(name=name, pixels=canvas.reduced(photographs[name], LARGEST_WIDTH_PX))


def draw(result: StageResult) -> dict[str, bytes]:
    """Draw all previews of a stage's result: name → PNG. Empty for the measurement of an open surface."""
    measurements = result.measurements if isinstance(result, MeasureResult) else ()
    pictures: dict[str, bytes | None] = {}
    for preview in previews_of(result.stage):
        if preview.per_breast:
            for measured in measurements:
                pictures[f"{preview.name}-{measured.name}"] = preview.draw(result, measured)
        else:
            pictures[preview.name] = preview.draw(result)
    return {name: png for name, png in pictures.items() if png is not None}


def draw_stage(stage: Stage, plan: Plan, inputs: Inputs, textured: TexturedMesh | None = None) -> dict[str, bytes]:
    """Draw every preview of a session's stage. Arguments as for `stage_result`."""
    return draw(stage_result(stage, plan, inputs, textured))
