"""Region of the body: a box in the frame of the board that the patient wears.

The board hangs on the belly, its upper edge below the breasts. Its x axis is along its rows, y down, z into the
board. Outside the box are the room, walls, legs, hands and the board itself.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np

from mammometry.base.value import value
from mammometry.geometry import Array, Bool, Camera, Float64

if TYPE_CHECKING:  # manifests are read without importing the algorithms
    from mammometry.calibration.targets.target import Target

TELEPHONE_BOARD: Mapping[str, Any] = MappingProxyType(
    {"kind": "charuco", "squares": [11, 7], "square_mm": 24.0, "marker_mm": 17.0, "dictionary": "DICT_5X5_100"}
)
"""``[target]`` of the board drawn by `mammometry target --telephone`: it fills an A4 page in landscape."""
HALF_WIDTH_MM = 260.0
"""From the board's middle to each side: half the shoulder breadth of 99 in 100 adults is below 255 mm (ANSUR II)."""
HEIGHT_MM = 400.0
"""Extent above the board: from below the breasts to the neck of tall adults, almost without the face."""
BEFORE_MM, BEHIND_MM = 220.0, 130.0
"""Extent in front of the board's plane and behind it: includes the breasts and the trunk's sides, but no wall."""
_EDGE_SHARE = 1.6  # squares between the highest inner corner and the upper edge: the outer squares, the white border
_GAP_MM = 8.0  # between the board and the first skin above it
_GRID = 9  # points along each edge of the box that are projected for its outline


@value(eq=False)
class Region:
    """A box along the world axes, mm."""

    low_world: Float64[Array, 3]
    high_world: Float64[Array, 3]

    @property
    def middle_world(self) -> Float64[Array, 3]:
        """Centre of the box, mm."""
        middle: Float64[Array, 3] = (self.low_world + self.high_world) / 2
        return middle

    def contains(self, points_world: Float64[Array, "*n 3"]) -> Bool[Array, "*n"]:
        """Whether points, mm, are inside the box."""
        return np.all((points_world > self.low_world) & (points_world < self.high_world), axis=-1)

    def mask(self, camera: Camera) -> Bool[Array, "h w"]:
        """Pixels of a camera that may show the box: the convex hull of its projection."""
        from PIL import Image, ImageDraw
        from scipy.spatial import ConvexHull

        steps = [np.linspace(low, high, _GRID) for low, high in zip(self.low_world, self.high_world, strict=True)]
        uv = camera.project(np.stack(np.meshgrid(*steps, indexing="ij"), axis=-1).reshape(-1, 3))
        uv = uv[np.isfinite(uv).all(axis=1)]
        picture = Image.new("1", camera.size_wh)
        if len(uv) > 2:
            outline = uv[ConvexHull(uv).vertices]
            ImageDraw.Draw(picture).polygon([(float(u), float(v)) for u, v in outline], fill=1)
        return np.asarray(picture, dtype=bool)


def region_above(target: Target) -> Region:
    """The box above a board on the belly, in the board's frame, mm."""
    points = target.points_target
    square_mm = float(np.diff(np.unique(points[:, 1])).min())
    middle = (points[:, 0].min() + points[:, 0].max()) / 2
    bottom = float(points[:, 1].min()) - _EDGE_SHARE * square_mm - _GAP_MM
    return Region(
        low_world=np.array([middle - HALF_WIDTH_MM, bottom - HEIGHT_MM, -BEFORE_MM]),
        high_world=np.array([middle + HALF_WIDTH_MM, bottom, BEHIND_MM]),
    )
