"""Disturbances of a walk with a telephone: breathing, lens, shutter, blur, print.

All sizes here are made up; no measurement uses them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from mammometry.geometry import Array, Float64
from mammometry.simulate.disturbances.registry import Number, Word, disturbance


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class WalkConditions:
    """Breathing, lens, shutter and blur at each photograph, and size and shape of the printed board."""

    breath_mm: Float64[Array, " n"]
    """Displacement of the front of the chest at each photograph, mm. Positive is forwards."""
    focal: Float64[Array, " n"]
    """Focal length at each photograph, relative to its usual value."""
    centre_px: Float64[Array, "n 2"]
    """Shift of the principal point at each photograph, pixels of a photograph at full size."""
    skew_px: Float64[Array, "n 2"]
    """Shift of the last row relative to the first, pixels of a photograph at full size."""
    blur_px: Float64[Array, " n"]
    """Standard deviation of the blur of each photograph, pixels of a photograph at full size."""
    ghost_px: Float64[Array, "n 2"]
    """Shift between the two exposures of which each photograph is the mean, pixels of a photograph at full size."""
    print_scale: float = 1.0
    """Size of the print relative to its stated size."""
    stretch: float = 1.0
    """Length of the print along its rows, relative to that of a print with the same scale in both directions."""
    bow_mm: float = 0.0
    """How far the middle of the board is in front of its left and right edges, mm."""
    card: str = ""
    """Colour of the bank card on the board. Empty: none."""


def still_walk(pictures: int) -> WalkConditions:
    """Conditions of a walk without breathing, with fixed focus and a correct print."""
    none_px = np.zeros((pictures, 2))
    return WalkConditions(
        breath_mm=np.zeros(pictures),
        focal=np.ones(pictures),
        centre_px=none_px,
        skew_px=none_px,
        blur_px=np.zeros(pictures),
        ghost_px=none_px,
    )


@disturbance(
    "breath",
    "walk",
    "breathing: the chest is displaced by up to this at each photograph",
    Number(usual=0.3, within=(0.0, 5.0), likely=(0.1, 0.5), unit="mm"),
)
def _breath(walk: WalkConditions, most_mm: float, rng: np.random.Generator) -> WalkConditions:
    return replace(walk, breath_mm=walk.breath_mm + rng.uniform(-most_mm, most_mm, len(walk.breath_mm)))


@disturbance(
    "two-breaths",
    "walk",
    "a breath held for each half of the walk: how much fuller the second one is",
    Number(usual=0.5, within=(-5.0, 5.0), likely=(0.2, 1.5), unit="mm"),
)
def _two_breaths(walk: WalkConditions, fuller_mm: float, rng: np.random.Generator) -> WalkConditions:
    second = np.arange(len(walk.breath_mm)) >= (len(walk.breath_mm) + 1) // 2
    return replace(walk, breath_mm=walk.breath_mm + fuller_mm * second)


@disturbance(
    "autofocus",
    "walk",
    "focusing again for each photograph: standard deviation of the focal length",
    Number(usual=0.2, within=(0.0, 3.0), likely=(0.05, 0.5), unit="%"),
)
def _autofocus(walk: WalkConditions, std_percent: float, rng: np.random.Generator) -> WalkConditions:
    return replace(walk, focal=walk.focal * (1.0 + rng.normal(0.0, std_percent / 100.0, len(walk.focal))))


@disturbance(
    "stabiliser",
    "walk",
    "a stabilised lens: standard deviation of its shift at each photograph, at full size",
    Number(usual=8.0, within=(0.0, 60.0), likely=(2.0, 15.0), unit="px"),
)
def _stabiliser(walk: WalkConditions, std_px: float, rng: np.random.Generator) -> WalkConditions:
    return replace(walk, centre_px=walk.centre_px + rng.normal(0.0, std_px, walk.centre_px.shape))


@disturbance(
    "rolling",
    "walk",
    "a telephone that turns while its rows are read: shift of the last row at each photograph, at full size",
    Number(usual=2.0, within=(0.0, 20.0), likely=(0.5, 4.0), unit="px"),
)
def _rolling(walk: WalkConditions, std_px: float, rng: np.random.Generator) -> WalkConditions:
    return replace(walk, skew_px=walk.skew_px + rng.normal(0.0, std_px, walk.skew_px.shape))


@disturbance(
    "unsharp",
    "walk",
    "a telephone that is moved or out of focus: most blur of a photograph (standard deviation), at full size",
    Number(usual=3.0, within=(0.0, 20.0), likely=(1.0, 5.0), unit="px"),
)
def _unsharp(walk: WalkConditions, most_px: float, rng: np.random.Generator) -> WalkConditions:
    blur_px = rng.uniform(0.0, most_px, len(walk.blur_px))
    return replace(walk, blur_px=np.hypot(walk.blur_px, blur_px))


@disturbance(
    "ghost",
    "walk",
    "HDR by hand: every fourth photograph is the mean of two exposures; shift between them, at full size",
    Number(usual=12.0, within=(0.0, 60.0), likely=(4.0, 20.0), unit="px"),
)
def _ghost(walk: WalkConditions, shift_px: float, rng: np.random.Generator) -> WalkConditions:
    ghost_px, angles = walk.ghost_px.copy(), rng.uniform(0.0, 2.0 * np.pi, len(walk.ghost_px))
    every = slice(int(rng.integers(4)), None, 4)
    ghost_px[every] += shift_px * np.column_stack([np.cos(angles), np.sin(angles)])[every]
    return replace(walk, ghost_px=ghost_px)


@disturbance(
    "stretched",
    "walk",
    "a board printed longer along its rows than across",
    Number(usual=0.3, within=(-3.0, 3.0), likely=(-0.5, 0.5), unit="%"),
)
def _stretched(walk: WalkConditions, percent: float, rng: np.random.Generator) -> WalkConditions:
    return replace(walk, stretch=walk.stretch * (1.0 + percent / 100.0))


@disturbance(
    "bowed",
    "walk",
    "a bowed board: how far its middle is in front of its left and right edges",
    Number(usual=1.0, within=(0.0, 20.0), likely=(0.3, 2.5), unit="mm"),
)
def _bowed(walk: WalkConditions, bow_mm: float, rng: np.random.Generator) -> WalkConditions:
    return replace(walk, bow_mm=walk.bow_mm + bow_mm)


@disturbance(
    "misprint",
    "walk",
    "a board printed larger than stated",
    Number(usual=1.0, within=(-5.0, 5.0), likely=(-1.0, 1.0), unit="%"),
)
def _misprint(walk: WalkConditions, percent: float, rng: np.random.Generator) -> WalkConditions:
    return replace(walk, print_scale=walk.print_scale * (1.0 + percent / 100.0))


@disturbance(
    "card",
    "walk",
    "a bank card on the board's field, 1 mm and 1 degree off; colour",
    Word(usual="grey", words=("grey", "white", "black")),
)
def _card(walk: WalkConditions, colour: str, rng: np.random.Generator) -> WalkConditions:
    return replace(walk, card=colour)
