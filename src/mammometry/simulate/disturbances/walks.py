"""Disturbances of a walk with a telephone: breath, autofocus, the size of the print.

All sizes here are made up; no measurement uses them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from mammometry.geometry import Array, Float64
from mammometry.simulate.disturbances.registry import Number, disturbance


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class WalkConditions:
    """What differs from photograph to photograph."""

    breath_mm: Float64[Array, " n"]
    """Height of the front of the chest above its mean, at each photograph."""
    focal: Float64[Array, " n"]
    """Focal length of each photograph relative to the lens's."""
    print_scale: float = 1.0
    """Size of the print relative to what its ruler says."""


def still_walk(pictures: int) -> WalkConditions:
    """Nothing moves, and the lens is locked."""
    return WalkConditions(breath_mm=np.zeros(pictures), focal=np.ones(pictures))


@disturbance(
    "breath",
    "walk",
    "the chest of a held breath out or in by up to this at each photograph",
    Number(usual=0.3, within=(0.0, 5.0), likely=(0.1, 0.5), unit="mm"),
)
def _breath(walk: WalkConditions, most_mm: float, rng: np.random.Generator) -> WalkConditions:
    return replace(walk, breath_mm=walk.breath_mm + rng.uniform(-most_mm, most_mm, len(walk.breath_mm)))


@disturbance(
    "autofocus",
    "walk",
    "a lens that focuses anew for each photograph: standard deviation of its focal length",
    Number(usual=0.2, within=(0.0, 3.0), likely=(0.05, 0.5), unit="%"),
)
def _autofocus(walk: WalkConditions, std_percent: float, rng: np.random.Generator) -> WalkConditions:
    return replace(walk, focal=walk.focal * (1.0 + rng.normal(0.0, std_percent / 100.0, len(walk.focal))))


@disturbance(
    "misprint",
    "walk",
    "a print that is larger than its ruler was read to be",
    Number(usual=1.0, within=(-5.0, 5.0), likely=(-1.0, 1.0), unit="%"),
)
def _misprint(walk: WalkConditions, percent: float, rng: np.random.Generator) -> WalkConditions:
    return replace(walk, print_scale=walk.print_scale * (1.0 + percent / 100.0))
