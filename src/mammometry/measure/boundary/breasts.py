"""Outlines of the breasts of a torso, or the reason why a side has none."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import median_filter

from mammometry.base.errors import MeasureError
from mammometry.base.notices import Notice
from mammometry.base.value import value
from mammometry.geometry import Array, Bool, Float64, TriangleMesh
from mammometry.geometry.nearest import closest_on_mesh
from mammometry.measure.boundary.crease import CREASE_PER_MM, Crease, follow_crease
from mammometry.measure.boundary.hidden_fold import hidden_fold_cm2
from mammometry.measure.boundary.prominence import (
    DOME_MM,
    ELSEWHERE_MM,
    LEAST_CREASED,
    LOW_CREASED,
    MIDLINE_MM,
    MIN_PROMINENCE_MM,
    SURE_PROMINENCE_MM,
    Middle,
    Prominence,
    SideName,
    Verdict,
    breast_middles,
    level_pair,
    prominence_within,
)
from mammometry.measure.solid.untangle import signed_area_mm2
from mammometry.measure.trunk.body import BodyDirections, find_body, lies_across
from mammometry.measure.trunk.head import HeadPlace, check_head, head_signs
from mammometry.measure.trunk.skin_map import PIXEL_MM, Relief, dense_samples, lay_flat
from mammometry.measure.trunk.thorax import (
    SkinSamples,
    Thorax,
    Trunk,
    find_trunk,
    fit_thorax,
    orthonormal,
    seen_faces,
    seen_skin,
)
from mammometry.surface.repair.repair import RepairedSurface

_OTHER: dict[SideName, SideName] = {"left": "right", "right": "left"}
_ROUNDS = 3  # iterations between the trunk and the middles of the breasts; not critical
_FAINT = 0.25  # domes below this roundness, relative to the other side's, stay in the trunk's fit; not critical
_HIGHEST_SIGMA_MM = 8.0  # Gaussian σ of the relief in which the highest point is searched; not critical
_BESIDE_MM = 25.0  # least distance of a side's highest point from the midline; not critical
_OUTSIDE_MM = 2 * PIXEL_MM  # distance outside a curve at which the innermost skin at a fold is the trunk's
_NEAR_MM = 20.0  # surface around an outline onto which it is projected; not critical
_ABSENT_SHARE = 1 / 3
"""Volume above the trunk at the mirrored place, relative to the other breast's, below which a breast is clearly absent:
nearer to an empty side (0) than to an equal one (1). Not 0, because the chest itself also protrudes."""
_SHEET_TURN = 0.15  # window of an outline's running median, in turns (60 to 80 mm); not critical
_LEAP_MM = 10.0  # largest distance from the running median on the same layer of skin; not critical
_FRONT_RAD, _FRONT_MM = np.deg2rad(60.0), 90.0  # half width and half height of the trunk's front
_FOLD_PER_MM = 0.08  # least concavity of a fold: folds have 0.1 to 1, the foot of a mound 0.02 to 0.06
_WIDEST_HALF_WIDTHS, _TALLEST_MM = 1.95, 260.0
"""Largest width of a base around the trunk, in half widths of the trunk, and largest height, mm. Not critical."""
_LARGEST_CM2 = 350.0
"""Largest area of a base on the flattened trunk. Real women have 170 ± 28 cm² seen from ahead; virtual ones of up to
1,600 cc, drawn from their statistics, up to 270 (docs/decisions/0029)."""
_LEAST_ROUND = 0.5  # least area of a base, relative to a circle of the same circumference; breasts have 0.7 to 1
_LOWER_QUARTER = (0.625, 0.875)  # part of the curve with the fold, in turns from the patient's left over the head


@value(eq=False)
class Outline:
    """The outline of one breast."""

    points_world: Float64[Array, "n 3"]
    """Closed curve on the surface, mm, world frame."""
    creased: float
    """Share of the curve that follows a crease. Elsewhere it follows the mean shape of breasts."""
    folded: float
    """Share of the curve's lower quarter that follows a crease as sharp as a fold."""
    seen: float
    """Share of the curve on visible skin."""
    sigma_mm: Float64[Array, " n"]
    """Standard uncertainty of each point across the curve, mm: small along a fold, large without a crease."""
    hidden_fold_cm2: float = 0.0
    """Area of skin that closes a hole at the fold, cm². 0: the fold is visible."""


