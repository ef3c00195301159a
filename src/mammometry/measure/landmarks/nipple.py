"""Proposed nipple of one breast, from colour and shape.

The colour used is ln R − ln G of linear light, which does not depend on shading. Areolae are redder than the skin
around them. A tip protrudes from the ring of skin around it. If neither is visible, nothing is proposed.

A disc with a soft edge is fitted to the areola's colours. Distances from its centre are measured in three dimensions,
because an areola on curved skin is round, but its projection is not. At each position near the centre, a bump is fitted
to the skin. Its improvement over smooth skin gives the likelihood of the position, and the distance from the areola's
centre the prior. The nipple is the mean position with these weights: a clear tip determines it, and the areola does if
a scan has flattened the tip. Without a visible areola, the nipple is the tip near the most projecting point.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from mammometry.base.normal import MAD
from mammometry.geometry import Array, Bool, Float64, Int64, TriangleMesh, UInt8
from mammometry.geometry.nearest import point_tree
from mammometry.measure.landmarks.landmarks import Landmark, proposed_landmark

_MARGIN_MM = 15.0  # least distance of a nipple from the boundary
_AREOLA_CONTRAST = 0.05  # least contrast of an areola, ln(R/G) in linear light; pale areolae have 0.1
_LEAST_TIP_MM = 1.2
"""Least protrusion of a nipple: height above the ring 8 to 14 mm around it, less that of the skin up to 36 mm away, mm.
A round breast has up to 0.5, a mound on a telephone's scan up to 0.7, a nipple 1.6 to 5."""
_TIP_SIGMA_MM = 2.5  # standard uncertainty of a tip within an areola; errors on a virtual torso were 2.6 and 3.2 mm
_ALONE_SIGMA_MM = 4.0  # standard uncertainty of an areola's centre without a tip, and of a tip without an areola
_AREOLA_TIP_PROBABILITY = 0.98  # probability of a nipple at an areola with a tip; like the next two, not critical
_AREOLA_PROBABILITY = 0.9  # probability of a nipple at an areola without a tip
_TIP_PROBABILITY = 0.6  # probability of a nipple at a tip without an areola, which may be a scar

# None of the following constants is critical.
_SAMPLE_MM = 2.5  # one vertex is used per cube of this side
_AREOLA_MM, _AREOLA_RING_MM = 10.0, (22.0, 36.0)  # radius of the areola's disc, and radii of the ring around it
_TIP_MM, _FOOT_MM = 4.5, (8.0, 14.0)  # radius of the nipple's disc, and radii of the ring around it
_WIDEST_MM, _CENTRING_ROUNDS = 32.0, 8  # largest radius of an areola, and iterations of its centre
_NEAR_TIP_MM, _NEAR_APEX_MM = 14.0, 30.0  # largest distance of a tip from the areola's centre, and from the apex
_HEIGHT = 0.85  # least height of a tip without an areola, relative to the apex
_FEWEST = 60  # fewest samples of a usable piece of skin
_EVERY = 10  # a wide ring uses every tenth sample
_AREOLA_SCATTERS = 5.0  # least contrast of an areola, in standard deviations of the breast's: skin may be mottled
_GAMMA, _BLACK = 2.2, 2e-3  # approximate gamma of sRGB, and light added so that black has a logarithm

