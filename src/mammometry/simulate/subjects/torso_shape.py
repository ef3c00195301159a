"""Measures of a torso and of its breasts, drawn by seed.

All sizes here are made up; no measurement uses them.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from mammometry.base.errors import UnknownWordError
from mammometry.simulate.subjects.body import BodyShape
from mammometry.simulate.subjects.marks import SkinMark

SIDES = ("left", "right")


@dataclass(frozen=True, slots=True, kw_only=True)
class BreastDesign:
    """Measures of one breast as seen along its axis, mm along the chest."""

    volume_cc: float = 400.0
    """Volume, cc. Met to 2 %."""
    apex_mm: tuple[float, float] = (76.0, -8.0)
    """Centre of the breast's base: distance from the midline, height."""
    radii_mm: tuple[float, float, float, float] = (66.0, 72.0, 80.0, 62.0)
    """Radii of the base: towards the midline, to the side, up, down."""
    projection_mm: float = 45.0
    """Height over the chest wall. Scaled to meet the volume."""
    hang_mm: float = 20.0
    """Distance by which gravity moves the mass: small if young and firm, large if ptotic with an undercut."""
    sag: float = 1.0
    """How the mass yields to gravity: 1 is in proportion to its height, larger values are more even."""
    below_fold_mm: float | None = None
    """Height of the fold above the nipple along the body, matched to 1 mm by adjusting `hang_mm`. None: not
    adjusted."""
    fullness: float = 0.85
    """Fullness of the lower pole: 0 tapers into the chest, 1 is round and meets it in a fold."""
    fold_mm: float = 4.0
    """Rounding of the fold."""
    nipple_place: tuple[float, float] = (0.05, -0.12)
    """Position of the nipple, in radii: to the side, up."""
    areola_mm: float = 20.0
    """Radius of the areola."""
    nipple_mm: float = 5.0
    """Height of the nipple."""
    unevenness_mm: float = 1.0
    """Amplitude of the skin's random unevenness."""
    cap: float = 2.6
    """Exponent of the upper profile: the larger it is, the longer the profile stays round before it tapers."""
    bare: bool = False
    """Whether it lacks areola and nipple."""
    removed: bool = False
    """Whether it was removed. Its measures then give its former position."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TorsoShape:
    """A trunk, its breasts and its pose."""

    body: BodyShape
    breasts: Mapping[str, BreastDesign]
    """"left" and "right", the patient's own."""
    lean_rad: float = math.radians(35.0)
    """Forward lean: 0 is standing, −π/2 is lying on the back."""
    marks: tuple[SkinMark, ...] = ()
    """Scars, folds, tattoos and other marks on its skin."""


def torso_shape(name: str, seed: int) -> TorsoShape:
    """Draw a torso by seed, with breasts of 100 to 1200 cc.

    Args:
        name: ``torso``, or ``torso_1``, ``torso_2``, … for others of the family.
        seed: seed of all random values.

    Raises:
        ValueError: the name is unknown.
    """
    number = name.removeprefix("torso").removeprefix("_")
    if name != "torso" and not (name.startswith("torso_") and number.isdecimal() and int(number) > 0):
        raise UnknownWordError("torsos are torso, torso_1, torso_2 and so on", f"{name!r}")
    rng = np.random.default_rng([seed, int(number or 0), 74])
    mean_cc = math.exp(rng.uniform(math.log(125.0), math.log(960.0)))
    ratio = math.exp(float(np.clip(rng.normal(0.0, 0.16), -0.4, 0.4)))
    # On average, larger breasts are on larger chests.
    heaviness = math.log(mean_cc / 100.0) / math.log(12.0)
    body = BodyShape(
        half_width_mm=132.0 + 22.0 * heaviness + rng.uniform(-6.0, 10.0),
        depth=rng.uniform(0.64, 0.78),
        flatness=rng.uniform(2.1, 2.9),
        skew=rng.normal(0.0, 0.02),
        arm_out_rad=math.radians(rng.uniform(28.0, 48.0)),
        arm_back_rad=math.radians(rng.uniform(0.0, 25.0)),
        arm_mm=rng.uniform(40.0, 50.0),
        sternum_mm=rng.uniform(1.0, 6.0),
        rib_mm=rng.uniform(0.0, 0.3),
        clavicle_mm=rng.uniform(1.0, 5.0),
        unevenness_mm=rng.uniform(0.5, 1.5),
        seed=int(rng.integers(1 << 31)),
    )
    slimness = float(np.clip(0.55 + 0.6 * heaviness + rng.normal(0.0, 0.06), 0.45, 1.3))
    ptosis = float(np.clip(0.1 + 0.65 * heaviness + rng.uniform(-0.15, 0.3), 0.02, 1.1))
    height = rng.uniform(-18.0, 10.0)
    fullness = min(rng.uniform(0.6, 1.0) + 0.25 * heaviness, 1.0)
    gap = rng.uniform(5.0, 12.0)
    areola, nipple = rng.uniform(0.25, 0.36), rng.uniform(3.0, 7.0)
    breasts: dict[str, BreastDesign] = {}
    for side, share in zip(SIDES, (math.sqrt(ratio), 1.0 / math.sqrt(ratio)), strict=True):
        volume_cc = float(np.clip(mean_cc * share, 103.0, 1160.0))
        radius = (volume_cc * 1000.0 / (0.45 * math.pi * slimness)) ** (1.0 / 3.0)
        inner = radius * rng.uniform(0.86, 0.96)
        apex = (inner + gap, height + rng.normal(0.0, 4.0))
        # The base ends before flank and armpit, where the chest cannot be described by a height map.
        outer = min(radius * rng.uniform(0.96, 1.06), body.half_width_mm + 4.0 - apex[0])
        upper = min(radius * rng.uniform(1.15, 1.4), 94.0 - apex[1])
        breasts[side] = BreastDesign(
            volume_cc=volume_cc,
            apex_mm=apex,
            radii_mm=(inner, outer, upper, radius * rng.uniform(0.82, 0.92)),
            projection_mm=slimness * radius,
            hang_mm=ptosis * radius * rng.uniform(0.9, 1.1),
            fullness=fullness,
            fold_mm=rng.uniform(2.5, 6.0),
            nipple_place=(rng.uniform(-0.02, 0.16), -0.06 - 0.22 * ptosis + rng.normal(0.0, 0.03)),
            areola_mm=min(areola * radius * rng.uniform(0.95, 1.05), 29.0),
            nipple_mm=nipple,
            unevenness_mm=rng.uniform(0.4, 1.4),
        )
    return TorsoShape(body=body, breasts=breasts, lean_rad=math.radians(rng.uniform(27.0, 42.0)))
