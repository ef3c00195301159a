"""Settings of the measurement: boundary, wall and uncertainty."""

from dataclasses import dataclass, field
from typing import Literal

ProtocolJoin = Literal["arc", "geodesic"]
"""How a boundary runs between landmarks. See `protocol`."""
_THICKEST_LAYER_MM = 100.0  # real women have 24 ± 8 mm where it is thickest; more is a slip of the unit or the point


@dataclass(frozen=True, slots=True, kw_only=True)
class BaseRimSettings:
    """How the base of a cast is found from its visible rim. docs/method, volume."""

    rim_radius_mm: float = 0.24
    """Assumed rounding radius of the rim if session.toml gives none, mm. A camera sees where the rounding turns away,
    not where the cast would end. So the base is put half of the radius behind the visible rim. Photographs do not show
    the radius (docs/decisions/0017).
    """
    rim_radius_sigma_mm: float = 0.14
    """Standard uncertainty of that radius, mm. Hand-made rims may have anything from 0 to .5."""
    silhouette_sigma_px: float = 0.05
    """Standard uncertainty of the edge in each camera, common to its whole outline, pixels. In eight cameras and three
    casts that are lit to the edge it was .00 to .04."""
    sharpest_limb_mm: float = 8.0
    """Radius of the sharpest limb of a breast, mm. Measured skin that turns to a cosine c of incidence at a distance g
    from the silhouette is no limb with a radius above 2 g/c². A point where that is less than this shows the rim. Of a
    ptotic cast photographed by one pair, at a tenth of full size, 92 % of the rim's points have less, and 92 % of the
    limb's have more."""
    seed: int = 0
    """Seed of the random samples in which the base is searched. The same photographs give the same volume."""
    local_sigma_px: float = 0.1
    """Standard uncertainty of the edge in one eighth of a camera's outline alone, pixels. Light differs around a rim:
    .02 to .12 was measured."""
    minimum_sectors: int = 36
    """Directions around the cast, out of 72, that must hold rim points for a base to be trusted. Half of them: where a
    third of a rim was seen, it lay on two planes, and the wrong one looked as sure (docs/decisions/0009)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ThoraxSettings:
    """How the trunk is described under the breasts of a torso."""

    chest_scale_mm: float = 4.0
    """Scatter of a chest about the smooth surface that is fitted to it, mm. Once the breasts are left out, skin that
    stands out up to three times as far still describes the trunk (muscle, collar bone)."""
    height_window_mm: float = 140.0
    """Skin within this height of the breasts describes the trunk, mm."""
    widest_deg: float = 115.0
    """Skin up to this far around from straight ahead describes the trunk, degrees."""
    steepest_lean_deg: float = 50.0
    """Greatest angle between the trunk's axis and the photographs' upright, degrees. Beyond it the upright serves as
    the axis. Patients lean forward by up to 42° in front of the rig, and the cameras are not quite upright on average.
    """


@dataclass(frozen=True, slots=True, kw_only=True)
class BreastSettings:
    """How a breast is outlined on a torso."""

    fewest_mm: float = 8.0
    """A breast stands out at least this far from the skin along its outline, mm. If nothing does, there is no breast on
    that side."""
    plain_mm: float = 24.0
    """Height over the skin along its outline above which something is a breast even without a crease around all of it,
    mm.
    """
    low_creased: float = 0.9
    """Share of the outline that must run in a crease for something as low as `fewest_mm` to be a breast, and not the
    chest's own form. In between the share is interpolated."""
    chest_mm: float = 6.0
    """Mean height up to which something without a crease around nearly all of it is the chest's own form, mm. Chests
    without a breast have 3 to 5.4 beside the armpit, mounds from 80 cc on 8 or more (docs/decisions/0026)."""
    least_creased: float = 0.4
    """Share of the boundary that must run in a crease. With less, no boundary is proposed."""
    reach_mm: float = 140.0
    """Farthest a boundary lies from the breast's middle, mm."""


