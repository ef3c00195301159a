"""Photographic colours that fade to grey where the skin was not measured.

More than some millimetres from measured skin, the surface is closed by silhouettes alone. With photographs on it, it
would look like skin in pictures, in the 3D view and in exported models.
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
"""sRGB. The same as `canvas.GREY`, which marks invented skin in the picture of provenance."""
WORDS = "Greyed: closed without having been measured"
_FADED = 0.75  # share of the grey in the colour: with less, a nipple remains recognisable; appearance only


def faded(colours: UInt8[Array, "*n 3"]) -> UInt8[Array, "*n 3"]:
    """Colours that are mostly replaced by grey, sRGB."""
    return np.rint((1 - _FADED) * colours + _FADED * np.array(GREY)).astype(np.uint8)


def shown_colours(colours: UInt8[Array, "n 3"], repaired: RepairedSurface) -> UInt8[Array, "n 3"]:
    """A surface's vertex colours, faded where the skin was not measured."""
    return np.where(repaired.claimed[:, None], colours, faded(colours))


def faded_atlas(atlas: Atlas, repaired: RepairedSurface) -> Atlas:
    """A viewing mesh whose picture is faded where the skin was not measured.

    A triangle counts as measured if the full surface's vertices nearest to at least two of its corners are.

    Args:
        atlas: the viewing mesh.
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
