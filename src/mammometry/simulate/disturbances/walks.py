"""Disturbances of a walk with a telephone: breathing, lens, shutter, size of the print.

All sizes here are made up; no measurement uses them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from mammometry.geometry import Array, Float64
from mammometry.simulate.disturbances.registry import Number, Word, disturbance


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class WalkConditions:
    """Breathing, focal length, principal point and skew at each photograph, and size of the printed board."""

    breath_mm: Float64[Array, " n"]
    """Displacement of the front of the chest at each photograph, mm. Positive: forwards."""
    focal: Float64[Array, " n"]
    """Focal length at each photograph, relative to its usual value."""
    centre_px: Float64[Array, "n 2"]
    """Shift of the principal point at each photograph, pixels of a photograph at full size."""
    skew_px: Float64[Array, "n 2"]
    """Shift of the last row relative to the first, pixels of a photograph at full size."""
    print_scale: float = 1.0
    """Size of the print relative to its stated size."""
    card: str = ""
    """Colour of the bank card on the board. Empty: none."""


def still_walk(pictures: int) -> WalkConditions:
    """Conditions of a walk without breathing, with a locked lens and a correct print."""
    none_px = np.zeros((pictures, 2))
    return WalkConditions(breath_mm=np.zeros(pictures), focal=np.ones(pictures), centre_px=none_px, skew_px=none_px)


@disturbance(
    "breath",
    "walk",
    "breathing: the chest is displaced by up to this at each photograph",
    Number(usual=0.3, within=(0.0, 5.0), likely=(0.1, 0.5), unit="mm"),
)
def _breath(walk: WalkConditions, most_mm: float, rng: np.random.Generator) -> WalkConditions:
    return replace(walk, breath_mm=walk.breath_mm + rng.uniform(-most_mm, most_mm, len(walk.breath_mm)))


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
