"""The trunk under the breasts: frame, axis and smooth radius r(θ, y), fitted to the skin beside them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from mammometry.base.errors import MeasureError
from mammometry.base.normal import MAD
from mammometry.base.value import value
from mammometry.geometry.arrays import Array, Bool, Float64, Int64
from mammometry.surface.repair.repair import Provenance, RepairedSurface

CHEST_SCALE_MM = 4.0
"""Scatter of a chest about the smooth surface fitted to it, mm. Without the breasts, skin up to three times as far out
still belongs to the trunk (muscle, collarbone)."""
HEIGHT_WINDOW_MM = 140.0
"""Largest height above and below the breasts of skin that describes the trunk, mm."""
WIDEST_DEG = 115.0
"""Largest angle from straight ahead of skin that describes the trunk, degrees."""
TRUNK_SAMPLES = 60_000  # samples of skin for the axis and the plane of symmetry; chosen for speed
_STEEPEST_LEAN_DEG = 50.0
"""Largest angle between the trunk's axis and the photographs' vertical, degrees; beyond it the vertical is used.
Patients lean forward by up to 42° in front of the rig, and the cameras are not exactly upright on average."""
_HARMONICS = 4  # Fourier order of the radius around the trunk: follows a thorax but not a breast
AROUND = 2 * _HARMONICS + 1  # Fourier terms
_HEIGHT_DEGREE = 2  # degree of each Fourier coefficient along the trunk: constant curvature (`bend_per_mm`)
_SIDE_AZIMUTH_DEG = (75.0, 100.0)
"""Directions of the normals of the trunk's sides, degrees from straight ahead (results with 70 to 90:
docs/decisions/0009)."""
_SIDE_BAND_MM = 80.0  # largest height above and below the breasts of side skin; not critical
_BREADTH_ROUNDS = 3  # iterations of the body's scale and its breadth: the third changes them by 0.5 % at most
_FEWEST_SIDE = 50  # fewest samples of skin on either side; not critical
_ARM_MM = 40.0  # least gap from the trunk's side to an arm's outer skin; arms are thicker, and sides have no gaps
_BEHIND_FRONT_MM = 30.0
"""Least distance of a trunk's side behind the breastbone's skin, mm. A breast's flank has the same direction but is
further ahead: a boundary 121 mm wide, tilted back by 7.7° (means of real women), ends 16 mm behind its medial end. Not
critical."""
_MIDDLE_MM = 15.0  # half width of the strip of skin that shows the breastbone; not critical
_HALF_WIDTHS_MM, _DEPTHS_MM = (95.0, 260.0), (50.0, 220.0)
"""Plausible half widths of a trunk, and depths of its axis behind the breastbone; far beyond adults. Not critical."""
_ASKEW = 0.35  # largest distance of the axis from the middle, relative to the half width; not critical
ASSUMED_DEPTH_MM, ASSUMED_HALF_WIDTH_MM = 110.0, 150.0
"""Depth of the axis behind the breastbone, and half width, if the sides are not visible. From 80 to 170 mm a breast's
volume changes by 5 % (145 breasts of real women: +3.5, +5.4, +7.1, +8.6 % at 80, 110, 140, 170 mm)."""
_AXIS_ROUNDS = 20  # most iterations of reweighting the normals
_FIT_SAMPLES = 20_000  # samples of skin for the radius; chosen for speed
_FIT_ROUNDS = 25  # iterations of reweighting the skin; not critical
_BONE_MM = 25.0  # half width of the breastbone's skin; not critical
_LEAN = 0.2  # sine of the angle between a normal and the horizontal at which its weight is half; not critical
ARM = 1.15
"""Distance from the axis at which an arm begins, half widths. 1.44 changes volumes by 1 % of an interval, 0.86 by 16 to
26 %: then a standing woman's arm counts as trunk (docs/measured.md)."""
_RIDGE = 1e-4  # regularisation of the higher harmonics, because the back is not visible; not critical
_FACING_OUT = 0.5
"""Least component away from the axis of a normal that shows the trunk's radius. The trunk's end, seen from below, and a
breast's underside face along the axis (docs/decisions/0019). Not critical."""
_CURVE_BITS = 16  # bits per coordinate along the curve: 0.03 mm in 2 m
_SEEN_SAMPLES, _COPIES = 400_000, 2  # most samples of the visible skin, and per face; chosen for memory
_FINEST_MM = 1.0  # least scatter while the skin still includes the breasts; not critical
CUT_OFF = 3.0  # Tukey's constant for skin that protrudes, in scatters


