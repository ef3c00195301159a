"""Settings of the measurement: how the boundary is found, which wall closes the breast, what its uncertainty is."""

from dataclasses import dataclass, field
from typing import Literal

ProtocolJoin = Literal["arc", "geodesic"]
"""How a boundary runs between landmarks; see `protocol`."""


@dataclass(frozen=True, slots=True, kw_only=True)
class BaseRimSettings:
    """How the base of a cast is found from the rim that the cameras see (docs/method, volume)."""

    rim_radius_mm: float = 0.24
    """Radius by which the rim is taken to be rounded where session.toml does not tell it, mm. A camera sees where the
    rounding turns away, not where the cast would end; so the base is put half of it behind the rim that is seen.
    Photographs do not show it. docs/decisions/0017 has the figures."""
    rim_radius_sigma_mm: float = 0.14
    """Standard uncertainty of that radius, mm: hand-made rims may have anything from 0 to .5."""
    silhouette_sigma_px: float = 0.05
    """Standard uncertainty of the edge in each camera, common to its whole outline, pixels; .00 to .04 measured in
    eight cameras and three casts that are lit to the edge."""
    edge_band_px: float = 8.0
    """Widest gap, pixels of the photograph, between a silhouette and the end of the measured surface beside it for
    the silhouette to be taken as the cast's rim; windows of the matcher end that far inside the edge."""
    patch_radius_mm: float = 7.0
    """Radius of the surface patch that is continued to the silhouette, mm."""
    continue_mm: float = 4.0
    """Longest way by which it is continued, mm."""
    least_facing: float = 0.1
    """Cosine of the steepest incidence of a ray on the continued surface; a limb has 0, a rim .3 to .9."""
    sharpest_limb_mm: float = 8.0
    """Radius of the sharpest limb of a breast, mm. Measured skin that turns to a cosine c of incidence at a distance g
    from the silhouette is no limb of a larger radius than 2 g/c²; a point where that is less shows the rim. Of a ptotic
    cast before one pair (a tenth of full size) 92 % of the true points have less and 92 % of the limb's more."""
    rim_knots: int = 40
    """Knots of the closed spline that stands for the rim when the base is adjusted."""
    inlier_mm: float = 1.0
    """Distance from the base within which a candidate may belong to the rim while the base is searched, mm."""
    sectors: int = 72
    """Directions around the cast that carry equal weight, so that a well seen side does not tilt the base."""
    trials: int = 2000
    """Random minimal samples drawn when the base is searched."""
    seed: int = 0
    """Seed of the random samples; the same photographs give the same volume."""
    bend_gain: float = 1.2
    """The base is taken as curved when the cameras disagree on a flat rim this many times as much (squared px)."""
    local_sigma_px: float = 0.1
    """The same of one eighth of a camera's outline alone, pixels: lights and shades differ around a rim; .02 to .12
    measured."""
    rival_gain: float = 2.0
    """Where plane and cylinder differ less than this many times in how the cameras disagree (squared px), both are
    possible, and half of what is between them is uncertain."""
    agreed_px: float = 0.07
    """Where the cameras agree to this on a plane or cylinder, RMS in pixels, no other one is looked for."""
    cut_share: float = 0.01
    """A base that cuts off this share of the measured surface more than another does is none."""
    minimum_sectors: int = 36
    """Directions, out of `sectors`, that must hold rim points for a base to be trusted. Half of them: a rim of which a
    third was seen lay on two planes, and the wrong one looked as sure as the right one."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ThoraxSettings:
    """How the trunk is described under the breasts of a torso."""

    harmonics: int = 4
    """Fourier order of the radius around the trunk; 4 follows a thorax and not a breast."""
    height_degree: int = 2
    """Polynomial degree of each Fourier coefficient along the trunk."""
    chest_scale_mm: float = 4.0
    """Scatter of a chest about so smooth a surface, mm: once the breasts are left out, skin that stands out up to three
    times as far still describes the trunk (muscle, collar bone)."""
    side_azimuth_deg: tuple[float, float] = (75.0, 100.0)
    """Skin whose normal points this far to the side of straight ahead shows where the trunk's axis lies, degrees."""
    side_band_mm: float = 80.0
    """Side skin is taken within this height of the breasts, mm."""
    fewest_side: int = 50
    """Vertices of side skin needed on either side."""
    height_window_mm: float = 140.0
    """Skin within this height of the breasts describes the trunk, mm."""
    widest_deg: float = 115.0
    """Skin up to this far around from straight ahead describes the trunk, degrees."""
    steepest_lean_deg: float = 50.0
    """Greatest angle of the trunk against the photographs' upright for its axis to be believed, degrees: patients lean
    forward by up to 42° before the rig, and the cameras are not quite upright on average."""


