"""Distance by which unmeasured skin could stand out unseen.

Nothing of the subject lies outside a silhouette, or in front of skin that a pair measured: the pair looked through
there. An outline may be not the subject's own edge but the border of a shadow on it (`contour`). There the edge is
lost. It may lie further out, the more so the farther along the outline from where it was last seen.
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
"""Distance outside a silhouette at which nothing of the subject is left, pixels."""
SILHOUETTE_DOUBT_SLOPE = 0.25
"""Growth of that distance, px for each px along an outline that is not an edge but the border of a shadow. In eight
outlines of a cast whose fold is as dark as the backdrop, such stretches lay up to .2 of it inside the true one."""
SEEN_THROUGH_MM = 0.5
"""Largest distance of the subject in front of skin that a pair measured, mm, beyond three standard deviations of the
datum."""
_STEPS = 24  # into which the farthest distance is divided; chosen for speed
_SIGMAS = 3  # standard deviations of a datum within which nothing is excluded


@value(eq=False)
class Silhouette:
    """One camera's silhouette. No part of the subject shows outside it."""

    camera: Camera
    background: Bool[Array, "h w"]
    """Pixels whose centre lies outside the silhouette."""
    outline_uv: Float64[Array, "n 2"]
    """Points of the outline, pixels."""
    doubt_px: Float64[Array, " n"]
    """How far outside each point the subject may end, pixels."""

    def excludes(self, points_world: Float64[Array, "n 3"]) -> Bool[Array, " n"]:
        """Points, mm, world frame, outside the silhouette by more than its doubt, as a mask."""
        seen, column, row = _pixels(self.camera, points_world)
        outside = seen[self.background[row, column]]
        uv = self.camera.project(points_world[outside])
        away_px, nearest = (np.asarray(answer) for answer in point_tree(self.outline_uv).query(uv))
        return _chosen(outside[away_px > self.doubt_px[nearest]], len(points_world))


@value(eq=False)
class SeenThrough:
    """Range data of one pair. Nothing stands in front of them."""

    camera: Camera
    """The pair's left one, of the whole range image."""
    first: tuple[int, int]
    """Row and column of the window that holds all data."""
    range_mm: Float32[Array, "h w"]
    sigma_mm: Float32[Array, "h w"]
    valid: Bool[Array, "h w"]
    """Inside the window."""
    margin_mm: float
    """Possible error of a datum, mm, besides three of its standard deviations."""

    @classmethod
    def of(cls, image: RangeImage, margin_mm: float) -> SeenThrough:
        """Cut out what holds data. The rest of a range image excludes nothing."""
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
        """Points, mm, world frame, that stand in front of a datum, as a mask."""
        seen, column, row = _pixels(self.camera, points_world)
        row, column = row - self.first[0], column - self.first[1]
        height, width = self.valid.shape
        within = (row >= 0) & (row < height) & (column >= 0) & (column < width)
        seen, row, column = seen[within], row[within], column[within]
        before_mm = self.range_mm[row, column] - np.linalg.norm(points_world[seen] - self.camera.centre_world, axis=1)
        free = self.valid[row, column] & (before_mm > self.margin_mm + _SIGMAS * self.sigma_mm[row, column])
        return _chosen(seen[free], len(points_world))


Bound = Silhouette | SeenThrough
"""What one view says about where the subject is not."""


def bounds(foregrounds: Mapping[str, Foreground], range_images: Sequence[RangeImage], rig: Rig) -> tuple[Bound, ...]:
    """Bounds of all views, from silhouettes and measured skin.

    Cameras without a silhouette have none. Pairs look through the space in front of measured skin.

    Args:
        foregrounds: silhouettes by camera, in the original photographs.
        range_images: what each pair measured, with its valid data.
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
    """Distance, mm, that each point may move out along its normal before a view excludes it.

    Args:
        points_world: skin, mm, world frame.
        normals_world: unit, outwards.
        views: what excludes.
        farthest_mm: largest distance returned; the distance is found to 1/24 of it.
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
    """Mask of the points in the picture, and their pixels' column and row."""
    uv = camera.project(points_world)
    with np.errstate(invalid="ignore"):
        within = np.flatnonzero((uv > -0.5).all(axis=1) & (uv < np.array(camera.size_wh) - 0.5).all(axis=1))
    column, row = np.round(uv[within]).astype(np.int64).T
    return within, column, row


def _chosen(indices: Int64[Array, " k"], count: int) -> Bool[Array, " n"]:
    chosen = np.zeros(count, dtype=bool)
    chosen[indices] = True
    return chosen
