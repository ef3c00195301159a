"""How a surface looks: colours, mottling fine enough to match at every scale, sheen. Numbers only; kernels paint."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mammometry.geometry.arrays import Array, Float64
from mammometry.simulate.kernels import CHROMA_OCTAVES, OCTAVES

# Strength of each octave of lightness, 40 mm to 0.16 mm, before `contrast`: about equal, a little more at 1–5 mm.
_LIGHTNESS = np.array([0.5, 0.5, 0.7, 0.9, 1.0, 1.0, 1.0, 0.9, 0.8])
_COLOUR = np.array([1.0, 0.8, 0.9, 0.8, 0.6])


@dataclass(frozen=True, slots=True, kw_only=True)
class Skin:
    """Reflectance of painted plaster or skin; linear light."""

    base_rgb: tuple[float, float, float] = (0.56, 0.39, 0.32)
    """Reflectance of the paint."""
    areola_rgb: tuple[float, float, float] = (0.38, 0.20, 0.17)
    """Reflectance of the areola."""
    contrast: float = 0.045
    """Standard deviation of the logarithm of lightness in one octave of the mottling; 0.005 is nearly textureless."""
    colour_contrast: float = 0.022
    """The same for the balance of red against blue, in the coarse octaves only."""
    specular: float = 0.012
    """Reflectance of the sheen at its peak, relative to white; sweat is about 0.1."""
    exponent: float = 24.0
    """Sharpness of the sheen (Blinn and Phong's exponent)."""
    wrap: float = 0.06
    """Softness by light that travels below the surface: how far beyond the terminator it reaches (cosine)."""

    def spectrum(self) -> Float64[Array, "2 octaves"]:
        """Weights of the mottling's octaves: lightness, then colour."""
        weights = np.zeros((2, OCTAVES))
        weights[0] = self.contrast * _LIGHTNESS
        weights[1, :CHROMA_OCTAVES] = self.colour_contrast * _COLOUR
        return weights

    def colours(self, backdrop: float) -> Float64[Array, "3 3"]:
        """Reflectance of the paint, the areola and the backdrop, RGB."""
        return np.array([self.base_rgb, self.areola_rgb, (backdrop, backdrop, backdrop)])
