"""Places where a breast stands out of the trunk, and what stands out within an outline.

A breast is a dome: its skin is round in every direction, over more than a palm's breadth. Folds, ribs, muscles, arms
and the collar bone are round in one direction alone, and belly and shoulders end with the picture.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np
from scipy.ndimage import gaussian_filter, label, maximum_filter
from scipy.sparse import coo_matrix, identity
from scipy.sparse.linalg import spsolve

from mammometry.base.value import value
from mammometry.geometry.arrays import Array, Bool, Float64
from mammometry.measure.trunk.skin_map import PIXEL_MM, Relief
from mammometry.measure.trunk.thorax import Trunk

SideName: TypeAlias = Literal["left", "right"]
SIDES: tuple[SideName, SideName] = ("left", "right")
_ROUND_MM = 16.0  # scale at which skin must be round in every direction: beyond nipples and folds; chosen by eye
_GATHERED_MM = 20.0  # roundness is gathered over this, so that a breast with two domes is one; chosen by eye
_LEAST_PER_MM = 0.0015  # gathered roundness of the flattest dome that is looked at; mounds of 80 cc have .004
_PEAK_RADIUS_MM = 25.0  # a peak is the highest place within this distance, in both coordinates; chosen by eye
_AROUND_MM = 50.0  # of a peak, over which the middle is taken; chosen by eye
_SMOOTHED_MM = 6.0  # a breast's top is looked for in relief smoothed over this; chosen by eye
DOME_MM = 75.0
"""All of a breast's dome lies this near to its middle, laid flat, mm, and skin this near is not the trunk's: half the
height of real women's bases is 84 mm, half the width 60."""
_BASE_OVER_DOME, _TELLING = 2.3, 0.7
"""Root of a base's area over that of its dome's, which is as large as if it were equally round all over: 2.3 ± .2 on 22
breasts of virtual women and torsos; and how much it counts beside the usual one: both are known to some 20 and 12 %."""
_BASE_OVER_HALF, _HALF_TELLING = 1.89, 0.84
"""The same of what is at least half as high as the top: 1.89 ± .13 on 87 breasts of eight families. A large breast's
dome, which gravity gathers, may tell a quarter too little (docs/decisions/0043)."""
_HALF_FROM_MM = (50.0, 80.0)
"""Height of the top over the trunk up to which the dome alone tells the base, and from which half the height alone, mm:
a trunk that lies 15 mm too deep above the breasts adds a muscle to the half of a low one. Chosen by eye."""
_USUAL_BASE_MM = 130.0  # root of the usual base's area: real women have 170 ± 28 cm²
_WIDEST_RAD = np.deg2rad(80.0)  # a breast's middle lies no further around the trunk than this; chosen by eye
_TALLEST_MM = 110.0  # nor further above or below the breasts' height; chosen by eye
_LIKE_MM = 60.0  # a pair whose places differ by this from mirrored ones counts 1/e; chosen by eye
_CLEAR_PER_MM, _CLEAR_SHARE = 0.006, 0.4
"""Least roundness of both of two breasts that show where the body's left is, and of the flatter over the rounder.
Bodies with two have .012 to .03, and .8 to 1; what else is round on a chest has up to .005 (docs/decisions/0026)."""
_BESIDE_MM = 60.0  # least distance between such domes across the body; chosen by eye
MIDLINE_MM = 4.0  # a breast's peak and its boundary lie this far from the midline at least; chosen by eye


@value(eq=False)
class Middle:
    """The middle of what may be a breast, laid flat."""

    flat: Float64[Array, 2]
    """(half width × θ, y), mm."""
    roundness_per_mm: float
    """Least curvature of the dome, gathered over its middle, 1/mm."""
    base_mm: float
    """Root of the area of the base that breasts of such a form have, mm."""


