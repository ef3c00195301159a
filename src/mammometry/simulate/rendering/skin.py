"""Appearance of a surface: colours, mottling, pores, moles, veins, sheen, softness, hair.

These are only parameters. Kernels compute the colours as a function of the position on the surface, so that all cameras
see the same. All sizes here are made up; no measurement uses them.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np

from mammometry.base.errors import UnknownWordError
from mammometry.geometry.arrays import Array, Float64
from mammometry.simulate.rendering.shading import CHROMA_OCTAVES, OCTAVES

# Strength of each octave of lightness, from 40 mm to 0.16 mm, before `contrast`: about equal, a little more at 1–5 mm.
_LIGHTNESS = np.array([0.5, 0.5, 0.7, 0.9, 1.0, 1.0, 1.0, 0.9, 0.8])
_COLOUR = np.array([1.0, 0.8, 0.9, 0.8, 0.6])


@dataclass(frozen=True, slots=True, kw_only=True)
class SkinReflectance:
    """Reflectance of painted plaster or skin, linear light."""

    base_rgb: tuple[float, float, float] = (0.56, 0.39, 0.32)
    """Reflectance of the paint."""
    areola_rgb: tuple[float, float, float] = (0.38, 0.20, 0.17)
    """Reflectance of the areola."""
    contrast: float = 0.045
    """Standard deviation of the logarithm of lightness in one octave of the mottling. 0.005 is nearly textureless."""
    colour_contrast: float = 0.022
    """The same for the balance between red and blue, in the coarse octaves only."""
    specular: float = 0.012
    """Reflectance of the sheen at its peak, relative to white. Sweat has about 0.1."""
    exponent: float = 24.0
    """Sharpness of the sheen (Blinn and Phong's exponent)."""
    sheen_patches: float = 0.0
    """Unevenness of the sheen: standard deviation of its strength, relative to the mean."""
    roughness: float = 0.0
    """Tilt of the smallest facets, 0.8 mm wide, in the sheen: standard deviation, radians."""
    wrap: float = 0.06
    """Softness of grazing light: cosine by which it extends beyond the terminator."""
    scatter_mm: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Light below the surface: standard deviation of its path along the surface for red, green and blue, mm. In skin,
    red travels farthest."""
    pores: float = 0.0
    """Relative darkness of pores, 0…1. They are 0.1–0.3 mm wide."""
    moles: float = 0.0
    """Mean number of moles of 1–5 mm per 1000 cm² of surface."""
    veins: float = 0.0
    """Optical depth of the veins below the surface in red light. They are about 3 mm wide and bluish."""
    hair_per_cm2: float = 0.0
    """Fine dark hairs per cm², 4–14 mm long."""

    def __post_init__(self) -> None:
        for name in ("contrast", "colour_contrast", "specular", "sheen_patches", "roughness", "wrap", "moles", "veins"):
            _require(name, getattr(self, name), 0.0, math.inf)
        _require("pores", self.pores, 0.0, 1.0)
        _require("hair_per_cm2", self.hair_per_cm2, 0.0, 50.0)
        _require("exponent", self.exponent, 1.0, 10000.0)
        for value in self.scatter_mm:
            _require("scatter_mm", value, 0.0, 20.0)
        for value in (*self.base_rgb, *self.areola_rgb):
            _require("a reflectance", value, 0.0, 1.0)

    def spectrum(self) -> Float64[Array, "2 octaves"]:
        """Weights of the mottling's octaves: lightness, then colour."""
        weights = np.zeros((2, OCTAVES))
        weights[0] = self.contrast * _LIGHTNESS
        weights[1, :CHROMA_OCTAVES] = self.colour_contrast * _COLOUR
        return weights

    def sheen(self) -> Float64[Array, 4]:
        """Specular reflectance, exponent, patches and roughness, for the kernel."""
        return np.array([self.specular, self.exponent, self.sheen_patches, self.roughness])

    def marks(self) -> Float64[Array, 3]:
        """Pores, share of cells with a mole, and veins, for the kernel."""
        # A surface intersects a cell of 20 mm in about 1.5 · 400 mm². If the cell has a ball (mean diameter 5.3 mm),
        # the surface hits it in a quarter of the cases.
        return np.array([self.pores, min(1.0, self.moles * 600.0 / (1e5 * 0.25)), self.veins])


def _require(name: str, value: float, low: float, high: float) -> None:
    if not low <= value <= high:
        raise UnknownWordError(f"{name} must be between {low:g} and {high:g}", value)


_LIVING = SkinReflectance(
    base_rgb=(0.58, 0.37, 0.28),
    areola_rgb=(0.34, 0.17, 0.14),
    contrast=0.022,
    colour_contrast=0.02,
    specular=0.02,
    exponent=16.0,
    sheen_patches=0.3,
    roughness=0.12,
    scatter_mm=(2.6, 1.1, 0.7),
    pores=0.22,
    moles=14.0,
    veins=0.10,
)
SKINS: Mapping[str, SkinReflectance] = MappingProxyType(
    {
        "plaster": SkinReflectance(),
        "plain": SkinReflectance(contrast=0.005, colour_contrast=0.003),
        "speckled": SkinReflectance(base_rgb=(0.5, 0.5, 0.5), contrast=0.1, colour_contrast=0.0, specular=0.0),
        "skin": _LIVING,
        "dark-skin": replace(
            _LIVING, base_rgb=(0.19, 0.105, 0.07), areola_rgb=(0.09, 0.045, 0.035), specular=0.03, veins=0.0
        ),
        "pale-skin": replace(
            _LIVING, base_rgb=(0.70, 0.51, 0.43), areola_rgb=(0.50, 0.27, 0.24), contrast=0.014, pores=0.15, veins=0.3
        ),
        "sweat": replace(_LIVING, specular=0.10, exponent=70.0, sheen_patches=0.8, roughness=0.18),
    }
)
"""Name on the command line → appearance: painted plaster, nearly textureless plaster, matt speckles, four skins."""


def make_skin(name: str, *, contrast: float | None = None, hair_per_cm2: float = 0.0) -> SkinReflectance:
    """An appearance from `SKINS`, with optional contrast and hair.

    Raises:
        ValueError: the name is unknown, or a number is out of range.
    """
    if name not in SKINS:
        raise UnknownWordError(f"skins are {', '.join(SKINS)}", f"{name!r}")
    skin = replace(SKINS[name], hair_per_cm2=hair_per_cm2)
    return skin if contrast is None else replace(skin, contrast=contrast, colour_contrast=0.5 * contrast)
