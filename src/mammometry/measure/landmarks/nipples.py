"""Propose where a nipple lies.

It is between the middle of the areola and the tip within it, or the tip near the most projecting point if no areola is
seen. Where neither is seen, nothing is proposed. Colour is ln R − ln G of linear light, which shading does not change:
an areola is redder and darker than the skin around it. A tip stands out from the ring of skin around it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mammometry.geometry import Array, Bool, Float64, TriangleMesh, UInt8
from mammometry.geometry.nearest import point_tree
from mammometry.measure.landmarks.landmarks import Landmark

_MARGIN_MM = 15.0
"""Nipples are not looked for nearer to the boundary than this, mm."""
_AREOLA_CONTRAST = 0.05
"""Least difference of ln(R/G), in linear light, between the areola and the skin around it. Pale areolae have .1."""
_LEAST_TIP_MM = 1.2
"""Least height of a nipple above the ring of skin 8 to 14 mm around it, beyond that of the skin up to 36 mm away,
mm. A round breast has up to .5, a mound on a telephone's scan up to .7, a nipple 1.6 to 5."""
_TIP_SIGMA_MM = 2.5
"""Standard uncertainty of a tip within an areola, mm. It was 2.6 and 3.2 mm off on a virtual torso at .15 of full
size."""
_AREOLA_SIGMA_MM = 4.0
"""Standard uncertainty of the middle of an areola without a tip, mm."""
_APEX_TIP_SIGMA_MM = 4.0
"""Standard uncertainty of a tip where no areola is seen, mm."""
_AREOLA_TIP_PROBABILITY = 0.98
"""Probability that a tip within an areola's colour is a nipple. This and the next two chosen by eye."""
_AREOLA_PROBABILITY = 0.9
"""Of an areola's colour without a tip."""
_TIP_PROBABILITY = 0.6
"""Probability that a tip without an areola's colour is a nipple: it may be a reconstructed nipple, a scan without
colours, or a scar."""

# All of these were chosen by eye.
_SAMPLE_MM = 2.5  # one vertex is taken in every cube of this side
_DISC_MM, _RING_MM = 10.0, (22.0, 36.0)  # radius of the areola's disc, and of the ring of skin that it is compared with
_TIP_MM, _FOOT_MM = 4.5, (8.0, 14.0)  # radius of the nipple's disc, and of the ring above which it stands
_WIDEST_MM, _CENTRING_ROUNDS = 32.0, 8  # radius of the widest areola, and times that its middle is found from itself
_NEAR_TIP_MM, _NEAR_APEX_MM = 14.0, 30.0  # how far a tip may lie from the areola's middle, and from the apex
_HEIGHT = 0.85  # a tip without an areola lies at least this high, as a share of the apex's height
_FEWEST = 60  # samples below which a piece of skin is too small to tell
_EVERY = 10  # of the samples that a wide ring is computed from, one in so many
_AREOLA_SCATTERS = 5.0
"""Standard deviations of the colour difference over the breast by which an areola differs, so that mottled skin is not
taken for one."""
_GAMMA, _BLACK = 2.2, 2e-3  # of sRGB, approximately; added to linear light, so that black has a logarithm


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Pairs:
    """Which samples lie around which, and how far away, mm."""

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
    """Pairs with every tenth sample only: a wide ring needs no more."""


def propose_nipple(
    name: str, skin: TriangleMesh, colours: UInt8[Array, "n 3"], boundary_world: Float64[Array, "b 3"]
) -> Landmark | None:
    """Find the nipple of one breast.

    Args:
        name: name of the landmark, e.g. ``nipple_left``.
        skin: the breast's skin within its boundary, open, mm, world frame.
        colours: colour of each vertex, sRGB. Without any contrast the shape alone decides.
        boundary_world: the breast's boundary, mm.

    Returns:
        The proposal near the skin, how it was found, how well, and how probably it is a nipple. None if neither areola
        nor tip is seen.
    """
    samples = _sampled(skin, colours, boundary_world)
    inner = samples.edge_mm > _MARGIN_MM
    if inner.sum() < _FEWEST:
        return None
    protrusion = _protrusion(samples)
    areola = _areola(samples, inner)
    if areola is not None:
        near = inner & (np.linalg.norm(samples.points - areola, axis=1) < _NEAR_TIP_MM)
        tip = _tip(samples, protrusion, near, _LEAST_TIP_MM)
        if tip is not None:
            how = "half way between the middle of the areola's colour and the tip within it"
            place, sigma = tip + _along_skin(samples, tip, (areola - tip) / 2), _TIP_SIGMA_MM
            probability = _AREOLA_TIP_PROBABILITY
        else:
            how, place, sigma = "middle of the areola's colour; no tip stands out", areola, _AREOLA_SIGMA_MM
            probability = _AREOLA_PROBABILITY
    else:
        centre = boundary_world.mean(axis=0)
        normal = np.linalg.svd(boundary_world - centre, full_matrices=False)[2][2]
        height = (samples.points - centre) @ normal
        height *= np.sign(height[np.argmax(np.abs(height))])
        apex = samples.points[np.argmax(np.where(inner, height, -np.inf))]
        near = inner & (height > _HEIGHT * height.max())
        near &= np.linalg.norm(samples.points - apex, axis=1) < _NEAR_APEX_MM
        tip = _tip(samples, protrusion, near, _LEAST_TIP_MM)
        if tip is None:
            return None
        how, place = "the tip near the most projecting point; no areola in the colours", tip
        sigma, probability = _APEX_TIP_SIGMA_MM, _TIP_PROBABILITY
    return Landmark(
        name=name,
        points_world=place[None],
        method=f"proposed: {how}; to be confirmed by eye",
        sigma_mm=sigma,
        probability=probability,
    )


