"""The rim of a cast's base in silhouettes, and the base adjusted to it.

Candidates come from the silhouettes and the measured surface. At a point of a silhouette the surface either turns away
smoothly (an occluding limb: the viewing ray touches it) or ends at the rim (the ray intersects its continuation). The
surface measured next to the silhouette is continued as a quadratic patch in its own tangent plane, so that it can
become steep towards the rim, and intersected with the ray. A limb so sharp that it begins beyond the measured skin
looks like a rim, so only points too sharp for a limb of any breast are accepted.

The viewing ray of each silhouette point on the rim intersects the base in a point of the rim. With the right base the
points of different cameras are on one closed curve, with a wrong base they are not. Base and curve are adjusted
together, by least squares in pixels: a bundle adjustment of one curve on one surface. Only silhouettes are used, so
errors of the matched surface near its edge do not matter.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields

import numpy as np
from scipy.sparse import csr_array, hstack

from mammometry.base.errors import MeasureError
from mammometry.base.normal import MAD
from mammometry.base.value import value
from mammometry.geometry import Array, Bool, Camera, Float64, Int64, Rig
from mammometry.geometry.nearest import point_tree
from mammometry.matching.foreground.contour import Contour, outline
from mammometry.matching.foreground.foreground import Foreground
from mammometry.measure.boundary.cast_base import SECTORS, Base, moved
from mammometry.surface.repair.repair import Provenance, RepairedSurface

SHARPEST_LIMB_MM = 8.0
"""Radius of the sharpest limb of a breast, mm. Measured skin with the cosine c of incidence at a distance g from the
silhouette can be a limb with a radius of at most 2 g/c². Where that is less than this value, the point shows the rim.
For a ptotic cast photographed by one pair, at a tenth of full size, 92 % of the rim's points have less, and 92 % of the
limb's have more."""
_EDGE_BAND_PX = 8.0
"""Largest gap between a rim's silhouette and the measured surface, pixels of the photograph: the matcher's windows end
that far inside the edge."""
_PATCH_RADIUS_MM = 7.0  # radius of the surface patch that is continued to the silhouette; not critical
_CONTINUE_MM = 4.0  # longest continuation; not critical
_LEAST_FACING = 0.1  # least cosine of incidence on the continued surface; a limb has 0, a rim 0.3 to 0.9
_PER_MM2 = 1.6  # vertices per mm² that are used; chosen for speed
_NEIGHBOURS = 160  # most vertices of a patch; 1.6 per mm² are 246 within 7 mm
_FEWEST = 40  # fewest vertices of a patch, whose quadratic has 6 coefficients


@value(eq=False)
class RimCandidates:
    """Silhouette points that may be on the rim, and their rays, world frame."""

    points_world: Float64[Array, "n 3"]
    """Intersection of each ray with the continued surface, mm."""
    centres_world: Float64[Array, "n 3"]
    """Perspective centre of the camera that saw each point, mm."""
    rays: Float64[Array, "n 3"]
    """Unit viewing rays."""
    outward: Float64[Array, "n 3"]
    """Unit normals, away from the cast, of the planes through each ray that are tangent to the silhouette."""
    mm_per_px: Float64[Array, " n"]
    """Size of a pixel of the photograph at each point, mm."""
    camera: Int64[Array, " n"]
    """Index, in the rig's order, of the camera that saw each point."""

    def chosen(self, which: slice | Bool[Array, " n"]) -> RimCandidates:
        """Part of the candidates."""
        return RimCandidates(**{field.name: getattr(self, field.name)[which] for field in fields(self)})


def require_separate(foregrounds: Mapping[str, Foreground]) -> None:
    """Refuse a cast that most silhouettes do not separate from its surroundings.

    A silhouette that reaches the photograph's edge contains a wall or a table, or the cast is cut off. With too few
    other silhouettes, that wall becomes part of the surface.

    Raises:
        MeasureError: more than half of the silhouettes are unknown, or reach the photograph's edge.
    """
    joined = [name for name, foreground in foregrounds.items() if foreground.everything or _at_edge(foreground.mask)]
    if 2 * len(joined) > len(foregrounds):
        raise MeasureError(
            "silhouettes of the model",
            found=f"its surroundings or the photograph's edge within {len(joined)} of {len(foregrounds)} of them "
            f"({', '.join(joined)})",
            expected="the whole cast, apart from everything else, in at least half",
            remedy="Photograph it in front of an even background that is darker or paler than it, or add masks",
        )


