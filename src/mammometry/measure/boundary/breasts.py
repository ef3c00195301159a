"""Outline each breast of a torso along its crease, if any.

The crease is between breast and trunk.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal, TypeAlias

import numpy as np
from scipy.ndimage import label, maximum_filter, median_filter

from mammometry.base.errors import MeasureError
from mammometry.geometry.arrays import Array, Bool, Float64, read_only
from mammometry.geometry.mesh import TriangleMesh
from mammometry.geometry.nearest import closest_on_mesh
from mammometry.measure.boundary.crease import CREASE_PER_MM, Crease, crease_worth, follow_crease
from mammometry.measure.boundary.standing import Standing, Verdict, standing_out
from mammometry.measure.settings import BreastSettings, ThoraxSettings
from mammometry.measure.trunk.body import Body, find_body
from mammometry.measure.trunk.head import check_head, head_signs
from mammometry.measure.trunk.skin_map import PIXEL_MM, Relief, dense_samples, lay_flat
from mammometry.measure.trunk.thorax import Skin, Thorax, Trunk, find_trunk, fit_thorax, seen_faces, seen_skin
from mammometry.surface.repair import RepairedSurface

SideName: TypeAlias = Literal["left", "right"]
_OTHER: dict[SideName, SideName] = {"left": "right", "right": "left"}
_ROUNDS = 3  # times that trunk and breasts are found, each from the other; chosen by eye
_CREASE_LOST = 0.03
"""Share of the crease by which a round may have less than the best before it. Each round's thorax rests on the outlines
of the one before, so that a wrong outline can make the next one worse. Chosen by eye: rounds that settle differ by
less."""
_PEAK_SIGMA_MM = 8.0  # the relief is smoothed over this to look for peaks; chosen by eye
_PEAK_RADIUS_MM = 25.0  # a peak is the highest place within this distance, in both coordinates; chosen by eye
_LOWEST_PEAK = 0.5
"""Share of the least height from which peaks are looked for. The thorax fit is off by some mm, and what stands out is
measured again over the skin along its outline.
"""
_PEAK_DIRECTIONS = 36  # in which a peak must fall off, 10° apart
_WIDEST_RAD = np.deg2rad(80.0)  # a breast's peak lies no further around the trunk than this; chosen by eye
_SURROUNDED = 0.75  # share of the directions in which a peak must fall to half its height; chosen by eye
_LIKE_MM = 60.0  # a pair whose places differ by this from mirrored ones counts 1/e; chosen by eye
_NEAR_MM = 20.0  # surface around an outline onto which it is laid; chosen by eye
_SHEET_TURN = 0.15  # of a turn, over which an outline's running median is taken: 60 to 80 mm; chosen by eye
_LEAP_MM = 10.0  # off the running median: another layer of skin. On whole captures no outline has any; chosen by eye
_MIDLINE_MM = 4.0  # each boundary keeps this far from the middle between both; chosen by eye
_FRONT_RAD, _FRONT_MM = np.deg2rad(60.0), 90.0  # of the trunk's front, where the highest place of a side is named
_FOLD_PER_MM = 0.08  # concavity from which a crease is a fold, not the foot of a mound (.02 to .06); a fold has .1 to 1
_WIDEST_HALF_WIDTHS, _TALLEST_MM = 1.95, 260.0
"""Largest width of a breast's base around the trunk, half widths, and largest height, mm. Chosen by eye."""
_LARGEST_CM2 = 350.0
"""Largest area of a base, laid flat. Real women's have 170 ± 28 cm² seen from ahead; virtual ones of up to 1,600 cc,
drawn from their statistics, up to 270 (docs/decisions/0029)."""
_LEAST_ROUND = 0.5  # area of a base over that of a circle of its length, laid flat; breasts have .7 to 1
_LOWER_QUARTER = (0.625, 0.875)  # of a turn from the patient's left by the head: where the fold is


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Outline:
    """The outline of one breast."""

    points_world: Float64[Array, "n 3"]
    """Closed curve on the surface, mm, world frame."""
    creased: float
    """Share of the curve that follows a crease. Elsewhere its neighbours decided."""
    folded: float
    """Share of the curve's lower quarter that follows a crease as sharp as a fold: it shows whether there is a fold."""
    seen: float
    """Share of the curve that lies on visible skin."""
    sigma_mm: float
    """Standard uncertainty of the curve across itself, mm: the sharpness of the crease's end on plain skin."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "points_world", read_only(self.points_world))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class NoBreast:
    """A side without an outlined breast, with the evidence for that."""

    name: SideName
    """The patient's "left" or "right"."""
    place_world: Float64[Array, 3]
    """The highest place on that side, on the skin, mm, world frame."""
    standing: Standing | None
    """What stands out there. None if nothing does."""
    why: str
    """What the result rests on, one sentence."""
    unclear: bool = False
    """Whether something stands out that may be a breast but has no clear end or base: then it is not measured."""
    refused: bool = False
    """Whether a breast was outlined there, and its volume refused."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "place_world", read_only(self.place_world))


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
    head: str
    """What the body says of where the head is, a clause."""


def find_breasts(
    surface: RepairedSurface,
    frame: Float64[Array, "3 3"],
    settings: BreastSettings = BreastSettings(),
    thorax_settings: ThoraxSettings = ThoraxSettings(),
    *,
    head_stated: bool = False,
) -> Breasts:
    """Find the breast of each side, or none, and the thorax.

    The thorax lies between and beside the breasts. Both are found in turn.

    Args:
        surface: the repaired mesh, world frame, mm.
        frame: patient's left, head, straight ahead (rows), roughly.
        settings: what a breast is and where it ends.
        thorax_settings: how the trunk is described.
        head_stated: whether the user said where the head is: then no sign of the body contradicts it.

    Raises:
        MeasureError: something stands out as a breast does, but its end or its base is not one's; the trunk is not
            seen, or its head is where the cameras have the feet.
    """
    skin = seen_skin(surface)
    body = find_body(surface, frame, thorax_settings, skin=skin, stated=head_stated)
    best = _best_round(surface, skin, body, settings, thorax_settings)
    thorax, relief, sides = best.thorax, best.relief, best.sides
    outlined = [side.crease for side in sides.values() if side.verdict == "breast"]
    signs = head_signs(skin, thorax.trunk, [fuller_below(crease, relief) for crease in outlined])
    head = check_head(signs, stated=head_stated)
    results: dict[SideName, Outline | NoBreast] = {}
    refused: list[MeasureError] = []
    for name, side in sides.items():
        try:
            results[name] = _result(name, side, sides[_OTHER[name]], relief, thorax, surface, settings)
        except MeasureError as error:
            refused.append(error)
            place = _on_skin(side.middle[None], relief, thorax, surface.mesh)[0]
            why = f"What stands out there cannot be outlined: found {error.found}, expected {error.expected}"
            results[name] = NoBreast(name=name, place_world=place, standing=side.standing, why=why, unclear=True)
    if refused and not any(isinstance(each, Outline) for each in results.values()):
        raise refused[0]
    return Breasts(left=results["left"], right=results["right"], thorax=thorax, body=body, head=head)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Side:
    """What was seen on one side."""

    middle: Float64[Array, 2]
    crease: Crease
    standing: Standing | None
    verdict: Verdict


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Round:
    """A trunk, and the sides that were seen on it."""

    thorax: Thorax
    relief: Relief
    sides: dict[SideName, _Side]

    @property
    def gathered(self) -> dict[SideName, float]:
        """How much of a crease each breast's outline follows, 0 to 1."""
        return {
            name: float(crease_worth(side.crease.concavity_per_mm).mean())
            for name, side in self.sides.items()
            if side.verdict == "breast"
        }


