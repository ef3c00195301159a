"""Outline both breasts of a torso along the crease between breast and trunk."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import label, maximum_filter

from mammometry.base.errors import MeasureError
from mammometry.geometry.arrays import Array, Bool, Float64, read_only
from mammometry.geometry.mesh import TriangleMesh
from mammometry.geometry.nearest import closest_on_mesh
from mammometry.measure.boundary.crease import CREASE_PER_MM, Crease, follow_crease
from mammometry.measure.settings import BreastSettings, ThoraxSettings
from mammometry.measure.trunk.skin_map import PIXEL_MM, Relief, dense_samples, lay_flat
from mammometry.measure.trunk.thorax import Thorax, Trunk, find_trunk, fit_thorax, seen_faces, seen_skin
from mammometry.surface.repair import RepairedSurface

_ROUNDS = 3  # times that trunk and breasts are found, each from the other; chosen by eye
_PEAK_SIGMA_MM = 8.0  # the relief is smoothed over this to look for peaks; chosen by eye
_PEAK_RADIUS_MM = 25.0  # a peak is the highest place within this distance, in both coordinates; chosen by eye
_PEAK_DIRECTIONS = 36  # in which a peak must fall off, 10° apart
_WIDEST_RAD = np.deg2rad(80.0)  # a breast's peak lies no further around the trunk than this; chosen by eye
_SURROUNDED = 0.75  # share of the directions in which a peak must fall to half its height; chosen by eye
_LIKE_MM = 60.0  # a pair whose places differ by this from mirrored ones counts 1/e; chosen by eye
_NEAR_MM = 20.0  # surface around an outline onto which it is laid; chosen by eye
_MIDLINE_MM = 4.0  # each boundary keeps this far from the middle between both; chosen by eye
_LOWER_QUARTER = (0.625, 0.875)  # of a turn from the patient's left by the head: where the fold is


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Outline:
    """The outline of one breast."""

    points_world: Float64[Array, "n 3"]
    """Closed curve on the surface, mm, world frame."""
    creased: float
    """Share of the curve that follows a crease; elsewhere its neighbours decided."""
    folded: float
    """Share of the curve's lower quarter that follows a crease: whether there is a fold."""
    seen: float
    """Share of the curve that lies on visible skin."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "points_world", read_only(self.points_world))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Breasts:
    """Both outlines and the trunk that they were found on."""

    left: Outline
    """The patient's left breast."""
    right: Outline
    """The patient's right breast."""
    thorax: Thorax
    """The trunk without the breasts."""


def find_breasts(
    surface: RepairedSurface,
    frame: Float64[Array, "3 3"],
    settings: BreastSettings = BreastSettings(),
    thorax_settings: ThoraxSettings = ThoraxSettings(),
) -> Breasts:
    """Find both breasts and the thorax between and beside them, in turn.

    Args:
        surface: the repaired mesh, world frame, mm.
        frame: patient's left, head, straight ahead (rows), roughly.
        settings: where a breast ends.
        thorax_settings: how the trunk is described.

    Raises:
        MeasureError: no breast stands out on one side, no crease runs around it, or the trunk is not seen.
    """
    skin = seen_skin(surface)
    points = skin.points_world
    samples = dense_samples(surface.mesh.submesh(seen_faces(surface)))
    outside = np.ones(len(points), dtype=bool)
    height_of: Float64[Array, 3] | None = None
    for _ in range(_ROUNDS):
        trunk = find_trunk(skin, frame, thorax_settings, height_of=height_of)
        thorax = fit_thorax(trunk, points[outside], thorax_settings, breasts_left_out=not outside.all())
        relief = lay_flat(thorax, samples, thorax_settings)
        middles = breast_middles(relief, trunk, settings)
        left, right = (follow_crease(relief, middle, settings) for middle in middles)
        flat = trunk.cylindrical(points)[:, :2]
        outside = ~(within_outline(flat, left.flat) | within_outline(flat, right.flat))
        middle = (left.flat.mean(axis=0) + right.flat.mean(axis=0)) / 2
        height_of = trunk.world(np.array([[*middle, 0.0]]))[0]
        frame = trunk.facing(float(middle[0]) / trunk.half_width_mm)  # straight ahead is between the breasts
    between = (float(left.flat[:, 0].min()) + float(right.flat[:, 0].max())) / 2
    return Breasts(
        left=_on_skin(left, "left", between, relief, thorax, surface, settings),
        right=_on_skin(right, "right", between, relief, thorax, surface, settings),
        thorax=thorax,
    )


