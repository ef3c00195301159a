"""Range images: for every pixel of a pair's left camera, the distance to the skin (paper 2.4)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy import ndimage

from mammometry.geometry.arrays import Array, Bool, Float32, Float64, read_only
from mammometry.geometry.camera import Camera
from mammometry.matching.match import DisparityMap

_MIN_NORMAL_MASS = 6
_MAX_NORMAL_WINDOW_PX = 61


@dataclass(frozen=True, slots=True, kw_only=True)
class TriangulateSettings:
    """Which disparities become range data."""

    max_sigma_mm: float = 3.0
    """A datum expected to be wrong by more than this is dropped, mm: it would lie outside every fusion band."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RangeImage:
    """What one stereo pair saw: |r(i, j)|, the distance from the left perspective centre to the surface.

    Raises:
        ValueError: arrays of different shapes, a distorted camera, or a valid range that is not positive and finite.
    """

    name: str
    """The pair's name."""
    camera: Camera
    """The pair's rectified left camera (no distortion) at this image's resolution."""
    range_mm: Float32[Array, "h w"]
    """Euclidean distance from the perspective centre (not the depth z), mm; 0 where not valid."""
    sigma_mm: Float32[Array, "h w"]
    """Expected standard deviation of `range_mm`, mm; 0 where not valid."""
    confidence: Float32[Array, "h w"]
    """Matching correlation c(i, j) of Eq. 1, −1…1."""
    valid: Bool[Array, "h w"]
    """Where there is a datum."""

    def __post_init__(self) -> None:
        if np.any(self.camera.distortion):
            raise ValueError(f"{self.name}: a range image belongs to an ideal camera, found lens distortion")
        for field in ("range_mm", "sigma_mm", "confidence", "valid"):
            array = getattr(self, field)
            if array.shape != self.camera.shape_hw:
                raise ValueError(f"{self.name}: {field} is {array.shape}, its camera {self.camera.shape_hw}")
            object.__setattr__(self, field, read_only(array))
        ranges = self.range_mm[self.valid]
        if not (np.isfinite(ranges).all() and (ranges > 0).all()):
            raise ValueError(f"{self.name}: valid ranges must be positive and finite")

    def ray_directions(self) -> Float64[Array, "h w 3"]:
        """Unit directions from the perspective centre through every pixel, world frame."""
        height, width = self.camera.shape_hw
        u, v = np.meshgrid(np.arange(width, dtype=np.float64), np.arange(height, dtype=np.float64))
        return self.camera.rays_world(np.stack([u, v], axis=-1))

    def points_world(self) -> Float64[Array, "h w 3"]:
        """Surface points P, world frame, mm; NaN where not valid."""
        points = self.camera.centre_world + self.ray_directions() * self.range_mm[..., None]
        points[~self.valid] = np.nan
        return points

    def valid_points_world(self) -> Float64[Array, "n 3"]:
        """Surface points of the valid elements only, in row order, world frame, mm."""
        rows, columns = np.nonzero(self.valid)
        rays = self.camera.rays_world(np.stack([columns, rows], axis=-1).astype(np.float64))
        return self.camera.centre_world + rays * self.range_mm[self.valid][:, None]

    def pixel_mm(self) -> float:
        """Median size of a pixel on the surface, across the ray, mm; NaN without data."""
        ranges = self.range_mm[self.valid]
        return float(np.median(ranges) / self.camera.matrix[0, 0]) if len(ranges) else float("nan")

    def normals_world(self, neighbourhood_mm: float = 2.5) -> Float64[Array, "h w 3"]:
        """Unit normals towards the camera, world frame; NaN where not valid or too few neighbours.

        Inverse depth is linear in the image on a plane, ``1/z = a x + b y + c`` with (x, y) = ideal image coordinates:
        its least-squares fit over the valid data within a square window of half-width `neighbourhood_mm` gives
        the normal (a, b, c) in the camera's frame. Fewer than six data, or all in a line, give none.
        """
        height, width = self.camera.shape_hw
        normals = np.full((height, width, 3), np.nan)
        if not self.valid.any():
            return normals
        rows, columns = (slice(box.start, box.stop) for box in ndimage.find_objects(self.valid.astype(np.uint8))[0])
        half = max(1, round(neighbourhood_mm / self.pixel_mm()))
        slopes, enough = _inverse_depth_planes(
            self.range_mm[rows, columns], self.valid[rows, columns], self.camera, (rows.start, columns.start), half
        )
        length = np.linalg.norm(slopes, axis=-1, keepdims=True)
        with np.errstate(invalid="ignore", divide="ignore"):
            facing = np.where(enough[..., None], -slopes / length, np.nan)
        normals[rows, columns] = facing @ self.camera.camera_from_world.rotation
        return normals

    def incidence_rad(self, neighbourhood_mm: float = 2.5) -> Float32[Array, "h w"]:
        """Angle between the local normal and the direction to the camera, rad; NaN where there is no normal."""
        cosine = -np.einsum("ijk,ijk->ij", self.normals_world(neighbourhood_mm), self.ray_directions())
        return np.arccos(np.clip(cosine, -1.0, 1.0)).astype(np.float32)

    def keeping(self, keep: Bool[Array, "h w"]) -> RangeImage:
        """Return the same image with data only where `keep` and valid; the rest is zeroed."""
        valid = self.valid & keep
        zero = np.float32(0)
        return replace(
            self,
            valid=valid,
            range_mm=np.where(valid, self.range_mm, zero),
            sigma_mm=np.where(valid, self.sigma_mm, zero),
        )


