"""Find where a cast's silhouette is the rim of its base.

Candidates come from the silhouettes and the measured surface. At a point of a silhouette the surface either turns away
smoothly (an occluding limb: the viewing ray touches it) or ends at the rim (the ray pierces its continuation). The
surface measured beside the silhouette, by whichever cameras saw it best, is continued as a quadratic patch in its own
tangent plane, so that it can turn steep towards the rim, and met with the ray. The distance between silhouette and
measured skin limits the test: a limb so sharply rounded that it begins beyond it looks like a rim. Only points too
sharp for any breast count.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields

import numpy as np

from mammometry.base.value import value
from mammometry.geometry.arrays import Array, Bool, Float64, Int64
from mammometry.geometry.camera import Camera, Rig
from mammometry.geometry.nearest import point_tree
from mammometry.matching.foreground.contour import Contour, outline
from mammometry.matching.foreground.foreground import Foreground
from mammometry.surface.repair.repair import Provenance, RepairedSurface

SHARPEST_LIMB_MM = 8.0
"""Radius of the sharpest limb of a breast, mm. Measured skin that turns to a cosine c of incidence at a distance g
from the silhouette is no limb with a radius above 2 g/c². A point where that is less than this shows the rim. Of a
ptotic cast photographed by one pair, at a tenth of full size, 92 % of the rim's points have less, and 92 % of the
limb's have more.
"""
_EDGE_BAND_PX = 8.0
"""Widest gap, pixels of the photograph, between a silhouette and the end of the measured surface beside it for the
silhouette to count as the cast's rim. Windows of the matcher end that far inside the edge."""
_PATCH_RADIUS_MM = 7.0  # radius of the surface patch that is continued to the silhouette; chosen by eye
_CONTINUE_MM = 4.0  # longest way by which it is continued; chosen by eye
_LEAST_FACING = 0.1  # cosine of the steepest incidence on the continued surface; a limb has 0, a rim .3 to .9
_PER_MM2 = 1.6  # vertices per mm² that are used; chosen for speed
_NEIGHBOURS = 160  # vertices of a patch at most; 1.6 per mm² make 246 within 7 mm
_FEWEST = 40  # vertices of a patch at least; its quadratic has 6 coefficients


@value(eq=False)
class RimCandidates:
    """Silhouette points that may lie on the rim, and their rays. World frame."""

    points_world: Float64[Array, "n 3"]
    """Where each ray meets the continued surface, mm."""
    centres_world: Float64[Array, "n 3"]
    """Perspective centre of the camera that saw each point, mm."""
    rays: Float64[Array, "n 3"]
    """Unit viewing rays."""
    outward: Float64[Array, "n 3"]
    """Unit normals of the planes that touch the silhouette along the rays, away from the cast."""
    mm_per_px: Float64[Array, " n"]
    """What a pixel of the photograph spans at each point, mm."""
    camera: Int64[Array, " n"]
    """Number, in the rig's order, of the camera that saw each point."""

    def chosen(self, which: slice | Bool[Array, " n"]) -> RimCandidates:
        """Some of them."""
        return RimCandidates(**{field.name: getattr(self, field.name)[which] for field in fields(self)})


def rim_candidates(surface: RepairedSurface, foregrounds: Mapping[str, Foreground], rig: Rig) -> RimCandidates:
    """Silhouette points where the continued surface is pierced.

    Merely touched ones do not count. On every camera's silhouette.
    """
    seen = np.flatnonzero(surface.provenance == Provenance.MEASURED)
    if len(seen) < _FEWEST:
        seen = np.arange(len(surface.mesh.vertices))
    density = len(surface.mesh.vertices) / max(surface.mesh.area_mm2(), 1e-9)
    seen = seen[:: max(1, int(density / _PER_MM2))]
    vertices, normals = surface.mesh.vertices[seen], surface.mesh.vertex_normals()[seen]
    found: list[tuple[Float64[Array, ...], ...]] = []
    for number, (name, camera) in enumerate(rig.cameras.items()):
        foreground = foregrounds.get(name)
        if foreground is None or foreground.everything:
            continue
        columns = _pierced(camera, outline(foreground), vertices, normals)
        found.append((*columns, np.full(len(columns[0]), number)))
    if not found:
        empty = np.empty((0, 3))
        found = [(empty, empty, empty, empty, np.empty(0), np.empty(0))]
    points, centres, rays, outward, mm_per_px, number_of = (
        np.concatenate(column) for column in zip(*found, strict=True)
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
    # A limb of radius r turns to the cosine c at the distance r c²/2 from its edge.
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
    """Range at which each ray enters the quadratic patch, and its cosine.

    The patch goes through the ray's points. The cosine is that of incidence. NaN if the ray passes by: there the
    silhouette is a limb.
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
