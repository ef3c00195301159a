"""Settings of the measurement (boundary, wall, uncertainty), and the patient's postures."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal, TypeAlias, get_args

Posture: TypeAlias = Literal["leaning", "standing", "lying"]
"""Posture of the patient, as recorded in a clinic's visit."""
POSTURES: tuple[Posture, ...] = get_args(Posture)
NOT_TO_BE_COMPARED = "Volumes of different postures are not to be compared"


SINCE = "since"
"""Metadata of a setting: the version that added it. It is in keys of stored results only if it is not the default."""
ProtocolJoin = Literal["arc", "geodesic"]
"""How a boundary runs between landmarks (`boundary.protocol`)."""
_THICKEST_LAYER_MM = 100.0  # real women have 24 ± 8 mm where it is thickest; more is a wrong unit or decimal point


@dataclass(frozen=True, slots=True, kw_only=True)
class BaseRimSettings:
    """Base of a cast, from its visible rim (docs/method, volume)."""

    rim_radius_mm: float = 0.24
    """Assumed radius of the rounded rim if session.toml gives none, mm. A camera sees where the rounding turns away and
    not where the cast ends, so the base is placed half the radius behind the visible rim. Photographs do not show the
    radius (docs/decisions/0017)."""
    minimum_sectors: int = 36
    """Least number of directions around the cast, out of 72, with rim points. With a third of them, points fitted two
    planes equally well, one of them wrong (docs/decisions/0009)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class NippleSettings:
    """Limit below which a proposed nipple is not used."""

    least_probability: float = 0.5
    """Smallest probability of a nipple for measuring lengths, quadrants and ptosis."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LayerSettings:
    """Layer of fat and skin between a flat chest and the muscle.

    Thicknesses at the boundary are measured normal to the muscle, by ultrasound or calliper. 0: not measured. See
    docs/decisions/0029.
    """

    left_lateral_mm: float = 0.0
    """At the left breast's outer end, mm."""
    left_upper_mm: float = 0.0
    """Above the left breast, mm."""
    left_medial_mm: float = 0.0
    """At the left breast's inner end, mm."""
    left_lower_mm: float = 0.0
    """Below the left breast, mm."""
    right_lateral_mm: float = 0.0
    """At the right breast's outer end, mm."""
    right_upper_mm: float = 0.0
    """Above the right breast, mm."""
    right_medial_mm: float = 0.0
    """At the right breast's inner end, mm."""
    right_lower_mm: float = 0.0
    """Below the right breast, mm."""

    def of(self, side: str) -> tuple[float, float, float, float]:
        """Lateral, upper, medial and lower thickness of one side, mm. 0 if not measured."""
        if side == "left":
            return (self.left_lateral_mm, self.left_upper_mm, self.left_medial_mm, self.left_lower_mm)
        return (self.right_lateral_mm, self.right_upper_mm, self.right_medial_mm, self.right_lower_mm)

    def __post_init__(self) -> None:
        thinnest, thickest = (bound(*self.of("left"), *self.of("right")) for bound in (min, max))
        if thinnest < 0:
            raise ValueError("thicknesses of 0 (not measured) or more")
        if thickest > _THICKEST_LAYER_MM:
            raise ValueError(f"thicknesses of at most {_THICKEST_LAYER_MM:.0f} mm: check the unit")


