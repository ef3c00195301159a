"""Cameras, stereo pairs and rigs.

Frames and pixels as in docs/conventions.md: x right, y down, z forward; integer coordinates at pixel centres; `uv` is
(column, row), pixels; world frame, mm. Lenses follow Brown's model (`lens`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from mammometry.base.value import value
from mammometry.geometry.arrays import Array, Float64
from mammometry.geometry.lens import distort, undistort
from mammometry.geometry.transform import Transform


@value(eq=False)
class Camera:
    """A calibrated camera: pose, K and lens.

    ``x_cam = R x_world + t``, then pinhole, then lens distortion.

    Raises:
        ValueError: a size below 1, a value that is not finite, or a K that is not fx 0 cx, 0 fy cy, 0 0 1.
    """

    name: str
    size_wh: tuple[int, int]
    """Image width and height, pixels."""
    matrix: Float64[Array, "3 3"]
    """K: focal lengths and principal point, pixels. No skew."""
    distortion: Float64[Array, 5]
    """Lens coefficients k1, k2, p1, p2, k3, dimensionless (`lens.COEFFICIENTS`)."""
    camera_from_world: Transform

    def __post_init__(self) -> None:
        if min(self.size_wh) < 1:
            raise ValueError(f"{self.name}: an image needs at least one pixel, found {self.size_wh}")
        if not (np.isfinite(self.matrix).all() and np.isfinite(self.distortion).all()):
            raise ValueError(f"{self.name}: K or dist has a value that is not finite")
        if self.matrix[0, 0] <= 0 or self.matrix[1, 1] <= 0:
            raise ValueError(f"{self.name}: focal lengths must be positive, found {np.diag(self.matrix)[:2]}")
        if self.matrix[[0, 1, 2, 2, 2], [1, 0, 0, 1, 2]].tolist() != [0.0, 0.0, 0.0, 0.0, 1.0]:
            raise ValueError(f"{self.name}: K must be fx 0 cx, 0 fy cy, 0 0 1, found {self.matrix.tolist()}")

    @property
    def intrinsics(self) -> Float64[Array, 4]:
        """Focal lengths and principal point fx, fy, cx, cy, pixels."""
        return self.matrix[[0, 1, 0, 1], [0, 1, 2, 2]]

    @property
    def centre_world(self) -> Float64[Array, 3]:
        """Perspective centre, world frame, mm."""
        return -self.camera_from_world.rotation.T @ self.camera_from_world.translation_mm

    @property
    def axis_world(self) -> Float64[Array, 3]:
        """Unit viewing direction (the camera's z), world frame."""
        return self.camera_from_world.rotation[2].copy()

    @property
    def shape_hw(self) -> tuple[int, int]:
        """Image height and width, pixels: the shape of its arrays."""
        return self.size_wh[1], self.size_wh[0]

    def project(self, points_world: Float64[Array, "*n 3"]) -> Float64[Array, "*n 2"]:
        """Project world points, mm, to distorted `uv`, pixels. Points behind the camera give NaN."""
        points_camera = self.camera_from_world.apply(points_world)
        with np.errstate(divide="ignore", invalid="ignore"):
            normalised = points_camera[..., :2] / points_camera[..., 2:]
        normalised[points_camera[..., 2] <= 0] = np.nan
        return self.pixels_from_normalised(normalised)

    def pixels_from_normalised(self, xy: Float64[Array, "*n 2"]) -> Float64[Array, "*n 2"]:
        """Distort ideal coordinates (x/z, y/z) and map them to `uv`, pixels."""
        distorted = distort(xy, self.distortion)
        return distorted * self.matrix[[0, 1], [0, 1]] + self.matrix[:2, 2]

    def normalised_from_pixels(self, uv: Float64[Array, "*n 2"]) -> Float64[Array, "*n 2"]:
        """Undo the lens: ideal coordinates (x/z, y/z) of distorted `uv`, by Newton's method."""
        return undistort((uv - self.matrix[:2, 2]) / self.matrix[[0, 1], [0, 1]], self.distortion)

    def rays_world(self, uv: Float64[Array, "*n 2"]) -> Float64[Array, "*n 3"]:
        """Unit directions from the perspective centre through `uv`, world frame."""
        xy = self.normalised_from_pixels(uv)
        rays = np.concatenate([xy, np.ones_like(xy[..., :1])], axis=-1)
        rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
        return rays @ self.camera_from_world.rotation


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class StereoPair:
    """Two cameras that view the same skin. Disparity is u_left − u_right."""

    name: str
    left: Camera
    right: Camera


@value(eq=False)
class Rig:
    """Cameras, and the stereo pairs among them."""

    name: str
    cameras: Mapping[str, Camera]
    """By name. Read-only."""
    pair_names: Mapping[str, tuple[str, str]]
    """Pair name → names of its left and right camera. Read-only."""
    target_middle_world: Float64[Array, 3] | None = None
    """Mean position of the calibration target, approximately where the subject is. World frame, mm. None if no target
    was seen."""

    def __post_init__(self) -> None:
        for pair, (left, right) in self.pair_names.items():
            missing = {left, right} - set(self.cameras)
            if missing or left == right:
                raise ValueError(f"pair {pair} needs two different cameras of the rig, found {left!r} and {right!r}")

    def pair(self, name: str) -> StereoPair:
        """The calibrated stereo pair with that name."""
        left, right = self.pair_names[name]
        return StereoPair(name=name, left=self.cameras[left], right=self.cameras[right])

    @property
    def pairs(self) -> tuple[StereoPair, ...]:
        """All pairs, in the manifest's order."""
        return tuple(self.pair(name) for name in self.pair_names)
