"""Errors of disparities, ranges and silhouettes against the true surface, per pixel.

A pixel of the photograph is projected through the *true* camera onto the true surface, and from there into the other
photograph. Only there do the calibrated cameras give the rectified pixel. So the matcher's error is separate from the
calibration's.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy import ndimage
from scipy.spatial import cKDTree
from skimage.measure import find_contours

from mammometry.base.normal import MAD
from mammometry.base.value import value
from mammometry.geometry import Array, Bool, Camera, Float64, StereoPair
from mammometry.matching.dense.match import DisparityMap
from mammometry.matching.foreground.foreground import Foreground
from mammometry.study.rays import RayScene, inside, pixel_grid
from mammometry.surface.ranges.range_image import RangeImage

EDGE_PX = 5.0
"""Least distance of an evaluated pixel from an occluding edge in either image, px."""
INCIDENCE_DEG = 70.0
"""Largest angle of incidence of an evaluated pixel in either camera, degrees."""
_NEAR_EDGE_PX, _RIM_PX = 20.0, 8.0  # distances from an occluding edge within which error and bias are given separately
_JUMP_MM = 3.0  # least difference in range between neighbouring pixels at an occluding edge
_JUDGED_WIDTH_PX = 1400  # image width above which only every n-th pixel is evaluated


@value(eq=False)
class TrueDisparity:
    """True values at the pixels of one rectified left image."""

    step: int
    """Spacing of the evaluated pixels, in rows and columns of the map."""
    focal_px: float
    """Focal length of the map in its pixels, which gives the subsampling of a range image."""
    d_h_px: Float64[Array, "h w"]
    """True horizontal disparity, pixels of the map; NaN without surface."""
    range_mm: Float64[Array, "h w"]
    """True distance from the left perspective centre, mm; NaN without surface."""
    judged: Bool[Array, "h w"]
    """Evaluated pixels: visible in both images, away from edges, at moderate incidence."""
    visible: Bool[Array, "h w"]
    """Pixels whose point is visible in both images, at any incidence and distance from an edge."""
    edge_px: Float64[Array, "h w"]
    """Distance to the nearest occluding edge in either photograph, pixels."""


@dataclass(frozen=True, slots=True, kw_only=True)
class MatchingAccuracy:
    """Errors of one pair's disparities over the evaluated pixels, in pixels of the rectified pair."""

    median_px: float
    """Median absolute error of the disparity, px."""
    p95_px: float
    """95th percentile of the same."""
    beyond_1_px_percent: float
    """Share of the matched pixels with an error above 1 px."""
    complete_percent: float
    """Share of the evaluated pixels that were matched."""
    depth_bias_mm: float
    """Median depth error caused by the disparity's error, mm; positive: too far."""
    near_edge_median_px: float
    """Median absolute error within 20 px of an occluding edge, px; NaN without such pixels."""
    rim_bias_mm: float
    """Median depth error within 8 px of an occluding edge, over all visible pixels, mm; NaN without such pixels."""
    all_accepted_beyond_1_px_percent: float
    """Share of *all* matched pixels on the surface, evaluated or not, with an error above 1 px."""
    error_over_sigma: float
    """Robust standard deviation of error / σ; ideally 1."""
    beyond_3_sigma_percent: float
    """Share of errors beyond 3 σ."""
    d_v_median_px: float
    """Median vertical disparity, px; 0 with correct cameras."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RangeAccuracy:
    """Errors of one pair's range image at evaluated pixels, mm, due to matching and cameras together."""

    bias_mm: float
    """Median of measured minus true range."""
    median_mm: float
    """Median absolute error."""
    p95_mm: float
    """95th percentile of the same."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SilhouetteAccuracy:
    """Distance between a found silhouette and the true one. The image's border is excluded."""

    mean_px: float
    """Mean signed distance, px, positive outside."""
    p95_px: float
    """95th percentile of the absolute distance, px."""


