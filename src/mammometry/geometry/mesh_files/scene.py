"""Contents of a mesh file of any format."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from mammometry.geometry.arrays import Array, Float64, Int32, Int64, UInt8

GREY = 128
"""sRGB of what has no colour."""
MIRRORED = (
    "The file places a part of the mesh mirrored (a negative scale), and it was read so. Compare left and right with "
    "the patient: a mole, the operated side or a tattoo."
)
HIDDEN = "Parts that the file hides, or does not draw, were left out."
SUBDIVIDED = "The file asks for a smoothed surface (subdivision). The mesh was read as it is, without it."
ANIMATED = "The file has an animation. The mesh was read as it is at its beginning."


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ScenePart:
    """A piece of a scene with one picture or none."""

    points: Float64[Array, "n 3"]
    """In the file's unit, where they are in the scene."""
    faces: Int64[Array, "m 3"]
    colours: UInt8[Array, "n 3"]
    """sRGB of each point. `GREY` where the file has none."""
    uv: Float64[Array, "n 2"] | None = None
    """Place of each point in the picture, (0, 0) lower left. None: no picture covers it."""
    picture: str | None = None
    """Name of the picture."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Scene:
    """Content of a GLB or USDZ."""

    parts: tuple[ScenePart, ...]
    pictures: dict[str, bytes] = field(default_factory=dict)
    """Name, with its ending → content of a JPEG, PNG or WebP."""
    metres_per_unit: float | None = None
    """None where the file does not say it."""
    remarks: tuple[str, ...] = ()
    """What was left out or needs a look, one sentence each."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MeshContent:
    """The triangles of a mesh file, in its own unit and frame."""

    points: Float64[Array, "n 3"]
    faces: Int32[Array, "m 3"]
    colours: UInt8[Array, "n 3"]
    """sRGB of each point. `GREY` where the file has none."""
    remarks: tuple[str, ...] = ()
    """What was left out or needs a look, one sentence each."""


def joined_parts(
    parts: Sequence[ScenePart],
) -> tuple[Float64[Array, "n 3"], Int64[Array, "m 3"], UInt8[Array, "n 3"]]:
    """Points, triangles and colours of all parts as one mesh."""
    before = np.cumsum([0, *(len(part.points) for part in parts)])
    return (
        np.concatenate([np.empty((0, 3)), *(part.points for part in parts)]),
        np.concatenate([np.empty((0, 3), np.int64), *(part.faces + before[n] for n, part in enumerate(parts))]),
        np.concatenate([np.empty((0, 3), np.uint8), *(part.colours for part in parts)]),
    )
