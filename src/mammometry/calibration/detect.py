"""Find the calibration target in photographs, and measure its points to hundredths of a pixel.

This module holds the values and dispatches on the kind of target; each way of finding one has its own module.
"""

from __future__ import annotations

from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from mammometry.calibration.detect_charuco import detect_charuco
from mammometry.calibration.detect_chessboard import detect_chessboard
from mammometry.calibration.found import FoundPoints
from mammometry.calibration.target import CharucoTarget, ChessboardTarget, Target
from mammometry.errors import CalibrationError, ImageError
from mammometry.geometry.arrays import Array, Float64, Int64, read_only
from mammometry.photograph import Photograph
from mammometry.progress import Progress, no_progress


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Detection:
    """The points of the target that one camera saw in one pose."""

    camera: str
    pose: str
    ids: Int64[Array, " n"]
    """Which points: rows of ``target.points_target``; each at most once, ascending."""
    uv: Float64[Array, "n 2"]
    """Where: distorted pixels of the original photograph, integers at pixel centres."""
    covariance_px2: Float64[Array, "n 2 2"]
    """How surely: covariance of each point's `uv`, px²."""

    def __post_init__(self) -> None:
        if not (len(self.ids) == len(self.uv) == len(self.covariance_px2)):
            raise ValueError(f"{self.pose}/{self.camera}: ids, uv and covariances differ in number")
        if np.any(np.diff(self.ids) <= 0):
            raise ValueError(f"{self.pose}/{self.camera}: ids must ascend without repetition")
        if not (np.isfinite(self.uv).all() and np.isfinite(self.covariance_px2).all()):
            raise ValueError(f"{self.pose}/{self.camera}: a point or covariance is not finite")
        for name in ("ids", "uv", "covariance_px2"):
            object.__setattr__(self, name, read_only(getattr(self, name)))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Observations:
    """All that was seen of one target: what the bundle adjustment works from."""

    target: Target
    sizes_wh: Mapping[str, tuple[int, int]]
    """Camera → image width and height, pixels; read-only. Cameras that saw nothing are here too."""
    detections: tuple[Detection, ...]
    """In order of pose, then camera; photographs without the target are left out."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "sizes_wh", MappingProxyType(dict(self.sizes_wh)))
        count = len(self.target.points_target)
        for detection in self.detections:
            if detection.camera not in self.sizes_wh:
                raise ValueError(f"no image size is known for camera {detection.camera!r}")
            if len(detection.ids) and not 0 <= detection.ids.min() <= detection.ids.max() < count:
                raise ValueError(f"{detection.pose}/{detection.camera}: an id is outside 0…{count - 1}")

    @property
    def cameras(self) -> tuple[str, ...]:
        """Cameras that saw the target at least once, in the order of `sizes_wh`."""
        seen = {detection.camera for detection in self.detections}
        return tuple(name for name in self.sizes_wh if name in seen)

    @property
    def poses(self) -> tuple[str, ...]:
        """Poses in which at least one camera saw the target, in name order."""
        return tuple(sorted({detection.pose for detection in self.detections}))


@dataclass(frozen=True, slots=True, kw_only=True)
class DetectSettings:
    """How the target is found and its points are measured."""

    search_width_px: int = 1100
    """The target is searched in a picture reduced to about this width: only its scale matters for finding it, and
    the final measurement is made in the original pixels."""
    window_squares: float = 0.48
    """Half-width of the window around a corner whose pixels are fitted, in sides of a square: nearly all of the four
    squares that meet there, without the neighbouring corners' blurred edges."""
    floor_px: float = 0.01
    """Standard deviation added to every point's own, px: what no fit of one point can know (print, pixel grid)."""
    min_points: int = 8
    """Points that a view must show to count; fewer say little and are more often wrong."""
    threads: int = 2
    """Photographs worked on at the same time; each needs about 200 MB at 13 megapixels."""


def detect_in(
    photograph: Photograph, target: Target, settings: DetectSettings = DetectSettings(), *, camera: str, pose: str
) -> Detection | None:
    """Find the target in one photograph; None where it is not, or shows fewer than ``settings.min_points`` points.

    Raises:
        SessionError: the target's description cannot be used (unknown marker dictionary).
    """
    found = _find(photograph, target, settings)
    return None if found is None else _detection(found, settings, camera, pose)


def detect(
    photographs: Mapping[tuple[str, str], Photograph],
    target: Target,
    settings: DetectSettings = DetectSettings(),
    *,
    progress: Progress = no_progress,
) -> Observations:
    """Find the target in all photographs, keyed by pose and camera; the mapping may load them when they are asked for.

    Raises:
        CalibrationError: the target is in none of them.
        ImageError: photographs of one camera differ in size.
        SessionError: the target's description cannot be used.
    """
    keys = sorted(photographs)

    def look(key: tuple[str, str]) -> tuple[tuple[int, int], str, Detection | None]:
        photograph = photographs[key]
        detection = detect_in(photograph, target, settings, camera=key[1], pose=key[0])
        return photograph.size_wh, photograph.name, detection

    sizes_wh: dict[str, tuple[int, int]] = {}
    detections: list[Detection] = []
    with ThreadPoolExecutor(settings.threads) as pool:
        for done, ((_, camera), (size_wh, name, detection)) in enumerate(zip(keys, pool.map(look, keys), strict=True)):
            expected_wh = sizes_wh.setdefault(camera, size_wh)
            if size_wh != expected_wh:
                raise ImageError(
                    name,
                    found=f"{size_wh[0]} × {size_wh[1]} pixels",
                    expected=f"{expected_wh[0]} × {expected_wh[1]}, as in the other poses of {camera}",
                    remedy="Export all photographs of a camera at the same size, without cropping or rotating",
                )
            if detection is not None:
                detections.append(detection)
            progress((done + 1) / len(keys))
    if not detections:
        raise CalibrationError(
            "calibration photographs",
            found=f"no {target.kind} target in any of the {len(keys)} photographs",
            expected="the target of the manifest, upright and not mirrored, in most of them",
            remedy="Compare [target] in session.toml with the board that was photographed",
        )
    return Observations(target=target, sizes_wh=sizes_wh, detections=tuple(detections))


def _find(photograph: Photograph, target: Target, settings: DetectSettings) -> FoundPoints | None:
    search_width_px, window_squares = settings.search_width_px, settings.window_squares
    match target:
        case CharucoTarget():
            return detect_charuco(photograph, target, search_width_px=search_width_px, window_squares=window_squares)
        case ChessboardTarget():
            return detect_chessboard(photograph, target, search_width_px=search_width_px, window_squares=window_squares)
    raise NotImplementedError(target.kind)


def _detection(found: FoundPoints, settings: DetectSettings, camera: str, pose: str) -> Detection | None:
    if len(found.ids) < settings.min_points:
        return None
    floor_px2 = settings.floor_px**2 * np.eye(2)
    return Detection(
        camera=camera, pose=pose, ids=found.ids, uv=found.uv, covariance_px2=found.covariance_px2 + floor_px2
    )
