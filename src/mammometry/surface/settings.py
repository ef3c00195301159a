"""Settings of the surface stage."""

from dataclasses import dataclass, field, replace
from typing import Literal, Self

TAPER_MM = 3.0
"""Distance from the edge of a view's data over which its weight rises, mm: windows at the edge extend past the
surface."""
CUBE_MM = 0.5
"""Edge of a cube of the first surface, mm: the paper's value."""
_TORSO_CUBE_MM = 0.7  # docs/decisions/0040


@dataclass(frozen=True, slots=True, kw_only=True)
class DecomposeSettings:
    """Comparison of range images with each other."""

    epsilon_mm: float = 0.5
    """Half-width of the overlapping zone, mm (ε of 2.6.1, where the paper's Results use 0.1)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class DentSettings:
    """Rule by which range data are removed as dents."""

    rule: Literal["element", "patch", "none"] = "element"
    """``patch``: Eq. 2–3 as written, a patch judged by its centre. ``element``: each datum by its own normal."""
    angle_deg: float = 70.0
    """Largest angle between normal and direction to the camera, degrees (the paper's patches: 60)."""
    neighbourhood_mm: float = 2.5
    """Distance within which points give a normal, mm (the paper's patches: 5)."""
    drop_seen_through: bool = True
    """Also remove data that another view sees through, unless several views agree with them (rule ``element``)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ExtractSettings:
    """Grid of cubes, and the rule that merges the views on it."""

    cube_mm: float = 0.0
    """Edge of a cube, mm. 0: 0.7 for a torso, otherwise 0.5, the paper's. A torso has ten times the skin of a cast: 0.7
    takes half the time with the same error (docs/decisions/0040)."""
    rule: Literal["default", "nearest", "furthest", "tsdf"] = "default"
    """Rule for views that disagree. ``nearest`` and ``furthest`` are the paper's two failing rules (Fig. 3). ``tsdf``
    is Curless and Levoy's average of truncated distances, including free space."""

    def of(self, subject_kind: str) -> Self:
        """Settings with the cube size for the subject."""
        if self.cube_mm:
            return self
        return replace(self, cube_mm=_TORSO_CUBE_MM if subject_kind == "torso" else CUBE_MM)


@dataclass(frozen=True, slots=True, kw_only=True)
class TriangulateSettings:
    """Choice of the disparities that become range data."""

    spacing_mm: float = 0.25
    """Largest distance between data on the surface, mm, as far as whole pixels allow: every second pixel of the
    reference rig's full-size photographs. Matching smooths over more, and the first surface's cubes are larger."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RepairSettings:
    """Elasticity, correspondence and iteration."""

    rho: float = 1.0
    """Weight ρ of the internal energy (Eq. 4), dimensionless. 10 gave a tenth more error."""
    rounds: int = 2
    """Largest number of rounds of correspondence and solution. It stops earlier if displacements stop decreasing."""
    target: Literal["closest", "blend"] = "blend"
    """``closest``: the closest point of all views (the paper). ``blend``: weighted mean of each view's closest."""
    taper_mm: float = TAPER_MM
    """Distance from the edge of a view's data over which ω rises, mm: windows at the edge extend past the surface. 0
    (the paper): ω is constant."""
    fade_mm: float = 1.0
    """Distance over which displacements extended to FALSE vertices decrease to 1/e, mm. 0 (the paper): no decrease.
    FALSE vertices are mostly on silhouettes, which are correct, and extended displacements would push them outwards."""


@dataclass(frozen=True, slots=True, kw_only=True)
class StillnessSettings:
    """Limits of disagreement between pairs above which a capture is refused."""

    most_mm: float = 3.0
    """Largest RMS displacement of a pair's points that is corrected, mm. Above it, calibrate again."""
    most_unexplained_mm: float = 0.7
    """Largest disagreement that no motion of cameras or pairs explains, standard deviation, mm. Above it, the capture
    is refused."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SurfaceSettings:
    """From disparity maps to the repaired, coloured surface (paper 2.4–2.6)."""

    triangulate: TriangulateSettings = field(default_factory=TriangulateSettings)
    """Choice of the disparities that become range data."""
    stillness: StillnessSettings = field(default_factory=StillnessSettings)
    """Limits of disagreement between pairs."""
    decompose: DecomposeSettings = field(default_factory=DecomposeSettings)
    """Comparison of range images with each other."""
    dents: DentSettings = field(default_factory=DentSettings)
    """Rule by which range data are removed."""
    extract: ExtractSettings = field(default_factory=ExtractSettings)
    """First surface."""
    repair: RepairSettings = field(default_factory=RepairSettings)
    """Elastic repair."""