def _best_round(
    surface: RepairedSurface, skin: Skin, body: Body, settings: BreastSettings, thorax_settings: ThoraxSettings
) -> _Round:
    """Find trunk and breasts in turn, and keep the last good round.

    It ends when an outline clearly loses the crease that it followed before.
    """
    samples = dense_samples(surface.mesh.submesh(seen_faces(surface)))
    outside = np.ones(len(skin.points_world), dtype=bool)
    height_of: Float64[Array, 3] | None = None
    most: dict[SideName, float] = {}
    best: _Round | None = None
    for _ in range(_ROUNDS):
        middle_of = None if body.plane is None else body.point_world
        trunk = find_trunk(skin, body.frame, thorax_settings, height_of=height_of, middle_of=middle_of)
        thorax = fit_thorax(trunk, skin.chosen(outside), thorax_settings, breasts_left_out=not outside.all())
        relief = lay_flat(thorax, samples, thorax_settings)
        this = _Round(thorax=thorax, relief=relief, sides=_sides(relief, trunk, settings))
        gathered = this.gathered
        if best is not None and any(share < most.get(name, 0.0) - _CREASE_LOST for name, share in gathered.items()):
            break
        best, most = this, {name: max(share, most.get(name, 0.0)) for name, share in gathered.items()}
        flat = trunk.cylindrical(skin.points_world)[:, :2]
        found = [side.crease.flat for side in _fullest_first(this.sides) if side.verdict == "breast"]
        # A breast's mirror image is left out too: so the trunk beside it is the same whatever the other side has.
        left_out = [curve * sign for curve in found for sign in ([1.0, 1.0], [-1.0, 1.0])]
        outside = np.ones(len(skin.points_world), dtype=bool)
        for curve in left_out:
            outside &= ~within_outline(flat, curve)
        if found:
            # At the height of the fuller breast, which does not depend on what the other side has.
            height_of = trunk.world(np.array([[0.0, found[0][:, 1].mean(), 0.0]]))[0]
    assert best is not None
    return best


