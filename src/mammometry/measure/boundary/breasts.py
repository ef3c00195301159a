"""Outline the breast of each side of a torso, or say that there is none."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import median_filter

from mammometry.base.errors import MeasureError
from mammometry.base.value import value
from mammometry.geometry import Array, Bool, Float64, TriangleMesh
from mammometry.geometry.nearest import closest_on_mesh
from mammometry.measure.boundary.crease import CREASE_PER_MM, Crease, follow_crease
from mammometry.measure.boundary.hidden_fold import hidden_fold_cm2
from mammometry.measure.boundary.prominence import (
    DOME_MM,
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
from mammometry.measure.trunk.body import Body, find_body, lies_across
from mammometry.measure.trunk.head import HeadPlace, check_head, head_signs
from mammometry.measure.trunk.skin_map import PIXEL_MM, Relief, dense_samples, lay_flat
from mammometry.measure.trunk.thorax import (
    Skin,
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
_ROUNDS = 3  # times that trunk and middles are found, each from the other; chosen by eye
_FAINT = 0.25  # a dome this much flatter than the other side's is left in the trunk; chosen by eye
_HIGHEST_SIGMA_MM = 8.0  # the relief is smoothed over this to look for the highest place; chosen by eye
_BESIDE_MM = 25.0  # the highest place of a side lies this far from the midline; chosen by eye
_OUTSIDE_MM = 2 * PIXEL_MM  # outside a curve at a fold the innermost skin is the trunk's, and not the breast's
_NEAR_MM = 20.0  # surface around an outline onto which it is laid; chosen by eye
_LACKS = 1 / 3
"""Share of the other breast's volume that stands out at its mirrored place, below which a side clearly has none: nearer
to an empty side, 0, than to an equal one, 1, since a chest's own form stands out, too."""
_SHEET_TURN = 0.15  # of a turn, over which an outline's running median is taken: 60 to 80 mm; chosen by eye
_LEAP_MM = 10.0  # off the running median: another layer of skin. On whole captures no outline has any; chosen by eye
_FRONT_RAD, _FRONT_MM = np.deg2rad(60.0), 90.0  # of the trunk's front, where the highest place of a side is named
_FOLD_PER_MM = 0.08  # concavity from which a crease is a fold, not the foot of a mound (.02 to .06); a fold has .1 to 1
_WIDEST_HALF_WIDTHS, _TALLEST_MM = 1.95, 260.0
"""Largest width of a breast's base around the trunk, half widths, and largest height, mm. Chosen by eye."""
_LARGEST_CM2 = 350.0
"""Largest area of a base, laid flat. Real women's have 170 ± 28 cm² seen from ahead; virtual ones of up to 1,600 cc,
drawn from their statistics, up to 270 (docs/decisions/0029)."""
_LEAST_ROUND = 0.5  # area of a base over that of a circle of its length, laid flat; breasts have .7 to 1
_LOWER_QUARTER = (0.625, 0.875)  # of a turn from the patient's left by the head: where the fold is


@value(eq=False)
class Outline:
    """The outline of one breast."""

    points_world: Float64[Array, "n 3"]
    """Closed curve on the surface, mm, world frame."""
    creased: float
    """Share of the curve that follows a crease. Elsewhere the shape of other breasts decided."""
    folded: float
    """Share of the curve's lower quarter that follows a crease as sharp as a fold: it shows whether there is a fold."""
    seen: float
    """Share of the curve that lies on visible skin."""
    sigma_mm: Float64[Array, " n"]
    """Standard uncertainty of each point across the curve, mm: small along a fold, large where nothing shows it."""
    hidden_fold_cm2: float = 0.0
    """Area of skin that closes a hole where the fold is, cm². 0: the fold is seen."""


