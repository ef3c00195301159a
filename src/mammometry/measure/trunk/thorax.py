"""The trunk under the breasts: frame, axis, and a smooth radius r(θ, y) fitted to the skin beside them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mammometry.base.errors import MeasureError
from mammometry.geometry.arrays import Array, Bool, Float64, Int64, read_only
from mammometry.measure.settings import ThoraxSettings
from mammometry.surface.repair import Provenance, RepairedSurface

_HARMONICS = 4  # Fourier order of the radius around the trunk; 4 follows a thorax and not a breast
_HEIGHT_DEGREE = 2  # of the polynomial of each Fourier coefficient along the trunk; chosen by eye
_SIDE_AZIMUTH_DEG = (75.0, 100.0)
"""Skin whose normal points this far to the side of straight ahead shows where the trunk's axis lies, degrees.
docs/decisions/0009 says what 70 to 90 gave instead."""
_SIDE_BAND_MM = 80.0  # side skin is taken within this height of the breasts; chosen by eye
_FEWEST_SIDE = 50  # samples of side skin needed on either side; chosen by eye
_AXIS_ROUNDS = 20  # of reweighting the normals at most; it ends when the axis is at rest
_AXIS_SAMPLES = 60_000  # of the skin from which the axis is found; chosen for speed
_FIT_SAMPLES = 20_000  # of the skin to which the radius is fitted; chosen for speed
_FIT_ROUNDS = 25  # of reweighting the skin; chosen by eye
_LEAN = 0.2  # sine of the angle between normal and level at which a normal counts half; chosen by eye
_ARM = 1.15  # skin further to the side than this many half widths is an arm's; chosen by eye
_RIDGE = 1e-4  # slight pull of the higher harmonics to zero, since the back is not seen; chosen by eye
_COPIES = 2  # samples for each face at most
_FINEST_MM = 1.0  # least scatter assumed while the breasts are still in the skin; chosen by eye
_CUT_OFF = 3.0  # scatters at which skin that stands out counts no more
_MAD = 1.4826  # standard deviation of a normal distribution over its median absolute deviation


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Trunk:
    """A trunk's cylindrical coordinates: θ from straight ahead towards the patient's left, y to the head, radius r."""

    frame: Float64[Array, "3 3"]
    """Rows: the patient's left, the head, straight ahead; world frame."""
    origin: Float64[Array, 3]
    """A point on the trunk's axis at the breasts' height, mm, world frame."""
    half_width_mm: float
    """Half the distance between the trunk's sides, mm; scale of θ when laid flat."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "frame", read_only(self.frame))
        object.__setattr__(self, "origin", read_only(self.origin))

    def cylindrical(self, points_world: Float64[Array, "n 3"]) -> Float64[Array, "n 3"]:
        """(half width × θ, y, r) of world points, mm: laid flat, as seen from in front of the patient."""
        x, y, z = ((points_world - self.origin) @ self.frame.T).T
        return np.stack([self.half_width_mm * np.arctan2(x, z), y, np.hypot(x, z)], axis=1)

    def world(self, cylindrical: Float64[Array, "n 3"]) -> Float64[Array, "n 3"]:
        """World points of (half width × θ, y, r), mm."""
        arc, y, r = cylindrical.T
        theta = arc / self.half_width_mm
        return self.origin + np.stack([r * np.sin(theta), y, r * np.cos(theta)], axis=1) @ self.frame

    def facing(self, theta_rad: float) -> Float64[Array, "3 3"]:
        """The frame turned about the axis so that straight ahead is at the angle θ of this one."""
        left, up, ahead = self.frame
        sine, cosine = np.sin(theta_rad), np.cos(theta_rad)
        return np.stack([cosine * left - sine * ahead, up, sine * left + cosine * ahead])


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Thorax:
    """A trunk and its smooth radius without breasts."""

    trunk: Trunk
    coefficients: Float64[Array, " c"]
    """Coefficients of the products of Fourier terms in θ and powers of y / height window, mm."""
    settings: ThoraxSettings
    rms_mm: float
    """Scatter of the skin that was fitted, mm."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "coefficients", read_only(self.coefficients))

    def radius_mm(self, arc_y: Float64[Array, "n 2"]) -> Float64[Array, " n"]:
        """Radius of the trunk without breasts at (half width × θ, y), mm."""
        return _design(arc_y, self.trunk.half_width_mm, self.settings) @ self.coefficients

    def bulge_mm(self, points_world: Float64[Array, "n 3"]) -> Float64[Array, " n"]:
        """How far points stand out from the trunk without breasts, mm."""
        cylindrical = self.trunk.cylindrical(points_world)
        return cylindrical[:, 2] - self.radius_mm(cylindrical[:, :2])


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Skin:
    """Samples of the visible skin."""

    points_world: Float64[Array, "n 3"]
    """Middles of faces, mm, world frame."""
    normals_world: Float64[Array, "n 3"]
    """Their unit outward normals."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "points_world", read_only(self.points_world))
        object.__setattr__(self, "normals_world", read_only(self.normals_world))


def seen_faces(surface: RepairedSurface) -> Int64[Array, " k"]:
    """Faces that are not invented; all faces if nothing is known to be measured."""
    seen = surface.mesh.faces_within(surface.provenance != Provenance.INVENTED)
    return np.flatnonzero(seen) if seen.any() else np.arange(len(surface.mesh.faces))


def seen_skin(surface: RepairedSurface, at_most: int = 400_000) -> Skin:
    """Sample the visible faces evenly by area, however finely each part is meshed."""
    chosen = seen_faces(surface)
    corners = surface.mesh.vertices[surface.mesh.faces[chosen]]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    doubled_mm2 = np.linalg.norm(normals, axis=1)
    reached = np.cumsum(doubled_mm2)
    count = min(at_most, _COPIES * len(chosen))
    even = np.searchsorted(reached, (np.arange(count) + 0.5) / count * reached[-1])
    normals = normals[even] / np.maximum(doubled_mm2[even, None], 1e-12)
    return Skin(points_world=corners[even].mean(axis=1), normals_world=normals)


def frame_from_sides(left: Float64[Array, "n 3"], right: Float64[Array, "m 3"], skin: Skin) -> Float64[Array, "3 3"]:
    """Patient's left, head and straight ahead (rows), from the curves around both breasts, mm."""
    across = left.mean(axis=0) - right.mean(axis=0)
    near = np.linalg.norm(skin.points_world - (left.mean(axis=0) + right.mean(axis=0)) / 2, axis=1)
    ahead = skin.normals_world[near < np.linalg.norm(across)].sum(axis=0)
    return orthonormal(np.cross(ahead, across), ahead)