def breast_middles(
    relief: Relief, trunk: Trunk, settings: BreastSettings = BreastSettings()
) -> tuple[Float64[Array, 2], Float64[Array, 2]]:
    """Middles of the left and right breast, laid flat, mm.

    A breast is a peak that falls off all around. Belly and shoulders do not: they end with the picture. Of all pairs
    the one is taken that stands out most and lies most alike on both sides. The middle is that of all skin that stands
    out at least half as far as the peak.

    Raises:
        MeasureError: there is no such peak on one side.
    """
    smooth = relief.smooth_mm(_PEAK_SIGMA_MM)
    size = 2 * int(_PEAK_RADIUS_MM / PIXEL_MM) + 1
    row, column = np.nonzero(
        (smooth == maximum_filter(smooth, size=size)) & relief.known & (smooth > settings.fewest_mm)
    )
    peaks = relief.low + np.stack([column, row], axis=1) * PIXEL_MM
    tops = smooth[row, column]
    worth = tops * np.array([_surrounded(relief, smooth, peak, settings) for peak in peaks])
    usable = (np.abs(peaks[:, 0]) < _WIDEST_RAD * trunk.half_width_mm) & (worth > _SURROUNDED * tops)
    sides = [np.flatnonzero(usable & (peaks[:, 0] * sign > _MIDLINE_MM)) for sign in (1, -1)]
    for found, name in zip(sides, ("left", "right"), strict=True):
        if not len(found):
            raise MeasureError(
                f"the patient's {name} breast",
                found=f"nothing that stands out {settings.fewest_mm:.0f} mm from the trunk on that side",
                expected="a breast",
                remedy="Give its boundary; a side without a breast has no boundary to find",
            )
    left, right = sides[0][:, None], sides[1][None]
    apart = np.hypot(peaks[left, 1] - peaks[right, 1], peaks[left, 0] + peaks[right, 0])
    pair = np.unravel_index(np.argmax(worth[left] * worth[right] * np.exp(-((apart / _LIKE_MM) ** 2))), apart.shape)
    chosen = int(sides[0][pair[0]]), int(sides[1][pair[1]])
    first, second = (_half_height(relief, smooth, peaks[peak], settings) for peak in chosen)
    return first, second


def _surrounded(
    relief: Relief, smooth: Float64[Array, "h w"], peak: Float64[Array, 2], settings: BreastSettings
) -> float:
    """Share of the directions in which the skin falls to half the peak's height within a breast's reach."""
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
    """Whether points lie inside a closed curve that is star-shaped about its mean."""
    middle = outline.mean(axis=0)
    around = np.arctan2(*(outline - middle).T[::-1])
    order = np.argsort(around)
    offset = flat - middle
    reach = np.interp(
        np.arctan2(offset[:, 1], offset[:, 0]),
        around[order],
        np.linalg.norm(outline - middle, axis=1)[order],
        period=2 * np.pi,
    )
    return np.linalg.norm(offset, axis=1) < reach


def _on_skin(
    crease: Crease,
    name: str,
    between_mm: float,
    relief: Relief,
    thorax: Thorax,
    surface: RepairedSurface,
    settings: BreastSettings,
) -> Outline:
    """Lay a crease onto the skin, clear of the middle between both breasts.

    Raises:
        MeasureError: there is no crease around most of the breast.
    """
    deep = crease.concavity_per_mm > CREASE_PER_MM
    creased = creased_share(crease, name, settings)
    below = np.arange(len(deep)) / len(deep)  # of a turn, from the patient's left by the head
    lower = deep[(below > _LOWER_QUARTER[0]) & (below < _LOWER_QUARTER[1])]
    flat = crease.flat.copy()
    side = 1.0 if name == "left" else -1.0
    flat[:, 0] = between_mm + side * np.maximum(side * (flat[:, 0] - between_mm), _MIDLINE_MM)
    radius = thorax.radius_mm(flat) + relief.at(flat, relief.bulge_mm)
    world = thorax.trunk.world(np.concatenate([flat, radius[:, None]], axis=1))
    return Outline(
        points_world=closest_on_mesh(world, _near(surface.mesh, world)).points,
        creased=creased,
        folded=float(lower.mean()),
        seen=float(crease.seen.mean()),
    )


def creased_share(crease: Crease, name: str, settings: BreastSettings = BreastSettings()) -> float:
    """Share of a curve along which there is a crease.

    Raises:
        MeasureError: it is too little to say where the breast ends.
    """
    creased = float((crease.concavity_per_mm > CREASE_PER_MM).mean())
    if creased < settings.least_creased:
        raise MeasureError(
            f"the patient's {name} breast",
            found=f"a crease around {100 * creased:.0f} % of it",
            expected=f"one around at least {100 * settings.least_creased:.0f} %, to tell where it ends",
            remedy="Draw its boundary with `mammometry edit`, or pick the landmarks of the protocol",
        )
    return creased


def _near(mesh: TriangleMesh, points_world: Float64[Array, "n 3"]) -> TriangleMesh:
    """The part of a mesh around some points on it; all of it where they are not."""
    inside = np.zeros(len(mesh.vertices), dtype=bool)
    inside[mesh.vertices_between(points_world.min(axis=0) - _NEAR_MM, points_world.max(axis=0) + _NEAR_MM)] = True
    part = mesh.submesh(mesh.faces_within(inside))
    return part if len(part.faces) else mesh
