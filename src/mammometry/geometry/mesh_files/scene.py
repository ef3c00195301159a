"""Content of a mesh file of any format."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from mammometry.geometry.arrays import Array, Float64, Int32, Int64, UInt8

GREY = 128
"""Grey level of points without a colour, sRGB."""
MIRRORED, HIDDEN = "mesh-part-mirrored", "mesh-parts-hidden"
SUBDIVIDED, ANIMATED = "mesh-subdivided", "mesh-animated"
"""Codes of notices about a file."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ScenePart:
    """A part of a scene with at most one image."""

    points: Float64[Array, "n 3"]
    """Points in the file's unit and the scene's frame."""
    faces: Int64[Array, "m 3"]
    colours: UInt8[Array, "n 3"]
    """sRGB of each point. `GREY` if the file has none."""
    uv: Float64[Array, "n 2"] | None = None
    """Texture coordinates of each point, with (0, 0) at the lower left. None without an image."""
    picture: str | None = None
    """Name of the image."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SceneContent:
    """Content of a GLB or USDZ."""

    parts: tuple[ScenePart, ...]
    pictures: dict[str, bytes] = field(default_factory=dict)
    """File name → content of a JPEG, PNG or WebP."""
    metres_per_unit: float | None = None
    """Unit of the file. None if the file does not state it."""
    remarks: tuple[str, ...] = ()
    """Codes of notices about parts that were not read or should be checked."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MeshContent:
    """Triangles of a mesh file, in its own unit and frame."""

    points: Float64[Array, "n 3"]
    faces: Int32[Array, "m 3"]
    colours: UInt8[Array, "n 3"]
    """sRGB of each point. `GREY` if the file has none."""
    remarks: tuple[str, ...] = ()
    """Codes of notices about parts that were not read or should be checked."""


def joined_parts(
    parts: Sequence[ScenePart],
) -> tuple[Float64[Array, "n 3"], Int64[Array, "m 3"], UInt8[Array, "n 3"]]:
    """Points, triangles and colours of all parts, as one mesh."""
    before = np.cumsum([0, *(len(part.points) for part in parts)])
    return (
        np.concatenate([np.empty((0, 3)), *(part.points for part in parts)]),
        np.concatenate([np.empty((0, 3), np.int64), *(part.faces + before[n] for n, part in enumerate(parts))]),
        np.concatenate([np.empty((0, 3), np.uint8), *(part.colours for part in parts)]),
    )
