"""Adjust a cast's base so that all cameras see one rim.

Every silhouette point on the rim defines a viewing ray. The ray meets the base in a point of the rim. With the right
base the points of different cameras lie on one closed curve. With a wrong one they do not, because the cameras look
from different sides. Base and curve are adjusted together, by least squares in pixels: a bundle adjustment of one
curve on one surface. Only silhouettes enter, so errors of the matched surface near its edge do not matter.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_array, hstack

from mammometry.base.value import value
from mammometry.geometry.arrays import Array, Float64
from mammometry.measure.boundary.cast_base import SECTORS, Base, moved
from mammometry.measure.boundary.cast_rim import RimCandidates

_SILHOUETTE_SIGMA_PX = 0.05
"""Standard uncertainty of the edge in each camera, common to its whole outline, pixels. In eight cameras and three
casts that are lit to the edge it was .00 to .04.
"""
_LOCAL_SIGMA_PX = 0.1
"""Standard uncertainty of the edge in one eighth of a camera's outline alone, pixels. Light differs around a rim:
.02 to .12 was measured.
"""
_RIM_KNOTS = 40  # of the closed spline that stands for the rim: one every 9°, chosen by eye
_ROUNDS = 30  # Gauss–Newton rounds at most; it ends when no step exceeds _CONVERGED_MM
_REWEIGHT = 4  # times that the weights are renewed in each round; chosen by eye
_TUKEY = 4.685  # standard deviations; Tukey's biweight is then 95 % efficient for normal errors
_FINEST_PX = 0.05  # smallest scatter assumed, pixels: what silhouettes are off as a whole (docs/decisions/0009)
_NARROWING = 0.8  # factor by which the coarse scatter shrinks from round to round; chosen by eye
_CORRELATED = 4.0  # neighbouring silhouette points share pixels: so many count as one
_PRIOR_MM = 0.5  # standard uncertainty of the candidates' own heights, mm: extrapolated range data erred by .3
_STEP = 1e-2  # step of the numerical derivatives, mm
_CONVERGED_MM = 2e-3  # a base that moves by less is at rest, mm; .02 cc of a cast
_STRETCHES = 8  # parts of an outline that may be off by themselves (`_LOCAL_SIGMA_PX`)


@value(eq=False)
class AdjustedBase:
    """A base on which the cameras agree about the rim."""

    base: Base
    weights: Float64[Array, " n"]
    """Of every candidate, 0 (no rim) to 1."""
    residuals_px: Float64[Array, " n"]
    """Distance of every silhouette point from the common rim, pixels."""
    scale_px: float
    """Robust standard deviation of the residuals, pixels."""
    extent_mm: float
    """Distance at which tilts are counted in mm (see `moved`)."""
    covariance: Float64[Array, "k k"]
    """Of the base's tilts, height and bend, from the scatter, mm²."""
    per_camera: Float64[Array, "k c"]
    """Their values with one camera's outline one pixel further out, mm."""
    per_stretch: Float64[Array, "k m"]
    """The same for one eighth of one camera's outline."""

    def sigma_mm(self, rim: Float64[Array, "n 3"]) -> float:
        """Standard uncertainty of the base's mean height within the rim, mm.

        It combines the scatter with outlines that are off as a whole or in stretches of an eighth. If only part of the
        rim was seen, the base can tilt, which changes the mean.

        Args:
            rim: closed curve on the base, mm, world frame.
            settings: how far outlines are off.
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
                    *(_SILHOUETTE_SIGMA_PX * gradient @ self.per_camera),
                    *(_LOCAL_SIGMA_PX * gradient @ self.per_stretch),
                ]
            )
        )


def mean_height(base: Base, rim: Float64[Array, "n 3"]) -> float:
    """Mean height above a base over the rim's area, mm. Exact for parabolas over ellipses."""
    return float((base.height(rim).mean() + base.height(rim.mean(axis=0)[None])[0]) / 2)


def adjust_base(start: Base, candidates: RimCandidates, *, bend: bool, coarse_px: float = 0.0) -> AdjustedBase:
    """Move a base until all silhouettes agree on its rim.

    The height of the candidates themselves (where the surface was continued to) enters weakly, for rigs whose
    cameras all look from one side.

    Args:
        start: within a few millimetres of the solution.
        candidates: silhouette points that show the rim, limbs left out but for a few.
        bend: whether the base may be a cylinder.
        coarse_px: scatter that is assumed beside the found one at first, and less from round to round, pixels.
    """
    parameters = 5 if bend else 3
    knots = _RIM_KNOTS
    extent = float(np.percentile(np.linalg.norm(candidates.points_world - start.origin, axis=1), 90))
    base, weights = start, np.ones(len(candidates.points_world))
    middle = np.median(base.flatten(candidates.points_world), axis=0)
    residuals, scale = weights, 1.0
    prior = np.clip(len(weights) / SECTORS, 1.0, None) ** -1 / 3 / _PRIOR_MM**2
    for number in range(_ROUNDS):
        finest = _FINEST_PX + coarse_px * _NARROWING**number
        angle, radius, gain = _on_base(base, candidates, middle)
        spline = _periodic_spline(angle, knots)
        for _ in range(_REWEIGHT):
            weight = weights * gain**2
            normal = (spline.T @ spline.multiply(weight[:, None])).toarray()
            normal += 1e-6 * weight.sum() / knots * np.eye(knots)
            rim = np.linalg.solve(normal, spline.T @ (weight * radius))
            residuals = (radius - spline @ rim) * gain
            scale = max(1.4826 * float(np.median(np.abs(residuals[weights > 0.05]))), finest)
            weights = np.clip(1 - (residuals / (_TUKEY * scale)) ** 2, 0, None) ** 2
        heights = base.height(candidates.points_world)
        columns, lifts = [], []
        for unit in np.eye(parameters):
            nearby = moved(base, _STEP * unit, extent)
            angle_2, radius_2, _ = _on_base(nearby, candidates, middle)
            change = (radius_2 - _periodic_spline(angle_2, knots) @ rim) * gain - residuals
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
    """Polar coordinates, on the unrolled base, of where the rays meet it.

    And pixels per mm of radius. Angle, rad; radius, mm, about `middle`.
    """
    centres, rays = candidates.centres_world, candidates.rays
    reach = -((centres - base.origin) @ base.frame[2]) / (rays @ base.frame[2])
    for _ in range(6):  # Newton; the first guess is exact for a plane
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


def _periodic_spline(angle: Float64[Array, " n"], knots: int) -> csr_array:
    """Values of the uniform periodic cubic B-splines at the angles, rad."""
    place = np.mod(angle, 2 * np.pi) / (2 * np.pi) * knots
    first = np.floor(place).astype(np.int64)
    f = place - first
    pieces = np.stack([(1 - f) ** 3, 3 * f**3 - 6 * f**2 + 4, -3 * f**3 + 3 * f**2 + 3 * f + 1, f**3], axis=1) / 6
    columns = (first[:, None] + np.arange(4)) % knots
    rows = np.repeat(np.arange(len(angle)), 4)
    return csr_array((pieces.ravel(), (rows, columns.ravel())), shape=(len(angle), knots))