@dataclass(frozen=True, slots=True, kw_only=True)
class ObserverSettings:
    """Standard uncertainty of a drawn curve by region, mm.

    Two ratings of a point of a breast's boundary are 3.5 mm apart on average at the most certain of three places and
    6.7 mm at the least certain, by one person as by two (16 women, doi 10.1007/s00238-018-1431-2). If each rating
    scatters by σ across and along the curve, their mean distance is √π σ, so σ is 2.0 to 3.8 mm. The authors call the
    fold and the medial border easy to see, and the upper and lateral border without landmarks.
    """

    medial_mm: float = 2.0
    """Towards the breastbone, mm: value of the most certain place."""
    lower_mm: float = 2.0
    """At the fold below the breast, mm: value of the most certain place."""
    upper_mm: float = 3.0
    """Towards the collarbone, mm: root mean square of the two extremes."""
    lateral_mm: float = 3.8
    """Towards the armpit, mm: value of the least certain place."""

    def __post_init__(self) -> None:
        if min(self.medial_mm, self.lower_mm, self.upper_mm, self.lateral_mm) < 0:
            raise ValueError("a value of 0 mm or more for each region")

    @property
    def mean_mm(self) -> float:
        """Root mean square of the four regions, mm."""
        return ((self.medial_mm**2 + self.lower_mm**2 + self.upper_mm**2 + self.lateral_mm**2) / 4) ** 0.5


@dataclass(frozen=True, slots=True, kw_only=True)
class MeasureSettings:
    """Settings of the measure stage."""

    wall: str = "default"
    """Name of the wall that closes the breast. default: the measured wall if the session has a wall.ply. Otherwise a
    cast gets its own base, plane or convex cylinder by its rim, and a torso the rounded membrane. (A flat wall
    overestimates a breast by a quarter to three quarters.)"""
    boundary: Literal["default", "landmarks"] = "default"
    """Source of a torso breast's boundary, unless drawn. default: its crease. landmarks: the named protocol, from
    picked landmarks (landmarks.json)."""
    protocol_join: ProtocolJoin = "geodesic"
    """How the protocol's landmarks are joined. geodesic: by shortest paths over the skin, which run around a breast and
    not over it. arc: by quarter ellipses. For 48 breasts ellipses left out 9 ± 11 %, paths 1 ± 7 % (decision 19).
    """
    base_rim: BaseRimSettings = field(default_factory=BaseRimSettings)
    """How a cast's base is found."""
    nipple: NippleSettings = field(default_factory=NippleSettings)
    """How nipples are proposed if none was picked."""
    layer: LayerSettings = field(default_factory=LayerSettings)
    """Measured thickness of the layer in front of the muscle."""
    size_confirmed: bool = field(default=False, metadata={SINCE: "1.1"})
    """Whether the body's lengths were checked and are right, although fewer than one adult in 1,000 has them. The body
    is then measured, with a warning."""
    bare_confirmed: bool = field(default=False, metadata={SINCE: "1.1"})
    """Whether both breasts were checked and are bare, although the skin inside a boundary has grooves, such as a hand
    or an arm on it would cause. Such a breast is then measured, with a warning."""
    surface_sigma_mm: float = 0.02
    """Standard uncertainty of a cast's whole surface along its normal, mm. Matching windows bias convex skin by 0.02 to
    0.04 mm."""
    observers: ObserverSettings = field(default_factory=ObserverSettings)
    """Standard uncertainty of a torso's boundary curve, as drawn by people. Where no pair measured the skin under it,
    half of the distance from measured skin is added (root of the sum of squares): automatic boundaries were 3 to 7 mm
    off on measured skin, 4 to 15 mm on unmeasured skin."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CompareSettings:
    """Limits of the comparison of two dates of one patient."""

    doubt_mm: float = 1.6
    """A comparison is doubtful if a fifth of one trunk is farther than this from the other date's, mm. For one virtual
    body in extreme poses 22 of 24 pairs are closer, half of them within 0.7 mm. For two bodies none is; the smallest
    has 1.9 mm."""
    refuse_mm: float = 4.0
    """Above it the comparison is refused as one of two bodies, mm. Poses of one body cause much less. Of 66 pairs of
    two bodies 45 are above it, and the others are doubtful."""
    other_posture: bool = False
    """Whether dates of different postures are compared, with a warning, instead of refused."""

    def __post_init__(self) -> None:
        if not 0 < self.doubt_mm <= self.refuse_mm:
            raise ValueError("doubt_mm above 0 and at most refuse_mm")
