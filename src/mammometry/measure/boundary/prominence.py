"""Middles of the breasts on the trunk, and the prominence within an outline.

A breast is a dome: its skin is convex in every direction over about 100 mm. Folds, ribs, muscles, arms and the
collarbone are convex in one direction only, and belly and shoulders reach the end of the map.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np
from scipy.ndimage import gaussian_filter, label, maximum_filter, minimum_filter
from scipy.sparse import coo_matrix, identity
from scipy.sparse.linalg import spsolve

from mammometry.base.value import value
from mammometry.geometry.arrays import Array, Bool, Float64
from mammometry.measure.trunk.skin_map import PIXEL_MM, Relief
from mammometry.measure.trunk.thorax import Trunk

SideName: TypeAlias = Literal["left", "right"]
SIDES: tuple[SideName, SideName] = ("left", "right")
_ROUND_MM = 16.0  # scale of the curvature: larger than nipples and folds; not critical
_GATHERED_MM = 20.0  # Gaussian σ of the roundness, so that a breast with two domes has one middle; not critical
_LEAST_PER_MM = 0.0015  # least smoothed roundness of a dome; mounds of 80 cc have 0.004
_PEAK_RADIUS_MM = 25.0  # half size of the window in which a peak is the maximum; not critical
_AROUND_MM = 50.0  # radius around a peak over which the middle is averaged; not critical
_SMOOTHED_MM = 6.0  # Gaussian σ of the relief in which a breast's top is searched; not critical
DOME_MM = 75.0
"""Radius around a breast's middle, on the flattened trunk, that contains its dome and excludes the trunk's skin, mm.
Half the height of real women's bases is 84 mm, half the width 60."""
_BASE_OVER_DOME, _TELLING = 2.3, 0.7
"""Square root of a base's area over that of its dome (the area that it would have with uniform roundness): 2.3 ± 0.2 on
22 breasts of virtual women and torsos; and the weight of this estimate against the usual base (SDs 20 and 12 %)."""
_BASE_OVER_HALF, _HALF_TELLING = 1.89, 0.84
"""The same for the area above half the height: 1.89 ± 0.13 on 87 breasts of eight families. The dome underestimates the
base of a ptotic breast by up to 25 % (docs/decisions/0043)."""
_HALF_FROM_MM = (50.0, 80.0)
"""Height of the top over the trunk up to which only the dome is used, and from which only the area above half the
height, mm. If the fitted trunk is 15 mm too deep above the breasts, muscle counts as the upper half of a low breast.
Not critical."""
_USUAL_BASE_MM = 130.0  # square root of the mean base area: real women have 170 ± 28 cm²
_WIDEST_RAD = np.deg2rad(80.0)  # largest angle of a breast's middle around the trunk; not critical
_TALLEST_MM = 110.0  # largest height of a breast's middle above or below the breasts' height; not critical
_LIKE_MM = 60.0  # difference from mirrored places at which a pair's weight is 1/e; not critical
_CLEAR_PER_MM, _CLEAR_SHARE = 0.006, 0.4
"""Least roundness of each of two breasts that determine the body's left, and of the flatter relative to the rounder.
Pairs of breasts have 0.012 to 0.03, and 0.8 to 1; other convex parts of a chest up to 0.005 (docs/decisions/0026)."""
_BESIDE_MM = 60.0  # least distance between such domes across the body; not critical
MIDLINE_MM = 4.0  # least distance of a breast's peak and of its boundary from the midline; not critical


@value(eq=False)
class Middle:
    """Middle of a possible breast on the flattened trunk."""

    flat: Float64[Array, 2]
    """(half width × θ, y), mm."""
    roundness_per_mm: float
    """Least curvature of the dome, averaged over its middle, 1/mm."""
    base_mm: float
    """Estimated square root of the area of its base, mm."""


def breast_middles(relief: Relief, trunk: Trunk) -> dict[SideName, Middle | None]:
    """Middle of the possible breast on each side, or None.

    If both sides have domes, the pair with the greatest roundness and symmetry is used.
    """
    dome = roundness_per_mm(relief)
    peaks, worth = _peaks(relief, dome)
    usable = np.abs(peaks[:, 0]) < _WIDEST_RAD * trunk.half_width_mm
    peaks, worth = peaks[usable], worth[usable]
    sides = [np.flatnonzero(peaks[:, 0] * sign > MIDLINE_MM) for sign in (1, -1)]
    chosen: list[int | None] = [int(side[np.argmax(worth[side])]) if len(side) else None for side in sides]
    if all(len(side) for side in sides):
        left, right = sides[0][:, None], sides[1][None]
        apart = np.hypot(peaks[left, 1] - peaks[right, 1], peaks[left, 0] + peaks[right, 0])
        alike = worth[left] * worth[right] * np.exp(-((apart / _LIKE_MM) ** 2))
        pair = np.unravel_index(np.argmax(alike), apart.shape)
        chosen = [int(sides[0][pair[0]]), int(sides[1][pair[1]])]
    return {
        name: None if peak is None else _middle(relief, dome, peaks[peak], float(worth[peak]))
        for name, peak in zip(SIDES, chosen, strict=True)
    }


