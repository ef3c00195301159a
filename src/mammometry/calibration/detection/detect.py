"""Find the target in photographs and measure its points to 0.01 px, or explain why it was not found."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from itertools import combinations
from types import MappingProxyType

import cv2
import numpy as np

from mammometry.base.errors import CalibrationError, ImageError
from mammometry.base.photograph import MeasuredPoints, Photograph
from mammometry.base.progress import Progress, no_progress
from mammometry.base.value import value
from mammometry.calibration.detection.finders import explain_miss, find
from mammometry.calibration.detection.finders.cylinder import numbered_alike
from mammometry.calibration.features.pixels import Cause, FoundPoints, grey_bytes, inverse_of, reduced
from mammometry.calibration.targets.target import Target
from mammometry.geometry.arrays import Array, Float64, Int64, UInt8


def points_from_table(
    name: str,
    ids: Int64[Array, " n"],
    uv: Float64[Array, "n 2"],
    target: Target,
    size_wh: tuple[int, int],
    *,
    std_px: float | Sequence[float] = 0.2,
) -> FoundPoints:
    """Check a table of measured points and sort it.

    Args:
        name: its name in messages, e.g. ``calibration/00/front_left.csv``.
        ids: index of each point in the target's list, from 0.
        uv: distorted pixels, integers at pixel centres.
        target: the target.
        size_wh: the photograph's size, pixels.
        std_px: standard deviation of a coordinate, pixels, one for all or one for each point.

    Raises:
        CalibrationError: no points, an unknown or duplicate id, a point outside the photograph, or a standard deviation
            that is not positive.
    """
    count = len(target.points_target)
    deviation = np.broadcast_to(np.asarray(std_px, np.float64), (len(ids),))
    if not len(ids):
        raise _error(name, "no points", f"ids from 0 to {count - 1} with u and v", "Add points, or remove the table")
    for number in ids.tolist():
        if not 0 <= number < count:
            expected = f"0 to {count - 1}, indices in the target's list"
            raise _error(name, f"id {number}", expected, "Correct the id; the first point is 0")
    numbers, repeats = np.unique(ids, return_counts=True)
    if (repeats > 1).any():
        raise _error(name, f"id {numbers[repeats > 1][0]} twice", "each point once", "Remove one of the two")
    inside = ((uv >= -0.5) & (uv <= np.array(size_wh) - 0.5)).all(axis=1)
    if not inside.all():
        first = int(np.flatnonzero(~inside)[0])
        found = f"point {ids[first]} at u {uv[first, 0]:g}, v {uv[first, 1]:g}"
        expected = f"pixels inside the photograph of {size_wh[0]} × {size_wh[1]}"
        raise _error(name, found, expected, "Give u (column) and v (row) in pixels, 0 at the first pixel's centre")
    if not (np.isfinite(deviation) & (deviation > 0)).all():
        raise _error(name, "a standard deviation that is not positive", "pixels above 0", "Omit it if unknown")
    order = np.argsort(ids)
    covariance = deviation[order, None, None] ** 2 * np.eye(2)
    return FoundPoints(ids=ids[order], uv=uv[order], covariance_px2=covariance)


def _error(name: str, found: str, expected: str, remedy: str) -> CalibrationError:
    return CalibrationError(name, found=found, expected=expected, remedy=remedy)


_WHITE, _MAX_WHITE_SHARE = 252, 0.35
"""Grey level of 255 that counts as overexposed, and its share in an overexposed image."""
_DARK = 40
"""Brightest grey level of an image that is nearly black."""
_MIN_STEP = 0.16
"""Smallest step between neighbouring pixels of the reduced image at a sharp edge, as a share of the image's contrast.
Blurred edges have smaller steps."""
_MIN_CONTRAST = 50
"""Grey levels between dark and bright above which an image without edges is called blurred."""

NOT_IN_VIEW = Cause(found="no target", remedy="")
"""Nothing suggests that the photograph shows the target."""


def diagnose(photograph: Photograph, target: Target) -> Cause:
    """Explain why a photograph has no detection."""
    small, _ = reduced(grey_bytes(photograph), SEARCH_WIDTH_PX)
    return explain_miss(target, small) or _about_exposure(small) or NOT_IN_VIEW


def _about_exposure(small: UInt8[Array, "h w"]) -> Cause | None:
    low, high = (float(level) for level in np.percentile(small, (1, 99.5)))
    white = float((small >= _WHITE).mean())
    if white > _MAX_WHITE_SHARE:
        return Cause(found=f"an overexposed image: {100 * white:.0f} % of it is white", remedy="Expose it less")
    if high < _DARK:
        return Cause(found="an image that is nearly black", remedy="Expose it more, or check its flash")
    steps = np.abs(np.diff(small.astype(np.float32), axis=1))
    if high - low > _MIN_CONTRAST and float(np.percentile(steps, 99.9)) < _MIN_STEP * (high - low):
        return Cause(
            found="an image without sharp edges: blurred by motion or focus, or without the target",
            remedy="Focus on the board and keep it still during the exposure",
            code="blurred",
        )
    return None


SEARCH_WIDTH_PX = 1100
"""Width of the reduced image in which the target is searched. The points are then measured in the original image."""
_FLOOR_PX = 0.01
"""Standard deviation added to every point's own, px, for errors of the print and the pixel grid."""
_THREADS = 2
"""Photographs processed in parallel. Each needs about 200 MB at 13 megapixels."""


