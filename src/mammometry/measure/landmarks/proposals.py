"""Proposed landmarks: nipples, sternal notch and umbilicus, the midline, and the ends of a breast.

The skin's distance ahead of the coronal plane is averaged on a grid. A hollow (sternal notch, umbilicus) is a local
minimum below the ring around it both along and across the body. A groove, such as that over the breastbone, is below
its ring only across the body.

The nipple is half way between the areola's centre and the tip within it, or the tip near the most projecting point if
no areola is visible. Colour is ln R − ln G of linear light, which shading does not change: areolae are redder than the
skin around them. A tip protrudes from the ring of skin around it. Nothing is proposed where neither is visible.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from scipy import ndimage
from scipy.ndimage import uniform_filter1d

from mammometry.base.normal import MAD
from mammometry.geometry import Array, Bool, Float64, TriangleMesh, UInt8
from mammometry.geometry.nearest import closest_on_mesh, point_tree
from mammometry.measure.landmarks.landmarks import Landmark

_STEP_MM, _ASIDE_MM = 2.0, 60.0  # cell size and half width of the grid; not critical
_SMOOTH_CELLS = 2.0  # Gaussian σ, in cells: removes a telephone's noise and keeps hollows
_FACING = 0.05  # least cosine between a normal and straight ahead
_DISC_MM, _RING_MM = 5.0, (14.0, 22.0)  # radius of a hollow's disc, and radii of the ring around it; not critical
_WHOLE = 0.98  # share of disc and ring that must be visible
_LEAST_CELL = 1e-3  # smoothed number of vertices below which a cell counts as not visible
_NOTCH_MM, _NAVEL_MM = 1.8, 0.9
"""Least depth. Virtual bodies and scans have notches of 2.7 to 4.2 mm, navels of 0.9 to 2.1, other hollows ≤ 0.7."""
_NOTCH_ASIDE_MM, _NAVEL_ASIDE_MM = 12.0, 8.0  # largest distance from the midline; not critical
_BONE_MM = 6.0  # distance of the breastbone's upper edge below the hollow's centre, from virtual bodies
_NAVEL_BELOW_MM = 80.0  # least distance below the breasts: virtual navels 104 to 157, hollows under a fold up to 60
_NOTCH_SIGMA_MM, _NAVEL_SIGMA_MM = 4.0, 5.0  # measured: benchmarks/accuracy/scans; two scans of one navel
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
        found.append(_proposed(name, place[None], "hollow of the skin on the midline", sigma, _PROBABILITY))
    middle = height[:, height.shape[1] // 2]
    rows = np.arange(0, len(middle), int(_LINE_MM / _STEP_MM))
    notch = next((mark.points_world[0, 1] for mark in found if mark.name == "sternal_notch"), np.inf)
    rows = rows[np.isfinite(middle[rows]) & (up[rows, 0] <= notch)]
    if len(rows) > 1:
        line = np.stack([np.zeros(len(rows)), up[rows, 0], middle[rows]], axis=1)
        found.append(_proposed("midline", line, "where the mid-sagittal plane meets the skin", plane_sigma_mm))
    return tuple(
        replace(mark, points_world=closest_on_mesh(point_world + mark.points_world @ frame, mesh).points)
        for mark in found
    )


def _proposed(
    name: str, points: Float64[Array, "k 3"], how: str, sigma_mm: float, probability: float = 1.0
) -> Landmark:
    return Landmark(
        name=name,
        points_world=points,
        method=f"proposed: {how}; to be confirmed by eye",
        sigma_mm=sigma_mm,
        probability=probability,
        proposed=True,
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
        sigma_mm = float(np.linalg.norm([sigma, along, np.average(across, weights=likely)]))
        yield _proposed(f"{name}_{side}", place[None], "the boundary's end in this direction", sigma_mm)


_MARGIN_MM = 15.0  # least distance of a nipple from the boundary
_AREOLA_CONTRAST = 0.05  # least contrast of an areola, ln(R/G) in linear light; pale areolae have 0.1
_LEAST_TIP_MM = 1.2
"""Least protrusion of a nipple: height above the ring 8 to 14 mm around it, less that of the skin up to 36 mm away, mm.
A round breast has up to 0.5, a mound on a telephone's scan up to 0.7, a nipple 1.6 to 5."""
_TIP_SIGMA_MM = 2.5  # standard uncertainty of a tip within an areola; errors on a virtual torso: 2.6 and 3.2 mm
_ALONE_SIGMA_MM = 4.0  # standard uncertainty of an areola's centre without a tip, and of a tip without an areola
_AREOLA_TIP_PROBABILITY = 0.98  # of a nipple, by an areola with a tip; not critical, as are the next two
_AREOLA_PROBABILITY = 0.9  # by an areola without a tip
_TIP_PROBABILITY = 0.6  # by a tip alone, which may be a scar