@dataclass(frozen=True, slots=True, kw_only=True)
class BreastSettings:
    """How a breast is outlined on a torso."""

    fewest_mm: float = 8.0
    """A breast stands out at least this far from the thorax fit, mm; below, the boundary must be given."""
    vanish_mm: float = 2.0
    """Height over the thorax fit at which a breast is held to end, mm; the fit's own scatter is 1–2 mm."""
    height_cost: float = 0.05
    """Cost of a boundary on skin that stands as high again above that level, in creases; weak, since it is only to keep
    the boundary out of the nipple's and other creases on the breast."""
    crease_sigma_mm: float = 4.0
    """Scale at which the skin's curvature is looked at, mm: wider than the matcher's and the skin's unevenness, less
    than a fold."""
    crease_per_mm: float = 0.01
    """Concavity that counts half as a crease, 1/mm, twice a mean curvature: a chest's own is below .005, a fold's .1 to
    1."""
    stiffness: float = 0.05
    """Cost of a boundary that moves in or out by 1 mm from one direction to the next, in creases; grows with the square
    of the movement."""
    rise_mm: float = 6.0
    """Skin that rises again by this much belongs to something else (arm, belly, other breast), mm."""
    least_creased: float = 0.4
    """Share of the boundary that must run in a crease for the boundary to be proposed at all."""
    reach_mm: float = 140.0
    """Farthest a boundary lies from the breast's middle, mm."""
    midline_mm: float = 4.0
    """Each boundary keeps this far from the middle between both, mm."""
    directions: int = 144
    """Directions from the breast's middle in which its end is looked for."""


@dataclass(frozen=True, slots=True, kw_only=True)
class NippleSettings:
    """How a nipple is proposed, and how well a proposal is held to be known."""

    margin_mm: float = 15.0
    """No nipple is looked for nearer to the boundary, mm."""
    areola_contrast: float = 0.05
    """Least difference of ln(R/G) of linear light between the areola and the skin around it: pale areolae have .1."""
    areola_scatters: float = 5.0
    """The same in standard deviations of that difference over the breast, so that mottled skin is not taken for one."""
    tip_mm: float = 1.2
    """Least height of a nipple above the ring of skin 8 to 14 mm around it, beyond that of the skin up to 36 mm away,
    mm: a round breast has up to .5, a nipple 2 to 5."""
    tip_sigma_mm: float = 2.5
    """Standard uncertainty of a tip within an areola, mm: 2.6 and 3.2 mm off on a virtual torso at .15 of full
    size."""
    areola_sigma_mm: float = 4.0
    """Standard uncertainty of the middle of an areola without a tip, mm."""
    apex_tip_sigma_mm: float = 4.0
    """Standard uncertainty of a tip where no areola is seen, mm."""
    apex_sigma_mm: float = 12.0
    """Standard uncertainty of the most projecting point as a nipple, mm: little more than a guess."""