def _at_edge(mask: Bool[Array, "h w"]) -> bool:
    return bool(mask[[0, -1]].any() or mask[:, [0, -1]].any())


def rim_candidates(surface: RepairedSurface, foregrounds: Mapping[str, Foreground], rig: Rig) -> RimCandidates:
    """Points of all silhouettes at which the ray intersects the continued surface instead of touching it."""
    seen = np.flatnonzero(surface.provenance == Provenance.MEASURED)
    if len(seen) < _FEWEST:
        seen = np.arange(len(surface.mesh.vertices))
    density = len(surface.mesh.vertices) / max(surface.mesh.area_mm2(), 1e-9)
    seen = seen[:: max(1, int(density / _PER_MM2))]
    vertices, normals = surface.mesh.vertices[seen], surface.mesh.vertex_normals()[seen]
    pierced: list[tuple[Float64[Array, ...], ...]] = []
    for number, (name, camera) in enumerate(rig.cameras.items()):
        foreground = foregrounds.get(name)
        if foreground is None or foreground.everything:
            continue
        columns = _pierced(camera, outline(foreground), vertices, normals)
        pierced.append((*columns, np.full(len(columns[0]), number)))
    if not pierced:
        empty = np.empty((0, 3))
        pierced = [(empty, empty, empty, empty, np.empty(0), np.empty(0))]
    points, centres, rays, outward, mm_per_px, number_of = (
        np.concatenate(column) for column in zip(*pierced, strict=True)
    )
    return RimCandidates(
        points_world=points,
        centres_world=centres,
        rays=rays,
        outward=outward,
        mm_per_px=mm_per_px,
        camera=number_of.astype(np.int64),
    )


def _pierced(
    camera: Camera, contour: Contour, vertices: Float64[Array, "m 3"], normals: Float64[Array, "m 3"]
) -> tuple[Float64[Array, ...], ...]:
    """Points, centres, rays, outward normals and pixel sizes of one camera's candidates."""
    towards = vertices - camera.centre_world
    towards /= np.linalg.norm(towards, axis=1, keepdims=True)
    facing = (towards * normals).sum(axis=1) < -_LEAST_FACING
    uv = camera.project(vertices[facing])
    facing_vertices = vertices[facing][np.isfinite(uv).all(axis=1)]
    uv = uv[np.isfinite(uv).all(axis=1)]
    nothing = np.empty((0, 3))
    if len(uv) < _FEWEST or not len(contour.uv):
        return nothing, nothing, nothing, nothing, np.empty(0)
    gap_px, nearest = (np.asarray(answer) for answer in point_tree(uv).query(contour.uv))
    close = gap_px < _EDGE_BAND_PX
    contour, anchor = contour.chosen(close), facing_vertices[nearest[close]]
    tree = point_tree(vertices)
    away, near = (
        np.asarray(answer) for answer in tree.query(anchor, k=_NEIGHBOURS, distance_upper_bound=_PATCH_RADIUS_MM)
    )
    enough = np.isfinite(away[:, _FEWEST - 1])
    contour, anchor, away, near = contour.chosen(enough), anchor[enough], away[enough], near[enough]
    rays = camera.rays_world(contour.uv)
    if not len(rays):
        return nothing, nothing, nothing, nothing, np.empty(0)
    exists = np.isfinite(away)
    near = np.where(exists, near, 0)
    weights = np.where(exists, np.exp(-2 * (np.where(exists, away, 0.0) / _PATCH_RADIUS_MM) ** 2), 0.0)
    range_mm, facing_by = _meet(camera.centre_world, rays, anchor, vertices[near], normals[near], weights)
    points = camera.centre_world + rays * np.where(np.isfinite(range_mm), range_mm, 0.0)[:, None]
    keep = np.isfinite(range_mm) & (facing_by > _LEAST_FACING)
    # A limb of radius r has the cosine c at the distance r c²/2 from its edge.
    aside = np.linalg.norm(np.cross(anchor - camera.centre_world, rays), axis=1)
    keep &= 2 * aside < SHARPEST_LIMB_MM * facing_by**2
    keep &= np.asarray(tree.query(points)[0]) < _CONTINUE_MM
    beside = camera.rays_world(contour.uv + contour.tangent)
    outward = np.cross(rays, beside)
    outward /= np.linalg.norm(outward, axis=1, keepdims=True)
    inside = camera.rays_world(contour.uv + contour.inward)
    outward *= -np.sign((outward * inside).sum(axis=1))[:, None]
    mm_per_px = range_mm / float(np.sqrt(camera.matrix[0, 0] * camera.matrix[1, 1]))
    centres = np.broadcast_to(camera.centre_world, rays.shape)
    return points[keep], centres[keep], rays[keep], outward[keep], mm_per_px[keep]


