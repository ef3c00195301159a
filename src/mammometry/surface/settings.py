"""All settings of the surface stage in one value."""

from dataclasses import dataclass, field

from mammometry.surface.decompose import DecomposeSettings
from mammometry.surface.dents import DentSettings
from mammometry.surface.extract import ExtractSettings
from mammometry.surface.range_image import TriangulateSettings
from mammometry.surface.repair import RepairSettings
from mammometry.surface.stillness import StillnessSettings
from mammometry.surface.texture import TextureSettings


@dataclass(frozen=True, slots=True, kw_only=True)
class SurfaceSettings:
    """From disparity maps to the repaired, coloured surface (paper 2.4–2.6)."""

    triangulate: TriangulateSettings = field(default_factory=TriangulateSettings)
    """Which disparities become range data."""
    stillness: StillnessSettings = field(default_factory=StillnessSettings)
    """When pairs that disagree are put right, and when refused."""
    decompose: DecomposeSettings = field(default_factory=DecomposeSettings)
    """Labelling of range images against one another."""
    dents: DentSettings = field(default_factory=DentSettings)
    """Which range data are dropped."""
    extract: ExtractSettings = field(default_factory=ExtractSettings)
    """First surface."""
    repair: RepairSettings = field(default_factory=RepairSettings)
    """Elastic repair."""
    texture: TextureSettings = field(default_factory=TextureSettings)
    """Colour of the vertices."""