@dataclass(frozen=True, slots=True, kw_only=True)
class NippleSettings:
    """How a nipple is proposed, and how well a proposal is known."""

    margin_mm: float = 15.0
    """Nipples are not looked for nearer to the boundary than this, mm."""
    areola_contrast: float = 0.05
    """Least difference of ln(R/G), in linear light, between the areola and the skin around it. Pale areolae have .1."""
    tip_mm: float = 1.2
    """Least height of a nipple above the ring of skin 8 to 14 mm around it, beyond that of the skin up to 36 mm away,
    mm. A round breast has up to .5, a nipple 2 to 5."""
    tip_sigma_mm: float = 2.5
    """Standard uncertainty of a tip within an areola, mm. It was 2.6 and 3.2 mm off on a virtual torso at .15 of full
    size."""
    areola_sigma_mm: float = 4.0
    """Standard uncertainty of the middle of an areola without a tip, mm."""
    apex_tip_sigma_mm: float = 4.0
    """Standard uncertainty of a tip where no areola is seen, mm."""
    areola_tip_probability: float = 0.98
    """Probability that a tip within an areola's colour is a nipple. This and the next three chosen by eye."""
    areola_probability: float = 0.9
    """Of an areola's colour without a tip."""
    tip_probability: float = 0.6
    """Probability that a tip without an areola's colour is a nipple: it may be a reconstructed nipple, a scan without
    colours, or a scar.
    """
    apex_probability: float = 0.1
    """Of the most projecting point, where neither is seen."""
    least_probability: float = 0.5
    """Least probability of a nipple from which lengths, quadrants and ptosis are measured."""
    apex_sigma_mm: float = 12.0
    """Standard uncertainty of the most projecting point as a nipple, mm: little more than a guess."""


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
    fewest: int = 2
    """Thicknesses of one side that are needed. With fewer, the mean of real women is used."""
    mean_mm: float = 17.8
    """Distance between the cylinder membrane and the muscle, mean of 145 breasts, mm."""
    u95_mm: float = 12.0
    """Half-width of its 95 % interval if no thickness was measured, mm. Of the same breasts."""
    over_layer_mm: float = 0.6
    """Excess of that over the mean layer normal to the muscle at the boundary: 17.8 less 17.2, mm."""
    measured_u95_mm: float = 5.0
    """Half-width with four measured thicknesses, mm: 4.7 on real women, each thickness ± 2 mm."""
    missing_u95_mm: float = 3.0
    """Added for two missing quadrants, mm (root of the sum of squares): quadrants of one breast correlate by .6 to .75
    and their mean has ± 4.5 mm between women.
    """

    @property
    def usual_mm(self) -> tuple[float, float, float, float]:
        """Lateral, upper, medial and lower thickness of real women, mean, mm."""
        return (24.0, 18.0, 12.0, 16.0)

    def of(self, side: str) -> tuple[float, float, float, float]:
        """Lateral, upper, medial and lower thickness of one side, mm.

        0 where not measured.
        """
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

    Two ratings of one point of a breast's boundary lie 3.5 mm apart on average at the surest of three places and 6.7 mm
    at the least sure, by one person or by two alike (16 women, doi 10.1007/s00238-018-1431-2). If each rating scatters
    by σ across the curve and as much along it, their mean distance is √π σ. So σ is 2.0 to 3.8 mm. The same authors
    call the fold and the medial border easy to see, and the upper and lateral border without landmarks.
    """

    medial_mm: float = 2.0
    """Towards the breastbone, mm: as the surest place."""
    lower_mm: float = 2.0
    """At the fold below the breast, mm: as the surest place."""
    upper_mm: float = 3.0
    """Towards the collarbone, mm: between both (their root mean square)."""
    lateral_mm: float = 3.8
    """Towards the armpit, mm: as the least sure place."""

    def __post_init__(self) -> None:
        if min(self.medial_mm, self.lower_mm, self.upper_mm, self.lateral_mm) < 0:
            raise ValueError("no region below 0 mm")

    @property
    def mean_mm(self) -> float:
        """Root mean square of the four regions, mm."""
        return ((self.medial_mm**2 + self.lower_mm**2 + self.upper_mm**2 + self.lateral_mm**2) / 4) ** 0.5


@dataclass(frozen=True, slots=True, kw_only=True)
class MeasureSettings:
    """Settings of the measure stage."""

    wall: str = "default"
    """Name of the wall that closes the breast. default: the measured wall if the session has a wall.ply. Otherwise a
    cast gets its own base, plane or convex cylinder as its rim shows, and a torso the cylinder membrane. (A flat wall
    overestimates a breast by a quarter to three quarters.)"""
    boundary: Literal["default", "landmarks"] = "default"
    """Source of a torso breast's boundary, unless drawn. default: its crease. landmarks: the named protocol, from
    picked landmarks (landmarks.json).
    """
    protocol_join: ProtocolJoin = "geodesic"
    """How the protocol's landmarks are joined. geodesic: by shortest paths over the skin, which run around a breast and
    not over it. arc: by quarter ellipses. For 48 breasts ellipses left out 9 ± 11 %, paths 1 ± 7 % (decision 19).
    """
    base_rim: BaseRimSettings = field(default_factory=BaseRimSettings)
    """How a cast's base is found."""
    thorax: ThoraxSettings = field(default_factory=ThoraxSettings)
    """How a torso's trunk is described."""
    breast: BreastSettings = field(default_factory=BreastSettings)
    """How a torso's breasts are outlined."""
    nipple: NippleSettings = field(default_factory=NippleSettings)
    """How nipples are proposed where none was picked."""
    layer: LayerSettings = field(default_factory=LayerSettings)
    """What is known of the layer before the muscle."""
    picked_sigma_mm: float = 2.0
    """Standard uncertainty of a picked landmark along the skin, mm. Repeated picks on 3D scans scatter by 1 to 3."""
    surface_sigma_mm: float = 0.02
    """Standard uncertainty of a cast's whole surface along its normal, mm. Matching windows bias convex skin by .02 to
    .04 mm."""
    common_share: float = 0.35
    """Share of the measured skin's expected error that is common to all of it. Weak texture and noise make matching
    flatten convex skin: for casts at .15 of full size the mean error was .1 to .4 of the expected one.
    """
    matching_reach_mm: float = 3.0
    """Distance on the skin within which random errors of a matched surface are alike, mm. Half a matching window."""
    repaired_sigma_mm: float = 0.1
    """Standard uncertainty of repaired skin beside measured skin, along its normal, mm. Common to all of it. Repaired
    casts were off by .08 mm on average and .8 mm at worst (99 %), in both directions.
    """
    invented_sigma_mm: float = 0.4
    """Standard uncertainty of skin that no camera measured and no neighbour supports, mm. Common to all of it."""
    unseen_slope: float = 0.5
    """Growth of both, mm for each mm of distance from measured skin, or of the distance by which the skin could stand
    further out without being seen, whichever is less. For a ptotic cast photographed by one pair, with its lower pole
    hidden (63 cm², up to 49 mm away), the volume was off by .5 times distance times area. For casts photographed by
    four pairs, at .15 of full size, it was -.2 to .4 times (docs/decisions/0009).
    """
    silhouette_doubt_px: float = 1.0
    """Distance outside a silhouette at which nothing of the subject is left, pixels."""
    silhouette_doubt_slope: float = 0.25
    """Growth of that distance, px for each px along an outline that is not an edge but the border of a shadow. In eight
    outlines of a cast whose fold is as dark as the backdrop, such stretches lay up to .2 of it inside the true one."""
    seen_through_mm: float = 0.5
    """Largest distance of the subject in front of skin that a pair measured, mm, beyond three standard deviations of
    the datum.
    """
    drawn_rim_sigma_mm: float = 0.5
    """Standard uncertainty of a cast's base along its normal if its rim was drawn by hand, mm. A rim is rounded by
    about as much, and a hand that follows it errs to both sides."""
    observers: ObserverSettings = field(default_factory=ObserverSettings)
    """How far off a torso's boundary curve may be, as persons draw it. Where no pair measured the skin under it,
    `unseen_slope` of the distance from measured skin is added (root of the sum of squares): automatic boundaries were 3
    to 7 mm off on seen skin, 4 to 15 on unseen skin."""
    axis_u95_share: float = 0.025
    """Share of the volume that a trunk's axis of assumed depth adds: ± 2.5 % from 80 to 170 mm, on the same breasts."""
    wall_measured_u95_mm: float = 1.0
    """Half-width for a separately measured wall (wall.ply), mm: how well two scans can be registered."""
    wall_sides_u95_mm: float = 1.9
    """Half-width, mm for each side, of what walls of both sides of one capture do not share. On real women right less
    left over the base was off by less than 2.6 mm in 95 %, which is 1.84 mm for each side. Our torsos have .93. An
    earlier synthetic family had 3.4. docs/decisions/0029.
    """
    wall_same_pose_u95_mm: float = 1.2
    """Half-width for the change of one breast between two captures in the same pose, mm."""
    wall_across_poses_u95_mm: float = 2.5
    """Half-width for the change of one breast between two captures in different poses, mm."""

    @property
    def wall_fit_u95_mm(self) -> float:
        """Half-width of one fitted wall's 95 % interval, mm.

        About the surface that its definition means. Two captures of one breast in different poses differ by both
        walls' shares.
        """
        return self.wall_across_poses_u95_mm / 2**0.5


@dataclass(frozen=True, slots=True, kw_only=True)
class CompareSettings:
    """How two dates of one patient are compared."""

    doubt_mm: float = 1.6
    """The trunks are doubted if a fifth of one is further than this from the other date's, mm. For one virtual body in
    extreme poses 22 of 24 pairs are nearer, half of them within .7. For two bodies none is. The least has 1.9.
    """
    refuse_mm: float = 4.0
    """Above it the trunks are refused as those of two bodies, mm. Poses do far less to one body. For 66 pairs of two
    bodies 45 are beyond it. The others are doubted.
    """
    same_pose_mm: float = 0.8
    """Trunks that agree to this stand in one pose, mm. Measured skin has .1 to .3. Arms and breath add a millimetre."""
    same_pose_deg: float = 4.0
    """Difference in lean above which poses count as different, because breasts hang differently, degrees."""
    doubt_deg: float = 15.0
    """Difference in lean above which there is a warning, degrees. The intervals were not measured for more."""
    other_posture: bool = False
    """Whether dates of different postures are compared, with a warning, instead of refused."""

    def __post_init__(self) -> None:
        if not 0 < self.doubt_mm <= self.refuse_mm:
            raise ValueError("doubt_mm above 0 and not above refuse_mm")