def find_trunk(
    skin: Skin,
    frame: Float64[Array, "3 3"],
    settings: ThoraxSettings = ThoraxSettings(),
    *,
    height_of: Float64[Array, 3] | None = None,
) -> Trunk:
    """Find the trunk's axis: its direction is the one that the skin's normals avoid, its place lies between the sides.

    Args:
        skin: what was seen of the torso.
        frame: patient's left, head, straight ahead (rows), roughly.
        settings: which skin counts as side.
        height_of: a world point at the breasts' height; without it the middle of the seen skin.

    Raises:
        MeasureError: no skin was seen at the patient's sides.
    """
    every = max(1, len(skin.points_world) // _AXIS_SAMPLES)
    points, normals = skin.points_world[::every], skin.normals_world[::every]
    axis = frame[1]
    for _ in range(_AXIS_ROUNDS):
        weights = 1 / (1 + ((normals @ axis) / _LEAN) ** 2)
        vector = np.linalg.eigh((normals * weights[:, None]).T @ normals)[1][:, 0]
        vector = vector if vector @ frame[1] > 0 else -vector
        if vector @ axis > 1 - 1e-10:
            break
        axis = vector
    if axis @ frame[1] < np.cos(np.deg2rad(settings.steepest_lean_deg)):
        axis = frame[1]  # the visible skin shows no axis near the head's direction
    frame = orthonormal(axis, frame[2])
    local, turned = points @ frame.T, normals @ frame.T
    height = float(np.median(local[:, 1]) if height_of is None else height_of @ frame[1])
    azimuth = np.rad2deg(np.arctan2(turned[:, 0], turned[:, 2]))
    low, high = _SIDE_AZIMUTH_DEG
    beside = (np.abs(azimuth) > low) & (np.abs(azimuth) < high) & (np.abs(local[:, 1] - height) < _SIDE_BAND_MM)
    if (beside & (azimuth > 0)).sum() < _FEWEST_SIDE or (beside & (azimuth < 0)).sum() < _FEWEST_SIDE:
        raise MeasureError(
            "torso",
            found="no skin seen at both of the patient's sides",
            expected="skin beside the breasts in the photographs",
            remedy="Add views from the sides, or choose --set measure.wall=membrane and give the boundaries",
        )
    left, right = np.median(local[beside & (azimuth > 0), 0]), np.median(local[beside & (azimuth < 0), 0])
    place = np.array([(left + right) / 2, height, np.median(local[beside, 2])])
    return Trunk(frame=frame, origin=place @ frame, half_width_mm=float(left - right) / 2)


def fit_thorax(
    trunk: Trunk,
    points_world: Float64[Array, "n 3"],
    settings: ThoraxSettings = ThoraxSettings(),
    *,
    breasts_left_out: bool = True,
) -> Thorax:
    """Fit r(θ, y) to the skin, leaving out what stands out (breasts, arms).

    A Fourier series in θ whose coefficients are polynomials in y. The weights are asymmetric: Tukey's for skin that
    stands out, Huber's for skin that lies deeper. A slight ridge holds the higher harmonics, as the back is not seen.

    Args:
        trunk: its axis.
        points_world: skin, mm, world frame.
        settings: orders of the fit, and what belongs to the trunk.
        breasts_left_out: whether the skin is already without the breasts. Then skin that stands out a little is chest,
            and only arms are left out.

    Raises:
        MeasureError: too little skin.
    """
    cylindrical = trunk.cylindrical(points_world[:: max(1, len(points_world) // _FIT_SAMPLES)])
    flat, radius = cylindrical[:, :2], cylindrical[:, 2]
    inside = (
        (np.abs(flat[:, 1]) < settings.height_window_mm)
        & (np.abs(flat[:, 0]) < np.deg2rad(settings.widest_deg) * trunk.half_width_mm)
        & on_trunk(cylindrical, trunk)
    )
    flat, radius = flat[inside], radius[inside]
    design = _design(flat, trunk.half_width_mm, settings)
    order = np.concatenate([[0], np.repeat(np.arange(1, _HARMONICS + 1), 2)])
    ridge = np.diag(np.tile(order.astype(np.float64) ** 4, _HEIGHT_DEGREE + 1) * _RIDGE + 1e-9) * len(radius)
    weights = np.ones(len(radius))
    finest = settings.chest_scale_mm if breasts_left_out else _FINEST_MM
    scale, coefficients = np.inf, np.zeros(design.shape[1])
    if len(radius) < 4 * design.shape[1]:
        raise MeasureError(
            "torso",
            found=f"{len(radius)} points of skin around the breasts",
            expected=f"at least {4 * design.shape[1]}",
            remedy="Photograph the trunk beside, above and below the breasts too",
        )
    for _ in range(_FIT_ROUNDS):
        weighted = design * weights[:, None]
        coefficients = np.linalg.solve(weighted.T @ design + ridge, weighted.T @ radius)
        error = radius - design @ coefficients
        scale = max(_MAD * float(np.median(np.abs(error[weights > 0.1]))), finest)
        reach = _CUT_OFF * scale
        weights = np.where(
            error > 0, np.clip(1 - (error / reach) ** 2, 0, None) ** 2, 1 / np.maximum(1, -error / reach)
        )
    return Thorax(trunk=trunk, coefficients=coefficients, settings=settings, rms_mm=scale)


def on_trunk(cylindrical: Float64[Array, "n 3"], trunk: Trunk) -> Bool[Array, " n"]:
    """Which places (half width × θ, y, r) do not belong to an arm, by how far to the side they lie."""
    return cylindrical[:, 2] * np.abs(np.sin(cylindrical[:, 0] / trunk.half_width_mm)) < _ARM * trunk.half_width_mm


def _design(arc_y: Float64[Array, "n 2"], half_width: float, settings: ThoraxSettings) -> Float64[Array, "n c"]:
    theta, height = arc_y[:, 0] / half_width, arc_y[:, 1] / settings.height_window_mm
    terms = [np.ones_like(theta)]
    for k in range(1, _HARMONICS + 1):
        terms += [np.cos(k * theta), np.sin(k * theta)]
    around = np.stack(terms, axis=1)
    return np.concatenate([around * height[:, None] ** d for d in range(_HEIGHT_DEGREE + 1)], axis=1)


def orthonormal(up: Float64[Array, 3], ahead: Float64[Array, 3]) -> Float64[Array, "3 3"]:
    """Frame (rows: patient's left, head, straight ahead) with the head along `up`, looking nearly ahead."""
    up = up / np.linalg.norm(up)
    ahead = ahead - up * (ahead @ up)
    ahead /= np.linalg.norm(ahead)
    return np.stack([np.cross(up, ahead), up, ahead])