@value(eq=False)
class NoBreast:
    """A side without an outlined breast, with the evidence for that."""

    name: SideName
    """The patient's "left" or "right"."""
    place_world: Float64[Array, 3]
    """The highest place on that side, on the skin, mm, world frame."""
    prominence: Prominence | None
    """What stands out there. None if nothing does."""
    why: str
    """What the result rests on, one sentence."""
    unclear: bool = False
    """Whether something stands out that may be a breast but has no clear end or base: then it is not measured."""
    refused: bool = False
    """Whether a breast was outlined there, and its volume refused."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Breasts:
    """Findings on both sides, and the trunk they were found on."""

    left: Outline | NoBreast
    """The patient's left side."""
    right: Outline | NoBreast
    """The patient's right side."""
    thorax: Thorax
    """The trunk without the breasts."""
    body: Body
    """The frame in which they were looked for."""
    head: HeadPlace
    """Where the head is."""


def find_breasts(surface: RepairedSurface, frame: Float64[Array, "3 3"], *, head_stated: bool = False) -> Breasts:
    """Find the breast of each side, or none, and the thorax.

    The thorax lies between and beside the breasts. Both are found in turn.

    Args:
        surface: the repaired mesh, world frame, mm.
        frame: patient's left, head, straight ahead (rows), roughly.
        head_stated: whether the user said where the head is: then no sign of the body contradicts it.

    Raises:
        MeasureError: something stands out as a breast does, but its end or its base is not one's; the trunk is not
            seen, or its head is where the cameras have the feet.
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
            why = f"What stands out there cannot be outlined: found {error.found}, expected {error.expected}"
            results[name] = NoBreast(name=name, place_world=place, prominence=side.prominence, why=why, unclear=True)
    if refused and not any(isinstance(side, Outline) for side in results.values()):
        raise refused[0]
    return Breasts(left=results["left"], right=results["right"], thorax=thorax, body=body, head=head)


def breasts_per_mm(surface: RepairedSurface, frame: Float64[Array, "3 3"]) -> float:
    """Roundness of both sides' domes together, 1/mm: how much a trunk with breasts is seen in a frame.

    0 where nothing is a dome, or no trunk is seen between two sides, as from aside.

    Raises:
        MeasureError: no skin of a trunk is seen.
    """
    skin = seen_skin(surface)
    thorax, _, middles = _trunk_beside(surface, skin, find_body(surface, frame, skin=skin, stated=True))
    domes = (0.0 if middle is None else middle.roundness_per_mm for middle in middles.values())
    return 0.0 if thorax.trunk.assumed else sum(domes)


def _lie_level(surface: RepairedSurface, skin: Skin, frame: Float64[Array, "3 3"]) -> bool:
    """Whether two breasts lie beside each other in the frame, and not one above the other.

    Where a gown covers the trunk's sides its skin does not show which way it lies, but two breasts do.
    """
    thorax = fit_thorax(find_trunk(skin, frame), skin)
    return level_pair(lay_flat(thorax, dense_samples(surface.mesh.submesh(seen_faces(surface))))) is not None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Side:
    """Findings of the search on one side."""

    middle: Float64[Array, 2]
    crease: Crease
    prominence: Prominence | None
    verdict: Verdict


def _trunk_beside(
    surface: RepairedSurface, skin: Skin, body: Body
) -> tuple[Thorax, Relief, dict[SideName, Middle | None]]:
    """Find the trunk and what stands out from it like a breast, each from the other."""
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
        if pair is not None:  # then both breasts show the body's left, and its middle
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
                # Its mirror image is left out too: so the trunk is the same whatever the other side has.
                for across in (dome.flat[0], 2 * between_mm - dome.flat[0]):
                    outside &= np.hypot(flat[:, 0] - across, flat[:, 1] - dome.flat[1]) > DOME_MM
        # At the height of the rounder breast, which does not depend on what the other side has.
        height_of = trunk.world(np.array([[0.0, domes[0].flat[1], 0.0]]))[0]
    return thorax, relief, middles


def _between(
    pair: tuple[Float64[Array, 2], Float64[Array, 2]], relief: Relief, thorax: Thorax
) -> tuple[Float64[Array, "3 3"], Float64[Array, 3]]:
    """Frame with two domes level, rows left, head, ahead, and the point between them."""
    flat = np.stack(pair)
    radius = thorax.radius_mm(flat) + relief.at(flat, relief.bulge_mm)
    left, right = thorax.trunk.world(np.concatenate([flat, radius[:, None]], axis=1))
    up = thorax.trunk.frame[1]
    return orthonormal(up, np.cross(left - right, up)), (left + right) / 2


def _between_mm(middles: dict[SideName, Middle | None]) -> float:
    """Place around the trunk between both breasts, half width × θ."""
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
    for name, side in sides.items():
        other = sides[_OTHER[name]]
        if side.verdict == "unclear" and side.prominence is not None and other.verdict == "breast":
            astray_mm = float(np.linalg.norm(side.middle - other.middle * [-1.0, 1.0]))
            sides[name] = replace(side, verdict=side.prominence.verdict(astray_mm))
    return {
        name: replace(side, verdict="unclear")
        if side.verdict == "none" and not _is_lacking(sides[_OTHER[name]], relief)
        else side
        for name, side in sides.items()
    }


def _is_lacking(other: _Side, relief: Relief) -> bool:
    """Whether the other side clearly has a breast, and little stands out where it is mirrored.

    That a breast is missing is a statement about surgery, which a flat chest with a low dome on one side does not show.
    """
    if other.verdict != "breast" or other.prominence is None or other.prominence.top_mm < SURE_PROMINENCE_MM:
        return False
    mirrored = prominence_within(relief, _pixels_within(relief, other.crease.flat * [-1.0, 1.0]), creased=0.0)
    return mirrored.volume_cc < _LACKS * other.prominence.volume_cc


def _pixels_within(relief: Relief, outline: Float64[Array, "k 2"]) -> Bool[Array, "h w"]:
    rows, columns = np.indices(relief.bulge_mm.shape)
    flat = relief.low + np.stack([columns.ravel(), rows.ravel()], axis=1) * PIXEL_MM
    return within_outline(flat, outline).reshape(rows.shape)


def _highest(relief: Relief, sign: float, trunk: Trunk) -> Float64[Array, 2]:
    """Place on one side's front that stands out most, laid flat, mm."""
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
    """A side's outline on the skin, or that it has none.

    Raises:
        MeasureError: something stands out, but no crease runs around most of it, or its base is not a breast's.
    """
    if side.verdict == "none":
        place = _on_skin(side.middle[None], relief, thorax, surface.mesh)[0]
        return NoBreast(name=name, place_world=place, prominence=side.prominence, why=_why_none(side.prominence))
    crease = side.crease
    if side.verdict == "unclear" and (side.prominence is None or side.prominence.top_mm < MIN_PROMINENCE_MM):
        place = _on_skin(side.middle[None], relief, thorax, surface.mesh)[0]
        why = f"{_why_none(side.prominence)}. Whether a breast is missing there is not clear"
        return NoBreast(name=name, place_world=place, prominence=side.prominence, why=why, unclear=True)
    creased = creased_share(crease, name)
    if side.verdict == "unclear":
        raise _no_crease(creased, name, LOW_CREASED)
    _check_base(crease.flat, name, thorax.trunk)
    flat = crease.flat
    below = np.arange(len(flat)) / len(flat)  # of a turn, from the patient's left by the head
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


