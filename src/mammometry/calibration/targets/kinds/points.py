"""A rigid object with surveyed points, marked by round dots."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np
from scipy.spatial import cKDTree

from mammometry.base.photograph import Photograph
from mammometry.calibration.features.constellation import (
    LEAST_DOTS,
    Reading,
    TargetCamera,
    adjusted,
    read_constellation,
)
from mammometry.calibration.features.dots import Dots, ToImage, measure_dots
from mammometry.calibration.features.found_points import Cause, FoundPoints
from mammometry.calibration.features.lattice import find_dots
from mammometry.calibration.features.pixels import enlarge, grey_bytes, linear_luma, reduced
from mammometry.calibration.targets.body import Body, Hits
from mammometry.calibration.targets.registry import TARGETS
from mammometry.calibration.targets.target import Target, require_measured, require_positive
from mammometry.geometry.arrays import Array, Bool, Float32, Float64, read_only

_SEARCH_WIDTHS = 2
"""Width of the searched picture compared with boards: dots are smaller than squares."""
_NEIGHBOURHOODS = (0.05, 0.12)
"""What a dot must be darker than, in picture widths."""
_MOST_DOTS = 250
"""More dots than this are texture. Chosen by eye."""
_START_HALF = 0.15
"""Starting radius if the diameter is not known, in distances of neighbouring points."""
_AROUND = 6
"""Neighbours that show the surface's inclination at a point. Chosen by eye."""
_FLAT = 0.12
"""Neighbours in a plane to within this share of their distance show the surface's inclination."""
_MAX_ERROR = 0.15
"""Largest distance of a dot from where the camera of all others puts it, in diameters."""
_ROUNDS = 2
"""Measurements, each with the camera of the one before. Chosen by eye."""

AMBIGUOUS = Cause(
    found="dots that fit the list of points in more than one way",
    remedy="Have more of the target in the picture, add points that break its symmetry, or write id,u,v to a .csv file "
    "of the photograph's name",
)
UNREAD = Cause(
    found="no dots that lie as the list of points says",
    remedy="Have at least eight dark round dots on a bright surface in view, or write id,u,v to a .csv file of the "
    "photograph's name",
)


def find_points(photograph: Photograph, target: PointsTarget, *, search_width_px: int) -> FoundPoints | Cause:
    """Find the dots of a surveyed target, or say why not."""
    small, scale = reduced(grey_bytes(photograph), _SEARCH_WIDTHS * search_width_px)
    points = target.points_target
    for neighbourhood in _NEIGHBOURHOODS:
        uv = enlarge(find_dots(small, neighbourhood), scale)
        if not LEAST_DOTS <= len(uv) <= _MOST_DOTS:
            continue
        readings = read_constellation(points, uv, photograph.size_wh)
        if len(readings) > 1:
            return AMBIGUOUS
        if readings:
            return _measured(linear_luma(photograph), target, readings[0]) or UNREAD
    return UNREAD


def _measured(linear: Float32[Array, "h w"], target: PointsTarget, reading: Reading) -> FoundPoints | None:
    """Measure the dots that were read."""
    points, camera, ids = target.points_target, reading.camera, np.sort(reading.ids)
    nearest_mm = float(np.asarray(cKDTree(points).query(points, k=2)[0])[:, 1].min())
    half_mm = target.dot_diameter_mm / 2 if target.dot_diameter_mm else _START_HALF * nearest_mm
    for _ in range(_ROUNDS):
        normals, flat = _normals(points, camera)
        dots = _measure(linear, camera, points[ids], normals[ids], half_mm, nearest_mm)
        if dots.ok.sum() < LEAST_DOTS:
            return None
        if target.dot_diameter_mm is None:
            half_mm = float(np.sqrt(np.median(dots.mass_mm2[dots.ok]) / np.pi))
        camera = adjusted(
            camera, points[ids[dots.ok]], dots.uv[dots.ok], free_lens=bool(dots.ok.sum() >= 2 * LEAST_DOTS)
        )
    error_px = np.linalg.norm(camera.image(points[ids]) - dots.uv, axis=1)
    size_px = 2 * half_mm * camera.focal_px / np.linalg.norm(points[ids] - camera.centre_mm, axis=1)
    good = dots.ok & (error_px < _MAX_ERROR * size_px)
    # Where the surface's slope is not known, the largest error that a slope could make is part of the uncertainty.
    doubt_px = np.where(flat[ids], 0.0, size_px**2 / (8 * camera.focal_px))
    covariance = dots.covariance_px2 + (doubt_px**2)[:, None, None] * np.eye(2)
    return FoundPoints(ids=ids[good], uv=dots.uv[good], covariance_px2=covariance[good]) if good.any() else None


