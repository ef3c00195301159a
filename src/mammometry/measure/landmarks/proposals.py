"""Proposed landmarks on the midline, and the ends of a breast.

The skin's distance ahead of the coronal plane is averaged on a grid. A hollow (sternal notch, umbilicus) is a local
minimum below the ring around it both along and across the body. A groove, such as that over the breastbone, is below
its ring only across the body.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from scipy import ndimage
from scipy.ndimage import uniform_filter1d

from mammometry.geometry import Array, Bool, Float64, TriangleMesh
from mammometry.geometry.nearest import closest_on_mesh
from mammometry.measure.landmarks.landmarks import Landmark, proposed_landmark

_STEP_MM, _ASIDE_MM = 2.0, 60.0  # cell size and half width of the grid; not critical
_SMOOTH_CELLS = 2.0  # Gaussian σ, in cells: removes a telephone's noise and keeps hollows
_FACING = 0.05  # least cosine between a normal and straight ahead
_DISC_MM, _RING_MM = 5.0, (14.0, 22.0)  # radius of a hollow's disc, and radii of the ring around it; not critical
_WHOLE = 0.98  # share of disc and ring that must be visible
_LEAST_CELL = 1e-3  # smoothed number of vertices below which a cell counts as not visible
_NOTCH_MM, _NAVEL_MM = 1.8, 0.9
"""Least depths of a sternal notch and an umbilicus, mm. Virtual bodies and scans have notches of 2.7 to 4.2 mm, navels
of 0.9 to 2.1, other hollows ≤ 0.7."""
_NOTCH_ASIDE_MM, _NAVEL_ASIDE_MM = 12.0, 8.0  # largest distance from the midline; not critical
_BONE_MM = 6.0  # distance of the breastbone's upper edge below the hollow's centre, from virtual bodies
_NAVEL_BELOW_MM = 80.0  # least distance below the breasts: virtual navels 104 to 157, hollows under a fold up to 60
_NOTCH_SIGMA_MM, _NAVEL_SIGMA_MM = 4.0, 5.0  # measured in benchmarks/accuracy/scans; from two scans of one navel
_PROBABILITY = 0.8  # probability that a hollow is the landmark; not critical
_LINE_MM = 10.0  # spacing of the midline's points


def propose_on_midline(
    mesh: TriangleMesh,
    frame: Float64[Array, "3 3"],
    point_world: Float64[Array, 3],
    plane_sigma_mm: float,
    lowest_mm: float,
    highest_mm: float,
    *,
    claimed: Bool[Array, " n"] | None = None,
) -> tuple[Landmark, ...]:
    """Proposals for the midline, the sternal notch and the umbilicus, if they are visible.

    Args:
        mesh: the whole surface, mm, world frame.
        frame: rows: the patient's left, the head, straight ahead; left is across the mid-sagittal plane.
        point_world: a point of the mid-sagittal plane, mm.
        plane_sigma_mm: standard uncertainty of the plane's place, mm.
        lowest_mm: height of the boundaries' lowest point over `point_world`, along the frame's second row.
        highest_mm: height of their highest point.
        claimed: vertices on measured skin or next to it; proposals are made only there. None: all.
    """
    ahead = mesh.vertex_normals() @ frame[2] > _FACING
    if claimed is not None:
        ahead &= claimed
    places = (mesh.vertices[ahead] - point_world) @ frame.T
    places = places[np.abs(places[:, 0]) < _ASIDE_MM]
    if not len(places):
        return ()
    bottom = float(places[:, 1].min())
    height = _height_map(places, bottom)
    hollow = _hollows(height)
    is_minimum = hollow >= ndimage.maximum_filter(hollow, footprint=np.hypot(*_window(_RING_MM[0])) < _RING_MM[0])
    aside = (np.arange(height.shape[1]) * _STEP_MM - _ASIDE_MM)[None, :]
    up = (bottom + np.arange(height.shape[0]) * _STEP_MM)[:, None]
    found = []
    for name, least, near, sigma, within, shift in (
        ("sternal_notch", _NOTCH_MM, _NOTCH_ASIDE_MM, _NOTCH_SIGMA_MM, up > highest_mm, -_BONE_MM),
        ("umbilicus", _NAVEL_MM, _NAVEL_ASIDE_MM, _NAVEL_SIGMA_MM, up < lowest_mm - _NAVEL_BELOW_MM, 0.0),
    ):
        depth = np.where(within & is_minimum & (np.abs(aside) <= near), hollow, -np.inf)
        row, column = np.unravel_index(np.argmax(depth), depth.shape)
        if depth[row, column] < least:
            continue
        lowered = max(0, int(row) + round(shift / _STEP_MM))
        place = np.array([aside[0, column], up[lowered, 0], height[lowered, column]])
        found.append(proposed_landmark(name, place[None], "hollow of the skin on the midline", sigma, _PROBABILITY))
    middle = height[:, height.shape[1] // 2]
    rows = np.arange(0, len(middle), int(_LINE_MM / _STEP_MM))
    notch = next((mark.points_world[0, 1] for mark in found if mark.name == "sternal_notch"), np.inf)
    rows = rows[np.isfinite(middle[rows]) & (up[rows, 0] <= notch)]
    if len(rows) > 1:
        line = np.stack([np.zeros(len(rows)), up[rows, 0], middle[rows]], axis=1)
        found.append(proposed_landmark("midline", line, "where the mid-sagittal plane meets the skin", plane_sigma_mm))
    return tuple(
        replace(mark, points_world=closest_on_mesh(point_world + mark.points_world @ frame, mesh).points)
        for mark in found
    )


def _height_map(places: Float64[Array, "n 3"], bottom_mm: float) -> Float64[Array, "h w"]:
    """Smoothed mean distance ahead in each cell, mm. NaN where no skin is visible."""
    cell = np.round((places[:, :2] + [_ASIDE_MM, -bottom_mm]) / _STEP_MM).astype(np.int64)
    shape = (int(cell[:, 1].max()) + 1, int(2 * _ASIDE_MM / _STEP_MM) + 1)
    number = cell[:, 1] * shape[1] + cell[:, 0]
    cells = shape[0] * shape[1]
    total, count = (
        ndimage.gaussian_filter(np.bincount(number, of, cells).reshape(shape), _SMOOTH_CELLS, mode="constant")
        for of in (places[:, 2], np.ones(len(places)))
    )
    return np.where(count > _LEAST_CELL, total / np.maximum(count, _LEAST_CELL), np.nan)


def _window(radius_mm: float) -> Float64[Array, "2 k k"]:
    """Offsets of the cells around a cell, across and along the body, mm."""
    reach = int(radius_mm / _STEP_MM) + 1
    at = np.arange(-reach, reach + 1) * _STEP_MM
    return np.stack(np.meshgrid(at, at))


def _hollows(height: Float64[Array, "h w"]) -> Float64[Array, "h w"]:
    """Depth of each cell below its ring, mm: the smaller of along and across. −∞ where not visible."""
    x, y = _window(_RING_MM[1])
    radius = np.hypot(x, y)
    ring = (radius >= _RING_MM[0]) & (radius <= _RING_MM[1])
    seen = np.isfinite(height).astype(np.float64)
    filled = np.nan_to_num(height)

    def mean(window: Array) -> Float64[Array, "h w"]:
        weight = window.astype(np.float64)
        share = ndimage.convolve(seen, weight, mode="constant")
        total = ndimage.convolve(filled, weight, mode="constant")
        return np.where(share >= _WHOLE * weight.sum(), total / np.maximum(share, 1.0), -np.inf)

    middle = mean(radius <= _DISC_MM)
    around = np.minimum(mean(ring & (np.abs(x) < np.abs(y))), mean(ring & (np.abs(x) > np.abs(y))))
    seen_whole = np.isfinite(middle) & np.isfinite(around)
    return np.where(seen_whole, np.where(seen_whole, around, 0.0) - np.where(seen_whole, middle, 0.0), -np.inf)


_PARTS, _EVEN_MM = 4, 15.0  # samples per edge of the curve, and length over which they are smoothed
_ROUND_MM = 8.0  # uncertainty of the lateral end, where the border curves around the flank; virtual scans: 7 to 14 mm
_FLAT_MM = 0.3  # points this close to the extreme one count as the end
_ALIKE = 0.15  # share of the boundary's uncertainty that is independent between points: 41 of 42 ends are within 2 σ


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class EndSigmas:
    """Standard uncertainty of the boundary, across it, at its three ends, mm."""

    lower_mm: float
    medial_mm: float
    lateral_mm: float
    across_mm: Float64[Array, " b"] | None = None
    """Additional uncertainty of each point, from how weakly the skin shows the border there. None: none."""


def propose_ends(
    side: str, boundary_world: Float64[Array, "b 3"], frame: Float64[Array, "3 3"], sigmas: EndSigmas
) -> Iterator[Landmark]:
    """Yield the lowest, the medial and the lateral end of one breast.

    Along a flat piece of the boundary the end is poorly defined: the middle of the piece is taken. The uncertainty
    includes the distance to all points that may be the end, given the boundary's own uncertainty.

    Args:
        side: the patient's ``left`` or ``right``.
        boundary_world: closed curve, mm.
        frame: rows: the patient's left, the head, straight ahead.
        sigmas: standard uncertainties of the boundary.
    """
    outwards = frame[0] if side == "left" else -frame[0]
    share = np.linspace(0, 1, _PARTS, endpoint=False)[:, None]
    steps = np.roll(boundary_world, -1, axis=0) - boundary_world
    dense = (boundary_world[:, None] + share * steps[:, None]).reshape(-1, 3)
    step_mm = float(np.linalg.norm(steps, axis=1).mean()) / _PARTS
    across = np.zeros(len(boundary_world)) if sigmas.across_mm is None else sigmas.across_mm
    across = np.repeat(across, _PARTS)
    even = uniform_filter1d(dense, max(1, round(_EVEN_MM / step_mm)), axis=0, mode="wrap")
    for name, direction, sigma in (
        ("inframammary_fold", -frame[1], sigmas.lower_mm),
        ("medial", -outwards, sigmas.medial_mm),
        ("lateral", outwards, float(np.hypot(sigmas.lateral_mm, _ROUND_MM))),
    ):
        far = even @ direction
        piece = dense[far > far.max() - _FLAT_MM]
        middle = piece.mean(axis=0)
        place = piece[np.argmin(np.linalg.norm(piece - middle, axis=1))]
        likely = np.exp(-(((far.max() - far) / np.hypot(_FLAT_MM, _ALIKE * across)) ** 2) / 2)
        along = np.sqrt(np.average(((dense - place) ** 2).sum(axis=1), weights=likely))
        sigma_mm = float(np.linalg.norm([sigma, along, np.average(across, weights=likely)]))
        yield proposed_landmark(f"{name}_{side}", place[None], "the boundary's end in this direction", sigma_mm)