def _sides(relief: Relief, trunk: Trunk, settings: BreastSettings) -> dict[SideName, _Side]:
    found: dict[SideName, _Side] = {}
    for name, middle in breast_middles(relief, trunk, settings).items():
        if middle is None:
            place = _highest(relief, 1.0 if name == "left" else -1.0, trunk)
            empty = Crease(
                flat=place[None].repeat(3, axis=0),
                concavity_per_mm=np.zeros(3),
                seen=np.ones(3, dtype=bool),
                blur_mm=np.zeros(3),
            )
            found[name] = _Side(middle=place, crease=empty, standing=None, verdict="none")
            continue
        crease = follow_crease(relief, middle, settings)
        creased = float((crease.concavity_per_mm > CREASE_PER_MM).mean())
        standing = standing_out(relief, _pixels_within(relief, crease.flat), creased)
        found[name] = _Side(middle=middle, crease=crease, standing=standing, verdict=standing.verdict(settings))
    for name, side in found.items():
        other = found[_OTHER[name]]
        if side.verdict == "unclear" and side.standing is not None and other.verdict == "breast":
            astray_mm = float(np.linalg.norm(side.middle - other.middle * [-1.0, 1.0]))
            found[name] = replace(side, verdict=side.standing.verdict(settings, astray_mm))
    return found


def _fullest_first(sides: dict[SideName, _Side]) -> list[_Side]:
    return sorted(sides.values(), key=lambda side: 0.0 if side.standing is None else -side.standing.volume_cc)


def _pixels_within(relief: Relief, outline: Float64[Array, "k 2"]) -> Bool[Array, "h w"]:
    rows, columns = np.indices(relief.bulge_mm.shape)
    flat = relief.low + np.stack([columns.ravel(), rows.ravel()], axis=1) * PIXEL_MM
    return within_outline(flat, outline).reshape(rows.shape)


def _highest(relief: Relief, sign: float, trunk: Trunk) -> Float64[Array, 2]:
    """Place on one side's front that stands out most, laid flat, mm."""
    smooth = relief.smooth_mm(_PEAK_SIGMA_MM)
    rows, columns = np.indices(smooth.shape)
    flat = relief.low + np.stack([columns, rows], axis=-1) * PIXEL_MM
    across = sign * flat[..., 0]
    there = relief.known & (across > _PEAK_RADIUS_MM) & (across < _FRONT_RAD * trunk.half_width_mm)
    there &= np.abs(flat[..., 1]) < _FRONT_MM
    best = np.unravel_index(np.argmax(np.where(there, smooth, -np.inf)), smooth.shape)
    return np.asarray(flat[best])