def _meet(
    centre: Float64[Array, 3],
    rays: Float64[Array, "n 3"],
    anchor: Float64[Array, "n 3"],
    points: Float64[Array, "n k 3"],
    normals: Float64[Array, "n k 3"],
    weights: Float64[Array, "n k"],
) -> tuple[Float64[Array, " n"], Float64[Array, " n"]]:
    """Range at which each ray enters the quadratic patch through its points, and the cosine of incidence.

    NaN if the ray misses the patch: there the silhouette is a limb.
    """
    normal = (normals * weights[..., None]).sum(axis=1)
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-9)
    axis = np.eye(3)[np.argmin(np.abs(normal), axis=1)]
    first = np.cross(axis, normal)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    frame = np.stack([first, np.cross(normal, first), normal], axis=1)
    x, y, z = np.moveaxis(np.einsum("nij,nkj->nki", frame, points - anchor[:, None]), 2, 0)
    design = np.stack([np.ones_like(x), x, y, x * x / 2, x * y, y * y / 2], axis=2)
    matrix = np.einsum("nki,nk,nkj->nij", design, weights, design) + 1e-9 * np.eye(6)
    c = np.linalg.solve(matrix, np.einsum("nki,nk->ni", design, weights * z)[..., None])[..., 0].T
    start = np.einsum("nij,nj->ni", frame, centre - anchor)
    direction = np.einsum("nij,nj->ni", frame, rays)
    reach = -(start * direction).sum(axis=1)  # the ray's point nearest to the anchor
    (px, py, pz), (dx, dy, dz) = (start + reach[:, None] * direction).T, direction.T
    # Height of the ray's points above the patch, as a quadratic in the step s from there: a + b s + q s².
    a = pz - (c[0] + c[1] * px + c[2] * py + c[3] * px * px / 2 + c[4] * px * py + c[5] * py * py / 2)
    b = dz - (c[1] * dx + c[2] * dy + c[3] * px * dx + c[4] * (px * dy + py * dx) + c[5] * py * dy)
    q = -(c[3] * dx * dx / 2 + c[4] * dx * dy + c[5] * dy * dy / 2)
    discriminant = b * b - 4 * q * a
    enters = (discriminant > 0) & (b < 0)
    step = -2 * a / np.where(enters, b - np.sqrt(np.maximum(discriminant, 0)), np.nan)
    px, py = px + step * dx, py + step * dy
    slope_x, slope_y = c[1] + c[3] * px + c[4] * py, c[2] + c[4] * px + c[5] * py
    cosine = (slope_x * dx + slope_y * dy - dz) / np.sqrt(1 + slope_x**2 + slope_y**2)
    return reach + step, cosine


SILHOUETTE_SIGMA_PX = 0.05
"""Standard uncertainty of the edge common to a camera's whole outline, px; also the least scatter that is assumed.
Measured: 0.00 to 0.04 in eight cameras, for three casts that are lit to the edge (docs/decisions/0009)."""
_LOCAL_SIGMA_PX = 0.1
"""Standard uncertainty of the edge in one eighth of a camera's outline, px. Measured: 0.02 to 0.12, because the light
varies around a rim."""
_RIM_KNOTS = 40  # knots of the rim's closed spline, one every 9°; not critical
_ROUNDS = 30  # most Gauss–Newton iterations
_REWEIGHT = 4  # updates of the weights per iteration; not critical
_TUKEY = 4.685  # Tukey's constant, standard deviations: 95 % efficiency for normal errors
_NARROWING = 0.8  # factor per iteration of the coarse scatter; not critical
_CORRELATED = 4.0  # neighbouring silhouette points that count as one, because they share pixels
_PRIOR_MM = 0.5  # standard uncertainty of the candidates' own heights; extrapolated ranges had errors of 0.3
_STEP = 1e-2  # step of numerical derivatives, mm
_CONVERGED_MM = 2e-3  # a smaller step ends the iteration: 0.02 cc of a cast
_STRETCHES = 8  # parts of an outline with errors of their own (`_LOCAL_SIGMA_PX`)


