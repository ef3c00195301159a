"""Test a motion correction with image features that cameras of different pairs share.

A correction is estimated from distances between the pairs' surfaces. If pairs have little skin in common, both see it
at a flat angle, and their matching errors are similar all over it, which looks like motion. Features of the skin do not
depend on the surfaces: a correct correction reduces their distances from the epipolar lines by the predicted amount. If
nothing moved, it increases them by as much.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Literal, TypeAlias

import numpy as np
from scipy.special import logsumexp

from mammometry.base.photograph import Photograph
from mammometry.calibration.features.keypoints import keypoints, matched
from mammometry.geometry import Array, Float64, Rig

Verdict: TypeAlias = Literal["confirmed", "refuted", "silent"]
Displacement: TypeAlias = Callable[[str, Float64[Array, "n 3"]], Float64[Array, "n 3"]]
"""Camera and points that it saw, world frame, mm → their displacements, mm."""

_WIDEST_DEG = 60.0
"""Largest angle between the axes of two cameras that are compared: SIFT matches hardly any features beyond 45°."""
_WIDTHS = ((450, 1000), (1200, 3000))
"""Widths of the reduced photographs, px, and number of the strongest features in each. Weak texture is matched in
small ones, sharp marks are located better in large ones."""
_FEATURE_PX = 0.5
"""Standard deviation of a feature's distance from its line, px of the reduced photograph: 0.3 to 0.6 on clean ones."""
_ON_LINE = 3.0  # standard deviations within which a match is on its line
_OFFSET_PX = 16.0
"""Largest distance from the line that is used, same px. Wrong matches are uniformly distributed up to it."""
_BY_CHANCE = 0.3
"""Assumed share of wrong matches among those. Up to a half occur."""
_COMMON_PX = np.linspace(-2.0, 2.0, 41)
"""Errors that all features of two cameras may share, same px: remaining calibration errors, and marks on curved skin
that look different from two sides."""
_COMMON_STD_PX = np.array([0.05, 0.1, 0.2, 0.4, 0.8])
"""Standard deviations of those errors over all pairs of cameras, with equal prior probabilities."""
_SHARES = np.linspace(-1.0, 2.0, 61)  # shares of a correction that are compared: 0 is none of it, 1 all
_SURE = 2.0  # standard deviations by which the share must differ from 0 or 1
_PARALLEL = 1e-6  # rays are parallel if 1 minus their cosine is smaller
_FEWEST = 12
"""Fewest matches on their lines for a verdict, as in the check of photographs' names: fewer may be due to chance."""
_HALF = 0.5  # share above which a correction improves more than it harms


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SharedFeatures:
    """Features that two cameras share, in full-size pixels of each."""

    first: str
    second: str
    uv_first: Float64[Array, "m 2"]
    uv_second: Float64[Array, "m 2"]
    unit_px: float
    """Full-size pixels per pixel of the reduced photographs."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CorrectionEvidence:
    """Result of the test of a correction."""

    share: float
    """Share of the correction that explains the features best: 0 if nothing moved, 1 if it is correct."""
    std: float
    """Standard deviation of that share. Infinite without features."""
    features: int
    """Number of matches on their lines with that share."""

    @property
    def verdict(self) -> Verdict:
        """Whether features confirm or refute the correction, or do not suffice (``silent``)."""
        if self.features < _FEWEST:
            return "silent"
        if self.share >= _HALF:
            return "confirmed" if self.share > _SURE * self.std else "silent"
        return "refuted" if self.share + _SURE * self.std < 1.0 else "silent"


def shared_features(rig: Rig, photographs: Mapping[str, Photograph]) -> tuple[SharedFeatures, ...]:
    """Matched features of cameras of different pairs with similar viewing directions.

    Args:
        rig: as calibrated.
        photographs: camera → photograph.
    """
    in_pairs = [name for name in rig.cameras if any(name in both for both in rig.pair_names.values())]
    found = []
    for width_px, most in _WIDTHS:
        seen = {name: keypoints(photographs[name], width_px, most) for name in in_pairs}
        for first, second in _of_different_pairs(rig, in_pairs):
            uv_first, uv_second = matched(seen[first], seen[second])
            unit_px = max(1.0, 0.5 * (rig.cameras[first].size_wh[0] + rig.cameras[second].size_wh[0]) / width_px)
            found.append(
                SharedFeatures(first=first, second=second, uv_first=uv_first, uv_second=uv_second, unit_px=unit_px)
            )
    return tuple(found)


def _of_different_pairs(rig: Rig, names: Sequence[str]) -> Iterator[tuple[str, str]]:
    pairs = [set(both) for both in rig.pair_names.values()]
    for first, second in combinations(names, 2):
        cosine = rig.cameras[first].axis_world @ rig.cameras[second].axis_world
        if cosine > np.cos(np.radians(_WIDEST_DEG)) and {first, second} not in pairs:
            yield first, second


def weigh_correction(
    rig: Rig, corrected: Rig, breathed_mm: Displacement, shared: Sequence[SharedFeatures]
) -> CorrectionEvidence:
    """Test a correction with features that cameras share.

    Args:
        rig: as calibrated.
        corrected: the cameras with corrected poses.
        breathed_mm: camera and points that it saw → their displacements to a body that did not breathe.
        shared: features of two cameras each.
    """
    log_prior = -0.5 * (_COMMON_PX / _COMMON_STD_PX[:, None]) ** 2
    log_prior -= logsumexp(log_prior, axis=1, keepdims=True)
    by_std = np.zeros((len(_COMMON_STD_PX), len(_SHARES)))
    distances = []
    for features in shared:
        before = _from_lines(rig, features)
        change = _from_lines(corrected, features, _shift_mm(rig, features, breathed_mm)) - before
        near = np.minimum(np.abs(before), np.abs(before + change)) < _OFFSET_PX
        if near.any():
            distances.append((before[near], change[near]))
            by_std += logsumexp(_log_likelihood(before[near], change[near]) + log_prior[:, None], axis=2)
    if not distances:
        return CorrectionEvidence(share=0.0, std=float("inf"), features=0)
    log_likelihood = logsumexp(by_std, axis=0)
    weight = np.exp(log_likelihood - logsumexp(log_likelihood))
    share = float(weight @ _SHARES)
    std = float(np.sqrt(weight @ (_SHARES - share) ** 2))
    before, change = (np.concatenate(parts) for parts in zip(*distances, strict=True))
    on_lines = int((np.abs(before + share * change) < _ON_LINE * _FEATURE_PX).sum())
    return CorrectionEvidence(share=share, std=max(std, float(_SHARES[1] - _SHARES[0])), features=on_lines)


def _log_likelihood(before: Float64[Array, " m"], change: Float64[Array, " m"]) -> Float64[Array, "s c"]:
    """Log likelihood of two cameras' features, for each share of the correction and common error."""
    sums = np.empty((len(_SHARES), len(_COMMON_PX)))
    for share, row in zip(_SHARES, sums, strict=True):
        left = before + share * change + _COMMON_PX[:, None]
        fitting = (1 - _BY_CHANCE) / (np.sqrt(2 * np.pi) * _FEATURE_PX) * np.exp(-0.5 * (left / _FEATURE_PX) ** 2)
        row[:] = np.log(fitting + _BY_CHANCE / (2 * _OFFSET_PX)).sum(axis=1)
    return sums