# Not critical:
_SAMPLE_MM = 2.5  # one vertex is used per cube of this side
_AREOLA_MM, _AREOLA_RING_MM = 10.0, (22.0, 36.0)  # radius of the areola's disc, and radii of the ring around it
_TIP_MM, _FOOT_MM = 4.5, (8.0, 14.0)  # radius of the nipple's disc, and radii of the ring around it
_WIDEST_MM, _CENTRING_ROUNDS = 32.0, 8  # radius of the widest areola, and rounds of centring it
_NEAR_TIP_MM, _NEAR_APEX_MM = 14.0, 30.0  # largest distance of a tip from the areola's centre, and from the apex
_HEIGHT = 0.85  # least height of a tip without an areola, relative to the apex
_FEWEST = 60  # fewest samples of a usable piece of skin
_EVERY = 10  # a wide ring uses every tenth sample
_AREOLA_SCATTERS = 5.0  # least contrast of an areola, in standard deviations over the breast: skin may be mottled
_GAMMA, _BLACK = 2.2, 2e-3  # approximate gamma of sRGB, and light added so that black has a logarithm


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Pairs:
    """Samples around each sample, and their distances, mm."""

    row: Array
    column: Array
    distance_mm: Array


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Samples:
    points: Float64[Array, "n 3"]
    normals: Float64[Array, "n 3"]
    redness: Float64[Array, " n"]
    edge_mm: Float64[Array, " n"]
    """Distance from the boundary, mm."""
    near: _Pairs
    far: _Pairs
    """Pairs with every tenth sample."""


def propose_nipple(
    name: str, skin: TriangleMesh, colours: UInt8[Array, "n 3"], boundary_world: Float64[Array, "b 3"]
) -> Landmark | None:
    """Proposed nipple of one breast, near the skin. None if neither areola nor tip is visible.

    Args:
        name: name of the landmark, e.g. ``nipple_left``.
        skin: the breast's skin within its boundary, open, mm, world frame.
        colours: colour of each vertex, sRGB. Without any contrast only the shape is used.
        boundary_world: the breast's boundary, mm.
    """
    samples = _sampled(skin, colours, boundary_world)
    inner = samples.edge_mm > _MARGIN_MM
    if inner.sum() < _FEWEST:
        return None
    protrusion = _protrusion(samples)
    areola = _areola(samples, inner)
    if areola is not None:
        near = inner & (np.linalg.norm(samples.points - areola, axis=1) < _NEAR_TIP_MM)
        tip = _tip(samples, protrusion, near)
        if tip is not None:
            how = "half way between the middle of the areola's colour and the tip within it"
            place, sigma = tip + _along_skin(samples, tip, (areola - tip) / 2), _TIP_SIGMA_MM
            probability = _AREOLA_TIP_PROBABILITY
        else:
            how, place, sigma = "middle of the areola's colour; no tip stands out", areola, _ALONE_SIGMA_MM
            probability = _AREOLA_PROBABILITY
    else:
        centre = boundary_world.mean(axis=0)
        normal = np.linalg.svd(boundary_world - centre, full_matrices=False)[2][2]
        height = (samples.points - centre) @ normal
        height *= np.sign(height[np.argmax(np.abs(height))])
        apex = samples.points[np.argmax(np.where(inner, height, -np.inf))]
        near = inner & (height > _HEIGHT * height.max())
        near &= np.linalg.norm(samples.points - apex, axis=1) < _NEAR_APEX_MM
        tip = _tip(samples, protrusion, near)
        if tip is None:
            return None
        how, place = "the tip near the most projecting point; no areola in the colours", tip
        sigma, probability = _ALONE_SIGMA_MM, _TIP_PROBABILITY
    return _proposed(name, place[None], how, sigma, probability)


def _along_skin(samples: _Samples, at: Float64[Array, 3], offset: Float64[Array, 3]) -> Float64[Array, 3]:
    """Tangential part of an offset: the mean of a curved areola's points is below the skin."""
    near = np.linalg.norm(samples.points - at, axis=1) < _AREOLA_RING_MM[0]
    normal = samples.normals[near].mean(axis=0)
    normal /= max(float(np.linalg.norm(normal)), 1e-9)
    return np.asarray(offset - (offset @ normal) * normal)