@value(eq=False)
class NoBreast:
    """A side without a measured breast, with the reason."""

    name: SideName
    """The patient's ``left`` or ``right``."""
    place_world: Float64[Array, 3]
    """Highest point of the skin on that side, mm, world frame."""
    prominence: Prominence | None
    """Prominence there. None if there is none."""
    reason: Notice
    unclear: bool = False
    """Whether there may be a breast, but without a clear border or base; it is not measured."""
    refused: bool = False
    """Whether a breast was outlined but its volume refused."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Breasts:
    """Results for both sides, and the trunk."""

    left: Outline | NoBreast
    """The patient's left side."""
    right: Outline | NoBreast
    """The patient's right side."""
    thorax: Thorax
    """The trunk without the breasts."""
    body: BodyDirections
    """The body frame used for the search."""
    head: HeadPlace
    """Direction of the head."""


def find_breasts(surface: RepairedSurface, frame: Float64[Array, "3 3"], *, head_stated: bool = False) -> Breasts:
    """Outline of each side's breast, or the reason for none, and the thorax. They are found iteratively.

    Args:
        surface: the repaired mesh, world frame, mm.
        frame: patient's left, head, straight ahead (rows), approximately.
        head_stated: whether the user stated the head's direction, which is then not tested.

    Raises:
        MeasureError: a prominent breast has no plausible border or base; the trunk is not visible; the head is at the
            cameras' lower end.
    """
    skin = seen_skin(surface)
    upright = head_stated or not lies_across(skin, frame) or _lie_level(surface, skin, frame)
    body = find_body(surface, frame, skin=skin, stated=upright)
    thorax, relief, middles = _trunk_beside(surface, skin, body)
    sides = _sides(relief, thorax.trunk, middles)
    outlined = [side.crease for side in sides.values() if side.verdict == "breast"]
    signs = head_signs(skin, thorax.trunk, [fuller_below(crease, relief) for crease in outlined])
    head = check_head(signs, stated=head_stated)
    results: dict[SideName, Outline | NoBreast] = {}
    refused: list[MeasureError] = []
    for name, side in sides.items():
        try:
            results[name] = _result(name, side, relief, thorax, surface)
        except MeasureError as error:
            refused.append(error)
            place = _on_skin(side.middle[None], relief, thorax, surface.mesh)[0]
            values = {"found": error.found, "expected": error.expected}
            reason = Notice(code="breast-not-outlined", about=(name,), values=values)
            results[name] = NoBreast(
                name=name, place_world=place, prominence=side.prominence, reason=reason, unclear=True
            )
    if refused and not any(isinstance(side, Outline) for side in results.values()):
        raise refused[0]
    return Breasts(left=results["left"], right=results["right"], thorax=thorax, body=body, head=head)


def breasts_per_mm(surface: RepairedSurface, frame: Float64[Array, "3 3"]) -> float:
    """Sum of the roundness of both sides' domes, 1/mm: a score for how well a frame fits a trunk.

    0 without domes, or if the frame shows the trunk from the side.

    Raises:
        MeasureError: no skin of a trunk is visible.
    """
    skin = seen_skin(surface)
    thorax, _, middles = _trunk_beside(surface, skin, find_body(surface, frame, skin=skin, stated=True))
    domes = (0.0 if middle is None else middle.roundness_per_mm for middle in middles.values())
    return 0.0 if thorax.trunk.assumed else sum(domes)


def facing_frame(surface: RepairedSurface, frame: Float64[Array, "3 3"]) -> tuple[Float64[Array, "3 3"], bool]:
    """Frame of the trunk and its breasts, and whether a breast is found.

    Its rows are the patient's left, the head, straight ahead.

    Args:
        surface: the repaired mesh.
        frame: the same directions, approximately; the head's is not tested.

    Raises:
        MeasureError: no skin of a trunk is visible.
    """
    body = find_body(surface, frame, skin=seen_skin(surface), stated=True)
    thorax, relief, middles = _trunk_beside(surface, seen_skin(surface), body)
    between_mm = 0.0 if body.plane is not None else _between_mm(middles)
    found = any(side.verdict == "breast" for side in _sides(relief, thorax.trunk, middles).values())
    return thorax.trunk.facing(between_mm / thorax.trunk.half_width_mm), found