@value(eq=False)
class Detection:
    """The points of the target that one camera saw in one pose."""

    camera: str
    pose: str
    ids: Int64[Array, " n"]
    """Indices into ``target.points_target``, ascending without duplicates."""
    uv: Float64[Array, "n 2"]
    """Distorted pixels of the original photograph, integers at pixel centres."""
    covariance_px2: Float64[Array, "n 2 2"]
    """Covariance of each point's `uv`, px²."""
    inverse: bool = False
    """Whether it was found in the inverted photograph: the target is printed white on black."""

    def __post_init__(self) -> None:
        if not (len(self.ids) == len(self.uv) == len(self.covariance_px2)):
            raise ValueError(f"{self.pose}/{self.camera}: different numbers of ids, uv and covariances")
        if np.any(np.diff(self.ids) <= 0):
            raise ValueError(f"{self.pose}/{self.camera}: ids must be ascending without duplicates")
        if not (np.isfinite(self.uv).all() and np.isfinite(self.covariance_px2).all()):
            raise ValueError(f"{self.pose}/{self.camera}: a point or covariance is not finite")


@dataclass(frozen=True, slots=True, kw_only=True)
class MissedView:
    """A photograph that is not used, and the reason."""

    camera: str
    pose: str
    found: str
    """What it shows instead."""
    remedy: str
    """What to do. Empty if nothing is wrong: not every camera sees the target in every pose."""
    code: str = "no-target"
    """Kind of the reason, for programs."""

    def __str__(self) -> str:
        """One sentence."""
        return f"pose {self.pose}, {self.camera}: {self.found}" + (f". {self.remedy}" if self.remedy else "")


@value(eq=False)
class Observations:
    """All detections of one target: the input of the bundle adjustment."""

    target: Target
    sizes_wh: Mapping[str, tuple[int, int]]
    """Camera → image width and height, pixels. Read-only. Cameras that saw nothing are included."""
    detections: tuple[Detection, ...]
    """In order of pose, then camera. Photographs without the target are not included."""
    missed: tuple[MissedView, ...] = ()
    """Photographs that are not used, with reasons."""

    def __post_init__(self) -> None:
        count = len(self.target.points_target)
        for detection in self.detections:
            if detection.camera not in self.sizes_wh:
                raise ValueError(f"no image size for camera {detection.camera!r}")
            if len(detection.ids) and not 0 <= detection.ids.min() <= detection.ids.max() < count:
                raise ValueError(f"{detection.pose}/{detection.camera}: an id is outside 0…{count - 1}")

    @property
    def cameras(self) -> tuple[str, ...]:
        """Cameras that saw the target, in the order of `sizes_wh`."""
        seen = {detection.camera for detection in self.detections}
        return tuple(name for name in self.sizes_wh if name in seen)

    @property
    def poses(self) -> tuple[str, ...]:
        """Poses in which a camera saw the target, in name order."""
        return tuple(sorted({detection.pose for detection in self.detections}))