def _sampled(skin: TriangleMesh, colours: UInt8[Array, "n 3"], boundary: Float64[Array, "b 3"]) -> _Samples:
    """One vertex per cube of side `_SAMPLE_MM`, with colour and distance from the boundary."""
    cells = np.floor(skin.vertices / _SAMPLE_MM).astype(np.int64)
    chosen = np.unique(cells, axis=0, return_index=True)[1]
    points = skin.vertices[chosen]
    linear = (colours[chosen].astype(np.float64) / 255) ** _GAMMA + _BLACK
    loop = np.concatenate([boundary, (boundary + np.roll(boundary, -1, axis=0)) / 2])
    return _Samples(
        points=points,
        normals=skin.vertex_normals()[chosen],
        redness=np.log(linear[:, 0]) - np.log(linear[:, 1]),
        edge_mm=np.asarray(point_tree(loop).query(points)[0]),
        near=_pairs(points, np.arange(len(points)), _FOOT_MM[1]),
        far=_pairs(points, np.arange(0, len(points), _EVERY), _AREOLA_RING_MM[1]),
    )


def _pairs(points: Float64[Array, "n 3"], chosen: Array, within_mm: float) -> _Pairs:
    found = point_tree(points).sparse_distance_matrix(point_tree(points[chosen]), within_mm, output_type="ndarray")
    return _Pairs(row=found["i"], column=chosen[found["j"]], distance_mm=found["v"])


def _mean(
    samples: _Samples, values: Float64[Array, "n k"], within_mm: float, beyond_mm: float = 0.0
) -> Float64[Array, "n k"]:
    """Mean over the samples in a ring around each sample. Its own value if there are none."""
    pairs = samples.near if within_mm <= _FOOT_MM[1] else samples.far
    kept = (pairs.distance_mm >= beyond_mm) & (pairs.distance_mm < within_mm)
    row, column = pairs.row[kept], pairs.column[kept]
    count = np.bincount(row, minlength=len(values))
    sums = np.stack(
        [np.bincount(row, column_values[column], minlength=len(values)) for column_values in values.T], axis=1
    )
    return np.where(count[:, None] > 0, sums / np.maximum(count, 1)[:, None], values)


def _areola(samples: _Samples, inner: Bool[Array, " n"]) -> Float64[Array, 3] | None:
    """Centre of a disc that is significantly redder than the ring around it, or None."""
    redness = samples.redness[:, None]
    contrast = (_mean(samples, redness, _AREOLA_MM) - _mean(samples, redness, _AREOLA_RING_MM[1], _AREOLA_RING_MM[0]))[
        :, 0
    ]
    middle = float(np.median(contrast[inner]))
    scatter = MAD * float(np.median(np.abs(contrast[inner] - middle)))
    best = int(np.argmax(np.where(inner, contrast, -np.inf)))
    if contrast[best] - middle < max(_AREOLA_CONTRAST, _AREOLA_SCATTERS * scatter):
        return None
    red = _mean(samples, redness, 1.5 * _SAMPLE_MM)[:, 0] - float(np.median(samples.redness[inner]))
    place = samples.points[best]
    disc = np.linalg.norm(samples.points - place, axis=1) < _AREOLA_MM
    coloured = red > np.median(red[disc]) / 2
    for _ in range(_CENTRING_ROUNDS):
        around = coloured & (np.linalg.norm(samples.points - place, axis=1) < _WIDEST_MM)
        if not around.any():
            break
        place = samples.points[around].mean(axis=0)
    return np.asarray(place)


def _protrusion(samples: _Samples) -> Float64[Array, " n"]:
    """Height of a small disc over its ring along the normal, less that of the wider surroundings, mm."""
    tip = _mean(samples, samples.points, _TIP_MM)
    foot = _mean(samples, samples.points, _FOOT_MM[1], _FOOT_MM[0])
    out = np.asarray(((tip - foot) * _mean(samples, samples.normals, _FOOT_MM[1])).sum(axis=1))
    return out - _mean(samples, out[:, None], _AREOLA_RING_MM[1], _FOOT_MM[1])[:, 0]


def _tip(samples: _Samples, protrusion: Float64[Array, " n"], near: Bool[Array, " n"]) -> Float64[Array, 3] | None:
    if not near.any():
        return None
    best = int(np.argmax(np.where(near, protrusion, -np.inf)))
    if protrusion[best] < _LEAST_TIP_MM:
        return None
    around = near & (np.linalg.norm(samples.points - samples.points[best], axis=1) < _FOOT_MM[0])
    weight = np.where(around, np.clip(protrusion - protrusion[best] / 2, 0.0, None), 0.0)
    return np.asarray((samples.points * weight[:, None]).sum(axis=0) / weight.sum())
