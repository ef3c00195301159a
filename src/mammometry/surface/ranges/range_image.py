"""Range images: distance to the skin at each pixel of a pair's left camera (paper 2.4)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mammometry.base.machine.cores import in_bands
from mammometry.base.value import value
from mammometry.geometry import Camera, mesh_kernels
from mammometry.geometry.arrays import SIGMA_BITS, Array, Bool, Float32, Float64, Int64, to_bits, to_step
from mammometry.matching.dense.match import DisparityMap
from mammometry.surface.ranges import image_kernels, ray_kernels
from mammometry.surface.settings import DentSettings, TriangulateSettings

MAX_SIGMA_MM = 3.0
"""Largest expected error of a datum, mm: beyond it, it would be outside every fusion band."""
_SAMPLES = 100_000  # data for a median: more change it by less than a thousandth
RANGE_STEP_MM = 2.0**-9
"""Step of stored ranges, mm: its rounding has a σ of 0.0006 mm, a datum at least 0.007 mm (docs/decisions/0039)."""
NORMAL_MM = 1.5
"""Half-width of the window for a datum's normal, in the first surface and the repair, mm. Not critical."""
NEIGHBOURHOOD_MM = DentSettings().neighbourhood_mm
"""Half-width of the window for a datum's normal where views are compared, mm."""
SIGMA_FLOOR_MM = 0.05
"""Added in quadrature to each datum's σ, mm: no datum is more accurate than the calibration."""
SIGMAS = 3.0
"""Standard deviations above which a difference is not a measurement error."""