def _normals(points: Float64[Array, "n 3"], camera: TargetCamera) -> tuple[Float64[Array, "n 3"], Bool[Array, " n"]]:
    """Unit normal of the surface at each point, towards the camera.

    Also whether its neighbours determine it. Otherwise the dot is assumed to face the camera.
    """
    distance, near = (np.asarray(part) for part in cKDTree(points).query(points, k=min(_AROUND + 1, len(points))))
    around = points[near] - points[near].mean(axis=1, keepdims=True)
    _, spread, axes = np.linalg.svd(around, full_matrices=False)
    flat: Bool[Array, " n"] = spread[:, 2] / np.sqrt(near.shape[1]) < _FLAT * distance[:, 1]
    flat &= spread[:, 1] > 0.2 * spread[:, 0]
    towards = camera.centre_mm - points
    towards /= np.linalg.norm(towards, axis=1, keepdims=True)
    normal = axes[:, 2] * np.sign((axes[:, 2] * towards).sum(axis=1, keepdims=True))
    flat &= (normal * towards).sum(axis=1) > 0.2
    return np.where(flat[:, None], normal, towards), flat


def _measure(
    linear: Float32[Array, "h w"],
    camera: TargetCamera,
    points: Float64[Array, "n 3"],
    normals: Float64[Array, "n 3"],
    half_mm: float,
    nearest_mm: float,
) -> Dots:
    across = np.where(np.abs(normals[:, :1]) < 0.9, np.array([1.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0]))
    first = np.cross(normals, across)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    second = np.cross(normals, first)

    return measure_dots(
        linear,
        _tangent_planes(camera, points, first, second),
        np.zeros((len(points), 2)),
        shape="disc",
        half_mm=half_mm,
        pitch_mm=(nearest_mm, nearest_mm),
    )


def _tangent_planes(
    camera: TargetCamera, points: Float64[Array, "n 3"], first: Float64[Array, "n 3"], second: Float64[Array, "n 3"]
) -> ToImage:
    """Map of offsets in each point's tangent plane, mm, to pixels.

    Row k of the argument belongs to point k.
    """

    def to_image(offset_mm: Float64[Array, "n *m 2"]) -> Float64[Array, "n *m 2"]:
        shape = (len(points), *(1,) * (offset_mm.ndim - 2), 3)
        at = (
            points.reshape(shape)
            + offset_mm[..., :1] * first.reshape(shape)
            + offset_mm[..., 1:] * second.reshape(shape)
        )
        return camera.image(at)

    return to_image


_LEAST_POINTS = 4
"""Three points have up to four poses in one picture. The fourth decides (Fischler and Bolles 1981)."""