@value(eq=False)
class Trunk:
    """Cylindrical coordinates: θ from straight ahead to the patient's left, y to the head, radius r."""

    frame: Float64[Array, "3 3"]
    """Rows: the patient's left, the head, straight ahead. World frame."""
    origin: Float64[Array, 3]
    """A point on the trunk's axis at the breasts' height, mm, world frame."""
    half_width_mm: float
    """Half the distance between the trunk's sides, mm; the scale of θ on the flattened trunk."""
    assumed: bool = False
    """Whether the sides are not visible, so that the axis has an assumed depth behind the breastbone."""

    def cylindrical(self, points_world: Float64[Array, "n 3"]) -> Float64[Array, "n 3"]:
        """(half width × θ, y, r) of world points, mm."""
        x, y, z = ((points_world - self.origin) @ self.frame.T).T
        return np.stack([self.half_width_mm * np.arctan2(x, z), y, np.hypot(x, z)], axis=1)

    def world(self, cylindrical: Float64[Array, "n 3"]) -> Float64[Array, "n 3"]:
        """World points of (half width × θ, y, r), mm."""
        arc, y, r = cylindrical.T
        theta = arc / self.half_width_mm
        return self.origin + np.stack([r * np.sin(theta), y, r * np.cos(theta)], axis=1) @ self.frame

    def facing(self, theta_rad: float) -> Float64[Array, "3 3"]:
        """Frame of the trunk turned about its axis, so that its angle θ is straight ahead."""
        left, up, ahead = self.frame
        sine, cosine = np.sin(theta_rad), np.cos(theta_rad)
        return np.stack([cosine * left - sine * ahead, up, sine * left + cosine * ahead])


@value(eq=False)
class Thorax:
    """A trunk and its smooth radius without breasts."""

    trunk: Trunk
    coefficients: Float64[Array, " c"]
    """Coefficients of the products of Fourier terms in θ and powers of y / height window, mm."""
    rms_mm: float
    """Scatter of the skin that was fitted, mm."""

    def radius_mm(self, arc_y: Float64[Array, "n 2"]) -> Float64[Array, " n"]:
        """Radius of the trunk without breasts at (half width × θ, y), all in mm."""
        return _design(arc_y, self.trunk.half_width_mm) @ self.coefficients

    def bend_per_mm(self, arc_y: Float64[Array, "n 2"]) -> Float64[Array, " n"]:
        """Curvature along the trunk at (half width × θ, y) in mm, 1/mm, positive where the trunk is convex."""
        around = _design(arc_y, self.trunk.half_width_mm)[:, :AROUND]
        return -2 * around @ self.coefficients[2 * AROUND :] / HEIGHT_WINDOW_MM**2

    def bulge_mm(self, points_world: Float64[Array, "n 3"]) -> Float64[Array, " n"]:
        """Height of points over the trunk without breasts, mm."""
        cylindrical = self.trunk.cylindrical(points_world)
        return cylindrical[:, 2] - self.radius_mm(cylindrical[:, :2])


