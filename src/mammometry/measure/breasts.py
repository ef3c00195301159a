"""Outline both breasts of a torso: where they cease to stand out from the thorax beneath.

The trunk is laid flat in its cylindrical coordinates. Of several layers at one place (a breast that hangs over its
fold) the innermost counts, so that the boundary follows the fold and not the breast's lower edge.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import (
    distance_transform_edt,
    gaussian_filter,
    gaussian_filter1d,
    label,
    map_coordinates,
    maximum_filter,
    median_filter,
)

from mammometry.errors import MeasureError
from mammometry.geometry.arrays import Array, Bool, Float64
from mammometry.measure.settings import BreastSettings, ThoraxSettings
from mammometry.measure.thorax import Thorax, Trunk, find_trunk, fit_thorax, seen_skin
from mammometry.surface.repair import RepairedSurface

_PIXEL_MM = 2.0
_ARM = 1.15
_ROUNDS = 3
_PEAK_SIGMA_MM = 8.0
_PEAK_RADIUS_MM = 25.0
_RISE_MM = 1.5
_TRUNK_MM = 25.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Breasts:
    """The outlines and what they were found with."""

    left: Float64[Array, "n 3"]
    """Closed curve around the patient's left breast, near the surface, mm, world frame."""
    right: Float64[Array, "n 3"]
    """Closed curve around the patient's right breast."""
    thorax: Thorax
    """The trunk without them."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Map:
    """The skin laid flat: how far it stands out, on a grid of (half width × θ, y)."""

    low: Float64[Array, 2]
    inner: Float64[Array, "h w"]
    """Bulge of the innermost layer, mm; gaps filled with the nearest."""
    outer: Float64[Array, "h w"]
    """Bulge of the outermost layer, mm."""
    known: Bool[Array, "h w"]

    def at(self, flat: Float64[Array, "n 2"], values: Float64[Array, "h w"]) -> Float64[Array, " n"]:
        """Values at (half width × θ, y), mm, by bilinear interpolation."""
        column, row = ((flat - self.low) / _PIXEL_MM).T
        sampled: Float64[Array, " n"] = map_coordinates(values, [row, column], order=1, mode="nearest")
        return sampled


def find_breasts(
    surface: RepairedSurface,
    frame: Float64[Array, "3 3"],
    settings: BreastSettings = BreastSettings(),
    thorax_settings: ThoraxSettings = ThoraxSettings(),
) -> Breasts:
    """Find the two breasts and the thorax between and beside them, each from the other in turn.

    Args:
        surface: the repaired mesh, world frame, mm.
        frame: patient's left, head, straight ahead (rows), roughly.
        settings: where a breast ends.
        thorax_settings: how the trunk is described.

    Raises:
        MeasureError: no breast stands out on one side, or the trunk is not seen.
    """
    seen = seen_skin(surface)
    points = seen.points_world
    outside = np.ones(len(points), dtype=bool)
    height_of: Float64[Array, 3] | None = None
    for _ in range(_ROUNDS):
        trunk = find_trunk(seen, frame, thorax_settings, height_of=height_of)
        thorax = fit_thorax(trunk, points[outside], thorax_settings, breasts_left_out=not outside.all())
        skin = _lay_flat(thorax, points, thorax_settings)
        left, right = (_outline(skin, side, trunk, settings) for side in (1, -1))
        flat = trunk.cylindrical(points)[:, :2]
        outside = ~(within_outline(flat, left) | within_outline(flat, right))
        middle = (left.mean(axis=0) + right.mean(axis=0)) / 2
        height_of = trunk.world(np.array([[*middle, 0.0]]))[0]
    return Breasts(left=_raised(left, skin, thorax), right=_raised(right, skin, thorax), thorax=thorax)


def _lay_flat(thorax: Thorax, points: Float64[Array, "n 3"], settings: ThoraxSettings) -> _Map:
    """Rasterise the innermost and outermost bulge of the skin around the trunk, arms left out."""
    trunk = thorax.trunk
    cylindrical = trunk.cylindrical(points)
    flat, radius = cylindrical[:, :2], cylindrical[:, 2]
    width, height = np.deg2rad(settings.widest_deg) * trunk.half_width_mm, settings.height_window_mm
    keep = (np.abs(flat[:, 0]) < width) & (np.abs(flat[:, 1]) < height)
    keep &= radius * np.abs(np.sin(flat[:, 0] / trunk.half_width_mm)) < _ARM * trunk.half_width_mm
    flat, bulge = flat[keep], (radius[keep] - thorax.radius_mm(flat[keep]))
    low = np.array([-width, -height])
    shape = (int(2 * height / _PIXEL_MM) + 2, int(2 * width / _PIXEL_MM) + 2)
    column, row = np.round((flat - low) / _PIXEL_MM).astype(int).T
    inner, outer = np.full(shape, np.inf), np.full(shape, -np.inf)
    np.minimum.at(inner, (row, column), bulge)
    np.maximum.at(outer, (row, column), bulge)
    known = np.isfinite(inner)
    if not known.any():
        raise MeasureError(
            "torso", found="no skin around the trunk", expected="the trunk's front and sides", remedy="Check the rig"
        )
    nearest = distance_transform_edt(~known, return_distances=False, return_indices=True)
    return _Map(low=low, inner=inner[tuple(nearest)], outer=outer[tuple(nearest)], known=known)


def _outline(skin: _Map, side: int, trunk: Trunk, settings: BreastSettings) -> Float64[Array, "n 2"]:
    """Closed curve (half width × θ, y) around the breast on one side; +1 is the patient's left.

    From the breast's middle outwards in every direction until the innermost skin ceases to stand out, or begins to
    rise again (towards an arm, the belly or the other breast); then smoothed, and drawn a margin further out.
    """
    middle = _middle(skin, side, trunk, settings)
    steps = np.arange(_PIXEL_MM, settings.reach_mm, _PIXEL_MM)
    angles = np.arange(settings.directions) * 2 * np.pi / settings.directions
    rays = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    profile = skin.at(
        (middle + rays[:, None] * steps[:, None]).reshape(-1, 2), gaussian_filter(skin.inner, 1.0)
    ).reshape(len(rays), -1)
    fallen = np.where(profile < np.maximum.accumulate(profile, axis=1) / 2, profile, np.inf)  # past the breast's top
    lowest = np.minimum.accumulate(fallen, axis=1)
    ended = (profile < settings.vanish_mm) | (profile > lowest + _RISE_MM)
    last = np.where(ended.any(axis=1), np.argmax(ended, axis=1), len(steps) - 1)
    fallen[steps[None, :] > steps[last][:, None]] = np.inf
    valley = np.where(np.isfinite(fallen).any(axis=1), np.argmin(fallen, axis=1), last)
    reach = steps[valley]
    reach = np.asarray(median_filter(reach, size=5, mode="wrap")) + settings.margin_mm
    spectrum = np.fft.rfft(reach)
    spectrum[settings.harmonics + 1 :] = 0
    reach = np.fft.irfft(spectrum, len(reach))
    curve = middle + rays * reach[:, None]
    curve[:, 0] = side * np.maximum(side * curve[:, 0], settings.midline_mm)
    return curve


def _middle(skin: _Map, side: int, trunk: Trunk, settings: BreastSettings) -> Float64[Array, 2]:
    """Middle of the breast on one side: of what stands out at least half as far as its highest interior peak."""
    smooth = gaussian_filter(np.minimum(skin.outer, 200.0), _PEAK_SIGMA_MM / _PIXEL_MM)
    size = 2 * int(_PEAK_RADIUS_MM / _PIXEL_MM) + 1
    peaks = (smooth == maximum_filter(smooth, size=size)) & skin.known & (smooth > settings.fewest_mm)
    row, column = np.nonzero(peaks)
    places = skin.low + np.stack([column, row], axis=1) * _PIXEL_MM
    angle = np.abs(places[:, 0]) / trunk.half_width_mm
    border = np.minimum(row, smooth.shape[0] - 1 - row) * _PIXEL_MM
    usable = (places[:, 0] * side > 0) & (angle < np.deg2rad(80)) & (border > _PEAK_RADIUS_MM)
    if not usable.any():
        name = "left" if side > 0 else "right"
        raise MeasureError(
            f"the patient's {name} breast",
            found=f"nothing that stands out {settings.fewest_mm:.0f} mm from the trunk on that side",
            expected="a breast",
            remedy="Give its boundary; a side without a breast has no boundary to find",
        )
    row, column = row[usable], column[usable]
    best = int(np.argmax(smooth[row, column]))
    top = smooth[row[best], column[best]]
    regions, _ = label(smooth > top / 2)
    rows, columns = np.nonzero(regions == regions[row[best], column[best]])
    near = np.hypot(rows - row[best], columns - column[best]) * _PIXEL_MM < settings.reach_mm
    return skin.low + np.array([columns[near].mean(), rows[near].mean()]) * _PIXEL_MM


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


def _raised(outline: Float64[Array, "k 2"], skin: _Map, thorax: Thorax) -> Float64[Array, "k 3"]:
    """World points of an outline on the innermost skin; under an overhang, where none is seen, from its neighbours."""
    bulge = skin.at(outline, skin.inner)
    trusted = (skin.at(outline, skin.known.astype(np.float64)) > 0.5) & (np.abs(bulge) < _TRUNK_MM)
    if not trusted.any():
        trusted[:] = True
    place = np.arange(len(outline))
    bulge = np.interp(place, place[trusted], bulge[trusted], period=len(outline))
    bulge = np.asarray(gaussian_filter1d(median_filter(bulge, size=5, mode="wrap"), 1.0, mode="wrap"))
    radius = thorax.radius_mm(outline) + bulge
    return thorax.trunk.world(np.concatenate([outline, radius[:, None]], axis=1))
