"""Volume of a breast from its specimen, by displaced water or by weight."""

from __future__ import annotations

import math
from dataclasses import dataclass

from mammometry.measure.volume.measurement import DENSITY_G_PER_CC, DENSITY_SD

SKIN_MM, SKIN_SD_MM = 1.44, 0.25
"""Thickness of a breast's skin and its standard deviation between women, mm (CT of 137 breasts, range 0.87 to 2.34 mm:
doi 10.1118/1.4793257)."""
FAT_G_PER_CC, GLAND_G_PER_CC = 0.93, 1.04
"""Density of fat and of fibroglandular tissue, g/cc. Assumed: the usual values in mammographic dosimetry, which cites
Hammerstein et al., Radiology 130 (1979) 485; the original was not checked. 0.02 g/cc more or less change the volume by
2 %, which `COMPOSITION_SD` includes."""
COMPOSITION_SD = 0.02
"""Standard uncertainty of a specimen's density if its composition is known, g/cc. Assumed: that between 31 specimens
of unknown composition (doi 10.1055/a-2253-8442)."""
YOUNGER, OLDER = (1.01, 0.08), (0.96, 0.04)
"""Density of specimens of women below and above 50 years and its standard deviation, g/cc (Arch Aesthetic Plast Surg
25(4), 2019)."""
_AGE = 50.0  # age that separates the two groups, years
_WATER_SHARE = 0.01  # standard uncertainty of displaced water, as a share, from reading and bubbles. Assumed
_WATER_CC = 3.0  # least standard uncertainty of displaced water, cc. Assumed
_SCALE_G = 1.0  # standard uncertainty of an operating theatre's scale, g. Assumed


@dataclass(frozen=True, slots=True, kw_only=True)
class TrueVolume:
    """Volume of a breast measured by another method."""

    volume_cc: float
    sd_cc: float
    """Its standard uncertainty, cc."""


def skin_left(area_cm2: float, thickness_mm: float | None) -> TrueVolume:
    """Volume of the skin that the operation left on the woman, which the surface measurement includes.

    Args:
        area_cm2: area of that skin; 0 if the specimen has all the skin.
        thickness_mm: its thickness. None: the published mean, `SKIN_MM`.
    """
    thickness, sd = (SKIN_MM, SKIN_SD_MM) if thickness_mm is None else (thickness_mm, 0.1 * thickness_mm)
    return TrueVolume(volume_cc=0.1 * thickness * area_cm2, sd_cc=0.1 * sd * area_cm2)


def water(displaced_g: float, temperature_c: float, skin: TrueVolume, sd_cc: float | None = None) -> TrueVolume:
    """Volume of a specimen from the weight of the water that it displaces.

    Args:
        displaced_g: mass of that water.
        temperature_c: temperature of the water.
        skin: skin that was left on the woman.
        sd_cc: standard uncertainty of the displacement. None: 1 %, at least 3 cc.
    """
    volume = displaced_g / water_density(temperature_c)
    own = max(_WATER_SHARE * volume, _WATER_CC) if sd_cc is None else sd_cc
    return TrueVolume(volume_cc=volume + skin.volume_cc, sd_cc=math.hypot(own, skin.sd_cc))


def water_density(temperature_c: float) -> float:
    """Density of water, g/cc, from 0 to 40 °C, by the formula of Thiesen, Scheel and Diesselhorst (1900)."""
    return 1.0 - (temperature_c - 3.9863) ** 2 * (temperature_c + 288.9414) / (508929.2 * (temperature_c + 68.12963))


def density(age: float | None, glandular_percent: float | None) -> tuple[float, float]:
    """Density of a specimen and its standard uncertainty, g/cc.

    By its composition (% of the volume that is fibroglandular) if known, otherwise by the woman's age, otherwise that
    of all women.
    """
    if glandular_percent is not None:
        share = glandular_percent / 100.0
        return share * GLAND_G_PER_CC + (1.0 - share) * FAT_G_PER_CC, COMPOSITION_SD
    if age is not None:
        return OLDER if age >= _AGE else YOUNGER
    return DENSITY_G_PER_CC, DENSITY_SD


def weight(weight_g: float, age: float | None, glandular_percent: float | None, skin: TrueVolume) -> TrueVolume:
    """Volume of a specimen from its weight and an assumed density (see `density`)."""
    per_cc, sd = density(age, glandular_percent)
    volume = weight_g / per_cc
    own = volume * math.hypot(sd / per_cc, _SCALE_G / weight_g)
    return TrueVolume(volume_cc=volume + skin.volume_cc, sd_cc=math.hypot(own, skin.sd_cc))