def _shift_mm(rig: Rig, features: SharedFeatures, breathed_mm: Displacement) -> Float64[Array, "m 3"]:
    """Displacement of each feature by breathing between the two exposures, world axes, mm.

    A feature is at the point of its first ray nearest to its second ray.
    """
    first, second = rig.cameras[features.first], rig.cameras[features.second]
    rays, others = first.rays_world(features.uv_first), second.rays_world(features.uv_second)
    baseline = second.centre_world - first.centre_world
    cosine = np.clip(np.einsum("ij,ij->i", rays, others), -1.0, 1.0 - _PARALLEL)
    distance = (rays @ baseline - cosine * (others @ baseline)) / (1 - cosine**2)
    points = first.centre_world + distance[:, None] * rays
    return breathed_mm(features.first, points) - breathed_mm(features.second, points)


def _from_lines(
    rig: Rig, features: SharedFeatures, shift_mm: Float64[Array, "m 3"] | None = None
) -> Float64[Array, " m"]:
    """Distance of each match from its epipolar lines, to first order, px of the reduced photographs.

    Args:
        rig: the cameras.
        features: features of two of them.
        shift_mm: displacement of each feature, first exposure minus second.
    """
    first, second = rig.cameras[features.first], rig.cameras[features.second]
    x, y = first.normalised_from_pixels(features.uv_first), second.normalised_from_pixels(features.uv_second)
    second_from_first = second.camera_from_world @ first.camera_from_world.inverse()
    rays, others = (np.concatenate([part, np.ones((len(part), 1))], axis=1) for part in (x, y))
    baseline = np.broadcast_to(second_from_first.translation_mm, rays.shape)
    if shift_mm is not None:
        baseline = baseline + shift_mm @ second.camera_from_world.rotation.T
    lines = np.cross(baseline, rays @ second_from_first.rotation.T)
    back = np.cross(others, baseline) @ second_from_first.rotation
    error = np.einsum("ij,ij->i", lines, others)
    slope = np.sqrt((lines[:, :2] ** 2).sum(axis=1) + (back[:, :2] ** 2).sum(axis=1))  # Sampson's
    return error / slope * np.sqrt(2.0) * float(second.matrix[1, 1]) / features.unit_px