def _why_none(prominence: Prominence | None) -> str:
    if prominence is None:
        return "Nothing on that side stands out from the trunk all around"
    return (
        f"The highest place stands out {prominence.top_mm:.0f} mm from the skin around it, and "
        f"{prominence.mean_mm:.0f} mm on average: a chest's form, not a breast's"
    )


def _on_skin(flat: Float64[Array, "n 2"], relief: Relief, thorax: Thorax, mesh: TriangleMesh) -> Float64[Array, "n 3"]:
    """Put places that were laid flat back on the skin, mm, world frame. Several are a closed curve."""
    bulge_mm = relief.at(flat, relief.bulge_mm)
    if len(flat) > 1:
        away = flat - flat.mean(axis=0)
        outside = flat + away * (_OUTSIDE_MM / np.linalg.norm(away, axis=1, keepdims=True))
        bulge_mm = on_one_sheet(np.minimum(bulge_mm, relief.at(outside, relief.bulge_mm)))
    radius = thorax.radius_mm(flat) + bulge_mm
    world = thorax.trunk.world(np.concatenate([flat, radius[:, None]], axis=1))
    return closest_on_mesh(world, _near(mesh, world)).points


def on_one_sheet(bulge_mm: Float64[Array, " n"]) -> Float64[Array, " n"]:
    """Replace leaps of an outline to another layer of skin.

    An outline lies on the trunk. Where a rail or a fold hides the trunk, the innermost skin that was seen is the
    underside of the breast, 20 to 40 mm before it, and the outline would run to and fro between both. What lies off
    the running median is interpolated between its neighbours instead.

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
    """Refuse a base that no breast has.

    Raises:
        MeasureError: it is too wide, too tall, too large or too ragged.
    """
    width, height = np.ptp(flat, axis=0)
    area = abs(signed_area_mm2(flat))
    length = float(np.linalg.norm(np.roll(flat, -1, axis=0) - flat, axis=1).sum())
    roundness = 4 * np.pi * area / length**2
    widest = _WIDEST_HALF_WIDTHS * trunk.half_width_mm
    area_cm2 = area / 100
    if width > widest or height > _TALLEST_MM or area_cm2 > _LARGEST_CM2 or roundness < _LEAST_ROUND:
        raise MeasureError(
            f"the patient's {name} breast",
            found=f"an outline {width:.0f} × {height:.0f} mm, {area_cm2:.0f} cm², "
            f"{100 * roundness:.0f} % as round as a circle",
            expected=f"at most {widest:.0f} × {_TALLEST_MM:.0f} mm, {_LARGEST_CM2:.0f} cm², "
            f"and {100 * _LEAST_ROUND:.0f} % or more",
            remedy="Draw its boundary with `mammometry edit`, or pick the landmarks of the protocol",
        )


def fuller_below(crease: Crease, relief: Relief) -> float:
    """Fullness and crease below against above, −1 to 1.

    Gravity and the inframammary fold make a breast's crease sharper below, and put its mass below the middle. So this
    shows where the feet are. Turned upside down it has the other sign.
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
    sunk = ((rows.max() + rows.min()) / 2 - float((rows * mass).sum() / max(mass.sum(), 1e-9))) / half
    return float(np.clip((below - above) / max(below + above, 1e-9) / 2 + 2 * sunk, -1.0, 1.0))


def creased_share(crease: Crease, name: str) -> float:
    """Share of a curve along which there is a crease.

    Raises:
        MeasureError: it is too little to say where the breast ends.
    """
    creased = float((crease.concavity_per_mm > CREASE_PER_MM).mean())
    if creased < LEAST_CREASED:
        raise _no_crease(creased, name, LEAST_CREASED)
    return creased


def _no_crease(creased: float, name: str, least: float) -> MeasureError:
    return MeasureError(
        f"the patient's {name} breast",
        found=f"a crease around {100 * creased:.0f} % of it",
        expected=f"one around at least {100 * least:.0f} %, to find where it ends",
        remedy="Draw its boundary with `mammometry edit`, or pick the landmarks of the protocol",
    )


def _near(mesh: TriangleMesh, points_world: Float64[Array, "n 3"]) -> TriangleMesh:
    """The part of a mesh around some points on it. All of it where they are not."""
    inside = np.zeros(len(mesh.vertices), dtype=bool)
    inside[mesh.vertices_between(points_world.min(axis=0) - _NEAR_MM, points_world.max(axis=0) + _NEAR_MM)] = True
    part = mesh.submesh(mesh.faces_within(inside))
    return part if len(part.faces) else mesh
