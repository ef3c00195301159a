"""Distance by which unmeasured skin could protrude unseen.

The subject is nowhere outside a silhouette or in front of skin that a pair measured. Where an outline is the border of
a shadow instead of the subject's edge (`contour`), the true edge may be further out, the more so the farther along the
outline from the visible edge.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from mammometry.base.machine.cores import map_in_threads
from mammometry.base.value import value
from mammometry.geometry import Array, Bool, Camera, Float32, Float64, Int64, Rig, mesh_kernels
from mammometry.geometry.nearest import point_tree
from mammometry.matching.foreground.contour import follow
from mammometry.matching.foreground.foreground import Foreground
from mammometry.surface.ranges.range_image import RangeImage

SILHOUETTE_DOUBT_PX = 1.0
"""Distance outside a silhouette from which points are excluded, px."""
SILHOUETTE_DOUBT_SLOPE = 0.25
"""Growth of that distance along an outline that is the border of a shadow, px per px. In eight outlines of a cast whose
fold is as dark as the backdrop, such stretches were inside the true outline by up to 0.2 px per px."""
SEEN_THROUGH_MM = 0.5
"""Distance in front of measured skin from which points are excluded, mm, in addition to three standard deviations."""
_STEPS = 24  # steps of the search along a normal; chosen for speed
_SIGMAS = 3  # standard deviations of a range


@value(eq=False)
class Silhouette:
    """One camera's silhouette, outside which there is no part of the subject."""

    camera: Camera
    background: Bool[Array, "h w"]
    """Pixels whose centre is outside the silhouette."""
    outline_uv: Float64[Array, "n 2"]
    """Points of the outline, px."""
    doubt_px: Float64[Array, " n"]
    """Distance outside each point up to which the subject may extend, px."""

    def excludes(self, points_world: Float64[Array, "n 3"]) -> Bool[Array, " n"]:
        """Mask of the points, mm, world frame, that are outside the silhouette by more than `doubt_px`."""
        seen, column, row = _pixels(self.camera, points_world)
        outside = seen[self.background[row, column]]
        uv = self.camera.project(points_world[outside])
        away_px, nearest = (np.asarray(answer) for answer in point_tree(self.outline_uv).query(uv))
        return _chosen(outside[away_px > self.doubt_px[nearest]], len(points_world))


@value(eq=False)
class SeenThrough:
    """Range data of one pair, in front of which there is no part of the subject."""

    camera: Camera
    """The pair's left camera, of the whole range image."""
    first: tuple[int, int]
    """First row and column of the window that contains all data."""
    range_mm: Float32[Array, "h w"]
    sigma_mm: Float32[Array, "h w"]
    valid: Bool[Array, "h w"]
    """Whether each pixel of the window has a range."""
    margin_mm: float
    """Possible error of a range, mm, in addition to three standard deviations."""

    @classmethod
    def of(cls, image: RangeImage, margin_mm: float) -> SeenThrough:
        """The window of a range image that contains data."""
        top, bottom, left, right = mesh_kernels.extent(image.valid).tolist()
        window = (slice(top, bottom), slice(left, right))
        return cls(
            camera=image.camera,
            first=(top, left),
            range_mm=image.range_mm[window].copy(),
            sigma_mm=image.sigma_mm[window].copy(),
            valid=image.valid[window].copy(),
            margin_mm=margin_mm,
        )

    def excludes(self, points_world: Float64[Array, "n 3"]) -> Bool[Array, " n"]:
        """Mask of the points, mm, world frame, that are in front of measured skin."""
        seen, column, row = _pixels(self.camera, points_world)
        row, column = row - self.first[0], column - self.first[1]
        height, width = self.valid.shape
        within = (row >= 0) & (row < height) & (column >= 0) & (column < width)
        seen, row, column = seen[within], row[within], column[within]
        before_mm = self.range_mm[row, column] - np.linalg.norm(points_world[seen] - self.camera.centre_world, axis=1)
        free = self.valid[row, column] & (before_mm > self.margin_mm + _SIGMAS * self.sigma_mm[row, column])
        return _chosen(seen[free], len(points_world))


Bound = Silhouette | SeenThrough
"""Space that one view excludes."""


def bounds(foregrounds: Mapping[str, Foreground], range_images: Sequence[RangeImage], rig: Rig) -> tuple[Bound, ...]:
    """Space that views exclude, from silhouettes and from range images.

    Args:
        foregrounds: silhouettes by camera, in the original photographs; cameras without one exclude nothing.
        range_images: range image of each pair.
        rig: the calibrated cameras.
    """
    through = (SeenThrough.of(image, SEEN_THROUGH_MM) for image in range_images)
    return (*_silhouettes(foregrounds, rig), *through)


def _silhouettes(foregrounds: Mapping[str, Foreground], rig: Rig) -> list[Silhouette]:
    known = [name for name in rig.cameras if name in foregrounds and not foregrounds[name].everything]

    def silhouette(name: str) -> Silhouette:
        foreground = foregrounds[name]
        traced = follow(foreground)
        return Silhouette(
            camera=rig.cameras[name],
            background=foreground.coverage < foreground.contour_level,
            outline_uv=traced.uv,
            doubt_px=np.hypot(SILHOUETTE_DOUBT_PX, SILHOUETTE_DOUBT_SLOPE * traced.lost_px),
        )

    return [found for found in map_in_threads(silhouette, known) if len(found.outline_uv)]


def outward_room_mm(
    points_world: Float64[Array, "n 3"],
    normals_world: Float64[Array, "n 3"],
    views: Sequence[Bound],
    farthest_mm: Float64[Array, " n"],
) -> Float64[Array, " n"]:
    """Distance that each point can move outwards along its normal before a view excludes it, mm.

    Args:
        points_world: skin, mm, world frame.
        normals_world: unit, outwards.
        views: excluded space.
        farthest_mm: largest distance returned; the resolution is 1/24 of it.
    """
    room_mm = farthest_mm.copy()
    for view in views:
        for step in range(1, _STEPS):
            tried_mm = farthest_mm * step / _STEPS
            free = np.flatnonzero(tried_mm < room_mm)
            stopped = free[view.excludes(points_world[free] + tried_mm[free, None] * normals_world[free])]
            room_mm[stopped] = tried_mm[stopped]
    return room_mm


def _pixels(
    camera: Camera, points_world: Float64[Array, "n 3"]
) -> tuple[Int64[Array, " k"], Int64[Array, " k"], Int64[Array, " k"]]:
    """Mask of the points inside the image, and their pixels' column and row."""
    uv = camera.project(points_world)
    with np.errstate(invalid="ignore"):
        within = np.flatnonzero((uv > -0.5).all(axis=1) & (uv < np.array(camera.size_wh) - 0.5).all(axis=1))
    column, row = np.round(uv[within]).astype(np.int64).T
    return within, column, row


def _chosen(indices: Int64[Array, " k"], count: int) -> Bool[Array, " n"]:
    chosen = np.zeros(count, dtype=bool)
    chosen[indices] = True
    return chosen