def level_pair(relief: Relief, most: int = 4) -> tuple[Float64[Array, 2], Float64[Array, 2]] | None:
    """Middles of the left and the right breast, flattened, mm, without knowledge of the midline.

    The roundest pair of domes at nearly the same height is chosen: an arm, or its end at the edge of the photographs,
    may be rounder than a breast, but is not level with one. None unless both are clearly breasts and side by side.

    Args:
        relief: the flattened skin.
        most: number of domes that are considered, the roundest first.
    """
    peaks, worth = _peaks(relief, roundness_per_mm(relief))
    order = np.argsort(-worth)[:most]
    order = order[worth[order] >= max(_CLEAR_PER_MM, _CLEAR_SHARE * worth.max(initial=0.0))]
    if len(order) < 2:
        return None
    peaks, worth = peaks[order], worth[order]
    first, second = np.triu_indices(len(peaks), 1)
    across, up = np.abs(peaks[first] - peaks[second]).T
    alike = worth[first] * worth[second] * np.exp(-((up / _LIKE_MM) ** 2))
    best = int(np.argmax(alike))
    if across[best] < max(up[best], _BESIDE_MM):
        return None
    left, right = sorted((peaks[first[best]], peaks[second[best]]), key=lambda peak: -float(peak[0]))
    return left, right


def _peaks(relief: Relief, dome: Float64[Array, "h w"]) -> tuple[Float64[Array, "k 2"], Float64[Array, " k"]]:
    """Peaks of the roundness, flattened, mm, and their smoothed roundness, 1/mm."""
    gathered = gaussian_filter(dome, _GATHERED_MM / PIXEL_MM)
    size = 2 * int(_PEAK_RADIUS_MM / PIXEL_MM) + 1
    row, column = np.nonzero((gathered == maximum_filter(gathered, size=size)) & (gathered > _LEAST_PER_MM))
    peaks = relief.low + np.stack([column, row], axis=1) * PIXEL_MM
    level = np.abs(peaks[:, 1]) < _TALLEST_MM
    return peaks[level], gathered[row, column][level]


def roundness_per_mm(relief: Relief) -> Float64[Array, "h w"]:
    """Least curvature of the skin over all directions if it is convex in each, 1/mm, else 0."""
    smooth = relief.smooth_mm(_ROUND_MM)
    down, across = np.gradient(smooth, PIXEL_MM)
    (down_down, _), (across_down, across_across) = np.gradient(down, PIXEL_MM), np.gradient(across, PIXEL_MM)
    half = (down_down + across_across) / 2
    flattest = half + np.sqrt(((down_down - across_across) / 2) ** 2 + across_down**2)
    return np.where(relief.known, np.clip(-flattest, 0.0, None) * relief.within_its_end(2 * _ROUND_MM), 0.0)


def _middle(relief: Relief, dome: Float64[Array, "h w"], peak: Float64[Array, 2], worth: float) -> Middle:
    rows, columns = np.indices(dome.shape)
    flat = relief.low + np.stack([columns, rows], axis=-1) * PIXEL_MM
    away = np.linalg.norm(flat - peak, axis=-1)
    own = flat[..., 0] * peak[0] > 0
    near, whole = own & (away < _AROUND_MM), dome[own & (away < DOME_MM)]
    domes_mm2 = whole.sum() ** 2 / (whole**2).sum() * PIXEL_MM**2
    smooth = np.where(near, relief.smooth_mm(_SMOOTHED_MM), -np.inf)
    highest = np.unravel_index(np.argmax(smooth), smooth.shape)
    top_mm = float(smooth[highest])
    parts, _ = label(own & (relief.smooth_mm(_SMOOTHED_MM) >= top_mm - abs(top_mm) / 2))
    halfs_mm2 = np.count_nonzero(parts == parts[highest]) * PIXEL_MM**2
    by_dome = _TELLING * np.log(_BASE_OVER_DOME * np.sqrt(domes_mm2) / _USUAL_BASE_MM)
    by_half = _HALF_TELLING * np.log(_BASE_OVER_HALF * np.sqrt(halfs_mm2) / _USUAL_BASE_MM)
    high = np.interp(top_mm, _HALF_FROM_MM, (0.0, 1.0))
    return Middle(
        flat=np.average(flat[near], axis=0, weights=dome[near]),
        roundness_per_mm=worth,
        base_mm=float(_USUAL_BASE_MM * np.exp(by_dome + high * (by_half - by_dome))),
    )


MIN_PROMINENCE_MM = 8.0
"""Least height of a breast over the skin along its outline, mm."""
SURE_PROMINENCE_MM = 24.0
"""Height over the skin along its outline from which it is a breast even without a crease all around, mm."""
LOW_CREASED = 0.9
"""Least share of the outline in a crease at the height `MIN_PROMINENCE_MM`. Up to `SURE_PROMINENCE_MM` the share is
interpolated."""
CHEST_MM = 6.0
"""Mean height up to which a prominence without a crease around nearly all of it is the shape of the chest, mm. Chests
without a breast have 3 to 5.4 beside the armpit, mounds of 80 cc or more at least 8 (docs/decisions/0026)."""
LEAST_CREASED = 0.4
"""Least share of a proposed boundary in a crease."""