def _lie_level(surface: RepairedSurface, skin: SkinSamples, frame: Float64[Array, "3 3"]) -> bool:
    """Whether two breasts are side by side in the frame, not one above the other.

    If a gown covers the trunk's sides, only the breasts show the trunk's direction.
    """
    thorax = fit_thorax(find_trunk(skin, frame), skin)
    relief = lay_flat(thorax, dense_samples(surface.mesh.submesh(seen_faces(surface))))
    return level_pair(relief, most=2) is not None  # only two: a third dome, level with one of them, would also pair


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Side:
    """Result of the search on one side."""

    middle: Float64[Array, 2]
    crease: Crease
    prominence: Prominence | None
    verdict: Verdict


def _trunk_beside(
    surface: RepairedSurface, skin: SkinSamples, body: BodyDirections
) -> tuple[Thorax, Relief, dict[SideName, Middle | None]]:
    """The trunk and the breasts' middles, found iteratively, each from the other."""
    samples = dense_samples(surface.mesh.submesh(seen_faces(surface)))
    middle_of = None if body.plane is None else body.point_world
    outside = np.ones(len(skin.points_world), dtype=bool)
    height_of: Float64[Array, 3] | None = None
    between_mm: float | None = None
    frame = body.frame

    def about_trunk() -> tuple[Trunk, Thorax, Relief]:
        trunk = find_trunk(skin, frame, height_of=height_of, middle_of=middle_of)
        thorax = fit_thorax(trunk, skin.chosen(outside), breasts_left_out=not outside.all(), breastbone_mm=between_mm)
        return trunk, thorax, lay_flat(thorax, samples)

    for _ in range(_ROUNDS):
        trunk, thorax, relief = about_trunk()
        pair = level_pair(relief) if body.plane is None else None
        if pair is not None:  # both breasts determine the body's left and its middle
            frame, middle_of = _between(pair, relief, thorax)
            trunk, thorax, relief = about_trunk()
        middles = breast_middles(relief, trunk)
        domes = sorted((dome for dome in middles.values() if dome is not None), key=lambda dome: -dome.roundness_per_mm)
        if not domes:
            break
        between_mm = 0.0 if body.plane is not None else _between_mm(middles)
        frame = trunk.facing(between_mm / trunk.half_width_mm)  # straight ahead is between both breasts
        flat = trunk.cylindrical(skin.points_world)[:, :2]
        outside = np.ones(len(flat), dtype=bool)
        for dome in domes:
            if dome.roundness_per_mm > _FAINT * domes[0].roundness_per_mm:
                # Its mirror image is excluded too, so that the trunk does not depend on the other side.
                for across in (dome.flat[0], 2 * between_mm - dome.flat[0]):
                    outside &= np.hypot(flat[:, 0] - across, flat[:, 1] - dome.flat[1]) > DOME_MM
        # At the height of the rounder breast, so that it does not depend on the other side.
        height_of = trunk.world(np.array([[0.0, domes[0].flat[1], 0.0]]))[0]
    return thorax, relief, middles


def _between(
    pair: tuple[Float64[Array, 2], Float64[Array, 2]], relief: Relief, thorax: Thorax
) -> tuple[Float64[Array, "3 3"], Float64[Array, 3]]:
    """Frame (rows left, head, ahead) with two domes at the same height, and the point midway between them."""
    flat = np.stack(pair)
    radius = thorax.radius_mm(flat) + relief.at(flat, relief.bulge_mm)
    left, right = thorax.trunk.world(np.concatenate([flat, radius[:, None]], axis=1))
    up = thorax.trunk.frame[1]
    return orthonormal(up, np.cross(left - right, up)), (left + right) / 2


def _between_mm(middles: dict[SideName, Middle | None]) -> float:
    """Position midway between the breasts around the trunk, half width × θ, mm."""
    left, right = middles["left"], middles["right"]
    return 0.0 if left is None or right is None else float(left.flat[0] + right.flat[0]) / 2


