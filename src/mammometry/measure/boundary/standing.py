"""Relief within an outline, to decide whether it is a breast."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np
from scipy.sparse import coo_matrix, identity
from scipy.sparse.linalg import spsolve

from mammometry.geometry.arrays import Array, Bool
from mammometry.measure.trunk.skin_map import PIXEL_MM, Relief

FEWEST_MM = 8.0
"""A breast stands out at least this far from the skin along its outline, mm. If nothing does, there is no breast on
that side.
"""
PLAIN_MM = 24.0
"""Height over the skin along its outline above which something is a breast even without a crease around all of it,
mm.
"""
LOW_CREASED = 0.9
"""Share of the outline that must run in a crease for something as low as `FEWEST_MM` to be a breast, and not the
chest's own form. In between the share is interpolated.
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
_ROUND_MM = 6.0  # a low mound's top is looked for in relief smoothed over this; chosen by eye


@dataclass(frozen=True, slots=True, kw_only=True)
class Standing:
    """What stands out in front of a membrane stretched over an outline."""

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
        """What it is.

        What stands out little on average, without a crease around nearly all of it, is the chest's own form if it lies
        elsewhere than the other side's breast, mirrored. What is low must have more of a crease to be a breast, and
        most where no other breast tells its place. What is neither is unclear.

        Args:
            astray_mm: how far it lies from the mirrored middle of the other side's breast, mm; None if there is none.
        """
        if self.top_mm < FEWEST_MM:
            return "none"
        mirrored = astray_mm is not None and astray_mm <= _ELSEWHERE_MM
        low_creased = min(_MIRRORED_CREASED, LOW_CREASED) if mirrored else LOW_CREASED
        if self.mean_mm < CHEST_MM and self.creased < low_creased:
            return "none" if astray_mm is not None and not mirrored else "unclear"
        share = np.clip((PLAIN_MM - self.top_mm) / (PLAIN_MM - FEWEST_MM), 0.0, 1.0)
        if self.creased >= LEAST_CREASED + share * (low_creased - LEAST_CREASED):
            return "breast"
        return "unclear"


def standing_out(relief: Relief, inside: Bool[Array, "h w"], creased: float) -> Standing:
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
        return Standing(top_mm=0.0, volume_cc=0.0, area_cm2=0.0, creased=creased)
    number[inside] = np.arange(count)
    row, column = np.nonzero(inside)
    right = np.zeros(count)
    entries = []
    for down, aside in ((1, 0), (-1, 0), (0, 1), (0, -1)):
        beside = number[row + down, column + aside]
        within = beside >= 0
        entries.append((np.flatnonzero(within), beside[within]))
        right[~within] += relief.bulge_mm[row + down, column + aside][~within]
    rows, columns = (np.concatenate(each) for each in zip(*entries, strict=True))
    laplace = 4 * identity(count) - coo_matrix((np.ones(len(rows)), (rows, columns)), shape=(count, count))
    wall_mm = spsolve(laplace.tocsc(), right)
    height_mm = relief.bulge_mm[inside] - wall_mm
    smooth_mm = relief.smooth_mm(_ROUND_MM)[inside] - wall_mm
    return Standing(
        top_mm=float(np.quantile(smooth_mm, _TOP)),
        volume_cc=float(height_mm.sum() * PIXEL_MM**2 / 1000),
        area_cm2=float(count * PIXEL_MM**2 / 100),
        creased=creased,
    )
