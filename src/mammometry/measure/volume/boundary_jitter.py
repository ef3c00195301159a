"""Change of the volume when the boundary is redrawn: linear theory, with real cuts.

The part is cut out again along curves near the first one. For speed only a band of skin around that curve is searched
(`Band`). The part is identical to one cut out of the whole mesh.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.ndimage import gaussian_filter1d

from mammometry.base.errors import MeasureError
from mammometry.geometry import Array, Bool, Float64, Int64, TriangleMesh, mesh_kernels
from mammometry.geometry.nearest import point_tree
from mammometry.measure.boundary.boundary import Boundary
from mammometry.measure.boundary.trace import REACH_MM, edge_loop
from mammometry.measure.settings import ObserverSettings
from mammometry.measure.solid.cut import OpenPart, faces_inside, inside_curve, open_part, sides_on
from mammometry.measure.wall import chest_wall
from mammometry.measure.wall.chest_wall import ChestWall
from mammometry.measure.wall.open_breast import OpenBreast
from mammometry.surface.repair.repair import Provenance


class Band:
    """Skin around a curve along which a mesh was cut.

    Args:
        mesh: a closed mesh, mm.
        curve: vertices of the closed curve, as for `inside_curve`.
        reach_mm: half width of the band.
    """

    def __init__(self, mesh: TriangleMesh, curve: Int64[Array, " n"], reach_mm: float) -> None:
        points = mesh.vertices[curve]
        box = mesh.vertices_between(points.min(axis=0) - reach_mm, points.max(axis=0) + reach_mm)
        away = np.asarray(point_tree(points).query(mesh.vertices[box], distance_upper_bound=reach_mm)[0])
        close = np.zeros(len(mesh.vertices), dtype=bool)
        close[box[np.isfinite(away)]] = True
        self._whole, self._inside = mesh, faces_inside(mesh, curve)
        in_band = mesh.faces_within(close)
        self._faces = np.flatnonzero(in_band)
        self._vertices = np.flatnonzero(mesh.vertices_used_by(self._faces))
        self.mesh = mesh.submesh(self._faces)
        """The band, open, mm."""
        self._core = self._inside & ~in_band
        self._at_core = self._beside(self._core)
        self._at_rest = self._beside(~self._inside & ~in_band)
        self._rings = mesh_kernels.edge_rings(len(self.mesh.vertices), self.mesh.faces)

    def inside(self, curve: Int64[Array, " k"]) -> OpenPart:
        """Part inside another curve.

        Args:
            curve: vertices of `mesh`, the band, in order.
        """
        walls = sides_on(self.mesh, curve)
        count, part = mesh_kernels.face_parts(self._rings, walls)
        core, rest, touching = (np.zeros(count, dtype=bool) for _ in range(3))
        core[part[self._at_core]] = rest[part[self._at_rest]] = True
        touching[part[np.flatnonzero(walls) // 3]] = True
        if (core & rest).any() or (core & touching).sum() != 1 or (rest & touching).sum() != 1 or touching.sum() != 2:
            return inside_curve(self._whole, self._vertices[curve])  # the band alone does not show it
        faces = self._core.copy()
        faces[self._faces] = core[part] | (~rest[part] & self._inside[self._faces])
        return open_part(self._whole, faces, self._vertices[curve])

    def _beside(self, faces: Bool[Array, " m"]) -> Bool[Array, " b"]:
        """Mask of the band's faces that share a vertex with faces outside it."""
        near = self._whole.vertices_used_by(faces)[self._vertices]
        a, b, c = self.mesh.faces.T
        return np.asarray(near[a] | near[b] | near[c])


UNSEEN_SLOPE = 0.5
"""Uncertainty of skin, and of a boundary on it, per mm of distance from measured skin, mm. On a photographed cast the
uncertainty of skin is limited to the space that no view excludes. For a ptotic cast photographed by one pair, with its
lower pole hidden (63 cm², up to 49 mm away), the volume error was 0.5 times distance times area. For casts photographed
by four pairs, at 0.15 of full size, it was −0.2 to 0.4 times (docs/decisions/0009)."""
ORDERS = 4  # Fourier orders 0 to 3: wider, shifted, oblong, three-lobed (docs/decisions/0009)
_SHARES = (1.0, 0.5, -1.0, -0.5)  # factors on a displacement, tried in turn until the curve stays on the skin
_SMOOTH = 48  # length of the curve over the σ with which its uncertainty is smoothed; not critical
_SKIN_MARGIN_MM = 10.0  # skin around a redrawn curve onto which it is projected; not critical


