"""Cameras, stereo pairs and rigs.

Frames and pixels as everywhere (docs/conventions.md): x right, y down, z forward; integer coordinates at pixel centres;
`uv` is (column, row) in pixels; the world in mm. Lens distortion is OpenCV's Brown model k1 k2 p1 p2 k3.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from mammometry.geometry.arrays import Array, Float64, read_only
from mammometry.geometry.transform import Transform

_NEWTON_STEPS = 20
_NEWTON_TOLERANCE = 1e-13
_NO_TERM = 1e-12  # a coefficient below moves no pixel, and its roots would overflow


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Camera:
    """A calibrated camera: ``x_cam = R x_world + t``, then pinhole, then lens distortion.

    Raises:
        ValueError: a size that is none, a value that is not finite, or a K that is not fx 0 cx, 0 fy cy, 0 0 1.
    """

    name: str
    size_wh: tuple[int, int]
    """Image width and height, pixels."""
    matrix: Float64[Array, "3 3"]
    """K: focal lengths and principal point, pixels; no skew."""
    distortion: Float64[Array, 5]
    """k1, k2, p1, p2, k3 of Brown's model in OpenCV's order, dimensionless."""
    camera_from_world: Transform

    def __post_init__(self) -> None:
        if min(self.size_wh) < 1:
            raise ValueError(f"{self.name}: an image has at least one pixel, found {self.size_wh}")
        if not (np.isfinite(self.matrix).all() and np.isfinite(self.distortion).all()):
            raise ValueError(f"{self.name}: K or dist has a value that is not finite")
        if self.matrix[0, 0] <= 0 or self.matrix[1, 1] <= 0:
            raise ValueError(f"{self.name}: focal lengths must be positive, found {np.diag(self.matrix)[:2]}")
        if self.matrix[[0, 1, 2, 2, 2], [1, 0, 0, 1, 2]].tolist() != [0.0, 0.0, 0.0, 0.0, 1.0]:
            raise ValueError(f"{self.name}: K is fx 0 cx, 0 fy cy, 0 0 1, found {self.matrix.tolist()}")
        object.__setattr__(self, "matrix", read_only(self.matrix))
        object.__setattr__(self, "distortion", read_only(self.distortion))

    @property
    def fold_xy(self) -> float:
        """Distorted radius r/z at which the lens model folds back; infinite where it never does.

        Beyond it two directions share a pixel, and pixels farther out have none. Radial terms only: decentring ones
        are a hundredth of them.
        """
        k1, k2, _, _, k3 = np.where(np.abs(self.distortion) > _NO_TERM, self.distortion, 0.0)
        roots = np.roots([7 * k3, 5 * k2, 3 * k1, 1.0])  # of d(distorted radius) / d(radius), over radius²
        folds = roots.real[(np.abs(roots.imag) < 1e-9 * np.abs(roots)) & (roots.real > 0)]
        if not len(folds):
            return np.inf
        radius = np.sqrt(folds.min())
        return float(distort(np.array([radius, 0.0]), np.array([k1, k2, 0.0, 0.0, k3]))[0])

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
        """Project world points, mm, to distorted `uv`, pixels; points behind the camera give NaN."""
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


def distort(xy: Float64[Array, "*n 2"], distortion: Float64[Array, 5]) -> Float64[Array, "*n 2"]:
    """Brown's distortion of ideal coordinates; dimensionless in and out."""
    k1, k2, p1, p2, k3 = distortion
    x, y = xy[..., 0], xy[..., 1]
    r2 = x * x + y * y
    radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
    return np.stack(
        [x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x), y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y],
        axis=-1,
    )


def undistort(xy_distorted: Float64[Array, "*n 2"], distortion: Float64[Array, 5]) -> Float64[Array, "*n 2"]:
    """Inverse of `distort`, by Newton's method with the analytic 2 × 2 Jacobian."""
    if not np.any(distortion):
        return xy_distorted.copy()
    k1, k2, p1, p2, k3 = distortion
    xy = xy_distorted.copy()
    for _ in range(_NEWTON_STEPS):
        x, y = xy[..., 0], xy[..., 1]
        r2 = x * x + y * y
        radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
        slope = k1 + r2 * (2 * k2 + 3 * r2 * k3)  # d radial / d r²
        error = distort(xy, distortion) - xy_distorted
        j_xx = radial + 2 * x * x * slope + 2 * p1 * y + 6 * p2 * x
        j_yy = radial + 2 * y * y * slope + 6 * p1 * y + 2 * p2 * x
        j_xy = 2 * x * y * slope + 2 * p1 * x + 2 * p2 * y
        determinant = j_xx * j_yy - j_xy * j_xy
        step = np.stack(
            [(j_yy * error[..., 0] - j_xy * error[..., 1]), (j_xx * error[..., 1] - j_xy * error[..., 0])], axis=-1
        )
        step /= determinant[..., None]
        xy -= step
        if np.nanmax(np.abs(step), initial=0.0) < _NEWTON_TOLERANCE:
            break
    return xy


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class StereoPair:
    """Two cameras that look at the same skin; disparity is u_left − u_right."""

    name: str
    left: Camera
    right: Camera


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Rig:
    """Any number of cameras and of stereo pairs among them."""

    name: str
    cameras: Mapping[str, Camera]
    """By name; read-only."""
    pair_names: Mapping[str, tuple[str, str]]
    """Pair name → names of its left and right camera; read-only."""

    def __post_init__(self) -> None:
        for pair, (left, right) in self.pair_names.items():
            missing = {left, right} - set(self.cameras)
            if missing or left == right:
                raise ValueError(f"pair {pair} needs two cameras of the rig, found {left!r} and {right!r}")
        object.__setattr__(self, "cameras", MappingProxyType(dict(self.cameras)))
        object.__setattr__(self, "pair_names", MappingProxyType(dict(self.pair_names)))

    def pair(self, name: str) -> StereoPair:
        """The calibrated stereo pair of that name."""
        left, right = self.pair_names[name]
        return StereoPair(name=name, left=self.cameras[left], right=self.cameras[right])

    @property
    def pairs(self) -> tuple[StereoPair, ...]:
        """All pairs, in the manifest's order."""
        return tuple(self.pair(name) for name in self.pair_names)
