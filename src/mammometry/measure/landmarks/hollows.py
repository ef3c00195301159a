"""Propose landmarks: sternal notch and umbilicus, the midline, and the ends of a breast.

The skin's height over a plane across the body is averaged on a grid. A hollow lies below the ring around it along the
body as well as across it. A groove, such as that over the breastbone, does so across it alone. Where no hollow is
seen, nothing is proposed.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy import ndimage
from scipy.ndimage import uniform_filter1d

from mammometry.geometry import Array, Float64, TriangleMesh
from mammometry.geometry.nearest import closest_on_mesh
from mammometry.measure.landmarks.landmarks import Landmark

_STEP_MM, _ASIDE_MM = 2.0, 60.0  # cells of the grid, and its half width; chosen by eye
_SMOOTH_CELLS = 2.0  # standard deviation of the mean over cells; noise of telephones vanishes, hollows stay
_FACING = 0.05  # cosine by which skin faces ahead at least
_DISC_MM, _RING_MM = 5.0, (14.0, 22.0)  # radii of a hollow's middle and of the ring around it; chosen by eye
_WHOLE = 0.98  # share of disc and ring that must be seen
_LEAST_CELL = 1e-3  # of the smoothed number of vertices: below it a cell is not seen
# On virtual bodies and scans: notches 2.7 to 4.2 mm, navels of another generator .9 to 2.1, else .7 at most.
_NOTCH_MM, _NAVEL_MM = 1.8, 0.9
_NOTCH_ASIDE_MM, _NAVEL_ASIDE_MM = 12.0, 8.0  # from the midline at most; chosen by eye
_BONE_MM = 6.0  # by which the breastbone's edge lies below the hollow's middle, as on virtual bodies
_NAVEL_BELOW_MM = 50.0  # below the breasts at least, so that a fold is not taken for it; chosen by eye
_NOTCH_SIGMA_MM, _NAVEL_SIGMA_MM = 4.0, 5.0  # measured: benchmarks/accuracy/scans; two scans of one navel
_PROBABILITY = 0.8  # of a hollow to be what it is called; chosen by eye
_LINE_MM = 10.0  # between points of the midline


def propose_on_midline(
    mesh: TriangleMesh,
    frame: Float64[Array, "3 3"],
    point_world: Float64[Array, 3],
    plane_sigma_mm: float,
    lowest_mm: float,
    highest_mm: float,
) -> tuple[Landmark, ...]:
    """Propose midline, sternal notch and umbilicus, as far as they are seen.

    Args:
        mesh: the whole surface, mm, world frame.
        frame: rows: the patient's left, the head, straight ahead; left is across the mid-sagittal plane.
        point_world: a point of the mid-sagittal plane, mm.
        plane_sigma_mm: standard uncertainty of the plane's place, mm.
        lowest_mm: height of the boundaries' lowest point over `point_world`, along the frame's second row.
        highest_mm: height of their highest point.
    """
    ahead = mesh.vertex_normals() @ frame[2] > _FACING
    places = (mesh.vertices[ahead] - point_world) @ frame.T
    places = places[np.abs(places[:, 0]) < _ASIDE_MM]
    if not len(places):
        return ()
    bottom = float(places[:, 1].min())
    height = _height_map(places, bottom)
    hollow = _hollows(height)
    aside = (np.arange(height.shape[1]) * _STEP_MM - _ASIDE_MM)[None, :]
    up = (bottom + np.arange(height.shape[0]) * _STEP_MM)[:, None]
    found = []
    for name, least, near, sigma, within, shift in (
        ("sternal_notch", _NOTCH_MM, _NOTCH_ASIDE_MM, _NOTCH_SIGMA_MM, up > highest_mm, -_BONE_MM),
        ("umbilicus", _NAVEL_MM, _NAVEL_ASIDE_MM, _NAVEL_SIGMA_MM, up < lowest_mm - _NAVEL_BELOW_MM, 0.0),
    ):
        depth = np.where(within & (np.abs(aside) <= near), hollow, -np.inf)
        row, column = np.unravel_index(np.argmax(depth), depth.shape)
        if depth[row, column] < least:
            continue
        lowered = max(0, int(row) + round(shift / _STEP_MM))
        place = np.array([aside[0, column], up[lowered, 0], height[lowered, column]])
        found.append(_landmark(name, place[None], "hollow of the skin on the midline", sigma, _PROBABILITY))
    middle = height[:, height.shape[1] // 2]
    rows = np.arange(0, len(middle), int(_LINE_MM / _STEP_MM))
    notch = next((mark.points_world[0, 1] for mark in found if mark.name == "sternal_notch"), np.inf)
    rows = rows[np.isfinite(middle[rows]) & (up[rows, 0] <= notch)]
    if len(rows) > 1:
        line = np.stack([np.zeros(len(rows)), up[rows, 0], middle[rows]], axis=1)
        found.append(_landmark("midline", line, "where the mid-sagittal plane meets the skin", plane_sigma_mm, 1.0))
    return tuple(
        Landmark(
            name=mark.name,
            points_world=closest_on_mesh(point_world + mark.points_world @ frame, mesh).points,
            method=mark.method,
            sigma_mm=mark.sigma_mm,
            probability=mark.probability,
        )
        for mark in found
    )


def _landmark(name: str, points: Float64[Array, "k 3"], how: str, sigma_mm: float, probability: float) -> Landmark:
    method = f"proposed: {how}; to be confirmed by eye"
    return Landmark(name=name, points_world=points, method=method, sigma_mm=sigma_mm, probability=probability)


def _height_map(places: Float64[Array, "n 3"], bottom_mm: float) -> Float64[Array, "h w"]:
    """Mean distance ahead in each cell, smoothed. NaN where nothing is seen."""
    cell = np.round((places[:, :2] + [_ASIDE_MM, -bottom_mm]) / _STEP_MM).astype(np.int64)
    shape = (int(cell[:, 1].max()) + 1, int(2 * _ASIDE_MM / _STEP_MM) + 1)
    number = cell[:, 1] * shape[1] + cell[:, 0]
    cells = shape[0] * shape[1]
    total, count = (
        ndimage.gaussian_filter(np.bincount(number, of, cells).reshape(shape), _SMOOTH_CELLS, mode="constant")
        for of in (places[:, 2], np.ones(len(places)))
    )
    return np.where(count > _LEAST_CELL, total / np.maximum(count, _LEAST_CELL), np.nan)


def _hollows(height: Float64[Array, "h w"]) -> Float64[Array, "h w"]:
    """Depth of each place below the ring around it, along or across the body, whichever is less. −∞ where not seen."""
    reach = int(_RING_MM[1] / _STEP_MM) + 1
    at = np.arange(-reach, reach + 1) * _STEP_MM
    x, y = np.meshgrid(at, at)
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


_PARTS, _EVEN_MM = 4, 15.0  # of each edge of the curve; length over which its points' scatter is evened out
_ROUND_MM = 8.0  # where a border runs around the flank its end is known by no more: scans of virtual women, 7 to 14 mm
_FLAT_MM = 0.3  # of an end: as good as the end itself
_ALIKE = 0.15  # share of the boundary's uncertainty by which its places differ: 41 of 42 ends of scans lie within 2 σ


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class EndSigmas:
    """Standard uncertainty of the boundary across itself, mm."""

    lower_mm: float
    medial_mm: float
    lateral_mm: float
    across_mm: Float64[Array, " b"] | None = None
    """Of each point, beside that of its end: how little the skin shows of the border there. None: nothing beside."""


def propose_ends(
    side: str, boundary_world: Float64[Array, "b 3"], frame: Float64[Array, "3 3"], sigmas: EndSigmas
) -> Iterator[Landmark]:
    """Yield the three ends of one breast.

    An end's place along a flat piece of the boundary is hardly known: it is taken in the middle of that piece. Wherever
    the boundary comes nearly as far, for what is known of it there, the end may lie too: its uncertainty is that of all
    these places.

    Args:
        side: the patient's ``left`` or ``right``.
        boundary_world: closed curve, mm.
        frame: rows: the patient's left, the head, straight ahead.
        sigmas: of the boundary.
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
        yield Landmark(
            name=f"{name}_{side}",
            points_world=place[None],
            method="proposed: the boundary's end in this direction; to be confirmed by eye",
            sigma_mm=float(np.linalg.norm([sigma, along, np.average(across, weights=likely)])),
        )