def breast_middles(relief: Relief, trunk: Trunk) -> dict[SideName, Middle | None]:
    """The dome of each side that may be a breast, or None.

    Where both sides have domes, the pair is taken that is roundest and lies most alike on both sides.
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


def level_pair(relief: Relief) -> tuple[Float64[Array, 2], Float64[Array, 2]] | None:
    """Left and right of the two roundest domes, laid flat, mm, wherever the midline is.

    None unless both are clearly breasts, and lie beside each other rather than one above the other.
    """
    peaks, worth = _peaks(relief, roundness_per_mm(relief))
    first, second = (int(place) for place in np.argsort(worth)[:-3:-1]) if len(worth) > 1 else (0, 0)
    if first == second or worth[second] < max(_CLEAR_PER_MM, _CLEAR_SHARE * worth[first]):
        return None
    across, up = np.abs(peaks[first] - peaks[second])
    if across < max(up, _BESIDE_MM):
        return None
    left, right = sorted((peaks[first], peaks[second]), key=lambda peak: -float(peak[0]))
    return left, right


def _peaks(relief: Relief, dome: Float64[Array, "h w"]) -> tuple[Float64[Array, "k 2"], Float64[Array, " k"]]:
    """Places where a dome is roundest, laid flat, mm, and their gathered roundness, 1/mm."""
    gathered = gaussian_filter(dome, _GATHERED_MM / PIXEL_MM)
    size = 2 * int(_PEAK_RADIUS_MM / PIXEL_MM) + 1
    row, column = np.nonzero((gathered == maximum_filter(gathered, size=size)) & (gathered > _LEAST_PER_MM))
    peaks = relief.low + np.stack([column, row], axis=1) * PIXEL_MM
    level = np.abs(peaks[:, 1]) < _TALLEST_MM
    return peaks[level], gathered[row, column][level]


def roundness_per_mm(relief: Relief) -> Float64[Array, "h w"]:
    """Least curvature of the skin over all directions where it is round in each, 1/mm, else 0."""
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
"""A breast stands out at least this far from the skin along its outline, mm. If nothing does, there is no breast on
that side.
"""
SURE_PROMINENCE_MM = 24.0
"""Height over the skin along its outline above which something is a breast even without a crease around all of it,
mm.
"""
LOW_CREASED = 0.9
"""Share of the outline that must run in a crease for something as low as `MIN_PROMINENCE_MM` to be a breast, and not
the chest's own form. In between the share is interpolated.
"""
CHEST_MM = 6.0
"""Mean height up to which something without a crease around nearly all of it is the chest's own form, mm. Chests
without a breast have 3 to 5.4 beside the armpit, mounds from 80 cc on 8 or more (docs/decisions/0026).
"""
LEAST_CREASED = 0.4
"""Share of the boundary that must run in a crease. With less, no boundary is proposed."""

Verdict: TypeAlias = Literal["breast", "none", "unclear"]

_ELSEWHERE_MM = 25.0  # from the mirrored middle of the other breast: chests' own forms gave 39 to 79 (decision 26)
_MIRRORED_CREASED = 0.7
"""Share of the outline that must run in a crease for something low to be a mound where the other breast is mirrored.
Photographed mounds of 80 cc had .74 to .78 there, others from .87 on. Chests without a breast had .1 to .8, but never
nearer than 39 mm to that place (docs/decisions/0026)."""
_TOP = 0.98  # quantile of the heights that counts as the top, so that a speck is none


@dataclass(frozen=True, slots=True, kw_only=True)
class Prominence:
    """Relief in front of a membrane stretched over an outline."""

    top_mm: float
    """Height of its top, mm."""
    volume_cc: float
    """Volume, cc, roughly: laid flat."""
    area_cm2: float
    """Area of the base, cm²."""
    creased: float
    """Share of the outline that follows a crease."""

    @property
    def mean_mm(self) -> float:
        """Mean height over the base, mm."""
        return 10 * self.volume_cc / max(self.area_cm2, 1e-9)

    def verdict(self, astray_mm: float | None = None) -> Verdict:
        """Breast, none, or unclear.

        What stands out little on average, without a crease around nearly all of it, is the chest's own form if it lies
        elsewhere than the other side's breast, mirrored. What is low must have more of a crease to be a breast, and
        most where no other breast tells its place. What is neither is unclear.

        Args:
            astray_mm: how far it lies from the mirrored middle of the other side's breast, mm; None if there is none.
        """
        if self.top_mm < MIN_PROMINENCE_MM:
            return "none"
        mirrored = astray_mm is not None and astray_mm <= _ELSEWHERE_MM
        low_creased = _MIRRORED_CREASED if mirrored else LOW_CREASED
        if self.mean_mm < CHEST_MM and self.creased < low_creased:
            return "none" if astray_mm is not None and not mirrored else "unclear"
        share = np.clip((SURE_PROMINENCE_MM - self.top_mm) / (SURE_PROMINENCE_MM - MIN_PROMINENCE_MM), 0.0, 1.0)
        if self.creased >= LEAST_CREASED + share * (low_creased - LEAST_CREASED):
            return "breast"
        return "unclear"


def prominence_within(relief: Relief, inside: Bool[Array, "h w"], creased: float) -> Prominence:
    """Measure what stands out within an outline laid flat.

    The membrane is harmonic over (half width × θ, y) and equal to the bulge along the outline, as the default wall is.

    Args:
        relief: the skin laid flat.
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
    entries = []
    for down, aside in ((1, 0), (-1, 0), (0, 1), (0, -1)):
        beside = number[row + down, column + aside]
        within = beside >= 0
        entries.append((np.flatnonzero(within), beside[within]))
        right[~within] += relief.bulge_mm[row + down, column + aside][~within]
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