def breast_middles(
    relief: Relief, trunk: Trunk, settings: BreastSettings = BreastSettings()
) -> dict[SideName, Float64[Array, 2] | None]:
    """Middles of the left and right breast, laid flat, mm.

    None on a side where no peak stands out. A breast is a peak that falls off all around. Belly and shoulders do not:
    they end with the picture. Where both sides have peaks, the pair is taken that stands out most and lies most alike
    on both sides. The middle is that of all skin that stands out at least half as far as the peak.
    """
    smooth = relief.smooth_mm(_PEAK_SIGMA_MM)
    size = 2 * int(_PEAK_RADIUS_MM / PIXEL_MM) + 1
    row, column = np.nonzero(
        (smooth == maximum_filter(smooth, size=size)) & relief.known & (smooth > _LOWEST_PEAK * settings.fewest_mm)
    )
    peaks = relief.low + np.stack([column, row], axis=1) * PIXEL_MM
    tops = smooth[row, column]
    worth = tops * np.array([_surrounded(relief, smooth, peak, settings) for peak in peaks])
    usable = (np.abs(peaks[:, 0]) < _WIDEST_RAD * trunk.half_width_mm) & (worth > _SURROUNDED * tops)
    sides = [np.flatnonzero(usable & (peaks[:, 0] * sign > _MIDLINE_MM)) for sign in (1, -1)]
    chosen: list[int | None] = [int(side[np.argmax(worth[side])]) if len(side) else None for side in sides]
    if all(len(side) for side in sides):
        left, right = sides[0][:, None], sides[1][None]
        apart = np.hypot(peaks[left, 1] - peaks[right, 1], peaks[left, 0] + peaks[right, 0])
        alike = worth[left] * worth[right] * np.exp(-((apart / _LIKE_MM) ** 2))
        pair = np.unravel_index(np.argmax(alike), apart.shape)
        chosen = [int(sides[0][pair[0]]), int(sides[1][pair[1]])]
    first, second = (None if peak is None else _half_height(relief, smooth, peaks[peak], settings) for peak in chosen)
    return {"left": first, "right": second}


def _surrounded(
    relief: Relief, smooth: Float64[Array, "h w"], peak: Float64[Array, 2], settings: BreastSettings
) -> float:
    """Share of directions in which the skin falls to half the height.

    Within a breast's reach of the peak.
    """
    angles = np.arange(_PEAK_DIRECTIONS) * 2 * np.pi / _PEAK_DIRECTIONS
    rays = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    places = peak + rays[:, None] * np.arange(0.0, settings.reach_mm, 2 * PIXEL_MM)[:, None]
    height = np.where(relief.within(places), relief.at(places, smooth), np.inf)
    return float((height < height[:, :1] / 2).any(axis=1).mean())


def _half_height(
    relief: Relief,
    smooth: Float64[Array, "h w"],
    peak: Float64[Array, 2],
    settings: BreastSettings,
) -> Float64[Array, 2]:
    column, row = np.round((peak - relief.low) / PIXEL_MM).astype(int)
    regions, _ = label(smooth > smooth[row, column] / 2)
    rows, columns = np.nonzero(regions == regions[row, column])
    places = relief.low + np.stack([columns, rows], axis=1) * PIXEL_MM
    near = (np.linalg.norm(places - peak, axis=1) < settings.reach_mm) & (places[:, 0] * peak[0] > 0)
    return np.asarray(places[near].mean(axis=0))


