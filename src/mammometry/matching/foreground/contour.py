"""The outline of a subject in a photograph, to sub-pixel accuracy.

A silhouette at a fixed level is inside or outside the true edge, depending on the photograph's blur and the border's
shading. So brightness, blur and position of the edge are estimated together. Across the edge, at the distance x inside
it, the photograph shows

    I(x) = A [Φ((x − x₀) / σ) − (1 − a) E(x − x₀)],    E(x) = exp(σ²/2d² − x/d) Φ(x/σ − σ/d),

a step at x₀ that is shaded towards the edge, from A to a fraction a of it over the depth d, with a Gaussian blur σ; E
is exp(−x/d) inside the edge, with the same blur. Blur and depth are common to the whole outline; brightness, shade and
position are estimated for each point.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter1d, map_coordinates
from scipy.special import log_ndtr, ndtr
from skimage.measure import find_contours

from mammometry.base.value import value
from mammometry.geometry import mesh_kernels
from mammometry.geometry.arrays import Array, Bool, Float64
from mammometry.geometry.nearest import point_tree
from mammometry.matching.foreground.foreground import Foreground

_TANGENT_STEP = 4  # contour points (about 1 px each) on either side
_CONTOUR_POINTS = 700  # fewest points, if there are as many; limits time
_FRAME_BORDER_PX = 2.0  # distance from the frame within which a profile is incomplete
_SHARPNESS = 0.3  # least steepness relative to the usual edge's: softer ones border shadows (docs/decisions/0017)
_ALONG = 2.0  # Gaussian σ over which profiles are averaged, contour points
# Search grids, in units of the blur of the contour's usual profile, which shading makes wider than the photograph's.
# Positions between grid points are found by a parabola.
_WINDOW = np.arange(-3.5, 4.76, 0.25)
_PLACES = np.arange(-2.0, 2.01, 0.05)
_BLURS = np.arange(0.5, 1.26, 0.05)
_DEPTHS = (1.0, 2.0, 4.0)  # depths of the shading, in σ
_DARKEST = 0.2  # smallest a: a darker border is not an edge; 0.65 to 0.95 occur (docs/decisions/0017)
_FOR_THE_BLUR = 150  # number of profiles for the common parameters; limits time


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Contour:
    """Points of a silhouette, in the original photograph."""

    uv: Float64[Array, "n 2"]
    """Pixels."""
    tangent: Float64[Array, "n 2"]
    """Unit vectors along the contour."""
    inward: Float64[Array, "n 2"]
    """Unit vectors across the contour, into the subject."""

    def chosen(self, keep: Bool[Array, " n"]) -> Contour:
        """Contour with some of the points."""
        return Contour(uv=self.uv[keep], tangent=self.tangent[keep], inward=self.inward[keep])


@value(eq=False)
class Trace:
    """A silhouette's contour, and where it is not the subject's edge."""

    uv: Float64[Array, "n 2"]
    """Points of the contour, pixels."""
    lost_px: Float64[Array, " n"]
    """0 where the subject's edge is visible. Where the contour is the border of a shadow on the subject, the true edge
    is farther out and invisible: the distance to the nearest point with a visible edge, pixels."""


def outline(foreground: Foreground) -> Contour:
    """The subject's outline in one photograph.

    It is the longest contour of the coverage, moved to the true edge, without borders of shadows and points at the
    frame. Empty if there is none.
    """
    contour = _sampled_contour(foreground)
    place = _edge_in_px(contour, foreground)
    seen = np.isfinite(place)
    moved = contour.uv + np.where(seen, place, 0.0)[:, None] * contour.inward
    return Contour(uv=moved, tangent=contour.tangent, inward=contour.inward).chosen(seen)


def follow(foreground: Foreground) -> Trace:
    """Trace the longest contour, and mark where it is an edge. Empty if there is none."""
    contour = _sampled_contour(foreground)
    seen = np.isfinite(_edge_in_px(contour, foreground))
    if not seen.any():
        return Trace(uv=np.empty((0, 2)), lost_px=np.empty(0))
    return Trace(uv=contour.uv, lost_px=np.asarray(point_tree(contour.uv[seen]).query(contour.uv)[0]))


def edge_places(profiles: Float64[Array, "n k"], x: Float64[Array, " k"], unit: float) -> Float64[Array, " n"]:
    """Position x₀ of the edge in each profile, by least squares with the module's model.

    Args:
        profiles: brightness across the edge, from outside to inside.
        x: its positions, ascending.
        unit: expected blur; σ is searched from half of it to a quarter more.

    Returns:
        x₀. NaN at the limits of the search, ± 2 units, or without a step.
    """
    some = profiles[:: max(1, len(profiles) // _FOR_THE_BLUR)]
    tried = [(sigma * unit, sigma * depth * unit) for sigma in _BLURS for depth in _DEPTHS]
    misfits = [np.median(_misfit(some, x, unit, *shape).min(axis=1)) for shape in tried]
    misfit = _misfit(profiles, x, unit, *tried[int(np.argmin(misfits))])
    best = np.argmin(misfit, axis=1)
    inner = np.clip(best, 1, len(_PLACES) - 2)
    row = np.arange(len(profiles))
    left, middle, right = (misfit[row, inner + k] for k in (-1, 0, 1))
    with np.errstate(invalid="ignore", divide="ignore"):
        vertex = 0.5 * (left - right) / (left - 2 * middle + right)
    step = _PLACES[1] - _PLACES[0]
    place = (_PLACES[inner] + vertex * step) * unit
    return np.where(np.isfinite(vertex) & (best == inner), place, np.nan)


def _misfit(
    profiles: Float64[Array, "n k"], x: Float64[Array, " k"], unit: float, sigma: float, depth: float
) -> Float64[Array, "n m"]:
    """Sum of squared residuals with the best A and a, for an edge at each of `_PLACES`."""
    inside = x - unit * _PLACES[:, None]
    step = ndtr(inside / sigma)
    shade = np.exp(sigma**2 / (2 * depth**2) - inside / depth + log_ndtr(inside / sigma - sigma / depth))
    length = np.linalg.norm(step, axis=1, keepdims=True)
    common = (shade * step).sum(axis=1, keepdims=True) / length
    rest = shade - common * step / length
    rest_length = np.linalg.norm(rest, axis=1, keepdims=True)
    by_step, by_rest = profiles @ (step / length).T, profiles @ (rest / rest_length).T
    darker = -by_rest / rest_length.T  # A (1 − a)
    bright = (by_step + darker * common.T) / length.T  # A
    # An edge that is brighter than its inside is treated as uniform.
    misfit = (profiles**2).sum(axis=1, keepdims=True) - by_step**2 - np.where(darker >= 0, by_rest**2, 0.0)
    return np.where(darker > (1 - _DARKEST) * bright, np.inf, misfit)


def _longest_contour(foreground: Foreground) -> Float64[Array, "n 2"]:
    """Contour corners `uv`, about one pixel apart."""
    top, bottom, left, right = mesh_kernels.extent(foreground.mask).tolist()
    if top == bottom:
        return np.empty((0, 2))
    top, left = max(top - 2, 0), max(left - 2, 0)
    coverage = foreground.coverage[top : bottom + 2, left : right + 2]
    contours: list[Float64[Array, "n 2"]] = find_contours(  # type: ignore[no-untyped-call]
        coverage, foreground.contour_level
    )
    if not contours:
        return np.empty((0, 2))
    longest = max(contours, key=len)
    if (longest[0] == longest[-1]).all():
        longest = longest[:-1]
    return longest[:, ::-1] + np.array([left, top])


def _sampled_contour(foreground: Foreground) -> Contour:
    """Some points of the longest contour. Empty if there is none."""
    uv = _longest_contour(foreground)
    if len(uv) <= 4 * _TANGENT_STEP:
        nothing = np.empty((0, 2))
        return Contour(uv=nothing, tangent=nothing, inward=nothing)
    tangent = np.roll(uv, -_TANGENT_STEP, axis=0) - np.roll(uv, _TANGENT_STEP, axis=0)
    tangent /= np.maximum(np.linalg.norm(tangent, axis=1, keepdims=True), 1e-9)
    # find_contours has lower values on the left of (row, column) paths, so inwards is on the other side in (u, v).
    inward = np.stack([-tangent[:, 1], tangent[:, 0]], axis=1)
    height, width = foreground.coverage.shape
    stride = max(1, len(uv) // _CONTOUR_POINTS)
    keep = ((uv > _FRAME_BORDER_PX) & (uv < np.array([width, height]) - 1 - _FRAME_BORDER_PX)).all(axis=1)
    keep &= np.arange(len(uv)) % stride == 0
    return Contour(uv=uv, tangent=tangent, inward=inward).chosen(keep)


def _edge_in_px(contour: Contour, foreground: Foreground) -> Float64[Array, " n"]:
    """Distance of the edge inside the contour, pixels. NaN if there is none."""

    def across(x: Float64[Array, " k"]) -> Float64[Array, "n k"]:
        u, v = np.moveaxis(contour.uv[:, None] + x[:, None] * contour.inward[:, None], 2, 0)
        sampled: Float64[Array, "n k"] = map_coordinates(
            foreground.coverage, [v, u], output=np.float64, order=1, mode="nearest"
        )
        return sampled

    if not len(contour.uv):
        return np.empty(0)
    unit = _blur(across(np.array([-0.5, 0.0, 0.5])), 0.5)
    unit = _blur(across(unit * _WINDOW), unit * (_WINDOW[1] - _WINDOW[0]))
    profiles: Float64[Array, "n k"] = gaussian_filter1d(across(unit * _WINDOW), _ALONG, axis=0, mode="wrap")
    place = edge_places(profiles, unit * _WINDOW, unit)
    steepest = np.diff(profiles, axis=1).max(axis=1)
    return np.where(steepest > _SHARPNESS * np.median(steepest), place, np.nan)


def _blur(profiles: Float64[Array, "n k"], step: float) -> float:
    """Standard deviation of a Gaussian that makes a step as steep as the usual profile."""
    steepest, brightest = np.median(np.diff(profiles, axis=1).max(axis=1)), np.median(profiles.max(axis=1))
    return float(step * brightest / (np.sqrt(2 * np.pi) * max(steepest, 1e-2 * step)))
