"""Range images: distance to the skin at each pixel (paper 2.4).

The pixels are those of a pair's left camera.
"""

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
"""Expected error above which a datum is dropped, mm: it would lie outside every fusion band."""
_SAMPLES = 100_000  # data of which a median is taken: more change it by less than a thousandth; chosen by eye

RANGE_STEP_MM = 2.0**-9
"""Of a range image: its rounding has a σ of .0006 mm, a datum .007 at least (docs/decisions/0039)."""
NORMAL_MM = 1.5
"""Half-width of the window for a datum's normal, in the first surface and the repair, mm. Chosen by eye."""
NEIGHBOURHOOD_MM = DentSettings().neighbourhood_mm
"""Half-width of the window for a datum's normal where views are compared, mm."""
SIGMA_FLOOR_MM = 0.05
"""Added in quadrature to each datum's σ, mm: no datum is better than the calibration."""
SIGMAS = 3.0
"""Multiple of its expected standard deviation above which a difference is no error of measuring."""


@value(eq=False)
class RangeImage:
    """Range image of one stereo pair.

    |r(i, j)| is the distance from the left perspective centre to the surface.

    Raises:
        ValueError: arrays of different shapes, a distorted camera, or a valid range that is not positive and finite.
    """

    name: str
    """The pair's name."""
    camera: Camera
    """The pair's rectified left camera (no distortion) at this image's resolution."""
    range_mm: Float32[Array, "h w"]
    """Euclidean distance from the perspective centre (not the depth z), mm. 0 if not valid. Triangulated in steps of
    2^-9 mm.
    """
    sigma_mm: Float32[Array, "h w"]
    """Expected standard deviation of `range_mm`, mm. 0 where not valid."""
    confidence: Float32[Array, "h w"]
    """Matching correlation c(i, j) of Eq. 1, −1…1. 0 where not valid."""
    valid: Bool[Array, "h w"]
    """Where there is a datum."""

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
        """Surface points P, world frame, mm. NaN where not valid."""
        points = self.camera.centre_world + self.ray_directions() * self.range_mm[..., None]
        points[~self.valid] = np.nan
        return points

    def valid_points_world(self) -> Float64[Array, "n 3"]:
        """Surface points of the valid elements, world frame, mm. In row order."""
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
        """Unit normals towards the camera, camera frame.

        NaN where not valid or too few neighbours. Inverse depth is linear in the image on a plane, ``1/z = a x + b y +
        c`` with (x, y) = ideal image coordinates: its least-squares fit over the valid data within a square window of
        half-width `neighbourhood_mm` gives the normal (a, b, c). Fewer than six data, or all in a line, give none.
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
        """Trust in each datum: 0.05 at the data's edge, rising to 1.

        It reaches 1 `taper_mm` inside, since windows at the edge see past the skin. The picture's own edge is one,
        too.
        """
        inside = image_kernels.distance_px(np.pad(~self.valid, 1, constant_values=True))[1:-1, 1:-1]
        return np.clip(inside * (self.pixel_mm() / max(taper_mm, 1e-6)), 0.05, 1.0).astype(np.float32)

    def keeping(self, keep: Bool[Array, "h w"]) -> RangeImage:
        """Return the same image with data only where `keep` and valid. The rest is zeroed."""
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
    """Intersect each left ray with its match's right ray (paper 2.4).

    The rays of (u, v) in the left and (u − d_H, v − d_V) in the right camera miss each other when d_V ≠ 0; the datum
    is the point *of the left ray* nearest to the right one, so that |r(i, j)| lies on the ray of element (i, j).
    Its σ is that of d_H carried through the same geometry. Correspondences that meet behind a camera are not valid.
    Pixels denser than `spacing_mm` are left out row- and columnwise: the image's camera is that of what is left.
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
    """Distances along both rays, and σ of the left one, mm. Only for the given pixels."""
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
    """Step between pixels that keeps neighbours within `spacing_mm`.

    On the surface. 1 if pixels are wider.
    """
    rows, columns = np.nonzero(disparity.valid)
    some = slice(None, None, max(1, len(rows) // (_SAMPLES // 10)))
    distance = _intersected(disparity, rows[some], columns[some])[0]
    distance = distance[np.isfinite(distance) & (distance > 0)]
    return max(1, int(spacing_mm * disparity.left.matrix[0, 0] / np.median(distance))) if len(distance) else 1


def thinned_camera(camera: Camera, step: int) -> Camera:
    """Camera of an image thinned to every `step`-th pixel and row. Counted from the first."""
    width, height = camera.size_wh
    scale = np.array([1.0 / step, 1.0 / step, 1.0])
    return replace(camera, size_wh=(-(-width // step), -(-height // step)), matrix=camera.matrix * scale[:, None])