def _along_skin(samples: _Samples, at: Float64[Array, 3], offset: Float64[Array, 3]) -> Float64[Array, 3]:
    """The part of an offset that runs along the skin: an areola's middle lies below the skin that curves around it."""
    near = np.linalg.norm(samples.points - at, axis=1) < _RING_MM[0]
    normal = samples.normals[near].mean(axis=0)
    normal /= max(float(np.linalg.norm(normal)), 1e-9)
    return np.asarray(offset - (offset @ normal) * normal)


def _sampled(skin: TriangleMesh, colours: UInt8[Array, "n 3"], boundary: Float64[Array, "b 3"]) -> _Samples:
    """One vertex in every cube of `_SAMPLE_MM`."""
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
        far=_pairs(points, np.arange(0, len(points), _EVERY), _RING_MM[1]),
    )


def _pairs(points: Float64[Array, "n 3"], chosen: Array, within_mm: float) -> _Pairs:
    found = point_tree(points).sparse_distance_matrix(point_tree(points[chosen]), within_mm, output_type="ndarray")
    return _Pairs(row=found["i"], column=chosen[found["j"]], distance_mm=found["v"])


def _mean(
    samples: _Samples, values: Float64[Array, "n k"], within_mm: float, beyond_mm: float = 0.0
) -> Float64[Array, "n k"]:
    """Mean over the samples at a distance from each sample. Its own value where there are none."""
    pairs = samples.near if within_mm <= _FOOT_MM[1] else samples.far
    kept = (pairs.distance_mm >= beyond_mm) & (pairs.distance_mm < within_mm)
    row, column = pairs.row[kept], pairs.column[kept]
    count = np.bincount(row, minlength=len(values))
    sums = np.stack(
        [np.bincount(row, column_values[column], minlength=len(values)) for column_values in values.T], axis=1
    )
    return np.where(count[:, None] > 0, sums / np.maximum(count, 1)[:, None], values)


def _areola(samples: _Samples, inner: Bool[Array, " n"]) -> Float64[Array, 3] | None:
    """Middle of a disc that is redder than the ring around it. None if none stands out from the scatter."""
    redness = samples.redness[:, None]
    contrast = (_mean(samples, redness, _DISC_MM) - _mean(samples, redness, _RING_MM[1], _RING_MM[0]))[:, 0]
    middle = float(np.median(contrast[inner]))
    scatter = 1.4826 * float(np.median(np.abs(contrast[inner] - middle)))
    best = int(np.argmax(np.where(inner, contrast, -np.inf)))
    if contrast[best] - middle < max(_AREOLA_CONTRAST, _AREOLA_SCATTERS * scatter):
        return None
    red = _mean(samples, redness, 1.5 * _SAMPLE_MM)[:, 0] - float(np.median(samples.redness[inner]))
    place = samples.points[best]
    disc = np.linalg.norm(samples.points - place, axis=1) < _DISC_MM
    coloured = red > np.median(red[disc]) / 2
    for _ in range(_CENTRING_ROUNDS):
        around = coloured & (np.linalg.norm(samples.points - place, axis=1) < _WIDEST_MM)
        if not around.any():
            break
        place = samples.points[around].mean(axis=0)
    return np.asarray(place)


def _protrusion(samples: _Samples) -> Float64[Array, " n"]:
    """Height of a small disc over the ring around it along the normal, less its surroundings', mm."""
    tip = _mean(samples, samples.points, _TIP_MM)
    foot = _mean(samples, samples.points, _FOOT_MM[1], _FOOT_MM[0])
    out = np.asarray(((tip - foot) * _mean(samples, samples.normals, _FOOT_MM[1])).sum(axis=1))
    return out - _mean(samples, out[:, None], _RING_MM[1], _FOOT_MM[1])[:, 0]


def _tip(
    samples: _Samples, protrusion: Float64[Array, " n"], near: Bool[Array, " n"], least_mm: float
) -> Float64[Array, 3] | None:
    if not near.any():
        return None
    best = int(np.argmax(np.where(near, protrusion, -np.inf)))
    if protrusion[best] < least_mm:
        return None
    around = near & (np.linalg.norm(samples.points - samples.points[best], axis=1) < _FOOT_MM[0])
    weight = np.where(around, np.clip(protrusion - protrusion[best] / 2, 0.0, None), 0.0)
    return np.asarray((samples.points * weight[:, None]).sum(axis=0) / weight.sum())