def within_outline(flat: Float64[Array, "n 2"], outline: Float64[Array, "k 2"]) -> Bool[Array, " n"]:
    """Whether points are inside a closed, star-shaped curve.

    It is star-shaped about its mean.
    """
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
    name: SideName,
    side: _Side,
    other: _Side,
    relief: Relief,
    thorax: Thorax,
    surface: RepairedSurface,
    settings: BreastSettings,
) -> Outline | NoBreast:
    """A side's outline on the skin, or that it has none.

    Raises:
        MeasureError: something stands out, but no crease runs around most of it, or its base is not a breast's.
    """
    if side.verdict == "none":
        place = _on_skin(side.middle[None], relief, thorax, surface.mesh)[0]
        return NoBreast(name=name, place_world=place, standing=side.standing, why=_why_none(side.standing))
    crease = side.crease
    assert side.standing is not None  # else it is none
    creased = creased_share(crease, name, settings)
    if side.verdict == "unclear":
        raise _no_crease(creased, name, settings.low_creased)
    _check_base(crease.flat, name, thorax.trunk)
    sign = 1.0 if name == "left" else -1.0
    flat = crease.flat.copy()
    between_mm = 0.0
    if other.verdict == "breast":
        between_mm = sign * ((sign * flat[:, 0]).min() + (sign * other.crease.flat[:, 0]).max()) / 2
    flat[:, 0] = between_mm + sign * np.maximum(sign * (flat[:, 0] - between_mm), _MIDLINE_MM)
    below = np.arange(len(flat)) / len(flat)  # of a turn, from the patient's left by the head
    lower = (below > _LOWER_QUARTER[0]) & (below < _LOWER_QUARTER[1])
    return Outline(
        points_world=_on_skin(flat, relief, thorax, surface.mesh),
        creased=creased,
        folded=float((crease.concavity_per_mm[lower] > _FOLD_PER_MM).mean()),
        seen=float(crease.seen.mean()),
        sigma_mm=float(np.sqrt(np.mean(crease.blur_mm**2))),
    )


def _why_none(standing: Standing | None) -> str:
    if standing is None:
        return "Nothing on that side stands out from the trunk all around"
    return (
        f"The highest place stands out {standing.top_mm:.0f} mm from the skin around it, and "
        f"{standing.mean_mm:.0f} mm on average: a chest's form, not a breast's"
    )


def _on_skin(flat: Float64[Array, "n 2"], relief: Relief, thorax: Thorax, mesh: TriangleMesh) -> Float64[Array, "n 3"]:
    """Put places that were laid flat back on the skin, mm, world frame.

    Several are a closed curve.
    """
    bulge_mm = relief.at(flat, relief.bulge_mm)
    radius = thorax.radius_mm(flat) + (bulge_mm if len(flat) == 1 else on_one_sheet(bulge_mm))
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
    following = np.roll(flat, -1, axis=0)
    area = abs(float((flat[:, 0] * following[:, 1] - flat[:, 1] * following[:, 0]).sum())) / 2
    length = float(np.linalg.norm(following - flat, axis=1).sum())
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
    lower, upper = ((turn > low) & (turn < high) for low, high in (_LOWER_QUARTER, (0.125, 0.375)))
    sharp = np.clip(crease.concavity_per_mm, 0.0, None)
    below, above = float(sharp[lower].mean()), float(sharp[upper].mean())
    inside = _pixels_within(relief, crease.flat)
    rows = np.nonzero(inside)[0]
    mass = np.clip(relief.bulge_mm[inside] - np.median(relief.at(crease.flat, relief.bulge_mm)), 0.0, None)
    half = max(float(np.ptp(rows)) / 2, 1.0)
    sunk = ((rows.max() + rows.min()) / 2 - float((rows * mass).sum() / max(mass.sum(), 1e-9))) / half
    return float(np.clip((below - above) / max(below + above, 1e-9) / 2 + 2 * sunk, -1.0, 1.0))


def creased_share(crease: Crease, name: str, settings: BreastSettings = BreastSettings()) -> float:
    """Share of a curve along which there is a crease.

    Raises:
        MeasureError: it is too little to say where the breast ends.
    """
    creased = float((crease.concavity_per_mm > CREASE_PER_MM).mean())
    if creased < settings.least_creased:
        raise _no_crease(creased, name, settings.least_creased)
    return creased


def _no_crease(creased: float, name: str, least: float) -> MeasureError:
    return MeasureError(
        f"the patient's {name} breast",
        found=f"a crease around {100 * creased:.0f} % of it",
        expected=f"one around at least {100 * least:.0f} %, to tell where it ends",
        remedy="Draw its boundary with `mammometry edit`, or pick the landmarks of the protocol",
    )


def _near(mesh: TriangleMesh, points_world: Float64[Array, "n 3"]) -> TriangleMesh:
    """The part of a mesh around some points on it.

    All of it where they are not.
    """
    inside = np.zeros(len(mesh.vertices), dtype=bool)
    inside[mesh.vertices_between(points_world.min(axis=0) - _NEAR_MM, points_world.max(axis=0) + _NEAR_MM)] = True
    part = mesh.submesh(mesh.faces_within(inside))
    return part if len(part.faces) else mesh