_COLOUR_MM, _SHAPE_MM = 38.0, 20.0  # radii of the skin used to fit the areola's disc and the nipple's bump
_AREOLAE_MM = (10.0, 14.0, 18.0, 22.0, 26.0, 30.0)  # starting radii of the areola's disc
_SOFT = 0.08  # width of an areola's soft edge, relative to its radius
_FURTHEST_MM = 10.0  # largest distance of the fitted disc's centre from that of the red skin
_BUMP_MM = 4.0  # Gaussian σ of a nipple's bump: fits gave 3 on clean virtual skin, 4.5 on a telephone's scan
_NEAR_MIDDLE_MM, _GRID_MM = 10, 1  # largest distance of a nipple from the areola's centre, and step of the search
_OFF_CENTRE_MM = 2.5  # standard deviation of a nipple's position about its areola's centre, in each direction
_ALIKE_MM2 = 100.0  # area of skin over which a scan's errors are correlated; from virtual scans
_ROUGH_MM2 = 0.02  # least mean square residual of the skin after fitting smooth skin and bump


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Pairs:
    """Pairs of samples near each other, and their distances."""

    row: Int64[Array, " p"]
    column: Int64[Array, " p"]
    distance_mm: Float64[Array, " p"]


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
    """Proposed nipple of one breast, on its skin. None if neither areola nor tip is visible.

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
        middle = _disc_centre(_patch(skin, colours, areola, _COLOUR_MM))
        areola = areola if middle is None else middle
        if tip is not None:
            how = "where the areola's colour and the tip within it together put it"
            place, sigma = _likeliest(_patch(skin, colours, areola, _SHAPE_MM)), _TIP_SIGMA_MM
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
    return proposed_landmark(name, place[None], how, sigma, probability)


def _sampled(skin: TriangleMesh, colours: UInt8[Array, "n 3"], boundary: Float64[Array, "b 3"]) -> _Samples:
    """One vertex per cube of side `_SAMPLE_MM`, with colour and distance from the boundary."""
    cells = np.floor(skin.vertices / _SAMPLE_MM).astype(np.int64)
    chosen = np.unique(cells, axis=0, return_index=True)[1]
    points = skin.vertices[chosen]
    loop = np.concatenate([boundary, (boundary + np.roll(boundary, -1, axis=0)) / 2])
    return _Samples(
        points=points,
        normals=skin.vertex_normals()[chosen],
        redness=_redness(colours[chosen]),
        edge_mm=np.asarray(point_tree(loop).query(points)[0]),
        near=_pairs(points, np.arange(len(points)), _FOOT_MM[1]),
        far=_pairs(points, np.arange(0, len(points), _EVERY), _AREOLA_RING_MM[1]),
    )


def _redness(colours: UInt8[Array, "n 3"]) -> Float64[Array, " n"]:
    linear = (colours.astype(np.float64) / 255) ** _GAMMA + _BLACK
    return np.log(linear[:, 0]) - np.log(linear[:, 1])


def _pairs(points: Float64[Array, "n 3"], chosen: Array, within_mm: float) -> _Pairs:
    found = point_tree(points).sparse_distance_matrix(point_tree(points[chosen]), within_mm, output_type="ndarray")
    return _Pairs(row=found["i"], column=chosen[found["j"]], distance_mm=found["v"])


def _mean(
    samples: _Samples, values: Float64[Array, "n k"], within_mm: float, beyond_mm: float = 0.0
) -> Float64[Array, "n k"]:
    """Mean over the samples in a ring around each sample. The sample's own value if the ring is empty."""
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
    """Height of a small disc above its ring along the normal, minus that of the wider surroundings, mm."""
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


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Patch:
    """Skin around a point, in a frame whose third axis is its mean normal, mm."""

    centre: Float64[Array, 3]
    axes: Float64[Array, "3 3"]
    """Rows: two tangents and the normal."""
    radius_mm: float
    flat: Float64[Array, "n 2"]
    height: Float64[Array, " n"]
    weight: Float64[Array, " n"]
    """Square root of each vertex's area, mm."""
    redness: Float64[Array, " n"]

    def smooth(self, flat: Float64[Array, "k 2"]) -> Float64[Array, "k 10"]:
        """Terms of a cubic surface at each point."""
        x, y = flat.T / self.radius_mm
        return np.stack([x**i * y**j for i in range(4) for j in range(4 - i)], axis=1)

    def at(self, flat: Float64[Array, 2], height: float) -> Float64[Array, 3]:
        """Point of the patch in the world frame."""
        return np.asarray(self.centre + np.append(flat, height) @ self.axes)