def _sides(relief: Relief, trunk: Trunk, middles: dict[SideName, Middle | None]) -> dict[SideName, _Side]:
    sides: dict[SideName, _Side] = {}
    between_mm = _between_mm(middles)
    for name, middle in middles.items():
        sign = 1.0 if name == "left" else -1.0
        if middle is None:
            place = _highest(relief, sign, trunk)
            empty = Crease(
                flat=place[None].repeat(3, axis=0),
                concavity_per_mm=np.zeros(3),
                seen=np.ones(3, dtype=bool),
                sigma_mm=np.zeros(3),
            )
            sides[name] = _Side(middle=place, crease=empty, prominence=None, verdict="none")
            continue
        medial_mm = between_mm + sign * MIDLINE_MM
        ends = (medial_mm, np.inf) if name == "left" else (-np.inf, medial_mm)
        crease = follow_crease(relief, middle.flat, side=name, base_mm=middle.base_mm, between_mm=ends)
        creased = float((crease.concavity_per_mm > CREASE_PER_MM).mean())
        prominence = prominence_within(relief, _pixels_within(relief, crease.flat), creased)
        sides[name] = _Side(middle=middle.flat, crease=crease, prominence=prominence, verdict=prominence.verdict())
    sides = _by_mirrored(sides)
    return {
        name: replace(side, verdict="unclear")
        if side.verdict == "none" and not _is_absent(sides[_OTHER[name]], relief)
        else side
        for name, side in sides.items()
    }


def _by_mirrored(sides: dict[SideName, _Side]) -> dict[SideName, _Side]:
    """Decide unclear sides by comparison with the other side.

    The dome is compared with the mirrored position of the other side's breast. Two low domes at mirrored positions
    support each other: chests without breasts have none there.
    """
    decided = dict(sides)
    for name, side in sides.items():
        other = decided[_OTHER[name]]
        if side.verdict != "unclear" or side.prominence is None or other.verdict == "none":
            continue
        offset_mm = float(np.linalg.norm(side.middle - other.middle * [-1.0, 1.0]))
        if other.verdict == "breast" or offset_mm <= ELSEWHERE_MM:
            decided[name] = replace(side, verdict=side.prominence.verdict(offset_mm))
    return decided


def _is_absent(other: _Side, relief: Relief) -> bool:
    """Whether this side's breast is clearly absent.

    The other side must have a clear breast, and this side little at its mirrored position. A flat chest with a low dome
    on one side is not enough, because an absent breast implies surgery.
    """
    if other.verdict != "breast" or other.prominence is None or other.prominence.top_mm < SURE_PROMINENCE_MM:
        return False
    mirrored = prominence_within(relief, _pixels_within(relief, other.crease.flat * [-1.0, 1.0]), creased=0.0)
    return mirrored.volume_cc < _ABSENT_SHARE * other.prominence.volume_cc


def _pixels_within(relief: Relief, outline: Float64[Array, "k 2"]) -> Bool[Array, "h w"]:
    rows, columns = np.indices(relief.bulge_mm.shape)
    flat = relief.low + np.stack([columns.ravel(), rows.ravel()], axis=1) * PIXEL_MM
    return within_outline(flat, outline).reshape(rows.shape)


def _highest(relief: Relief, sign: float, trunk: Trunk) -> Float64[Array, 2]:
    """Highest point of one side's front, flattened, mm."""
    smooth = relief.smooth_mm(_HIGHEST_SIGMA_MM)
    rows, columns = np.indices(smooth.shape)
    flat = relief.low + np.stack([columns, rows], axis=-1) * PIXEL_MM
    across = sign * flat[..., 0]
    there = relief.known & (across > _BESIDE_MM) & (across < _FRONT_RAD * trunk.half_width_mm)
    there &= np.abs(flat[..., 1]) < _FRONT_MM
    best = np.unravel_index(np.argmax(np.where(there, smooth, -np.inf)), smooth.shape)
    return np.asarray(flat[best])


