"""Foregrounds, disparity maps and range images reduced for pictures, and matched shares."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from mammometry.geometry import Array, Bool, Camera, Float32, Float64, Rig
from mammometry.matching.dense.match import DisparityMap
from mammometry.matching.foreground.foreground import Foreground
from mammometry.matching.quality import MatchQuality, assess
from mammometry.report.figures.canvas import thinned
from mammometry.surface.ranges.dents import ValidPatches
from mammometry.surface.ranges.range_image import RangeImage, thinned_camera

LARGEST_WIDTH_PX = 1200
"""Largest width of a photograph in pictures of the matching, pixels."""
_FOREGROUND_PX = 870  # width of a reduced foreground: three times its panel, for a smooth outline
_MAP_PX = 640  # longer side of a reduced map: more than its panel shows
_SHARE_PX = 320  # longer side of the grid on which shares are counted; appearance only
_FAR_MM = 1000.0  # any distance works: a camera at the same place projects the whole ray to one pixel


def thinned_foreground(known: Foreground) -> Foreground:
    """Reduce a foreground to the resolution of pictures."""
    step = max(1, known.coverage.shape[1] // (_FOREGROUND_PX))
    return replace(known, coverage=np.ascontiguousarray(known.coverage[::step, ::step]))


def thinned_map(disparity: DisparityMap) -> DisparityMap:
    """Reduce a disparity map for pictures. Its values become pixels of the rectified pair."""
    step = max(1, -(-max(disparity.valid.shape) // _MAP_PX))

    def thin(values: Array) -> Array:
        return np.ascontiguousarray(values[::step, ::step])

    return replace(
        disparity,
        left=thinned_camera(disparity.left, step),
        right=thinned_camera(disparity.right, step),
        d_h_px=disparity.pair_px * thin(disparity.d_h_px),
        d_v_px=disparity.pair_px * thin(disparity.d_v_px),
        confidence=thin(disparity.confidence),
        sigma_px=disparity.pair_px * thin(disparity.sigma_px),
        valid=thin(disparity.valid),
        weak=thin(disparity.weak),
    )


def thinned_maps(disparities: Mapping[str, DisparityMap]) -> tuple[dict[str, DisparityMap], dict[str, MatchQuality]]:
    """Reduce the maps of all pairs, and assess the complete ones. Each map is looked up only once."""
    maps, quality = {}, {}
    for pair, disparity in disparities.items():
        maps[pair], quality[pair] = thinned_map(disparity), assess(disparity)
    return maps, quality


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ThinnedRange:
    """A range image for pictures and tables, before and after the removal of dents."""

    name: str
    """Name of the pair."""
    size_wh: tuple[int, int]
    """Size of the complete image, pixels."""
    ranges_mm: Float32[Array, " n"]
    """Distances of all data, in row order."""
    sigma_median_mm: float | None
    """None if there are no data."""
    kept_count: int
    """Number of data that were kept."""
    range_mm: Float32[Array, "h w"]
    """Every k-th pixel, as for `valid`, `kept` and `angles_rad`. 0 if not valid."""
    valid: Bool[Array, "h w"]
    kept: Bool[Array, "h w"]
    angles_rad: Float32[Array, "h w"]
    """Angle between the local normal and the direction to the camera. NaN if unknown."""


def thinned_ranges(ranges: Mapping[str, RangeImage], valid: ValidPatches) -> tuple[ThinnedRange, ...]:
    """Reduce the range images of all pairs for pictures.

    Each is looked up once, because it is large.
    """
    return tuple(
        _thinned_range(ranges[kept.name], kept.valid, angles)
        for kept, angles in zip(valid.range_images, valid.angles_rad, strict=True)
    )


def _thinned_range(image: RangeImage, kept: Bool[Array, "h w"], angles_rad: Float32[Array, "h w"]) -> ThinnedRange:
    def thin(values: Array) -> Array:
        return thinned(values, _MAP_PX).copy()

    sigmas_mm = image.sigma_mm[image.valid]
    return ThinnedRange(
        name=image.name,
        size_wh=image.camera.size_wh,
        ranges_mm=image.range_mm[image.valid],
        sigma_median_mm=float(np.median(sigmas_mm)) if len(sigmas_mm) else None,
        kept_count=int(kept.sum()),
        range_mm=thin(image.range_mm),
        valid=thin(image.valid),
        kept=thin(kept),
        angles_rad=thin(angles_rad),
    )


def matched_shares(
    rig: Rig, foregrounds: Mapping[str, Foreground], disparities: Mapping[str, DisparityMap]
) -> dict[str, float]:
    """Pair → matched share of the subject in its left picture.

    Counted on a reduced grid. Pairs without silhouettes are left out.
    """
    shares = {}
    for pair, disparity in disparities.items():
        name = rig.pair_names[pair][0]
        known = foregrounds[name]
        if known.everything:
            continue
        columns, rows, source = source_grid(rig.cameras[name], disparity.left, _SHARE_PX)
        height, width = known.coverage.shape
        thinning = rig.cameras[name].size_wh[0] / width
        column, row = (np.rint(source[..., axis] / thinning).astype(np.int64) for axis in (0, 1))
        inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
        subject = np.zeros(inside.shape, dtype=bool)
        subject[inside] = known.mask[row[inside], column[inside]]
        matched = disparity.valid[rows.astype(np.int64), columns.astype(np.int64)]
        shares[pair] = float((matched & subject).sum() / max(int(subject.sum()), 1))
    return shares


def source_grid(
    camera: Camera, ideal: Camera, longest_px: int
) -> tuple[Float64[Array, "h w"], Float64[Array, "h w"], Float64[Array, "h w 2"]]:
    """Columns and rows of a preview's grid, and its positions in the photograph.

    The grid is in the ideal camera's picture.
    """
    width, height = ideal.size_wh
    step = max(1.0, max(width, height) / longest_px)
    columns, rows = np.meshgrid(np.arange(0, width, step), np.arange(0, height, step))
    rays: Float64[Array, "h w 3"] = ideal.rays_world(np.stack([columns, rows], axis=-1))
    return columns, rows, camera.project(camera.centre_world + _FAR_MM * rays)