@value(eq=False)
class SkinSamples:
    """Samples of the visible skin."""

    points_world: Float64[Array, "n 3"]
    """Centroids of faces, mm, world frame."""
    normals_world: Float64[Array, "n 3"]
    """Their unit outward normals."""

    def chosen(self, which: Bool[Array, " n"] | slice) -> SkinSamples:
        """Part of the samples."""
        return SkinSamples(points_world=self.points_world[which], normals_world=self.normals_world[which])

    def about(self, count: int) -> SkinSamples:
        """Evenly chosen samples, at least `count` of them, or all."""
        return self.chosen(slice(None, None, max(1, len(self.points_world) // count)))


def seen_faces(surface: RepairedSurface) -> Int64[Array, " k"]:
    """Faces that are not invented, or all faces if none is measured."""
    seen = surface.mesh.faces_within(surface.provenance != Provenance.INVENTED)
    return np.flatnonzero(seen) if seen.any() else np.arange(len(surface.mesh.faces))


@lru_cache(maxsize=1)  # several steps of a measurement use the same surface
def seen_skin(surface: RepairedSurface) -> SkinSamples:
    """Samples of the visible faces, evenly by area.

    Their order follows a space-filling curve, so that every n-th of them is also an even sample, independently of the
    fineness of the mesh and the order of its faces.
    """
    chosen = seen_faces(surface)
    chosen = chosen[np.argsort(_place_on_curve(surface.mesh.vertices[surface.mesh.faces[chosen]].mean(axis=1)))]
    normals = surface.mesh.face_vectors()[chosen]
    area_mm2 = np.linalg.norm(normals, axis=1)
    reached = np.cumsum(area_mm2)
    count = min(_SEEN_SAMPLES, _COPIES * len(chosen))
    even = np.searchsorted(reached, (np.arange(count) + 0.5) / count * reached[-1])
    points = surface.mesh.vertices[surface.mesh.faces[chosen[even]]].mean(axis=1)
    return SkinSamples(points_world=points, normals_world=normals[even] / np.maximum(area_mm2[even, None], 1e-12))


def _place_on_curve(points: Float64[Array, "n 3"]) -> Int64[Array, " n"]:
    """Position of each point on Morton's curve through their bounding box."""
    low, high = points.min(axis=0), points.max(axis=0)
    cells = (1 << _CURVE_BITS) - 1
    cell = np.round((points - low) / max(float((high - low).max()), 1e-9) * cells).astype(np.int64)
    place = np.zeros(len(points), dtype=np.int64)
    for bit in range(_CURVE_BITS):
        for axis in range(3):
            place |= ((cell[:, axis] >> bit) & 1) << (3 * bit + axis)
    return place


def frame_from_sides(
    left: Float64[Array, "n 3"], right: Float64[Array, "m 3"], skin: SkinSamples
) -> Float64[Array, "3 3"]:
    """Patient's left, head and straight ahead (rows), from both boundary curves, mm."""
    across = left.mean(axis=0) - right.mean(axis=0)
    near = np.linalg.norm(skin.points_world - (left.mean(axis=0) + right.mean(axis=0)) / 2, axis=1)
    ahead = skin.normals_world[near < np.linalg.norm(across)].sum(axis=0)
    return orthonormal(np.cross(ahead, across), ahead)


def find_trunk(
    skin: SkinSamples,
    frame: Float64[Array, "3 3"],
    *,
    height_of: Float64[Array, 3] | None = None,
    middle_of: Float64[Array, 3] | None = None,
) -> Trunk:
    """The trunk with its axis, from the skin.

    The axis is as perpendicular as possible to the skin's normals, and midway between the trunk's sides. The sides are
    skin that faces sideways well behind the breastbone (a breast's flank is further ahead). If a side is not visible,
    the axis is the frame's up, `ASSUMED_DEPTH_MM` behind the breastbone, and `Trunk.assumed` is true.

    Args:
        skin: the torso's visible skin.
        frame: patient's left, head, straight ahead (rows), approximately.
        height_of: a world point at the breasts' height; None: the middle of the visible skin.
        middle_of: a world point of the mid-sagittal plane; None: the middle of the skin that faces ahead.

    Raises:
        MeasureError: no skin is visible at the breasts' height.
    """
    sampled = skin.about(TRUNK_SAMPLES)
    axis = _axis(sampled.normals_world, frame)
    if middle_of is not None:
        axis = axis - frame[0] * (axis @ frame[0])  # the axis is in the mid-sagittal plane
    turned_up = orthonormal(axis, frame[2])
    front = _front(sampled, turned_up, height_of, middle_of)
    found = _between_sides(front, turned_up, symmetric=middle_of is not None)
    return _behind_breastbone(_front(sampled, frame, height_of, middle_of), frame) if found is None else found


def _axis(normals: Float64[Array, "n 3"], frame: Float64[Array, "3 3"]) -> Float64[Array, 3]:
    """Trunk axis: least-variance direction of the normals near the frame's up, else the frame's up."""
    axis, _ = level_axis(normals, frame[1])
    if axis @ frame[1] < np.cos(np.deg2rad(_STEEPEST_LEAN_DEG)):
        return np.asarray(frame[1])
    return axis


def level_axis(normals: Float64[Array, "n 3"], start: Float64[Array, 3]) -> tuple[Float64[Array, 3], float]:
    """Direction to which most of the skin is parallel, from a first guess, and that skin's share."""
    axis = start
    for _ in range(_AXIS_ROUNDS):
        weights = 1 / (1 + ((normals @ axis) / _LEAN) ** 2)
        vector = np.linalg.eigh((normals * weights[:, None]).T @ normals)[1][:, 0]
        vector = vector if vector @ start > 0 else -vector
        if vector @ axis > 1 - 1e-10:
            break
        axis = vector
    return np.asarray(axis), float(weights.mean())


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Front:
    """Visible skin at the breasts' height, in a frame."""

    local: Float64[Array, "n 3"]
    azimuth_deg: Float64[Array, " n"]
    """Direction of its normals, from straight ahead towards the patient's left."""
    bone: Float64[Array, 3]
    """Position of the breastbone."""


def _front(
    skin: SkinSamples,
    frame: Float64[Array, "3 3"],
    height_of: Float64[Array, 3] | None,
    middle_of: Float64[Array, 3] | None,
    scale: float = 1.0,
) -> _Front:
    """Visible skin at the breasts' height, in a band that scales with the body.

    Raises:
        MeasureError: there is too little.
    """
    local, turned = skin.points_world @ frame.T, skin.normals_world @ frame.T
    height = float(np.median(local[:, 1]) if height_of is None else height_of @ frame[1])
    band = np.abs(local[:, 1] - height) < scale * _SIDE_BAND_MM
    if band.sum() < _FEWEST_SIDE:
        raise MeasureError(
            "torso",
            found="no skin at the height of the breasts",
            expected="the trunk beside the breasts",
            remedy="Check that the boundaries are of this surface, and in millimetres",
        )
    local, turned = local[band], turned[band]
    middle = _middle(local[:, 0], turned[:, 2]) if middle_of is None else float(middle_of @ frame[0])
    between = np.abs(local[:, 0] - middle) < _MIDDLE_MM
    ahead = float(np.median(local[between, 2] if between.any() else local[:, 2]))
    azimuth_deg = np.rad2deg(np.arctan2(turned[:, 0], turned[:, 2]))
    return _Front(local=local, azimuth_deg=azimuth_deg, bone=np.array([middle, height, ahead]))


def _middle(across: Float64[Array, " n"], ahead: Float64[Array, " n"]) -> float:
    """Median of the skin's projected area from right to left.

    An arm that is visible on one side only hardly moves it. A breast does not move it: it covers as much as a flat
    chest.
    """
    order = np.argsort(across)
    covered = np.cumsum(np.clip(ahead, 0.0, None)[order])
    return float(across[order][min(int(np.searchsorted(covered, covered[-1] / 2)), len(order) - 1)])


def _between_sides(front: _Front, frame: Float64[Array, "3 3"], *, symmetric: bool) -> Trunk | None:
    """The trunk with its axis midway between the sides, or behind the breastbone in a plane of symmetry.

    None if the sides are not visible or not plausible.
    """
    bone, sides = front.bone, _side_skin(front)
    if sides is None:
        return None
    left, right = sides
    most, least = np.median(left[:, 0]), np.median(right[:, 0])
    half_width, depth = float(most - least) / 2, float(np.median(np.concatenate([left, right])[:, 2]))
    middle = float(most + least) / 2
    narrowest, widest = _HALF_WIDTHS_MM
    nearest, deepest = _DEPTHS_MM
    if not (narrowest < half_width < widest and nearest < bone[2] - depth < deepest):
        return None
    if abs(middle - bone[0]) > _ASKEW * half_width:
        return None
    place = np.array([bone[0] if symmetric else middle, bone[1], depth])
    return Trunk(frame=frame, origin=place @ frame, half_width_mm=half_width)


def _side_skin(front: _Front, scale: float = 1.0) -> tuple[Float64[Array, "n 3"], Float64[Array, "m 3"]] | None:
    """Skin of the trunk's left and right side, in the frame. None if too little of one is visible.

    Args:
        front: skin at the breasts' height.
        scale: size of the body relative to an adult.
    """
    local, azimuth, bone = front.local, front.azimuth_deg, front.bone
    low, high = _SIDE_AZIMUTH_DEG
    beside = (np.abs(azimuth) > low) & (np.abs(azimuth) < high) & (local[:, 2] < bone[2] - scale * _BEHIND_FRONT_MM)
    left, right = (local[beside & (sign * azimuth > 0) & (sign * (local[:, 0] - bone[0]) > 0)] for sign in (1, -1))
    if min(len(left), len(right)) < _FEWEST_SIDE:
        return None
    left, right = (side[_nearer_than_arm(np.abs(side[:, 0] - bone[0]), scale)] for side in (left, right))
    return left, right


def trunk_breadth_mm(
    skin: SkinSamples, frame: Float64[Array, "3 3"], *, height_of: Float64[Array, 3] | None = None
) -> float | None:
    """Distance between the trunk's sides at the breasts' height, mm. None if they are not visible.

    All limits scale with the body, so that the result does not depend on an adult's size.

    Args:
        skin: the torso's visible skin.
        frame: patient's left, head, straight ahead (rows).
        height_of: a world point at the breasts' height; None: the middle of the visible skin.

    Raises:
        MeasureError: no skin is visible at the breasts' height.
    """
    sampled = skin.about(TRUNK_SAMPLES)
    turned_up = orthonormal(_axis(sampled.normals_world, frame), frame[2])
    usual_mm = 2 * ASSUMED_HALF_WIDTH_MM
    for first in (float(np.ptp(sampled.points_world @ turned_up[0])) / usual_mm, 1.0):
        breadth_mm, scale = None, first
        for _ in range(_BREADTH_ROUNDS):
            breadth_mm = _breadth_mm(_front(sampled, turned_up, height_of, None, scale), scale)
            if breadth_mm is None:
                break
            scale = breadth_mm / usual_mm
        if breadth_mm is not None:
            return breadth_mm
    return None


def _breadth_mm(front: _Front, scale: float) -> float | None:
    sides = _side_skin(front, scale)
    if sides is None:
        return None
    left, right = (float(np.median(np.abs(side[:, 0] - front.bone[0]))) for side in sides)
    return left + right if abs(left - right) < _ASKEW * (left + right) else None


def _nearer_than_arm(out_mm: Float64[Array, " n"], scale: float) -> Bool[Array, " n"]:
    """Mask of side skin that belongs to the trunk: none beyond the first gap as wide as an arm."""
    ordered = np.sort(out_mm)
    gaps = _FEWEST_SIDE - 1 + np.flatnonzero(np.diff(ordered[_FEWEST_SIDE - 1 :]) > scale * _ARM_MM)
    return out_mm <= ordered[gaps[0] if len(gaps) else -1]


def _behind_breastbone(front: _Front, frame: Float64[Array, "3 3"]) -> Trunk:
    place = front.bone - [0.0, 0.0, ASSUMED_DEPTH_MM]
    return Trunk(frame=frame, origin=place @ frame, half_width_mm=ASSUMED_HALF_WIDTH_MM, assumed=True)


def fit_thorax(
    trunk: Trunk, skin: SkinSamples, *, breasts_left_out: bool = True, breastbone_mm: float | None = None
) -> Thorax:
    """Smooth radius r(θ, y) of the trunk, fitted robustly to the skin.

    The model is a Fourier series in θ whose coefficients are polynomials in y. The weights are asymmetric: Tukey's for
    skin outside the model (breasts and arms), Huber's for skin inside. Skin that faces along the axis (the trunk's end,
    a breast's underside) is excluded. The higher harmonics are slightly regularised, because the back is not visible.

    Args:
        trunk: its axis.
        skin: samples, world frame.
        breasts_left_out: whether the skin is already without the breasts. Then skin that protrudes a little is chest,
            and only arms are excluded.
        breastbone_mm: position of the breastbone around the trunk, half width × θ, if known; its skin always counts.

    Raises:
        MeasureError: too little skin.
    """
    skin = skin.about(_FIT_SAMPLES)
    cylindrical = trunk.cylindrical(skin.points_world)
    flat, radius = cylindrical[:, :2], cylindrical[:, 2]
    inside = (
        (np.abs(flat[:, 1]) < HEIGHT_WINDOW_MM)
        & (np.abs(flat[:, 0]) < np.deg2rad(WIDEST_DEG) * trunk.half_width_mm)
        & on_trunk(cylindrical, trunk)
        & (_facing_out(skin, trunk) > _FACING_OUT)
    )
    flat, radius = flat[inside], radius[inside]
    bone = np.zeros(len(flat), dtype=bool) if breastbone_mm is None else np.abs(flat[:, 0] - breastbone_mm) < _BONE_MM
    design = _design(flat, trunk.half_width_mm)
    order = np.concatenate([[0], np.repeat(np.arange(1, _HARMONICS + 1), 2)])
    ridge = np.diag(np.tile(order.astype(np.float64) ** 4, _HEIGHT_DEGREE + 1) * _RIDGE + 1e-9) * len(radius)
    weights = np.ones(len(radius))
    finest = CHEST_SCALE_MM if breasts_left_out else _FINEST_MM
    scale, coefficients = np.inf, np.zeros(design.shape[1])
    if len(radius) < 4 * design.shape[1]:
        raise MeasureError(
            "torso",
            found=f"{len(radius)} points of skin around the breasts",
            expected=f"at least {4 * design.shape[1]}",
            remedy="Photograph the trunk beside, above and below the breasts too",
            mesh_remedy="Scan the trunk beside, above and below the breasts too",
        )
    for _ in range(_FIT_ROUNDS):
        weighted = design * weights[:, None]
        coefficients = np.linalg.solve(weighted.T @ design + ridge, weighted.T @ radius)
        error = radius - design @ coefficients
        scale = max(MAD * float(np.median(np.abs(error[weights > 0.1]))), finest)
        reach = CUT_OFF * scale
        weights = np.where(
            (error > 0) & ~bone,
            np.clip(1 - (error / reach) ** 2, 0, None) ** 2,
            1 / np.maximum(1, np.abs(error) / reach),
        )
    return Thorax(trunk=trunk, coefficients=coefficients, rms_mm=scale)


def _facing_out(skin: SkinSamples, trunk: Trunk) -> Float64[Array, " n"]:
    """Component of each unit normal away from the trunk's axis."""
    aside, _, ahead = ((skin.points_world - trunk.origin) @ trunk.frame.T).T
    to_left, _, to_front = (skin.normals_world @ trunk.frame.T).T
    return np.asarray((aside * to_left + ahead * to_front) / np.maximum(np.hypot(aside, ahead), 1e-9))


def on_trunk(cylindrical: Float64[Array, "n 3"], trunk: Trunk) -> Bool[Array, " n"]:
    """Mask of the places (half width × θ, y, r), mm, that are not an arm, by their distance to the side."""
    return cylindrical[:, 2] * np.abs(np.sin(cylindrical[:, 0] / trunk.half_width_mm)) < ARM * trunk.half_width_mm


def _design(arc_y: Float64[Array, "n 2"], half_width: float) -> Float64[Array, "n c"]:
    theta, height = arc_y[:, 0] / half_width, arc_y[:, 1] / HEIGHT_WINDOW_MM
    terms = [np.ones_like(theta)]
    for k in range(1, _HARMONICS + 1):
        terms += [np.cos(k * theta), np.sin(k * theta)]
    around = np.stack(terms, axis=1)
    return np.concatenate([around * height[:, None] ** d for d in range(_HEIGHT_DEGREE + 1)], axis=1)


def orthonormal(up: Float64[Array, 3], ahead: Float64[Array, 3]) -> Float64[Array, "3 3"]:
    """Frame (rows: patient's left, head, straight ahead) with the head along `up`."""
    up = up / np.linalg.norm(up)
    ahead = ahead - up * (ahead @ up)
    ahead /= np.linalg.norm(ahead)
    return np.stack([np.cross(up, ahead), up, ahead])
