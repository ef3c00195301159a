"""Range images: for every pixel of a pair's left camera, the distance to the skin (paper 2.4)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from mammometry.geometry.arrays import Array, Bool, Float32, Float64, read_only
from mammometry.geometry.camera import Camera


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RangeImage:
    """What one stereo pair saw: |r(i, j)|, the distance from the left perspective centre to the surface.

    Raises:
        ValueError: arrays of different shapes, or a valid range that is not positive and finite.
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