@value(eq=False)
class AdjustedBase:
    """A base adjusted to the rim in all cameras."""

    base: Base
    weights: Float64[Array, " n"]
    """Weight of each candidate, 0 (not rim) to 1."""
    residuals_px: Float64[Array, " n"]
    """Distance of each silhouette point from the common rim, px."""
    scale_px: float
    """Robust standard deviation of the residuals, px."""
    extent_mm: float
    """Distance at which tilts are given in mm (see `moved`)."""
    covariance: Float64[Array, "k k"]
    """Covariance of the base's tilts, height and bend, from the scatter, mm²."""
    per_camera: Float64[Array, "k c"]
    """Change of tilts, height and bend if one camera's outline moves outwards by one pixel, mm."""
    per_stretch: Float64[Array, "k m"]
    """The same change for one eighth of one camera's outline."""

    def sigma_mm(self, rim: Float64[Array, "n 3"]) -> float:
        """Standard uncertainty of the base's mean height within the rim, mm.

        It combines the scatter with errors of whole outlines and of eighths of outlines. If only part of the rim is
        visible, the base can tilt, which changes the mean.

        Args:
            rim: closed curve on the base, mm, world frame.
        """
        moves = [
            mean_height(moved(self.base, _STEP * unit, self.extent_mm), rim) / _STEP
            for unit in np.eye(len(self.covariance))
        ]
        gradient = np.array(moves) - mean_height(self.base, rim) / _STEP
        return float(
            np.linalg.norm(
                [
                    np.sqrt(gradient @ self.covariance @ gradient),
                    *(SILHOUETTE_SIGMA_PX * gradient @ self.per_camera),
                    *(_LOCAL_SIGMA_PX * gradient @ self.per_stretch),
                ]
            )
        )


def mean_height(base: Base, rim: Float64[Array, "n 3"]) -> float:
    """Mean height above a base over the rim's area, mm, exact for parabolas over ellipses."""
    return float((base.height(rim).mean() + base.height(rim.mean(axis=0)[None])[0]) / 2)