def detect_in(
    photograph: Photograph, target: Target, *, camera: str, pose: str, search_width_px: int = SEARCH_WIDTH_PX
) -> Detection | None:
    """Find the target in one photograph.

    None if it is not found or has fewer than the target's `least_points`. The columns of a dotted cylinder are numbered
    from the first one seen; `detect` makes the numbers of all photographs consistent.

    Raises:
        SessionError: the target's description is invalid (unknown marker dictionary).
    """
    seen = _look(photograph, target, search_width_px)
    if isinstance(seen, Cause | None) or len(seen.ids) < target.least_points:
        return None
    return detection_of(seen, camera=camera, pose=pose)


def detect(
    photographs: Mapping[tuple[str, str], Photograph],
    target: Target,
    *,
    measured: Mapping[tuple[str, str], MeasuredPoints] = MappingProxyType({}),
    threads: int = _THREADS,
    progress: Progress = no_progress,
) -> Observations:
    """Find the target in all photographs, keyed by pose and camera.

    Photographs may be loaded on look-up. Those without the target have no detection but an explanation in
    `Observations.missed`. Photographs with `measured` points are not searched.

    Raises:
        CalibrationError: a table of measured points is wrong, or photographs contradict each other in their numbering.
        ImageError: photographs of one camera differ in size.
        SessionError: the target's description is invalid.
    """
    keys = sorted(photographs)

    def look(key: tuple[str, str]) -> tuple[tuple[int, int], str, FoundPoints | Cause]:
        photograph = photographs[key]
        table = measured.get(key)
        if table is None:
            return photograph.size_wh, photograph.name, _look_or_explain(photograph, target)
        points = points_from_table(table.name, table.ids, table.uv, target, photograph.size_wh)
        return photograph.size_wh, photograph.name, points

    sizes_wh: dict[str, tuple[int, int]] = {}
    found: dict[str, FoundPoints] = {}
    missed: list[MissedView] = []
    with ThreadPoolExecutor(threads) as pool:
        for done, (key, (size_wh, name, seen)) in enumerate(zip(keys, pool.map(look, keys), strict=True)):
            _require_size(name, key[1], size_wh, sizes_wh.setdefault(key[1], size_wh))
            if isinstance(seen, Cause):
                missed.append(
                    MissedView(pose=key[0], camera=key[1], found=seen.found, remedy=seen.remedy, code=seen.code)
                )
            else:
                found["/".join(key)] = seen
            progress((done + 1) / len(keys))
    numbered = numbered_alike(found)
    detections = tuple(
        detection_of(numbered[name], camera=camera, pose=pose)
        for pose, camera in keys
        if (name := f"{pose}/{camera}") in numbered
    )
    return Observations(target=target, sizes_wh=sizes_wh, detections=detections, missed=tuple(missed))


def merged(parts: Sequence[Observations]) -> Observations:
    """Combine the observations of one target from several sets of photographs.

    Raises:
        ImageError: photographs of one camera differ in size.
    """
    sizes_wh: dict[str, tuple[int, int]] = {}
    for part in parts:
        for camera, size_wh in part.sizes_wh.items():
            name = f"photographs of pose {', '.join(part.poses)} of {camera}"
            _require_size(name, camera, size_wh, sizes_wh.setdefault(camera, size_wh))
    detections = sorted((seen for part in parts for seen in part.detections), key=lambda seen: (seen.pose, seen.camera))
    missed = tuple(view for part in parts for view in part.missed)
    return Observations(target=parts[0].target, sizes_wh=sizes_wh, detections=tuple(detections), missed=missed)


def _look(photograph: Photograph, target: Target, search_width_px: int) -> FoundPoints | Cause | None:
    # OpenCV's grid searches use random numbers. Without a new seed, results would depend on the photographs that the
    # same thread searched before.
    cv2.setRNGSeed(0)
    seen = find(target, photograph, search_width_px)
    if not target.has_inverse or (isinstance(seen, FoundPoints) and len(seen.ids)):
        return seen
    inverse = find(target, inverse_of(photograph), search_width_px)
    if isinstance(inverse, FoundPoints) and len(inverse.ids) >= target.least_points:
        return replace(inverse, inverse=True)
    return seen