Verdict: TypeAlias = Literal["breast", "none", "unclear"]

ELSEWHERE_MM = 25.0
"""Distance from the other breast's mirrored middle up to which a low mound is a breast, mm. Bulges of the chest itself
are 39 to 79 mm from it (docs/decisions/0026)."""
_MIRRORED_CREASED = 0.7
"""Least share of the outline in a crease of a low mound at the mirrored place of the other breast. Photographed mounds
of 80 cc had 0.74 to 0.78 there, others at least 0.87. Chests without a breast had 0.1 to 0.8, but at least 39 mm from
that place (docs/decisions/0026)."""
_OVERHANG_MM, _OVERHANG_REACH = 10.0, 3
"""Least step of the skin at an overhang, mm, and its distance outside the outline, pixels: outlines of hanging breasts
are up to 6 mm inside the fold, and the step is 20 to 90 mm (docs/decisions/appendix/0043.md)."""
_TOP = 0.98  # quantile of the heights that counts as the top, to exclude outliers


@dataclass(frozen=True, slots=True, kw_only=True)
class Prominence:
    """Relief in front of a membrane that spans an outline."""

    top_mm: float
    """Height of its top, mm."""
    volume_cc: float
    """Approximate volume on the flattened trunk, cc."""
    area_cm2: float
    """Area of the base, cm²."""
    creased: float
    """Share of the outline that follows a crease."""

    @property
    def mean_mm(self) -> float:
        """Mean height over the base, mm."""
        return 10 * self.volume_cc / max(self.area_cm2, 1e-9)

    def verdict(self, offset_mm: float | None = None) -> Verdict:
        """Breast, none, or unclear.

        A low mean height without a crease around nearly all of the outline is the shape of the chest, unless it is at
        the mirrored position of the other breast. The lower a prominence, the more of its outline must be a crease for
        it to be a breast, and most if there is no other breast. Everything else is unclear.

        Args:
            offset_mm: distance from the mirrored middle of the other breast, mm; None without one.
        """
        if self.top_mm < MIN_PROMINENCE_MM:
            return "none"
        mirrored = offset_mm is not None and offset_mm <= ELSEWHERE_MM
        low_creased = _MIRRORED_CREASED if mirrored else LOW_CREASED
        if self.mean_mm < CHEST_MM and self.creased < low_creased:
            return "none" if offset_mm is not None and not mirrored else "unclear"
        share = np.clip((SURE_PROMINENCE_MM - self.top_mm) / (SURE_PROMINENCE_MM - MIN_PROMINENCE_MM), 0.0, 1.0)
        if self.creased >= LEAST_CREASED + share * (low_creased - LEAST_CREASED):
            return "breast"
        return "unclear"


def prominence_within(relief: Relief, inside: Bool[Array, "h w"], creased: float) -> Prominence:
    """Prominence within an outline on the flattened trunk.

    The membrane is harmonic over (half width × θ, y) and equal to the bulge along the outline, like the default wall.
    Where the breast hangs over the outline, it is equal to the trunk's skin below the overhang.

    Args:
        relief: the flattened skin.
        inside: pixels within the outline.
        creased: share of the outline that follows a crease.
    """
    inside = inside.copy()
    inside[[0, -1]] = inside[:, [0, -1]] = False
    number = np.full(inside.shape, -1)
    count = int(inside.sum())
    if not count:
        return Prominence(top_mm=0.0, volume_cc=0.0, area_cm2=0.0, creased=creased)
    number[inside] = np.arange(count)
    row, column = np.nonzero(inside)
    right = np.zeros(count)
    edge_mm = _below_overhang_mm(relief)
    entries = []
    for down, aside in ((1, 0), (-1, 0), (0, 1), (0, -1)):
        beside = number[row + down, column + aside]
        within = beside >= 0
        entries.append((np.flatnonzero(within), beside[within]))
        right[~within] += edge_mm[row + down, column + aside][~within]
    rows, columns = (np.concatenate(places) for places in zip(*entries, strict=True))
    laplace = 4 * identity(count) - coo_matrix((np.ones(len(rows)), (rows, columns)), shape=(count, count))
    wall_mm = spsolve(laplace.tocsc(), right)
    height_mm = relief.bulge_mm[inside] - wall_mm
    smooth_mm = relief.smooth_mm(_SMOOTHED_MM)[inside] - wall_mm
    return Prominence(
        top_mm=float(np.quantile(smooth_mm, _TOP)),
        volume_cc=float(height_mm.sum() * PIXEL_MM**2 / 1000),
        area_cm2=float(count * PIXEL_MM**2 / 100),
        creased=creased,
    )


def _below_overhang_mm(relief: Relief) -> Float64[Array, "h w"]:
    """Bulge of each pixel, but next to a step that of its lower side, mm."""
    lowest: Float64[Array, "h w"] = minimum_filter(relief.bulge_mm, size=2 * _OVERHANG_REACH + 1)
    return np.where(relief.bulge_mm - lowest > _OVERHANG_MM, lowest, relief.bulge_mm)
