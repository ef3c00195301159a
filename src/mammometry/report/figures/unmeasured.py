"""Fading of skin that no pair measured, in photographic colours.

Between measured places the surface is closed: by its neighbours, and further off by silhouettes alone. Photographs
painted on it look like skin all the same. So its colours fade to grey, in pictures and in the 3D view.
"""

from __future__ import annotations

import numpy as np
from PIL import Image, ImageDraw

from mammometry.geometry.arrays import Array, UInt8
from mammometry.surface.atlas import Atlas
from mammometry.surface.repair import Provenance, RepairedSurface

GREY = (154, 163, 173)
"""sRGB. `canvas.GREY`, in which the picture of provenance draws what is invented."""
WORDS = "Greyed: closed without having been measured"
_FADED = 0.75  # share of the grey in the colour: a nipple is still made out below it; chosen by eye


def faded(colours: UInt8[Array, "*n 3"]) -> UInt8[Array, "*n 3"]:
    """Colours with most of them replaced by grey, sRGB."""
    return np.rint((1 - _FADED) * colours + _FADED * np.array(GREY)).astype(np.uint8)


def shown_colours(colours: UInt8[Array, "n 3"], repaired: RepairedSurface) -> UInt8[Array, "n 3"]:
    """A surface's vertex colours, with unmeasured skin faded."""
    measured = repaired.provenance == Provenance.MEASURED
    return np.where(measured[:, None], colours, faded(colours))


def shown_picture(atlas: Atlas, nearest: Array, repaired: RepairedSurface) -> Image.Image:
    """Picture of a viewing mesh, with unmeasured skin faded.

    Args:
        atlas: the surface thinned for looking.
        nearest: for each of its vertices, the nearest vertex of the full surface.
        repaired: the full surface.
    """
    measured = (repaired.provenance == Provenance.MEASURED)[nearest]
    unmeasured = np.flatnonzero((measured[atlas.mesh.faces].sum(axis=1) < 2) & (atlas.view >= 0))
    picture = np.asarray(atlas.picture)
    mask = Image.new("1", (picture.shape[1], picture.shape[0]))
    draw = ImageDraw.Draw(mask)
    for corners in atlas.uv_px[unmeasured].reshape(-1, 6).tolist():
        draw.polygon(corners, fill=1, outline=1)
    hidden = np.asarray(mask)
    drawn = picture.copy()
    drawn[hidden] = faded(picture[hidden])
    return Image.fromarray(drawn)
