"""Facts of a stage for the report.

They are computed together with the stage's pictures, so that large values are read once.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TypeAlias

from mammometry.geometry.camera import Rig
from mammometry.job.graph import Plan
from mammometry.job.inputs import Inputs
from mammometry.job.products import Stage, Uncached
from mammometry.job.stages import match, surface
from mammometry.matching.foreground.foreground import Foreground
from mammometry.matching.quality import MatchQuality
from mammometry.report.content import StageReport
from mammometry.report.figures.stage_results import MatchingResult, SurfaceResult, draw, stage_result
from mammometry.report.figures.thinning import matched_shares, thinned_foreground, thinned_maps, thinned_ranges
from mammometry.report.scene import ViewerScene
from mammometry.report.words.describe import surface_report
from mammometry.surface.motion import motion_detection
from mammometry.walk import motion as walk_motion


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MatchingFacts:
    """The matching in numbers."""

    foregrounds: Mapping[str, Foreground]
    """Camera → its silhouette, at the resolution of pictures."""
    quality: Mapping[str, MatchQuality]
    """Pair → quality of its matching."""
    shares: Mapping[str, float]
    """Pair → matched share of the subject."""


Facts: TypeAlias = MatchingFacts | StageReport | None
"""Facts about the matching or the surface, or none."""


@dataclass(frozen=True, slots=True, kw_only=True)
class DrawnStages:
    """Pictures of all stages, and their facts."""

    pictures: Mapping[str, Mapping[str, bytes]]
    """Stage → its previews, name → PNG."""
    facts: Mapping[Stage, Facts] = field(default_factory=dict)
    """Stage → facts from `drawn`."""
    scene: ViewerScene | None = None
    """Result of `gather.whole_scene`, for a report that leaves nothing out."""


def drawn(stage: Stage, plan: Plan, inputs: Inputs) -> tuple[dict[str, bytes], Facts]:
    """Previews of a stage, and its facts for the report."""
    result = stage_result(stage, plan, inputs)
    pictures = draw(result)
    if isinstance(result, MatchingResult):
        return pictures, MatchingFacts(foregrounds=result.foregrounds, quality=result.quality, shares=result.shares)
    if isinstance(result, SurfaceResult):
        return pictures, surface_report(result.ranges, result.repaired, motion_words(plan))
    return pictures, None


def motion_words(plan: Plan) -> str:
    """One line about motion of cameras and body, or of the body during a walk."""
    walk = plan.value(surface.walk_motion)
    return motion_detection.summary(plan[surface.stillness]()) if walk is None else walk_motion.summary(walk)


def matching_facts(plan: Plan, rig: Rig) -> MatchingFacts:
    """The report's facts about the matching, without pictures."""
    foregrounds = {camera: thinned_foreground(seen) for camera, seen in Uncached(plan[match.foreground]).items()}
    maps, quality = thinned_maps(Uncached(plan[match.disparity]))
    return MatchingFacts(foregrounds=foregrounds, quality=quality, shares=matched_shares(rig, foregrounds, maps))


def surface_facts(plan: Plan) -> StageReport:
    """The report's facts about the surface, without pictures."""
    ranges = thinned_ranges(Uncached(plan[surface.range_image]), plan[surface.valid_patches].uncached())
    return surface_report(ranges, plan[surface.mesh]().repaired, motion_words(plan))