def within_outline(flat: Float64[Array, "n 2"], outline: Float64[Array, "k 2"]) -> Bool[Array, " n"]:
    """Mask of the points inside a closed curve that is star-shaped about its mean."""
    middle = outline.mean(axis=0)
    around = np.arctan2(*(outline - middle).T[::-1])
    away = np.linalg.norm(outline - middle, axis=1)
    order = np.argsort(around)
    inside = np.zeros(len(flat), dtype=bool)
    near = np.flatnonzero((np.abs(flat - middle) <= away.max()).all(axis=1))
    offset = flat[near] - middle
    reach = np.interp(np.arctan2(offset[:, 1], offset[:, 0]), around[order], away[order], period=2 * np.pi)
    inside[near] = np.linalg.norm(offset, axis=1) < reach
    return inside


def _result(
    name: SideName, side: _Side, relief: Relief, thorax: Thorax, surface: RepairedSurface
) -> Outline | NoBreast:
    """A side's outline on the skin, or the reason for none.

    Raises:
        MeasureError: a prominent breast has too little of a crease around it, or an implausible base.
    """
    if side.verdict == "none":
        place = _on_skin(side.middle[None], relief, thorax, surface.mesh)[0]
        reason = _low("no-breast", name, side.prominence)
        return NoBreast(name=name, place_world=place, prominence=side.prominence, reason=reason)
    crease = side.crease
    if side.verdict == "unclear" and (side.prominence is None or side.prominence.top_mm < MIN_PROMINENCE_MM):
        place = _on_skin(side.middle[None], relief, thorax, surface.mesh)[0]
        reason = _low("breast-unclear", name, side.prominence)
        return NoBreast(name=name, place_world=place, prominence=side.prominence, reason=reason, unclear=True)
    creased = creased_share(crease, name)
    if side.verdict == "unclear":
        raise _no_crease(creased, name, LOW_CREASED)
    _check_base(crease.flat, name, thorax.trunk)
    flat = crease.flat
    below = np.arange(len(flat)) / len(flat)  # turns, from the patient's left over the head
    lower = (below > _LOWER_QUARTER[0]) & (below < _LOWER_QUARTER[1])
    points = _on_skin(flat, relief, thorax, surface.mesh)
    return Outline(
        points_world=points,
        creased=creased,
        folded=float((crease.concavity_per_mm[lower] > _FOLD_PER_MM).mean()),
        seen=float(crease.seen.mean()),
        sigma_mm=crease.sigma_mm,
        hidden_fold_cm2=hidden_fold_cm2(points[lower], surface),
    )


def _low(code: str, name: SideName, prominence: Prominence | None) -> Notice:
    """Notice with this code. A low prominence appends ``-low`` to the code and gives its height."""
    if prominence is None:
        return Notice(code=code, about=(name,))
    values = {"top_mm": prominence.top_mm, "mean_mm": prominence.mean_mm}
    return Notice(code=f"{code}-low", about=(name,), values=values)


def _on_skin(flat: Float64[Array, "n 2"], relief: Relief, thorax: Thorax, mesh: TriangleMesh) -> Float64[Array, "n 3"]:
    """Points of a flattened closed curve (or one point) on the skin, mm, world frame."""
    bulge_mm = relief.at(flat, relief.bulge_mm)
    if len(flat) > 1:
        away = flat - flat.mean(axis=0)
        outside = flat + away * (_OUTSIDE_MM / np.linalg.norm(away, axis=1, keepdims=True))
        bulge_mm = on_one_sheet(np.minimum(bulge_mm, relief.at(outside, relief.bulge_mm)))
    radius = thorax.radius_mm(flat) + bulge_mm
    world = thorax.trunk.world(np.concatenate([flat, radius[:, None]], axis=1))
    return closest_on_mesh(world, _near(mesh, world)).points


def on_one_sheet(bulge_mm: Float64[Array, " n"]) -> Float64[Array, " n"]:
    """Bulge of an outline without jumps to another layer of skin, mm.

    Where a rail or a fold hides the trunk, the innermost visible skin is the underside of the breast, 20 to 40 mm in
    front, and the outline would alternate between both. Points off the running median are interpolated instead.

    Args:
        bulge_mm: at equal parts of a turn.
    """
    width = max(3, 2 * round(_SHEET_TURN * len(bulge_mm) / 2) + 1)
    leaps = np.abs(bulge_mm - median_filter(bulge_mm, size=width, mode="wrap")) > _LEAP_MM
    if leaps.all() or not leaps.any():
        return bulge_mm
    places, kept = np.arange(len(bulge_mm)), np.flatnonzero(~leaps)
    filled: Float64[Array, " n"] = np.where(
        leaps, np.interp(places, kept, bulge_mm[kept], period=len(bulge_mm)), bulge_mm
    )
    return filled