def true_disparity(
    scene: RayScene, true: StereoPair, calibrated: StereoPair, left: Camera, right: Camera, *, pair_px: float = 1.0
) -> TrueDisparity:
    """True disparity of a rectified pair's left pixels.

    Args:
        scene: the true surface.
        true: the cameras that took the photographs, in the scene's frame.
        calibrated: the cameras with which the photographs were rectified, in any frame.
        left: the rectified left camera, in the frame of `calibrated`.
        right: the rectified right camera.
        pair_px: pixels of the rectified pair per pixel of `left`.
    """
    step = max(1, round(left.size_wh[0] / _JUDGED_WIDTH_PX))
    uv = pixel_grid(left, step)
    rays, photograph_uv = _true_rays(uv, left, calibrated.left, true.left)
    hits = scene.cast(true.left.centre_world, rays)
    points = true.left.centre_world + hits.range_mm[..., None] * rays
    right_photograph_uv = true.right.project(points)
    calibrated_rays = calibrated.right.rays_world(right_photograph_uv)
    right_uv = right.project(right.centre_world + 1e3 * calibrated_rays)

    other = scene.seen_from(true.right.centre_world, points)
    least = np.cos(np.radians(INCIDENCE_DEG))
    visible = other.hit & inside(true.left, photograph_uv) & inside(true.right, right_photograph_uv)
    with np.errstate(invalid="ignore"):
        judged = visible & (hits.cosine > least) & (other.cosine > least)

    right_rays, _ = _true_rays(pixel_grid(right, step), right, calibrated.right, true.right)
    right_edge = _from_edge(scene.cast(true.right.centre_world, right_rays).range_mm)
    place = np.nan_to_num(right_uv, nan=-1.0)[..., ::-1] / step
    edge = ndimage.map_coordinates(right_edge, np.moveaxis(place, -1, 0), order=1)
    edge_px = pair_px * step * np.minimum(_from_edge(hits.range_mm), edge)
    return TrueDisparity(
        step=step,
        focal_px=float(left.matrix[0, 0]),
        d_h_px=uv[..., 0] - right_uv[..., 0],
        range_mm=hits.range_mm,
        judged=judged & (edge_px > EDGE_PX),
        visible=visible,
        edge_px=edge_px,
    )


def judge_disparity(truth: TrueDisparity, found: DisparityMap) -> MatchingAccuracy | None:
    """Errors of one pair's disparities. None if no evaluated pixel was matched.

    Args:
        truth: true values for the same rectified left camera.
        found: the matcher's result.
    """
    some = slice(None, None, truth.step)
    d_h, sigma, valid = (field[some, some] for field in (found.d_h_px, found.sigma_px, found.valid))
    error = found.pair_px * (d_h - truth.d_h_px)
    judged = truth.judged & valid
    if not judged.any():
        return None
    size = np.abs(error[judged])
    focal = found.left.matrix[0, 0]
    baseline = float(np.linalg.norm(found.left.centre_world - found.right.centre_world))
    parallax = found.left.matrix[0, 2] - found.right.matrix[0, 2]
    with np.errstate(divide="ignore", invalid="ignore"):
        depth_error = focal * baseline * (1 / (d_h - parallax) - 1 / (truth.d_h_px - parallax))
    near = judged & (truth.edge_px < _NEAR_EDGE_PX)
    rim = truth.visible & valid & (truth.edge_px < _RIM_PX)
    anywhere = valid & np.isfinite(truth.d_h_px)
    score = size / (found.pair_px * sigma[judged])
    return MatchingAccuracy(
        median_px=float(np.median(size)),
        p95_px=float(np.percentile(size, 95)),
        beyond_1_px_percent=float(100 * np.mean(size > 1)),
        complete_percent=float(100 * judged.sum() / truth.judged.sum()),
        depth_bias_mm=float(np.median(depth_error[judged])),
        near_edge_median_px=float(np.median(np.abs(error[near]))) if near.any() else float("nan"),
        rim_bias_mm=float(np.median(depth_error[rim])) if rim.any() else float("nan"),
        all_accepted_beyond_1_px_percent=float(100 * np.mean(np.abs(error[anywhere]) > 1)),
        error_over_sigma=float(MAD * np.median(score)),
        beyond_3_sigma_percent=float(100 * np.mean(score > 3)),
        d_v_median_px=found.pair_px * float(np.median(found.d_v_px[found.valid])),
    )