def triangulate(disparity: DisparityMap, settings: TriangulateSettings = TriangulateSettings()) -> RangeImage:
    """Intersect each left ray with the right ray of its correspondence (paper 2.4).

    The rays of (u, v) in the left and (u − d_H, v − d_V) in the right camera miss each other when d_V ≠ 0; the datum
    is the point *of the left ray* nearest to the right one, so that |r(i, j)| lies on the ray of element (i, j).
    Its σ is that of d_H carried through the same geometry. Correspondences that meet behind a camera are not valid.
    """
    left, right = disparity.left, disparity.right
    valid = np.asarray(disparity.valid, dtype=bool)
    height, width = left.shape_hw
    v, u = (index.astype(np.float64) for index in np.nonzero(valid))
    d_h = disparity.d_h_px[valid].astype(np.float64)
    d_v = disparity.d_v_px[valid].astype(np.float64)
    sigma_px = disparity.sigma_px[valid].astype(np.float64)
    rays_left = left.rays_world(np.stack([u, v], axis=-1))
    baseline = right.centre_world - left.centre_world

    def along_left(shift: Float64[Array, " n"]) -> tuple[Float64[Array, " n"], Float64[Array, " n"]]:
        rays_right = right.rays_world(np.stack([u - d_h - shift, v - d_v], axis=-1))
        cosine = np.einsum("ij,ij->i", rays_left, rays_right)
        with np.errstate(divide="ignore", invalid="ignore"):
            denominator = 1.0 - cosine**2
            to_left, to_right = rays_left @ baseline, rays_right @ baseline
            return (to_left - cosine * to_right) / denominator, (cosine * to_left - to_right) / denominator

    distance, distance_right = along_left(np.zeros_like(d_h))
    step = 0.05
    slope = (along_left(np.full_like(d_h, step))[0] - along_left(np.full_like(d_h, -step))[0]) / (2 * step)
    sigma = np.abs(slope) * sigma_px
    with np.errstate(invalid="ignore"):
        good = np.isfinite(distance) & (distance > 0) & (distance_right > 0) & (sigma <= settings.max_sigma_mm)

    def spread(values: Float64[Array, " n"]) -> Float32[Array, "h w"]:
        image = np.zeros((height, width), dtype=np.float32)
        image[valid] = np.where(good, values, 0.0)
        return image

    confidence = np.where(valid, disparity.confidence, np.float32(0))
    usable = valid.copy()
    usable[valid] = good
    return RangeImage(
        name=disparity.name,
        camera=left,
        range_mm=spread(distance),
        sigma_mm=spread(sigma),
        confidence=confidence,
        valid=usable,
    )


def _inverse_depth_planes(
    range_mm: Float32[Array, "h w"], valid: Bool[Array, "h w"], camera: Camera, origin: tuple[int, int], half: int
) -> tuple[Float64[Array, "h w 3"], Bool[Array, "h w"]]:
    """Coefficients (a, b, c) of 1/z = a x + b y + c around each pixel, and whether there were data enough.

    Windowed sums of 1, x, y, x², … are running sums, so the cost does not depend on the window; large windows
    are thinned to at most `_MAX_NORMAL_WINDOW_PX` samples a side. Coordinates are taken about the pixel itself.
    """
    height, width = valid.shape
    x = (np.arange(width) + origin[1] - camera.matrix[0, 2]) / camera.matrix[0, 0]
    y = (np.arange(height) + origin[0] - camera.matrix[1, 2]) / camera.matrix[1, 1]
    ray_length = np.sqrt(1.0 + x[None, :] ** 2 + y[:, None] ** 2)
    weight = valid.astype(np.float64)
    with np.errstate(divide="ignore"):
        inverse_depth = np.where(valid, ray_length / range_mm, 0.0)
    middle = inverse_depth[valid].mean()
    q = np.where(valid, inverse_depth - middle, 0.0)
    size = min(2 * half + 1, _MAX_NORMAL_WINDOW_PX)
    scale = 1.0 / camera.matrix[0, 0]

    offsets = np.arange(size) - size // 2
    ones = np.ones(size)

    def windowed(image: Float64[Array, "h w"], in_y: int, in_x: int) -> Float64[Array, "h w"]:
        kernel_y, kernel_x = (ones if power == 0 else offsets.astype(np.float64) ** power for power in (in_y, in_x))
        rows = ndimage.correlate1d(image, kernel_x, axis=1, mode="constant")
        return ndimage.correlate1d(rows, kernel_y, axis=0, mode="constant")

    s0 = windowed(weight, 0, 0)
    sx, sy = windowed(weight, 0, 1), windowed(weight, 1, 0)
    sxx, sxy, syy = windowed(weight, 0, 2), windowed(weight, 1, 1), windowed(weight, 2, 0)
    sq, sxq, syq = windowed(q, 0, 0), windowed(q, 0, 1), windowed(q, 1, 0)
    mass = np.maximum(s0, 1.0)
    cxx, cxy, cyy = sxx - sx * sx / mass, sxy - sx * sy / mass, syy - sy * sy / mass
    cxq, cyq = sxq - sx * sq / mass, syq - sy * sq / mass
    determinant = cxx * cyy - cxy * cxy
    enough = valid & (s0 >= _MIN_NORMAL_MASS) & (determinant > 1e-3 * mass**2)
    safe = np.where(enough, determinant, 1.0)
    a = (cyy * cxq - cxy * cyq) / safe / scale
    b = (cxx * cyq - cxy * cxq) / safe / scale
    at_pixel = middle + (sq - a * scale * sx - b * scale * sy) / mass
    c = at_pixel - a * x[None, :] - b * y[:, None]
    return np.stack([a, b, c], axis=-1), enough