def _check_base(flat: Float64[Array, "n 2"], name: str, trunk: Trunk) -> None:
    """Raise a MeasureError if a base is too wide, too tall, too large or too ragged for a breast."""
    width, height = np.ptp(flat, axis=0)
    area = abs(signed_area_mm2(flat))
    length = float(np.linalg.norm(np.roll(flat, -1, axis=0) - flat, axis=1).sum())
    roundness = 4 * np.pi * area / length**2
    widest = _WIDEST_HALF_WIDTHS * trunk.half_width_mm
    area_cm2 = area / 100
    if width > widest or height > _TALLEST_MM or area_cm2 > _LARGEST_CM2 or roundness < _LEAST_ROUND:
        raise MeasureError(
            f"the patient's {name} breast",
            found=f"an outline {width:.0f} × {height:.0f} mm, {area_cm2:.0f} cm², roundness {100 * roundness:.0f} %",
            expected=f"at most {widest:.0f} × {_TALLEST_MM:.0f} mm, {_LARGEST_CM2:.0f} cm², "
            f"roundness at least {100 * _LEAST_ROUND:.0f} %",
            remedy="Draw its boundary with `mammometry edit`, or pick the landmarks of the protocol",
        )


def fuller_below(crease: Crease, relief: Relief) -> float:
    """Inferior–superior asymmetry of fullness and crease, −1 to 1.

    Gravity and the inframammary fold make a breast's crease sharper below and shift its mass below the middle, so the
    sign shows the direction of the feet.
    """
    turn = np.arange(len(crease.flat)) / len(crease.flat)
    low, high = _LOWER_QUARTER
    lower, upper = ((turn > low - half) & (turn < high - half) for half in (0.0, 0.5))
    sharp = np.clip(crease.concavity_per_mm, 0.0, None)
    below, above = float(sharp[lower].mean()), float(sharp[upper].mean())
    inside = _pixels_within(relief, crease.flat)
    rows = np.nonzero(inside)[0]
    mass = np.clip(relief.bulge_mm[inside] - np.median(relief.at(crease.flat, relief.bulge_mm)), 0.0, None)
    half = max(float(np.ptp(rows)) / 2, 1.0)
    inferior_shift = ((rows.max() + rows.min()) / 2 - float((rows * mass).sum() / max(mass.sum(), 1e-9))) / half
    return float(np.clip((below - above) / max(below + above, 1e-9) / 2 + 2 * inferior_shift, -1.0, 1.0))


def creased_share(crease: Crease, name: str) -> float:
    """Share of a curve along which there is a crease.

    Raises:
        MeasureError: the share is too small to locate the border.
    """
    creased = float((crease.concavity_per_mm > CREASE_PER_MM).mean())
    if creased < LEAST_CREASED:
        raise _no_crease(creased, name, LEAST_CREASED)
    return creased


def _no_crease(creased: float, name: str, least: float) -> MeasureError:
    return MeasureError(
        f"the patient's {name} breast",
        found=f"a crease around {100 * creased:.0f} % of it",
        expected=f"one around at least {100 * least:.0f} %, to find its border",
        remedy="Draw its boundary with `mammometry edit`, or pick the landmarks of the protocol",
    )


def _near(mesh: TriangleMesh, points_world: Float64[Array, "n 3"]) -> TriangleMesh:
    """Part of a mesh near the points. The whole mesh if it has no faces there."""
    inside = np.zeros(len(mesh.vertices), dtype=bool)
    inside[mesh.vertices_between(points_world.min(axis=0) - _NEAR_MM, points_world.max(axis=0) + _NEAR_MM)] = True
    part = mesh.submesh(mesh.faces_within(inside))
    return part if len(part.faces) else mesh