@dataclass(frozen=True, slots=True, kw_only=True)
class MeasureSettings:
    """Settings of the measure stage."""

    wall: str = "default"
    """The wall that closes the breast. default: as it was measured by itself where a session brings a wall.ply; else a
    cast gets its own base (plane or convex cylinder, chosen by the data), a torso the cylinder membrane (a flat wall
    overestimates a breast by a quarter to three quarters)."""
    boundary: Literal["default", "landmarks"] = "default"
    """Where the boundary of a torso's breast comes from, unless it was drawn. default: its crease; landmarks: the named
    protocol, from landmarks that were picked (landmarks.json)."""
    protocol_join: ProtocolJoin = "geodesic"
    """How the protocol's landmarks are joined: by shortest paths over the skin, which run around a breast and not over
    it, or by quarter ellipses, which left out 9 ± 11 % of 48 breasts where the paths left out 1 ± 7 %."""
    base_rim: BaseRimSettings = field(default_factory=BaseRimSettings)
    """How a cast's base is found."""
    thorax: ThoraxSettings = field(default_factory=ThoraxSettings)
    """How a torso's trunk is described."""
    breast: BreastSettings = field(default_factory=BreastSettings)
    """How a torso's breasts are outlined."""
    nipple: NippleSettings = field(default_factory=NippleSettings)
    """How nipples that nobody picked are proposed."""
    picked_sigma_mm: float = 2.0
    """Standard uncertainty of a landmark that was picked on the surface, along the skin, mm: repeated picks on 3D scans
    scatter by 1 to 3 mm."""
    surface_sigma_mm: float = 0.02
    """Standard uncertainty of a cast's whole surface along its normal, mm: matching windows bias convex skin by .02 to
    .04 mm."""
    common_share: float = 0.35
    """Share of the measured skin's expected error that all of it has in common: weak texture and noise make matching
    flatten convex skin. Of casts at .15 of full size the mean error was .1 to .4 of the expected one."""
    matching_reach_mm: float = 3.0
    """Distance on the skin within which a matched surface's random errors are alike, mm: half a matching window."""
    repaired_sigma_mm: float = 0.1
    """Standard uncertainty of repaired skin along its normal, taken as common to all of it, mm, beside measured skin:
    repaired casts were off by .08 mm on average and .8 mm at worst (99 %), in both directions."""
    invented_sigma_mm: float = 0.4
    """The same of skin that no camera measured and no neighbour supports, mm."""
    unseen_slope: float = 0.5
    """What both grow by, mm a mm, with the distance from measured skin or, where that is less, with the distance by
    which the skin could stand further out without being seen. Of a ptotic cast before one pair, whose lower pole is
    hidden (63 cm², up to 49 mm away), the volume was off by .5 times the sum of distance and area; of casts before
    four pairs at .15 of full size by -.2 to .4 times the sum of that room and area."""
    silhouette_doubt_px: float = 1.0
    """Distance outside a silhouette at which nothing of the subject is left, pixels."""
    silhouette_doubt_slope: float = 0.25
    """What that grows by with the distance along an outline that is no edge but the border of a shadow, px a px: of
    eight outlines of a cast whose fold is as dark as the backdrop, those stretches lay up to .2 of it inside the true
    one."""
    seen_through_mm: float = 0.5
    """Nothing of the subject stands this far before skin that a pair measured, mm, three standard deviations apart."""
    drawn_rim_sigma_mm: float = 0.5
    """Standard uncertainty of a cast's base where its rim was drawn by hand, along the base's normal, mm: a rim is
    rounded by about as much, and a hand that follows it errs to both sides."""
    boundary_jitter_mm: float = 3.0
    """Standard uncertainty of a torso's boundary curve, mm, after published observer variability of 3.5–6.7 mm.
    Where it runs over skin that no pair measured, `unseen_slope` of the distance from measured skin is added to it
    (root of the sum of squares): automatic boundaries were 3 to 7 mm off on seen skin, 4 to 15 on unseen."""
    boundary_cc_per_mm_cm2: float = 0.025
    """Change of a torso's volume when its curve jitters by a standard deviation of 1 mm, cc per cm² of base: 4 mm made
    16 cc of SD on breasts of 166 cm² base."""
    wall_u95_mm: float = 9.0
    """Half-width of the 95 % interval that a torso's wall alone causes, mm of wall height: .9 cc per cm² of base,
    measured on 60 synthetic breasts; provisional."""
    wall_measured_u95_mm: float = 1.0
    """The same for a wall that was measured by itself (wall.ply), mm: how well two scans can be registered."""
    wall_sides_u95_mm: float = 3.4
    """The same for what the walls of both sides of one capture do not share: U95(ln ratio) = .34·√((A/V)² + (A/V)²)
    with A in cm² and V in cc; errors of both sides correlate."""
    wall_same_pose_u95_mm: float = 1.2
    """The same for the change of one breast between two captures in one pose, mm."""
    wall_across_poses_u95_mm: float = 2.5
    """The same between captures in different poses, mm."""

    @property
    def wall_fit_u95_mm(self) -> float:
        """Half-width of the 95 % interval of one fitted wall about the surface that its definition means, mm.

        What two captures of one breast in different poses differ by is both walls' share.
        """
        return self.wall_across_poses_u95_mm / 2**0.5


@dataclass(frozen=True, slots=True, kw_only=True)
class CompareSettings:
    """How two dates of one patient are compared."""

    doubt_mm: float = 1.6
    """The trunk is doubted where four fifths of it lie no nearer than this to the other date's, mm. Of one virtual body
    in extreme poses 22 of 24 pairs are nearer, half of them within .7; of two bodies none, the least has 1.9."""
    refuse_mm: float = 4.0
    """It is refused as another body from here on, mm: far beyond what poses do to one; 45 of 66 pairs of two bodies are
    beyond it, the others are doubted."""
    same_pose_mm: float = 0.8
    """Trunks that agree to this stand in one pose, mm: measured skin has .1 to .3, arms and breath add a millimetre."""
    same_pose_deg: float = 4.0
    """A trunk that leans this much differently hangs its breasts in another way, degrees."""
    doubt_deg: float = 15.0
    """From here on that is said as a warning, degrees: beyond what the constants of poses were measured for."""

    def __post_init__(self) -> None:
        if not 0 < self.doubt_mm <= self.refuse_mm:
            raise ValueError("doubt_mm above 0 and not above refuse_mm")
