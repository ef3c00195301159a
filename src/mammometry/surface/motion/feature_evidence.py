"""Test a correction by features that cameras of different pairs share.

A correction is made from distances between pairs' surfaces, and not from features. Where pairs barely see the same
skin, both see it aslant, and matching errs alike over all of it, which looks like motion. Natural features depend on no
surface. If a correction is right, the features' distances from their epipolar lines shrink by as much as the corrected
cameras say; if nothing moved, they grow by as much.
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
"""Angle between two cameras' axes up to which they share features: with SIFT, hardly any beyond 45°."""
_WIDTHS = ((450, 1000), (1200, 3000))
"""Columns, about, of the pictures in which features are found, and features of one, the strongest. Weak skin is matched
in small ones, sharp marks are placed better in large ones."""
_FEATURE_PX = 0.5
"""Standard deviation of a feature's distance from its line, pixels of the reduced picture: .3 to .6 on clean ones."""
_ON_LINE = 3.0
"""Standard deviations within which a match lies on its line."""
_ASTRAY_PX = 16.0
"""Distances from the lines that are used, in the same pixels: matches by chance are spread evenly within."""
_BY_CHANCE = 0.3
"""Share of those matches that are by chance; up to a half."""
_COMMON_PX = np.linspace(-2.0, 2.0, 41)
"""Errors that all features of two cameras may share, in the same pixels: what the calibration leaves, and what marks on
round skin show differently from two sides."""
_COMMON_STD_PX = np.array([0.05, 0.1, 0.2, 0.4, 0.8])
"""Standard deviations of those errors over all pairs of cameras, equally likely beforehand."""
_SHARES = np.linspace(-1.0, 2.0, 61)
"""Shares of a correction that are compared: 0 is none of it, 1 all."""
_SURE = 2.0
"""Standard deviations by which the share must differ from none, or from all."""
_PARALLEL = 1e-6
"""Rays whose cosine is nearer to 1 meet nowhere."""
_FEWEST = 12
"""Fewest matches on their lines, as of photographs whose names are tested: fewer may be there by chance."""
_HALF = 0.5
"""Share from which a correction improves more than it harms."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SharedFeatures:
    """Features that two cameras share, in whole pixels of each."""

    first: str
    second: str
    uv_first: Float64[Array, "m 2"]
    uv_second: Float64[Array, "m 2"]
    unit_px: float
    """Pixels of the photographs to one of the reduced pictures in which they were found."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CorrectionEvidence:
    """What features say of a correction."""

    share: float
    """Share of the correction that explains the features best: 0 where nothing moved, 1 where it is right."""
    std: float
    """Standard deviation of that share. Infinite without features."""
    features: int
    """Number of matches that lie on their lines with that share."""

    @property
    def verdict(self) -> Verdict:
        """Whether features confirm the correction, refute it, or do not know."""
        if self.features < _FEWEST:
            return "silent"
        if self.share >= _HALF:
            return "confirmed" if self.share > _SURE * self.std else "silent"
        return "refuted" if self.share + _SURE * self.std < 1.0 else "silent"


def shared_features(rig: Rig, photographs: Mapping[str, Photograph]) -> tuple[SharedFeatures, ...]:
    """Match features between cameras of different pairs that look alike.

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
    """Weigh a correction by features that cameras share.

    Args:
        rig: as calibrated.
        corrected: the same cameras at their corrected places.
        breathed_mm: camera and points that it saw → their displacement to where a body is that did not breathe.
        shared: features of two cameras each.
    """
    log_prior = -0.5 * (_COMMON_PX / _COMMON_STD_PX[:, None]) ** 2
    log_prior -= logsumexp(log_prior, axis=1, keepdims=True)
    by_std = np.zeros((len(_COMMON_STD_PX), len(_SHARES)))
    distances = []
    for features in shared:
        before = _from_lines(rig, features)
        change = _from_lines(corrected, features, _shift_mm(rig, features, breathed_mm)) - before
        near = np.minimum(np.abs(before), np.abs(before + change)) < _ASTRAY_PX
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
    """Log likelihood of the features of two cameras, for each share of the correction and each common error."""
    sums = np.empty((len(_SHARES), len(_COMMON_PX)))
    for share, row in zip(_SHARES, sums, strict=True):
        left = before + share * change + _COMMON_PX[:, None]
        fitting = (1 - _BY_CHANCE) / (np.sqrt(2 * np.pi) * _FEATURE_PX) * np.exp(-0.5 * (left / _FEATURE_PX) ** 2)
        row[:] = np.log(fitting + _BY_CHANCE / (2 * _ASTRAY_PX)).sum(axis=1)
    return sums


def _shift_mm(rig: Rig, features: SharedFeatures, breathed_mm: Displacement) -> Float64[Array, "m 3"]:
    """Displacement of each feature between the two exposures by a breath, world axes, where both rays nearly meet."""
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
    """Distance of each match from its epipolar lines, to first order in both pictures, pixels of the reduced ones.

    Args:
        rig: the cameras.
        features: that two of them share.
        shift_mm: by how much each feature had moved on, before the first exposure as against the second.
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