@value(eq=False)
class RangeImage:
    """Range image of one stereo pair: distance |r(i, j)| from the left perspective centre to the surface.

    Raises:
        ValueError: arrays of different shapes, a distorted camera, or a valid range that is not positive and finite.
    """

    name: str
    """The pair's name."""
    camera: Camera
    """The pair's rectified left camera (no distortion) at this image's resolution."""
    range_mm: Float32[Array, "h w"]
    """Euclidean distance from the perspective centre (not the depth z), mm. 0 if not valid. Steps of 2^-9 mm."""
    sigma_mm: Float32[Array, "h w"]
    """Expected standard deviation of `range_mm`, mm. 0 where not valid."""
    confidence: Float32[Array, "h w"]
    """Matching correlation c(i, j) of Eq. 1, −1…1. 0 where not valid."""
    valid: Bool[Array, "h w"]
    """Pixels with a datum."""

    def __post_init__(self) -> None:
        if np.any(self.camera.distortion):
            raise ValueError(f"{self.name}: a range image needs an ideal camera, found lens distortion")
        for field in ("range_mm", "sigma_mm", "confidence", "valid"):
            if (shape := getattr(self, field).shape) != self.camera.shape_hw:
                raise ValueError(f"{self.name}: {field} is {shape}, its camera {self.camera.shape_hw}")
        ranges = self.range_mm[self.valid]
        if not (np.isfinite(ranges).all() and (ranges > 0).all()):
            raise ValueError(f"{self.name}: valid ranges must be positive and finite")

    def ray_directions(self) -> Float64[Array, "h w 3"]:
        """Unit directions from the perspective centre through every pixel, world frame."""
        rotation = np.ascontiguousarray(self.camera.camera_from_world.rotation)
        rays: Float64[Array, "h w 3"] = image_kernels.ray_directions(
            *self.camera.shape_hw, rotation, self.camera.intrinsics
        )
        return rays

    def points_world(self) -> Float64[Array, "h w 3"]:
        """Surface points, world frame, mm. NaN where not valid."""
        points = self.camera.centre_world + self.ray_directions() * self.range_mm[..., None]
        points[~self.valid] = np.nan
        return points

    def valid_points_world(self) -> Float64[Array, "n 3"]:
        """Surface points of the valid elements in row order, world frame, mm."""
        rotation = np.ascontiguousarray(self.camera.camera_from_world.rotation)
        points: Float64[Array, "n 3"] = image_kernels.valid_points(
            self.range_mm, self.valid, rotation, self.camera.centre_world, self.camera.intrinsics
        )
        return points

    def pixel_mm(self) -> float:
        """Median size of a pixel on the surface, across the ray, mm. NaN without data."""
        ranges = self.range_mm[self.valid]
        ranges = ranges[:: max(1, len(ranges) // _SAMPLES)]
        return float(np.median(ranges) / self.camera.matrix[0, 0]) if len(ranges) else float("nan")

    def normals_camera(self, neighbourhood_mm: float = NEIGHBOURHOOD_MM) -> Float32[Array, "h w 3"]:
        """Unit normals towards the camera, camera frame. NaN where not valid or unknown.

        On a plane the inverse depth is linear, ``1/z = a x + b y + c``, in ideal image coordinates (x, y). A
        least-squares fit over the valid data in a square window of half-width `neighbourhood_mm` gives the normal's
        direction −(a, b, c). It is unknown with fewer than six data, or with all data on a line.
        """
        normals = np.full((*self.camera.shape_hw, 3), np.nan, dtype=np.float32)
        if not self.valid.any():
            return normals
        top, bottom, left, right = mesh_kernels.extent(self.valid).tolist()
        rows, columns = slice(top, bottom), slice(left, right)
        fx, fy, cx, cy = self.camera.intrinsics
        normals[rows, columns] = image_kernels.inverse_depth_planes(
            np.ascontiguousarray(self.range_mm[rows, columns]),
            np.ascontiguousarray(self.valid[rows, columns]),
            np.array([fx, fy, cx - columns.start, cy - rows.start]),
            max(1, round(neighbourhood_mm / self.pixel_mm())),
        )
        return normals

    def normals_world(self, neighbourhood_mm: float = NEIGHBOURHOOD_MM) -> Float64[Array, "h w 3"]:
        """`normals_camera`, in the world frame."""
        return self.normals_camera(neighbourhood_mm) @ self.camera.camera_from_world.rotation

    def incidence_rad(self, neighbourhood_mm: float) -> Float32[Array, "h w"]:
        """Angle between the local normal and the direction to the camera, rad. NaN where there is no normal."""
        cosine = image_kernels.incidence_cosines(self.normals_camera(neighbourhood_mm), self.camera.intrinsics)
        return np.arccos(np.clip(cosine, -1.0, 1.0))

    def trust(self, taper_mm: float) -> Float32[Array, "h w"]:
        """Weight of each datum: 0.05 at the edge of the data, rising to 1 at `taper_mm` inside it.

        Windows at the edge extend past the skin. The edge of the image counts as an edge of the data.
        """
        inside = image_kernels.distance_px(np.pad(~self.valid, 1, constant_values=True))[1:-1, 1:-1]
        return np.clip(inside * (self.pixel_mm() / max(taper_mm, 1e-6)), 0.05, 1.0).astype(np.float32)

    def keeping(self, keep: Bool[Array, "h w"]) -> RangeImage:
        """The image with data only where `keep` and valid, else 0."""
        valid = self.valid & keep
        zero = np.float32(0)
        return replace(
            self,
            valid=valid,
            range_mm=np.where(valid, self.range_mm, zero),
            sigma_mm=np.where(valid, self.sigma_mm, zero),
            confidence=np.where(valid, self.confidence, zero),
        )


def triangulate(disparity: DisparityMap, settings: TriangulateSettings = TriangulateSettings()) -> RangeImage:
    """Intersect the rays of each match (paper 2.4).

    The rays of (u, v) in the left and (u − d_H, v − d_V) in the right camera are skew if d_V ≠ 0. The datum is the
    point *of the left ray* nearest to the right one, so that |r(i, j)| is on the ray of element (i, j). Its σ follows
    from that of d_H. Rays that meet behind a camera are not valid. Pixels denser than `spacing_mm` are skipped by whole
    rows and columns, and the image's camera describes the remaining ones.
    """
    step = _step(disparity, settings.spacing_mm)
    thin = (slice(None, None, step), slice(None, None, step))
    valid = np.array(disparity.valid[thin], dtype=bool)
    rows, columns = np.nonzero(valid)
    distance, distance_right, sigma = _intersected(disparity, rows * step, columns * step)
    with np.errstate(invalid="ignore"):
        good = np.isfinite(distance) & (distance > RANGE_STEP_MM) & (distance_right > 0) & (sigma <= MAX_SIGMA_MM)

    def spread(values: Float64[Array, " n"]) -> Float32[Array, "h w"]:
        image = np.zeros(valid.shape, dtype=np.float32)
        image[valid] = np.where(good, values, 0.0)
        return image

    usable = valid.copy()
    usable[valid] = good
    return RangeImage(
        name=disparity.name,
        camera=thinned_camera(disparity.left, step),
        range_mm=to_step(spread(distance), RANGE_STEP_MM),
        sigma_mm=to_bits(spread(sigma), SIGMA_BITS),
        confidence=np.where(usable, disparity.confidence[thin], np.float32(0)),
        valid=usable,
    )


def _intersected(
    disparity: DisparityMap, rows: Int64[Array, " n"], columns: Int64[Array, " n"]
) -> tuple[Float64[Array, " n"], Float64[Array, " n"], Float64[Array, " n"]]:
    """Distances along both rays and σ of the left one, mm, for the given pixels."""
    left, right = disparity.left, disparity.right
    left_from_right = left.camera_from_world.rotation @ right.camera_from_world.rotation.T
    baseline = left.camera_from_world.rotation @ (right.centre_world - left.centre_world)

    def of(some: slice) -> tuple[Float64[Array, " n"], ...]:
        at = np.ascontiguousarray(rows[some]), np.ascontiguousarray(columns[some])
        matches = [np.ascontiguousarray(found[at], dtype=np.float64) for found in (disparity.d_h_px, disparity.d_v_px)]
        met: tuple[Float64[Array, " n"], ...] = ray_kernels.meetings(
            *at, *matches, left.intrinsics, right.intrinsics, left_from_right, baseline
        )
        return met

    parts = zip(*in_bands(of, len(rows)), strict=True)
    distance, distance_right, slope = (np.concatenate(part) for part in parts)
    return distance, distance_right, slope * disparity.sigma_px[rows, columns]


def _step(disparity: DisparityMap, spacing_mm: float) -> int:
    """Largest step between pixels that keeps neighbours within `spacing_mm` on the surface. At least 1."""
    rows, columns = np.nonzero(disparity.valid)
    some = slice(None, None, max(1, len(rows) // (_SAMPLES // 10)))
    distance = _intersected(disparity, rows[some], columns[some])[0]
    distance = distance[np.isfinite(distance) & (distance > 0)]
    return max(1, int(spacing_mm * disparity.left.matrix[0, 0] / np.median(distance))) if len(distance) else 1


def thinned_camera(camera: Camera, step: int) -> Camera:
    """Camera of an image of which every `step`-th row and column is kept, from the first."""
    width, height = camera.size_wh
    scale = np.array([1.0 / step, 1.0 / step, 1.0])
    return replace(camera, size_wh=(-(-width // step), -(-height // step)), matrix=camera.matrix * scale[:, None])