def _look_or_explain(photograph: Photograph, target: Target) -> FoundPoints | Cause:
    """Find the target, or explain why it cannot be used."""
    seen = _look(photograph, target, SEARCH_WIDTH_PX)
    if isinstance(seen, Cause):
        return seen
    if seen is None or not len(seen.uv):
        return diagnose(photograph, target)
    if len(seen.uv) < target.least_points:
        return Cause(
            found=f"{len(seen.uv)} of {len(target.points_target)} points of the target, fewer than "
            f"{target.least_points}",
            remedy="Show more of it, larger or less tilted",
        )
    return seen


def detection_of(found: FoundPoints, *, camera: str, pose: str) -> Detection:
    """Points found in one photograph, with the errors of print and pixel grid."""
    floor_px2 = _FLOOR_PX**2 * np.eye(2)
    return Detection(
        camera=camera,
        pose=pose,
        ids=found.ids,
        uv=found.uv,
        covariance_px2=found.covariance_px2 + floor_px2,
        inverse=found.inverse,
    )


def _require_size(name: str, camera: str, size_wh: tuple[int, int], expected_wh: tuple[int, int]) -> None:
    if size_wh != expected_wh:
        raise ImageError(
            name,
            found=f"{size_wh[0]} × {size_wh[1]} pixels",
            expected=f"{expected_wh[0]} × {expected_wh[1]}, as in the other poses of {camera}",
            remedy="Export all photographs of a camera at the same size, without cropping or rotating",
        )


_SAME_PX = 0.1
"""Median distance of the same points, px, below which two photographs are the same. Views of different cameras are
never so close. Two views of one camera are if nothing moved, but then those of all other cameras are, too."""
_COPIED_PX = 1e-3
"""Median distance above which photographs of a target at rest are two exposures, px: noise alone moves corners by
more."""
_COMMON = 0.9
"""Smallest share of points that two copies of an image have in common."""


def set_duplicates_aside(observations: Observations) -> Observations:
    """Exclude photographs that exist more than once, with an explanation.

    One image may have been stored under the names of two cameras, or in two poses of a camera while the other cameras
    saw the target move. Neither copy is used. If a whole pose was copied, it counts once.
    """
    twins: dict[tuple[str, str], list[Detection]] = defaultdict(list)
    for a, b in combinations(observations.detections, 2):
        distance_px = median_distance_px(a, b)
        if distance_px < _SAME_PX:
            stood_still = a.camera == b.camera and _stood_still(observations, a, b)
            if not stood_still:
                twins[a.pose, a.camera].append(b)
            if not stood_still or distance_px < _COPIED_PX:
                twins[b.pose, b.camera].append(a)
    if not twins:
        return observations
    missed = [
        MissedView(
            camera=camera,
            pose=pose,
            found=f"the same image as {', '.join(f'{other.pose}/{other.camera}' for other in others)}",
            remedy="Copy the right photograph again, or remove the pose",
            code="duplicate",
        )
        for (pose, camera), others in twins.items()
    ]
    kept = tuple(seen for seen in observations.detections if (seen.pose, seen.camera) not in twins)
    return replace(observations, detections=kept, missed=(*observations.missed, *missed))


def _stood_still(observations: Observations, a: Detection, b: Detection) -> bool:
    """Whether every other camera saw the target at the same place in both poses."""
    others = {seen.camera: seen for seen in observations.detections if seen.pose == a.pose and seen.camera != a.camera}
    pairs = [
        (others[seen.camera], seen) for seen in observations.detections if seen.pose == b.pose and seen.camera in others
    ]
    return all(median_distance_px(first, second) < _SAME_PX for first, second in pairs)


def median_distance_px(a: Detection, b: Detection) -> float:
    """Median distance of the points in both, px. Infinite if few points are in both."""
    _, i, j = np.intersect1d(a.ids, b.ids, assume_unique=True, return_indices=True)
    if len(i) < _COMMON * max(len(a.ids), len(b.ids)) or not len(i):
        return float("inf")
    return float(np.median(np.linalg.norm(a.uv[i] - b.uv[j], axis=1)))
