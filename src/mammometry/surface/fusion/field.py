"""Signed distance field of the solid, from range images, silhouettes and a closing box (paper 2.5).

In mm, positive outside the solid, limited to ± the truncation.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np
from scipy import ndimage

from mammometry.base.machine.cores import in_bands, map_in_threads
from mammometry.base.value import value
from mammometry.geometry import Array, Bool, Camera, Float32, Float64, Rig, mesh_kernels
from mammometry.matching.foreground.contour import follow
from mammometry.matching.foreground.foreground import Foreground
from mammometry.surface.fusion import field_kernels as kernels
from mammometry.surface.fusion.camera_records import COLUMNS, view_row
from mammometry.surface.occlusion import SAMPLES
from mammometry.surface.ranges import image_kernels
from mammometry.surface.ranges.range_image import NORMAL_MM, SIGMA_FLOOR_MM, RangeImage, thinned_camera
from mammometry.surface.settings import TAPER_MM

TRUNCATION_MM = 2.0
"""Half-width of the band around a measured surface in which views are averaged, mm. 2 gave the smallest errors."""
EXTEND_MM = 16.0
"""Distance by which range data are continued outwards along their tangent plane, mm across the ray. Matching loses the
rim and a band along every occluding edge, where the surface would swell: with 4 mm, errors on a torso are 10 %
larger."""
SPAN_JUMP_MM = 20.0
"""Difference in range between a gap's sides above which the gap is spanned, mm. Nothing unmeasured is assumed in front
of the span. Spans close what a breast hides: the skin between two breasts and under one. 10 to 40 gave the same
surfaces."""
LOST_SLOPE = 0.1
"""Assumed distance of the subject's edge outside a silhouette whose edge is hidden in shadow, px per px of distance to
the nearest visible edge. Folds of casts have 0.05 to 0.2 (docs/decisions/0017)."""

Rule: TypeAlias = Literal["default", "nearest", "furthest", "tsdf"]
_RULES: dict[Rule, int] = {
    "default": kernels.RULE_DEFAULT,
    "nearest": kernels.RULE_NEAREST,
    "furthest": kernels.RULE_FURTHEST,
    "tsdf": kernels.RULE_TSDF,
}
EXTEND_WEIGHT = 0.05
"""Weight of continued data relative to the datum that they continue. Not critical."""
JUMP_MM = 2.0
"""Difference of neighbouring ranges above which there is an edge, and nothing is interpolated, mm."""
_CONTOUR_BAND_PX = 12.0  # width of exact distances from a silhouette: more than the field's band in pixels
_AROUND_PX = 64  # largest distance from a silhouette, and margin around the subject's box; not critical
_OUTLIERS = 0.002  # percent of the data at either end of an axis that do not widen the closing box: one in 50,000
_BOX_SAMPLES = 1_000_000  # data for the box's percentiles
_SMALLEST_HOLE_SHARE = 2e-3  # share of the subject's area: larger holes in a mask are gaps between limbs; not critical
_SLOPE_MM = 4.0  # distance over which the slope of skin next to a gap is measured; not critical
_BLOCK_PX = 4  # side of the blocks in which other views' data are looked up: each contains some data
_BEFORE_MM = 5.0  # data of other views more than this in front of a span contradict it; not critical
_CLOSING_MM = 4.0  # without a silhouette, gaps in the data narrower than twice this are closed; not critical


@value(eq=False)
class ClosingBox:
    """Box behind and around the measured data that closes the solid."""

    planes: Float64[Array, "f 4"]
    """Outward unit normal and offset of each side: ``n · x − d``, positive outside, mm. The back is first."""
    corners: Float64[Array, "8 3"]
    """World frame, mm."""

    def distance_mm(self, points_world: Float64[Array, "n 3"]) -> Float64[Array, " n"]:
        """Signed distance to the nearest side, mm, negative inside."""
        sides: Float64[Array, " n"] = (points_world @ self.planes[:, :3].T - self.planes[:, 3]).max(axis=1)
        return sides


def closing_box(range_images: Sequence[RangeImage], *, back_mm: float, around_mm: float) -> ClosingBox:
    """Box around the data along the views' mean direction, which bounds the solid.

    Its back is `back_mm` behind the farthest datum along that direction, the other sides are `around_mm` outside the
    data. One datum in 50,000 at either end is an outlier; the visible parts of an arm are inside.
    """
    points = block_seeds(range_images)
    inward = np.sum([image.camera.axis_world for image in range_images], axis=0)
    if np.linalg.norm(inward) < 1e-3 * len(range_images):  # cameras all around: any direction is suitable
        inward = range_images[0].camera.axis_world
    inward = inward / np.linalg.norm(inward)
    across = np.eye(3)[np.argmin(np.abs(inward))]
    across = across - (across @ inward) * inward
    across /= np.linalg.norm(across)
    axes = np.stack([inward, across, np.cross(inward, across)])
    some = points[:: max(1, len(points) // _BOX_SAMPLES)]
    low, high = np.percentile(some @ axes.T, [_OUTLIERS, 100 - _OUTLIERS], axis=0)
    low, high = low - around_mm, high + np.array([back_mm, around_mm, around_mm])
    planes = np.concatenate([np.column_stack([axes, high]), np.column_stack([-axes, -low])])
    choice = np.array([[i, j, k] for i in (0, 1) for j in (0, 1) for k in (0, 1)], dtype=bool)
    return ClosingBox(planes=planes, corners=np.where(choice, high, low) @ axes)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class DistanceField:
    """Signed distance of the solid as a function of position."""

    views: Float64[Array, "v 24"]
    elements: Float32[Array, "p 3"]
    contours: Float64[Array, "c 24"]
    distances: Float32[Array, " q"]
    box: ClosingBox
    truncation_mm: float
    rule: Rule

    def sample(self, origins: Float64[Array, "n 3"], side: int, spacing_mm: float) -> Float32[Array, "n s s s"]:
        """Values at side³ points, `spacing_mm` apart, from each origin, mm. Positive outside."""

        def sampled(part: slice) -> Float32[Array, "k s s s"]:
            return kernels.sample_field(
                np.ascontiguousarray(origins[part], dtype=np.float64),
                side,
                float(spacing_mm),
                self.views,
                self.elements,
                self.contours,
                self.distances,
                np.array(self.box.planes),
                self.truncation_mm,
                JUMP_MM,
                _RULES[self.rule],
            )

        return np.concatenate(in_bands(sampled, len(origins)))


def build_field(
    range_images: Sequence[RangeImage], foregrounds: Mapping[str, Foreground], rig: Rig, box: ClosingBox, rule: Rule
) -> DistanceField:
    """Field of all views and silhouettes. Each view must have data (`fuse.usable`)."""
    starts = np.cumsum([0, *(image.valid.size for image in range_images)])
    elements = np.empty((starts[-1], 3), dtype=np.float32)
    view_rows = [
        view_row(image.camera, image.valid.shape, start) for image, start in zip(range_images, starts[:-1], strict=True)
    ]

    def fill(number: int) -> None:
        image = range_images[number]
        left = rig.pair(image.name).left
        others_mm = nearest_of_others_mm(image, range_images)
        rows = view_elements(image, left, foregrounds.get(left.name), others_mm)
        elements[starts[number] : starts[number + 1]] = rows.reshape(-1, 3)

    map_in_threads(fill, range(len(range_images)))
    outlined = {
        name: foreground
        for name, foreground in foregrounds.items()
        if not foreground.everything and foreground.mask.any()
    }
    steps = {name: _silhouette_step(rig.cameras[name], range_images) for name in outlined}
    distances = map_in_threads(
        lambda name: silhouette_distance_px(outlined[name], steps[name], LOST_SLOPE), list(outlined)
    )
    starts_of_lines = np.cumsum([0, *(distance_map.size for distance_map in distances)])
    contour_rows = [
        view_row(thinned_camera(rig.cameras[name], steps[name]), distance_map.shape, start)
        for name, distance_map, start in zip(outlined, distances, starts_of_lines[:-1], strict=True)
    ]
    return DistanceField(
        views=np.array(view_rows).reshape(-1, COLUMNS),
        elements=elements,
        contours=np.array(contour_rows).reshape(-1, COLUMNS),
        distances=np.concatenate(
            [np.zeros(0, dtype=np.float32), *(distance_map.ravel() for distance_map in distances)]
        ),
        box=box,
        truncation_mm=TRUNCATION_MM,
        rule=rule,
    )


def _silhouette_step(camera: Camera, range_images: Sequence[RangeImage]) -> int:
    """Step at which a camera's pixels are as dense on the subject as the range images' elements."""
    ranges = [np.linalg.norm(image.camera.centre_world - camera.centre_world) for image in range_images]
    nearest = range_images[int(np.argmin(ranges))]  # at about the same distance from the subject
    return max(1, round(nearest.pixel_mm() / np.median(nearest.range_mm[nearest.valid]) * camera.matrix[0, 0]))


def nearest_of_others_mm(image: RangeImage, all_images: Sequence[RangeImage]) -> Float32[Array, "H W"]:
    """Range of other views' nearest datum in each block of pixels, mm. Infinite without one."""
    height, width = image.valid.shape
    nearest = np.full((-(-height // _BLOCK_PX), -(-width // _BLOCK_PX)), np.inf, dtype=np.float32)
    for other in all_images:
        if other is image:
            continue
        points = other.valid_points_world()
        points = points[:: max(1, len(points) // SAMPLES)]
        uv = image.camera.project(points)
        with np.errstate(invalid="ignore"):
            inside = ((uv > -0.5) & (uv < [width - 0.5, height - 0.5])).all(axis=1)
        column, row = np.rint(uv[inside]).astype(np.intp).T // _BLOCK_PX
        range_mm = np.linalg.norm(points[inside] - image.camera.centre_world, axis=1).astype(np.float32)
        np.minimum.at(nearest, (row, column), range_mm)
    return nearest


def view_elements(
    image: RangeImage, left: Camera, foreground: Foreground | None, others_mm: Float32[Array, "H W"]
) -> Float32[Array, "h w 3"]:
    """Range, cosine of incidence and signed weight of every pixel, for `kernels.sample_field`.

    Measured data have the weight cos²/(σ² + floor²), less near the edge of the data. Up to `EXTEND_MM` outwards they
    are continued on the nearest datum's tangent plane. The rest of the subject's silhouette (or, without one, of the
    data's outline) has the nearest datum's range, which only supports what is behind it. Gaps between near and far skin
    are spanned instead (`image_kernels.spans`): hidden skin turns away there, and nothing unmeasured is in front of the
    span. `others_mm`: from `nearest_of_others_mm`.
    """
    normals = image.normals_camera(NORMAL_MM)
    subject = _subject_mask(image, left, foreground)
    slope_px = max(2, round(_SLOPE_MM / image.pixel_mm()))
    spans_mm = image_kernels.spans(
        image.range_mm, image.valid, subject, others_mm, _BLOCK_PX, slope_px, SPAN_JUMP_MM, _BEFORE_MM
    )
    elements: Float32[Array, "h w 3"] = kernels.view_elements(
        image.range_mm,
        image.valid,
        image.sigma_mm,
        image.trust(TAPER_MM),
        normals,
        *image_kernels.nearest_true(image.valid & np.isfinite(normals[..., 0])),
        subject,
        spans_mm,
        image.camera.intrinsics,
        image.pixel_mm(),
        EXTEND_MM,
        EXTEND_WEIGHT,
        SIGMA_FLOOR_MM,
    )
    return elements


def silhouette_distance_px(foreground: Foreground, step: int = 1, lost_slope: float = 0.0) -> Float32[Array, "h w"]:
    """Distance of every `step`-th pixel from the silhouette, positive outside.

    In steps, with sub-pixel precision. The silhouette is the `contour_level` line of the coverage, as straight pieces;
    the image's border is not part of it. The mask must not be empty. Small holes in the subject (dark spots) are closed
    first. Farther than `_AROUND_PX` from the subject's bounding box, the distance is `_AROUND_PX`: nothing is measured
    there. Where the line is not the subject's edge but a shadow's, the subject extends outside it by `lost_slope` times
    the distance along the line to the nearest visible edge.
    """
    height, width = (-(-side // step) for side in foreground.coverage.shape)
    mask = foreground.mask
    top, bottom, left, right = mesh_kernels.extent(mask).tolist()
    window = tuple(
        slice(max(start // step - _AROUND_PX, 0) * step, min((stop // step + _AROUND_PX) * step, side))
        for start, stop, side in zip((top, left), (bottom, right), mask.shape, strict=True)
    )
    inside = mask[window][::step, ::step]
    holes = _small_holes(inside)
    if step > 1:  # dark pixels between two steps belong to the hole next to them
        holes = ndimage.binary_dilation(holes)
    inside = inside | holes
    if inside.all():
        return np.full((height, width), -1e4, dtype=np.float32)
    ends = np.array([end for axis in window for end in (axis.start, axis.stop)], dtype=np.int64)
    starts, steps = kernels.contour_pieces(
        np.ascontiguousarray(foreground.coverage), ends, np.ascontiguousarray(holes), step, foreground.contour_level
    )
    distances = np.full((height, width), np.float32(_AROUND_PX))
    distances[tuple(slice(axis.start // step, -(-axis.stop // step)) for axis in window)] = (
        image_kernels.outline_distances(inside, starts, steps, _CONTOUR_BAND_PX)
    )
    if lost_slope > 0:
        _dilate(distances, foreground, step, lost_slope)
    return distances


def _dilate(distances: Float32[Array, "h w"], foreground: Foreground, step: int, lost_slope: float) -> None:
    """Dilate the silhouette where its edge is lost, by discs around points of the contour."""
    traced = follow(foreground)
    lost = traced.lost_px > 0
    for (column, row), radius in zip(traced.uv[lost] / step, lost_slope * traced.lost_px[lost] / step, strict=True):
        reach = radius + _AROUND_PX
        top, left = max(int(row - reach), 0), max(int(column - reach), 0)
        around = distances[top : int(row + reach) + 1, left : int(column + reach) + 1]
        down, across = np.ogrid[top : top + around.shape[0], left : left + around.shape[1]]
        np.minimum(around, np.hypot(down - row, across - column) - radius, out=around, casting="same_kind")


def _small_holes(mask: Bool[Array, "h w"]) -> Bool[Array, "h w"]:
    """Small enclosed background regions: too small to be gaps between body parts."""
    holes, count = ndimage.label(~mask)
    sizes = np.bincount(holes.ravel(), minlength=count + 1)
    for border in (holes[0], holes[-1], holes[:, 0], holes[:, -1]):
        sizes[border] = mask.size
    sizes[0] = mask.size
    return np.asarray(sizes < _SMALLEST_HOLE_SHARE * mask.sum())[holes]


def _subject_mask(image: RangeImage, left: Camera, foreground: Foreground | None) -> Bool[Array, "h w"]:
    """Pixels of the range image on the subject, by its silhouette, or else by the outline of the data."""
    if foreground is None or foreground.everything:
        radius = max(1, round(_CLOSING_MM / image.pixel_mm()))
        padded = np.pad(image.valid, radius)
        near = ndimage.distance_transform_edt(~padded) <= radius
        closed = ndimage.distance_transform_edt(near) > radius
        return np.asarray(ndimage.binary_fill_holes(closed[radius:-radius, radius:-radius] | image.valid))
    # The mapping from the ideal to the real image is smooth: exact on a coarse grid, linear in between.
    height, width = image.valid.shape
    rows, columns = np.linspace(0, height - 1, height // 16 + 2), np.linspace(0, width - 1, width // 16 + 2)
    u, v = np.meshgrid(columns, rows)
    directions = image.camera.rays_world(np.stack([u, v], axis=-1).reshape(-1, 2))
    original = left.project(left.centre_world + directions * 1000.0).reshape(len(rows), len(columns), 2)
    places = np.ascontiguousarray(original[..., ::-1])
    coverage = image_kernels.resampled(np.ascontiguousarray(foreground.coverage), places, height, width)
    mask = coverage >= foreground.contour_level
    return np.asarray(mask | _small_holes(mask) | image.valid)


def block_seeds(range_images: Sequence[RangeImage]) -> Float64[Array, "n 3"]:
    """All measured points, world frame, mm. The surface passes near them."""
    return np.concatenate([image.valid_points_world() for image in range_images])