@TARGETS.add("points")
@dataclass(frozen=True, slots=True, kw_only=True)
class PointsTarget(Target):
    """Surveyed points in the object's own frame, which is the world. Ids are positions in the list.

    Raises:
        ValueError: fewer than four points, or a coordinate that is not finite.
    """

    is_surveyed: ClassVar[bool] = True
    size_key: ClassVar[str] = "points_mm"

    points_mm: tuple[tuple[float, float, float], ...]
    """Surveyed coordinates, mm."""
    dot_diameter_mm: float | None = None
    """Diameter of the points' round dots, mm, if they have any."""
    scale_std: float | None = None
    """Relative standard uncertainty of all lengths, from the survey. None: not known."""

    def __post_init__(self) -> None:
        if len(self.points_mm) < _LEAST_POINTS:
            raise ValueError(f"points_mm needs at least {_LEAST_POINTS} points, found {len(self.points_mm)}")
        if not np.isfinite(np.asarray(self.points_mm)).all():
            raise ValueError("points_mm has a coordinate that is not a finite number")
        if self.dot_diameter_mm is not None:
            require_positive(dot_diameter_mm=self.dot_diameter_mm)
        require_measured(scale_std=self.scale_std)

    @property
    def points_target(self) -> Float64[Array, "n 3"]:
        """Surveyed points by id, mm."""
        return read_only(np.array(self.points_mm, dtype=np.float64))

    def find(
        self, photograph: Photograph, *, search_width_px: int, window_squares: float
    ) -> FoundPoints | Cause | None:
        """Find the dots by their constellation. See `find_points`."""
        return find_points(photograph, self, search_width_px=search_width_px)

    @property
    def body(self) -> DottedBox:
        """A box around the origin. The simulation makes no other object of points."""
        return DottedBox(target=self)


@dataclass(frozen=True, slots=True, kw_only=True)
class DottedBox(Body):
    """A white cube around the origin with round dots on its faces."""

    attitude: ClassVar[Literal["facing", "upright", "any"]] = "any"
    comes_measured: ClassVar[bool] = True

    target: PointsTarget

    @property
    def normals_target(self) -> Float64[Array, "n 3"]:
        """Normal of the face on which each point lies."""
        points = self.target.points_target
        normals = np.zeros_like(points)
        axis = np.abs(points).argmax(axis=1)
        rows = np.arange(len(points))
        normals[rows, axis] = np.sign(points[rows, axis])
        return normals

    @property
    def middle_mm(self) -> Float64[Array, 3]:
        """Middle of the points' extent, mm."""
        points = self.target.points_target
        return 0.5 * (points.min(axis=0) + points.max(axis=0))

    @property
    def hull_target(self) -> Float64[Array, "n 3"]:
        """The cube's corners, mm."""
        return self._half_mm * np.array([[x, y, z] for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)])

    def is_whole(
        self, seen: Bool[Array, " n"], in_picture: Callable[[Float64[Array, "m 3"]], Bool[Array, " m"]]
    ) -> bool:
        """True: any part of the list is enough."""
        return True

    def meet(self, origins: Float64[Array, "n 3"], directions: Float64[Array, "n 3"]) -> Hits:
        """Meet the cube's faces by the slab method (Kay and Kajiya 1986)."""
        from scipy.spatial import cKDTree

        dots, half = self.target.points_target, self._half_mm
        with np.errstate(divide="ignore", invalid="ignore"):
            enter = (-np.sign(directions) * half - origins) / directions
            leave = (np.sign(directions) * half - origins) / directions
        axis = np.argmax(enter, axis=1)
        rows = np.arange(len(origins))
        t = enter[rows, axis]
        points = origins + t[:, None] * directions
        normals = np.zeros_like(points)
        normals[rows, axis] = -np.sign(directions[rows, axis])
        white = np.where((t > 0) & (t <= leave.min(axis=1)), 1.0, np.nan)
        radius = 0.5 * (self.target.dot_diameter_mm or 0.0)
        hit = np.flatnonzero(np.isfinite(white))
        white[hit[cKDTree(dots).query(points[hit])[0] <= radius]] = 0.0
        return Hits(points=points, normals=normals, white=white)

    @property
    def _half_mm(self) -> float:
        """Half the cube's side, mm: the dots lie on its faces."""
        return float(np.abs(self.target.points_target).max())
