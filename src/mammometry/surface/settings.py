"""All settings of the surface stage in one value."""

from dataclasses import dataclass, field, replace
from typing import Literal, Self

TAPER_MM = 3.0
"""Distance over which a view's weight rises from its data's edge, mm, since windows at the edge see past the surface.
"""

CUBE_MM = 0.5
"""Edge of a cube of the first surface, mm: the paper's."""
_TORSO_CUBE_MM = 0.7  # docs/decisions/0040


@dataclass(frozen=True, slots=True, kw_only=True)
class DecomposeSettings:
    """How range images are compared with one another."""

    epsilon_mm: float = 0.5
    """Half-width of the overlapping zone, mm (ε of 2.6.1, where the paper's Results use 0.1)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class DentSettings:
    """Which range data count as dented."""

    rule: Literal["element", "patch", "none"] = "element"
    """``patch``: Eq. 2–3 as written, a patch judged by its centre. ``element``: each datum by its own normal."""
    angle_deg: float = 70.0
    """Largest angle between normal and direction to the camera, degrees (the paper's patches: 60)."""
    neighbourhood_mm: float = 2.5
    """Distance within which points give a normal, mm (the paper's patches: 5)."""
    drop_seen_through: bool = True
    """Also drop what another view sees through (rule ``element``): no surface can be there."""
    seen_through_mm: float = 1.0
    """Distance in front of another view's surface at which a datum is dropped, mm, besides three σ of both."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FieldSettings:
    """How strongly each source speaks."""

    truncation_mm: float = 2.0
    """Half-width of the band around a measured surface in which it is averaged, mm. 2 measured best."""
    extend_mm: float = 16.0
    """Distance by which range data are continued outwards along their tangent plane, mm across the ray. The matcher
    loses the rim and a band beside every occluding edge, which otherwise swell: 4 mm left 10 % more error on a torso.
    """
    span_jump_mm: float = 20.0
    """Gaps in a view's data whose sides lie further apart in range than this are spanned, mm: nothing that was not
    measured stands before the span. What lies hidden beside a breast (between two, under one) is closed by it. 10 to 40
    gave the same surfaces.
    """
    lost_slope: float = 0.1
    """Where a shadow hides a silhouette's edge: how far outside it the subject is assumed to end, px per px of distance
    to the nearest visible edge. Casts' folds have .05 to .2 (docs/decisions/0017).
    """


@dataclass(frozen=True, slots=True, kw_only=True)
class ExtractSettings:
    """Grid of cubes, and the rule that merges views on it."""

    cube_mm: float = 0.0
    """Edge of a cube, mm. 0: 0.7 for a torso, else 0.5, the paper's. A torso has ten times the skin of a cast: with 0.7
    it takes half the time, and errs as much (docs/decisions/0040).
    """
    rule: Literal["default", "nearest", "furthest", "tsdf"] = "default"
    """Rule for disagreeing views. ``nearest`` and ``furthest`` are the paper's two failing rules (Fig. 3). ``tsdf`` is
    Curless and Levoy's average of truncated distances, free space included.
    """
    smoothing_cubes: float = 1.0
    """Standard deviation of the Gaussian on the signed distance, cubes. Without it the surface has tunnels."""
    near_mm: float = 2.0
    """Distance from all range data beyond which the surface is only closed, mm, in cubes four times as large. The
    repair moves nothing so far away.
    """
    back_mm: float = 10.0
    """How far behind the furthest datum the unseen back is closed, mm."""
    around_mm: float = 20.0
    """Distance of the closing box's other sides from the data, mm. Silhouettes bound the solid earlier."""
    field: FieldSettings = field(default_factory=FieldSettings)
    """How strongly each source speaks."""

    def of(self, subject_kind: str) -> Self:
        """The same, with the edge of the cubes that suits the subject."""
        if self.cube_mm:
            return self
        return replace(self, cube_mm=_TORSO_CUBE_MM if subject_kind == "torso" else CUBE_MM)


@dataclass(frozen=True, slots=True, kw_only=True)
class TriangulateSettings:
    """Which disparities become range data."""

    spacing_mm: float = 0.25
    """Largest distance of elements on the surface, mm, as far as whole pixels allow: every second pixel of the
    reference rig's full-size photographs. The matcher smooths over more, and the first surface's cubes are larger.
    """
    max_sigma_mm: float = 3.0
    """Expected error above which a datum is dropped, mm: it would lie outside every fusion band."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RepairSettings:
    """Elastic moduli, correspondence gates and iteration."""

    rho: float = 1.0
    """Weight ρ of the internal energy (Eq. 4), dimensionless. 10 was worse by a tenth."""
    k_ext: float = 1.0
    """External modulus (Eq. 5), dimensionless."""
    k_int: float = 1.0
    """Internal modulus (Eq. 6), dimensionless."""
    rounds: int = 2
    """Largest number of correspond-and-solve rounds. It ends earlier when displacements stop shrinking."""
    false_weight: float = 0.2
    """ω of a vertex without plausible point, which keeps the displacement of its neighbours. Without any weight the
    solution needs many times the iterations.
    """
    target: Literal["closest", "blend"] = "blend"
    """``closest``: the closest point over all views (the paper). ``blend``: each view's closest, weighted."""
    reach_mm: float = 4.0
    """A datum further from the vertex than this is not plausible, mm."""
    normal_angle_deg: float = 45.0
    """Nor one whose normal differs by more, degrees."""
    tangential_mm: float = 0.8
    """Largest distance of a datum beside the vertex, mm. Further off, the vertex is beyond the edge of the data."""
    similarity_mm: float = 2.0
    """Distance at which the similarity ω has fallen to 1/e, mm."""
    taper_mm: float = TAPER_MM
    """Distance over which ω rises from the edge of a view's data, mm, since windows at the edge see past the surface. 0
    (the paper): ω does not rise.
    """
    fade_mm: float = 1.0
    """Distance over which displacements carried over FALSE vertices fade to 1/e, mm. 0 (the paper): they do not fade.
    Departure: FALSE vertices mostly lie on silhouettes, which are right. Carried on, displacements push the rim out.
    """
    repaired_reach_mm: float = 15.0
    """Distance from measured vertices, along the surface, beyond which a vertex without datum counts as invented, mm.
    """


@dataclass(frozen=True, slots=True, kw_only=True)
class StillnessSettings:
    """When pairs that disagree are put right, and when refused."""

    correct: bool = True
    """Whether cameras are set to their most probable poses. If not, only the interval grows."""
    least_evidence: float = 10.0
    """Rise of the log probability of all observations above which something is taken to have moved: e¹⁰ is 1 in 22,000.
    Clean captures reach 0 to 3.
    """
    least_mm: float = 0.06
    """RMS displacement of the worst pair's points below which nothing is corrected, mm: two thirds of a clean surface's
    error.
    """
    most_mm: float = 3.0
    """Largest RMS displacement of a pair's points that is corrected, mm. Above it, calibrate again."""
    most_unexplained_mm: float = 0.7
    """Largest disagreement that no motion of cameras or pairs explains, standard deviation, mm. Above it, the capture
    is refused.
    """


@dataclass(frozen=True, slots=True, kw_only=True)
class TextureSettings:
    """How photographs are blended on the surface."""

    sharpness: float = 6.0
    """Power of the cosine of incidence in a photograph's weight. High values take each vertex from its best view."""
    clearance_mm: float = 0.7
    """What stands less than this before a vertex does not hide it from a camera, mm: more than a cube's edge."""
    triangles: int = 200_000
    """Triangles of the viewing mesh, which carries the photographs at full resolution. The measured mesh keeps all of
    its own.
    """
    atlas_px: int = 8192
    """Largest width and height of the viewing mesh's picture, pixels."""


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
