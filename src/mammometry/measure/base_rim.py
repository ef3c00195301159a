"""Where a cast's silhouette is the rim of its base: candidates from the photographs and the range images.

On a point of a silhouette the surface either turns away smoothly (an occluding limb) or ends at the rim. There the
measured surface reaches up to the silhouette and meets the viewing ray at an angle: extrapolated over the last
pixels, where matching windows no longer reach, it gives the rim's depth.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree
from skimage.measure import find_contours

from mammometry.geometry.arrays import Array, Float64, Int64, read_only
from mammometry.geometry.camera import Camera, Rig
from mammometry.matching.foreground import Foreground
from mammometry.measure.settings import BaseRimSettings
from mammometry.surface.range_image import RangeImage

_NEIGHBOURS = 120
_FEWEST = 50
_TANGENT_STEP = 4


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RimCandidates:
    """Points that may lie on the rim."""

    points_world: Float64[Array, "n 3"]
    """mm, world frame."""
    cameras: tuple[str, ...]
    """Camera whose silhouette each point lies on, one per point."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "points_world", read_only(self.points_world))


def rim_candidates(
    range_images: Sequence[RangeImage],
    foregrounds: Mapping[str, Foreground],
    rig: Rig,
    settings: BaseRimSettings = BaseRimSettings(),
) -> RimCandidates:
    """Points on every camera's silhouette at the depth where the measured surface, extrapolated, meets it."""
    points, cameras = [], []
    for image in range_images:
        measured = image.points_world()[image.valid]
        for name in rig.pair_names[image.name]:
            foreground = foregrounds.get(name)
            if foreground is None or foreground.everything or len(measured) < _NEIGHBOURS:
                continue
            contour = silhouette(foreground)
            found = _extrapolate(rig.cameras[name], contour, measured, settings)
            points.append(found)
            cameras += [name] * len(found)
    return RimCandidates(points_world=np.concatenate(points) if points else np.empty((0, 3)), cameras=tuple(cameras))


def silhouette(foreground: Foreground) -> Float64[Array, "n 2"]:
    """The longest contour of the coverage at its level, as `uv` corners about a pixel apart; empty without one."""
    contours: list[Float64[Array, "n 2"]] = find_contours(  # type: ignore[no-untyped-call]
        foreground.coverage.astype(np.float64), foreground.contour_level
    )
    if not contours:
        return np.empty((0, 2))
    longest = max(contours, key=len)
    if (longest[0] == longest[-1]).all():
        longest = longest[:-1]
    return np.ascontiguousarray(longest[:, ::-1])


def _extrapolate(
    camera: Camera, contour: Float64[Array, "n 2"], measured: Float64[Array, "m 3"], settings: BaseRimSettings
) -> Float64[Array, "k 3"]:
    """World points on the contour's rays at the depth of the nearby surface, continued by a local quadratic."""
    if len(contour) < 4 * _TANGENT_STEP:
        return np.empty((0, 3))
    uv = camera.project(measured)
    seen = np.isfinite(uv).all(axis=1)
    uv, measured = uv[seen], measured[seen]
    distances = np.linalg.norm(measured - camera.centre_world, axis=1)
    tangent = np.roll(contour, -_TANGENT_STEP, axis=0) - np.roll(contour, _TANGENT_STEP, axis=0)
    tangent /= np.maximum(np.linalg.norm(tangent, axis=1, keepdims=True), 1e-9)
    gap: Float64[Array, "n k"]
    near: Int64[Array, "n k"]
    gap, near = cKDTree(uv).query(  # type: ignore[assignment]
        contour, k=_NEIGHBOURS, distance_upper_bound=settings.plane_band_px
    )
    inside_frame = ((contour > 1) & (contour < np.array(camera.size_wh) - 2)).all(axis=1)
    usable = inside_frame & (gap[:, 0] < settings.edge_band_px) & np.isfinite(gap[:, _FEWEST - 1])
    contour, tangent, gap, near = contour[usable], tangent[usable], gap[usable], near[usable]
    if not len(contour):
        return np.empty((0, 3))
    exists = np.isfinite(gap)
    near = np.where(exists, near, 0)
    offset = uv[near] - contour[:, None]
    along = (offset * tangent[:, None]).sum(axis=2)
    inward = offset[..., 1] * tangent[:, None, 0] - offset[..., 0] * tangent[:, None, 1]
    inward *= np.sign(np.sum(np.where(exists, inward, 0.0), axis=1))[:, None]
    weights = np.where(exists, np.exp(-2 * (np.where(exists, gap, 0.0) / settings.plane_band_px) ** 2), 0.0)
    start = distances[near[:, :1]]
    design = np.stack([np.ones_like(inward), inward, along, inward**2 / 2, inward * along], axis=2)
    normal = np.einsum("nki,nk,nkj->nij", design, weights, design) + 1e-9 * np.eye(design.shape[2])
    right = np.einsum("nki,nk->ni", design, weights * (distances[near] - start))
    solution = np.linalg.solve(normal, right[..., None])[..., 0]
    range_mm = start[:, 0] + solution[:, 0]
    # Slope of the surface against the ray, mm per mm across it: beyond 72° it is a limb, or too uncertain to continue.
    slope = np.abs(solution[:, 1]) * camera.matrix[0, 0] / range_mm
    keep = slope < settings.steepest
    return camera.centre_world + camera.rays_world(contour[keep]) * range_mm[keep, None]
