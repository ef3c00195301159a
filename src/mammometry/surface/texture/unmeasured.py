"""Fading of skin that no pair measured, in photographic colours.

Further than a few millimetres from measured places the surface is closed by silhouettes alone. Photographs painted on
it look like skin all the same. So its colours fade to grey: in pictures, in the 3D view and in the models that other
programs open.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from PIL import Image, ImageDraw

from mammometry.geometry.arrays import Array, UInt8
from mammometry.geometry.nearest import point_tree
from mammometry.surface.repair.repair import RepairedSurface
from mammometry.surface.texture.texture_atlas import Atlas

GREY = (154, 163, 173)
"""sRGB. `canvas.GREY`, in which the picture of provenance draws what is invented."""
WORDS = "Greyed: closed without having been measured"
_FADED = 0.75  # share of the grey in the colour: a nipple is still made out below it; chosen by eye


def faded(colours: UInt8[Array, "*n 3"]) -> UInt8[Array, "*n 3"]:
    """Colours with most of them replaced by grey, sRGB."""
    return np.rint((1 - _FADED) * colours + _FADED * np.array(GREY)).astype(np.uint8)


def shown_colours(colours: UInt8[Array, "n 3"], repaired: RepairedSurface) -> UInt8[Array, "n 3"]:
    """A surface's vertex colours, with skin that is not claimed faded."""
    return np.where(repaired.claimed[:, None], colours, faded(colours))


def faded_atlas(atlas: Atlas, repaired: RepairedSurface) -> Atlas:
    """A viewing mesh whose picture is faded on skin that is not claimed.

    A triangle counts as claimed where the nearest vertices of the full surface are, for two of its corners or three.

    Args:
        atlas: the surface thinned for looking.
        repaired: the full surface.
    """
    nearest = point_tree(repaired.mesh.vertices).query(atlas.mesh.vertices)[1]
    claimed = repaired.claimed[nearest]
    unmeasured = np.flatnonzero((claimed[atlas.mesh.faces].sum(axis=1) < 2) & (atlas.view >= 0))
    mask = Image.new("1", (atlas.picture.shape[1], atlas.picture.shape[0]))
    draw = ImageDraw.Draw(mask)
    for corners in atlas.uv_px[unmeasured].reshape(-1, 6).tolist():
        draw.polygon(corners, fill=1, outline=1)
    hidden = np.asarray(mask)
    drawn = np.array(atlas.picture)
    drawn[hidden] = faded(drawn[hidden])
    return replace(atlas, picture=drawn, jpeg=None)