def boundary_std_cc(breast: OpenBreast, wall: ChestWall) -> float | None:
    """Standard deviation of the volume due to jitter of a torso's boundary, cc.

    The variance of the jitter is the sum of those of observers (``settings.observers``), of the boundary's own
    uncertainty (``across_mm``), and of unmeasured skin, which may be wrong and shows no crease: ``UNSEEN_SLOPE`` times
    the distance from measured skin, squared. None if a displaced curve cannot be followed on the skin.

    The jitter is a displacement across the curve, along the skin, by independent Fourier terms up to the third order,
    each with that profile. Each order has the same share of the variance. For each of the seven terms the curve is
    redrawn, cut and closed again.

    Where skin and wall meet tangentially, a wider curve changes nothing and a narrower one cuts the breast. So both
    signs of the widest term are computed, V₊ and V₋. The mean change b = (V₊ + V₋)/2 − V depends only on the variances,
    which are equal, so each order contributes it: ((V₊ − V₋)/2)² + Σ (Vₖ − V − b/2)² + (4b)².

    Args:
        breast: a breast of a torso.
        wall: the wall that closes it; its kind is kept.
    """
    boundary, surface = breast.boundary, breast.surface
    volume_cc = wall.closed.volume_mm3() / 1000
    wider, *others_mm = displacements_mm(_sigma_mm(breast))
    modes = (wider, -wider, *others_mm)
    reach_mm = 2 * float(max(np.abs(mode).max() for mode in modes)) + REACH_MM
    changes_cc = []
    try:
        band = Band(surface.mesh, edge_loop(boundary.name, boundary.points_world, surface.mesh), reach_mm)
    except MeasureError:
        return None
    for across_mm in modes:
        for share in _SHARES:
            moved_cc = _redrawn_cc(breast, wall, band, share * across_mm)
            if moved_cc is not None:
                changes_cc.append((moved_cc - volume_cc) / share)
                break
        else:
            return None
    widened, narrowed, *bent = changes_cc
    mean = (widened + narrowed) / 2
    linear = [(widened - narrowed) / 2, *(change - mean / 2 for change in bent)]
    return float(np.sqrt(np.sum(np.square(linear)) + (ORDERS * mean) ** 2))


def _redrawn_cc(breast: OpenBreast, wall: ChestWall, band: Band, across_mm: Float64[Array, " n"]) -> float | None:
    """Volume within a displaced boundary, cc. None if it cannot be followed."""
    redrawn = redraw(breast.boundary, across_mm, band.mesh)
    boundaries = [redrawn if other.name == redrawn.name else other for other in breast.boundaries]
    try:
        part = band.inside(edge_loop(redrawn.name, redrawn.points_world, band.mesh))
        again = replace(breast, boundary=redrawn, boundaries=boundaries, seen=breast.skin, cut=part)
        return chest_wall.fit(again, wall.kind).closed.volume_mm3() / 1000
    except MeasureError:
        return None


def _sigma_mm(breast: OpenBreast) -> Float64[Array, " n"]:
    """Smoothed standard uncertainty of each boundary point across the curve, mm."""
    boundary, surface, settings = breast.boundary, breast.surface, breast.settings
    points = boundary.points_world
    measured = surface.mesh.vertices[surface.provenance == Provenance.MEASURED]
    away_mm = np.asarray(point_tree(measured).query(points)[0]) if len(measured) else np.zeros(len(points))
    away_mm = gaussian_filter1d(away_mm, len(points) / _SMOOTH, mode="wrap")
    drawn_mm = drawn_sigma_mm(boundary, breast.body_frame, settings.observers)
    if boundary.across_mm is not None:
        drawn_mm = np.hypot(drawn_mm, boundary.across_mm)
    return np.hypot(drawn_mm, UNSEEN_SLOPE * away_mm)


def drawn_sigma_mm(
    boundary: Boundary, frame: Float64[Array, "3 3"] | None, observers: ObserverSettings
) -> Float64[Array, " n"]:
    """Standard uncertainty of each point of a drawn curve, across the curve, mm.

    The variance is the mean of those of the four regions, weighted by the squared cosine of the angle from each
    region's direction about the curve's centre, where the cosine is positive; the weights add up to 1.

    Args:
        boundary: boundary of a torso's breast.
        frame: body frame, rows: the patient's left, the head, straight ahead. None: all regions have equal weight.
        observers: standard uncertainty of drawn curves by region.
    """
    points = boundary.points_world
    if frame is None:
        return np.full(len(points), observers.mean_mm)
    lateral = frame[0] if boundary.name == "left" else -frame[0]
    seen = (points - points.mean(axis=0)) @ np.stack([lateral, frame[1]], axis=1)
    seen /= np.maximum(np.linalg.norm(seen, axis=1, keepdims=True), 1e-12)
    towards = np.maximum(np.concatenate([seen, -seen], axis=1), 0.0)
    regions = np.array([observers.lateral_mm, observers.upper_mm, observers.medial_mm, observers.lower_mm])
    return np.asarray(np.sqrt(towards**2 @ regions**2))


def displacements_mm(sigma_mm: Float64[Array, " n"]) -> Float64[Array, "m n"]:
    """Displacements across a closed curve, mm, one row per Fourier term. Their squares add up to σ²."""
    count = len(sigma_mm)
    around = 2 * np.pi * np.arange(count) / count
    terms = [np.ones(count)]
    for order in range(1, ORDERS):
        terms += [np.cos(order * around), np.sin(order * around)]
    return np.stack(terms) * sigma_mm / np.sqrt(ORDERS)


def redraw(boundary: Boundary, across_mm: Float64[Array, " n"], mesh: TriangleMesh) -> Boundary:
    """A boundary displaced outwards along its best plane, and moved to the skin's nearest vertices."""
    points = boundary.points_world
    centre = points.mean(axis=0)
    normal = np.linalg.svd(points - centre, full_matrices=False)[2][2]
    outwards = np.cross(np.roll(points, -1, axis=0) - np.roll(points, 1, axis=0), normal)
    outwards /= np.maximum(np.linalg.norm(outwards, axis=1, keepdims=True), 1e-12)
    if np.sum(outwards * (points - centre)) < 0:
        outwards = -outwards
    wanted = points + across_mm[:, None] * outwards
    low, high = wanted.min(axis=0) - _SKIN_MARGIN_MM, wanted.max(axis=0) + _SKIN_MARGIN_MM
    near = mesh.vertices[mesh.vertices_between(low, high)]
    foot = near[np.asarray(point_tree(near).query(wanted)[1])]
    return replace(boundary, points_world=foot)
