"""What a report says of a stage by itself.

It is found with the stage's pictures, from the same values: they are large, and read once.
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
from mammometry.surface.motion.motion_test import summary


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MatchingFacts:
    """The matching in numbers."""

    foregrounds: Mapping[str, Foreground]
    """Camera → its silhouette, thinned."""
    quality: Mapping[str, MatchQuality]
    """By pair."""
    shares: Mapping[str, float]
    """Pair → matched share of the subject."""


Facts: TypeAlias = MatchingFacts | StageReport | None
"""Of the matching, of the surface, or none."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Shown:
    """Pictures of all stages, and what was said with them."""

    pictures: Mapping[str, Mapping[str, bytes]]
    """Stage → its previews, name → PNG."""
    facts: Mapping[Stage, Facts] = field(default_factory=dict)
    """Stage → what `drawn` found."""
    scene: ViewerScene | None = None
    """What `gather.whole_scene` made of the session, for a report that leaves nothing out."""


def drawn(stage: Stage, plan: Plan, inputs: Inputs) -> tuple[dict[str, bytes], Facts]:
    """Previews of a stage, and what the report says of it."""
    result = stage_result(stage, plan, inputs)
    pictures = draw(result)
    if isinstance(result, MatchingResult):
        return pictures, MatchingFacts(foregrounds=result.foregrounds, quality=result.quality, shares=result.shares)
    if isinstance(result, SurfaceResult):
        return pictures, surface_report(result.ranges, result.repaired, summary(plan[surface.stillness]()))
    return pictures, None


def matching_facts(plan: Plan, rig: Rig) -> MatchingFacts:
    """Find what the report says of the matching, without pictures."""
    foregrounds = {camera: thinned_foreground(seen) for camera, seen in Uncached(plan[match.foreground]).items()}
    maps, quality = thinned_maps(Uncached(plan[match.disparity]))
    return MatchingFacts(foregrounds=foregrounds, quality=quality, shares=matched_shares(rig, foregrounds, maps))


def surface_facts(plan: Plan) -> StageReport:
    """Find what the report says of the surface, without pictures."""
    ranges = thinned_ranges(Uncached(plan[surface.range_image]), plan[surface.valid_patches].uncached())
    return surface_report(ranges, plan[surface.mesh]().repaired, summary(plan[surface.stillness]()))