def adjust_base(start: Base, candidates: RimCandidates, *, bend: bool, coarse_px: float = 0.0) -> AdjustedBase:
    """A base adjusted until all silhouettes agree on its rim.

    The candidates' own heights have a small weight, for rigs whose cameras are all on one side.

    Args:
        start: within a few millimetres of the solution.
        candidates: silhouette points on the rim, with few outliers on limbs.
        bend: whether the base may be a cylinder.
        coarse_px: initial additional scatter, px, which decreases from iteration to iteration.
    """
    parameters = 5 if bend else 3
    extent = float(np.percentile(np.linalg.norm(candidates.points_world - start.origin, axis=1), 90))
    base, weights = start, np.ones(len(candidates.points_world))
    middle = np.median(base.flatten(candidates.points_world), axis=0)
    residuals, scale = weights, 1.0
    prior = np.clip(len(weights) / SECTORS, 1.0, None) ** -1 / 3 / _PRIOR_MM**2
    for number in range(_ROUNDS):
        finest = SILHOUETTE_SIGMA_PX + coarse_px * _NARROWING**number
        angle, radius, gain = _on_base(base, candidates, middle)
        spline = _periodic_spline(angle)
        for _ in range(_REWEIGHT):
            weight = weights * gain**2
            normal = (spline.T @ spline.multiply(weight[:, None])).toarray()
            normal += 1e-6 * weight.sum() / _RIM_KNOTS * np.eye(_RIM_KNOTS)
            rim = np.linalg.solve(normal, spline.T @ (weight * radius))
            residuals = (radius - spline @ rim) * gain
            scale = max(MAD * float(np.median(np.abs(residuals[weights > 0.05]))), finest)
            weights = np.clip(1 - (residuals / (_TUKEY * scale)) ** 2, 0, None) ** 2
        heights = base.height(candidates.points_world)
        columns, lifts = [], []
        for unit in np.eye(parameters):
            nearby = moved(base, _STEP * unit, extent)
            angle_2, radius_2, _ = _on_base(nearby, candidates, middle)
            change = (radius_2 - _periodic_spline(angle_2) @ rim) * gain - residuals
            columns.append(change / _STEP)
            lifts.append((nearby.height(candidates.points_world) - heights) / _STEP)
        jacobian = hstack([csr_array(np.stack(columns, axis=1)), spline.multiply(-gain[:, None])], format="csr")
        lift = np.stack(lifts, axis=1)
        near = np.clip(1 - (heights / (4 * _PRIOR_MM)) ** 2, 0, None) ** 2 * prior
        confidence = weights / (_CORRELATED * scale**2)
        normal = (jacobian.T @ jacobian.multiply(confidence[:, None])).toarray()
        right = jacobian.T @ (confidence * residuals)
        normal[:parameters, :parameters] += np.einsum("ni,n,nj->ij", lift, near, lift)
        right[:parameters] += np.einsum("ni,n->i", lift, near * heights)
        normal += 1e-9 * np.trace(normal) / len(normal) * np.eye(len(normal))
        step = -np.linalg.solve(normal, right)[:parameters]
        inverse = np.linalg.inv(normal)[:parameters]
        base = moved(base, step * min(1.0, 1.0 / max(float(np.abs(step).max()), 1e-12)), extent)
        if np.abs(step).max() < _CONVERGED_MM:
            break
    camera = np.unique(candidates.camera, return_inverse=True)[1]
    stretch = camera * _STRETCHES + np.floor((angle / (2 * np.pi) + 0.5) * _STRETCHES).astype(np.int64) % _STRETCHES
    per_camera, per_stretch = (
        -inverse @ (jacobian.T @ (confidence[:, None] * np.equal.outer(group, np.unique(group)).astype(np.float64)))
        for group in (camera, stretch)
    )
    return AdjustedBase(
        base=base,
        weights=weights,
        residuals_px=residuals,
        scale_px=scale,
        extent_mm=extent,
        covariance=inverse[:, :parameters],
        per_camera=per_camera,
        per_stretch=per_stretch,
    )


def _on_base(
    base: Base, candidates: RimCandidates, middle: Float64[Array, 2]
) -> tuple[Float64[Array, " n"], Float64[Array, " n"], Float64[Array, " n"]]:
    """Polar coordinates about `middle`, on the unrolled base, of the rays' intersections with it.

    Angle, rad; radius, mm; pixels per mm of radius.
    """
    centres, rays = candidates.centres_world, candidates.rays
    reach = -((centres - base.origin) @ base.frame[2]) / (rays @ base.frame[2])
    for _ in range(6):  # Newton; the initial value is exact for a plane
        height = base.height(centres + rays * reach[:, None])
        slope = (base.height(centres + rays * (reach + 1e-3)[:, None]) - height) / 1e-3
        reach = reach - height / np.where(np.abs(slope) > 1e-3, slope, -1.0)
        if np.abs(height).max() < 1e-9:
            break
    offset = base.flatten(centres + rays * reach[:, None]) - middle
    radius = np.maximum(np.linalg.norm(offset, axis=1), 1e-9)
    radial = (offset / radius[:, None]) @ base.frame[:2]
    gain = np.abs((radial * candidates.outward).sum(axis=1)) / candidates.mm_per_px
    return np.arctan2(offset[:, 1], offset[:, 0]), radius, gain


def _periodic_spline(angle: Float64[Array, " n"]) -> csr_array:
    """Values of uniform periodic cubic B-splines at angles, rad."""
    place = np.mod(angle, 2 * np.pi) / (2 * np.pi) * _RIM_KNOTS
    first = np.floor(place).astype(np.int64)
    f = place - first
    pieces = np.stack([(1 - f) ** 3, 3 * f**3 - 6 * f**2 + 4, -3 * f**3 + 3 * f**2 + 3 * f + 1, f**3], axis=1) / 6
    columns = (first[:, None] + np.arange(4)) % _RIM_KNOTS
    rows = np.repeat(np.arange(len(angle)), 4)
    return csr_array((pieces.ravel(), (rows, columns.ravel())), shape=(len(angle), _RIM_KNOTS))