def _patch(skin: TriangleMesh, colours: UInt8[Array, "n 3"], centre: Float64[Array, 3], radius_mm: float) -> _Patch:
    near = np.linalg.norm(skin.vertices - centre, axis=1) < radius_mm
    area = np.bincount(
        skin.faces.ravel(), np.repeat(np.linalg.norm(skin.face_vectors(), axis=1) / 6, 3), len(skin.vertices)
    )[near]
    normal = area @ skin.vertex_normals()[near]
    axes = np.linalg.svd(normal[None])[2][[1, 2, 0]]
    axes[2] *= np.sign(axes[2] @ normal) or 1.0
    places = (skin.vertices[near] - centre) @ axes.T
    return _Patch(
        centre=centre,
        axes=axes,
        radius_mm=radius_mm,
        flat=places[:, :2],
        height=places[:, 2],
        weight=np.sqrt(area),
        redness=_redness(colours[near]),
    )


def _disc_centre(patch: _Patch) -> Float64[Array, 3] | None:
    """Centre of the areola on the smoothed skin, world frame, mm. None if the fit diverged."""
    weight = patch.weight / max(float(np.sqrt(np.mean(patch.weight**2))), 1e-9)
    redness = patch.redness * weight
    base = np.linalg.lstsq(patch.smooth(patch.flat) * weight[:, None], patch.height * weight, rcond=None)[0]

    def height(flat: Float64[Array, 2]) -> float:
        return float((patch.smooth(flat[None]) @ base)[0])

    def off(disc: Float64[Array, 3]) -> Float64[Array, " n"]:
        flat, radius = disc[:2], float(np.clip(disc[2], _AREOLAE_MM[0] / 2, _AREOLA_RING_MM[1]))
        away = np.hypot(np.linalg.norm(patch.flat - flat, axis=1), patch.height - height(flat))
        inside = 1 / (1 + np.exp(np.clip((away - radius) / (_SOFT * radius), -30, 30)))
        columns = np.column_stack([np.ones(len(away)), patch.flat / patch.radius_mm, inside]) * weight[:, None]
        return np.asarray(columns @ np.linalg.lstsq(columns, redness, rcond=None)[0] - redness)

    start = min(
        (np.array([0.0, 0.0, radius]) for radius in _AREOLAE_MM), key=lambda disc: float((off(disc) ** 2).sum())
    )
    scatter = MAD * float(np.median(np.abs(off(start))))
    edge = max(2 * scatter, 1e-3)
    found = least_squares(off, start, loss="soft_l1", f_scale=edge, diff_step=[1e-2] * 3, x_scale=3.0).x[:2]
    return patch.at(found, height(found)) if np.hypot(*found) < _FURTHEST_MM else None


def _likeliest(patch: _Patch) -> Float64[Array, 3]:
    """Mean position of the nipple near the centre of a patch around the areola's, world frame, mm."""
    weight = patch.weight
    smooth = np.linalg.qr(patch.smooth(patch.flat) * weight[:, None])[0]
    height = patch.height * weight
    height -= smooth @ (smooth.T @ height)
    steps = np.arange(-_NEAR_MIDDLE_MM, _NEAR_MIDDLE_MM + _GRID_MM, _GRID_MM)
    tried = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2).astype(np.float64)
    tried = tried[np.hypot(*tried.T) <= _NEAR_MIDDLE_MM]
    gain = np.zeros(len(tried))
    for k, place in enumerate(tried):
        bump = weight * np.exp(-((patch.flat - place) ** 2).sum(axis=1) / (2 * _BUMP_MM**2))
        bump -= smooth @ (smooth.T @ bump)
        gain[k] = max(float(bump @ height), 0.0) ** 2 / max(float(bump @ bump), 1e-9)
    rough = max(float(height @ height - gain.max()) / float(weight @ weight), _ROUGH_MM2)
    log = gain / (2 * rough * _ALIKE_MM2) - (tried**2).sum(axis=1) / (2 * _OFF_CENTRE_MM**2)
    likely = np.exp(log - log.max())
    flat = np.asarray(likely @ tried / likely.sum())
    near = np.exp(-((patch.flat - flat) ** 2).sum(axis=1) / (2 * _GRID_MM**2)) * weight**2
    return patch.at(flat, float(near @ patch.height / max(float(near.sum()), 1e-9)))