def judge_range(truth: TrueDisparity, found: RangeImage) -> RangeAccuracy | None:
    """Errors of one pair's range image. None if no evaluated pixel has a range.

    Distances from the perspective centre do not depend on the frame, so no alignment is needed.
    """
    thinned = round(truth.focal_px / float(found.camera.matrix[0, 0]))  # subsampling of the range image
    common = math.lcm(truth.step, thinned)
    in_truth, in_found = slice(None, None, common // truth.step), slice(None, None, common // thinned)
    judged = truth.judged[in_truth, in_truth] & found.valid[in_found, in_found]
    if not judged.any():
        return None
    error = found.range_mm[in_found, in_found][judged] - truth.range_mm[in_truth, in_truth][judged]
    return RangeAccuracy(
        bias_mm=float(np.median(error)),
        median_mm=float(np.median(np.abs(error))),
        p95_mm=float(np.percentile(np.abs(error), 95)),
    )


def judge_silhouette(scene: RayScene, true: Camera, foreground: Foreground) -> SilhouetteAccuracy | None:
    """Distance between a found silhouette and the true one, photograph pixels. None without a contour.

    The true contour is at half coverage, computed with 8 × 8 rays in each pixel near the edge.

    Args:
        scene: the true surface.
        true: the camera, in the scene's frame.
        foreground: silhouette found in its photograph.
    """
    coverage = scene.cast(true.centre_world, true.rays_world(pixel_grid(true))).hit.astype(np.float64)
    band = ndimage.binary_dilation(coverage > 0, iterations=2)
    band &= ~ndimage.binary_erosion(coverage > 0, iterations=2, border_value=1)
    rows, columns = np.nonzero(band)
    steps = (np.arange(8) + 0.5) / 8 - 0.5
    offsets = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
    uv = np.stack([columns, rows], axis=1)[:, None] + offsets
    coverage[rows, columns] = scene.cast(true.centre_world, true.rays_world(uv)).hit.mean(axis=1)
    true_contours = _contours(coverage, 0.5)
    contours = _contours(np.asarray(foreground.coverage), foreground.contour_level)
    if not (true_contours and contours):
        return None
    found = np.concatenate(contours)
    found = found[((found > 3) & (found < np.array(true.shape_hw) - 4)).all(axis=1)]
    if not len(found):
        return None
    distance = cKDTree(np.concatenate(true_contours)).query(found)[0]
    distance *= np.where(ndimage.map_coordinates(coverage, found.T, order=1) > 0.5, -1, 1)
    return SilhouetteAccuracy(mean_px=float(distance.mean()), p95_px=float(np.percentile(np.abs(distance), 95)))


def silhouette_overlap(scene: RayScene, true: Camera, foreground: Foreground) -> tuple[float, float]:
    """Areas of intersection and union of the found and the true silhouette, px²."""
    step = max(1, true.size_wh[0] // 300)
    seen = scene.cast(true.centre_world, true.rays_world(pixel_grid(true, step))).hit
    found = foreground.coverage[::step, ::step] >= foreground.contour_level
    return float((seen & found).sum() * step**2), float((seen | found).sum() * step**2)


def _true_rays(
    uv: Float64[Array, "h w 2"], rectified: Camera, calibrated: Camera, true: Camera
) -> tuple[Float64[Array, "h w 3"], Float64[Array, "h w 2"]]:
    """True rays of rectified pixels, and their pixels in the photograph."""
    photograph_uv = calibrated.project(calibrated.centre_world + 1e3 * rectified.rays_world(uv))
    return true.rays_world(photograph_uv), photograph_uv


def _contours(image: Array, level: float) -> list[Float64[Array, "n 2"]]:
    found: list[Float64[Array, "n 2"]] = find_contours(image, level)  # type: ignore[no-untyped-call]
    return found


def _from_edge(range_mm: Float64[Array, "h w"]) -> Float64[Array, "h w"]:
    """Distance of each pixel from the nearest jump in range, in pixels of this grid."""
    filled = np.where(np.isfinite(range_mm), range_mm, 1e4)
    jump = ndimage.maximum_filter(filled, 3) - ndimage.minimum_filter(filled, 3) > _JUMP_MM
    distance: Float64[Array, "h w"] = ndimage.distance_transform_edt(~jump)
    return distance
