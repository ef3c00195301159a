"""Natural features shared by two images: SIFT (Lowe 2004) of OpenCV on a reduced image."""

from __future__ import annotations

from functools import lru_cache

import cv2
import numpy as np
from scipy.special import bdtrc

from mammometry.base.photograph import Photograph
from mammometry.base.value import value
from mammometry.geometry.arrays import Array, Float32, Float64

WIDTH_PX = 450
"""Approximate width of the reduced image, px: as many features match as at 600 px, in three quarters of the time."""
MOST = 1000
"""Most features of an image, the strongest: more take time without more information."""
_CONTRAST = 0.01  # smallest contrast of a feature; on skin OpenCV's default 0.04 leaves a tenth of them
_COARSE_STEP = 4  # reduction factor above which only every other row and column is used
_RATIO = 0.8  # largest ratio of the nearest to the second nearest descriptor's distance; Lowe 2004, section 7.1

_DETERMINED_BY = 7  # matches that determine a fundamental matrix (up to three of them)
_CONSENSUS = 0.006  # largest distance of a match from its epipolar line, image widths
_ATTEMPTS = 2000  # number of fundamental matrices tested
_UNLIKELY = 1e-3  # probability of a chance agreement in all attempts together


@value(eq=False)
class Keypoints:
    """Features of one image."""

    uv: Float64[Array, "n 2"]
    """Positions in the full-size image, px, integers at pixel centres."""
    descriptors: Float32[Array, "n 128"]


def keypoints(photograph: Photograph, width_px: int = WIDTH_PX, most: int = MOST) -> Keypoints:
    """Find the strongest `most` features in an image reduced to about `width_px` columns."""
    pixels = photograph.pixels
    step = max(1, round(pixels.shape[1] / width_px))
    if pixels.dtype == np.uint16:
        pixels = (pixels >> 8).astype(np.uint8)
    # Only green is used: reducing three colours of 13.5 million pixels takes ten times as long. In a large image every
    # other pixel is enough.
    thin = 2 if step >= _COARSE_STEP else 1
    step = thin * (step // thin)
    green = pixels[..., 1] if pixels.ndim == 3 else pixels
    grey = np.ascontiguousarray(green[::thin, ::thin])
    height, width = (side * thin // step for side in grey.shape)
    inside = grey[: height * step // thin, : width * step // thin]
    small = cv2.resize(inside, (width, height), interpolation=cv2.INTER_AREA)
    small = cv2.createCLAHE(clipLimit=4.0, tileGridSize=(8, 8)).apply(small)
    found, descriptors = cv2.SIFT.create(nfeatures=most, contrastThreshold=_CONTRAST).detectAndCompute(small, None)
    if not found:
        return Keypoints(uv=np.empty((0, 2)), descriptors=np.empty((0, 128), np.float32))
    uv = np.array([point.pt for point in found], dtype=np.float64)
    # Centre of a block's used pixels.
    return Keypoints(uv=(uv + 0.5) * step - 0.5 * thin, descriptors=np.asarray(descriptors, np.float32))


def matched(one: Keypoints, other: Keypoints) -> tuple[Float64[Array, "m 2"], Float64[Array, "m 2"]]:
    """Match features that are each other's nearest, clearly before any second one. Returns positions, px.

    The second nearest feature is searched in both images, since the squares of a patterned board look alike.
    """
    if min(len(one.uv), len(other.uv)) < 2:
        return np.empty((0, 2)), np.empty((0, 2))
    squares = _squares(one, other)
    nearest = squares.argmin(axis=1)
    rows = np.arange(len(nearest))
    two = np.partition(squares, 1, axis=1)
    seconds = np.minimum.reduce([two[:, 1], _nearest_of_own(one), _nearest_of_own(other)[nearest]])
    good = (squares.argmin(axis=0)[nearest] == rows) & (two[:, 0] < _RATIO**2 * seconds)
    return one.uv[good], other.uv[nearest[good]]


def show_the_same(uv_one: Float64[Array, "m 2"], uv_other: Float64[Array, "m 2"]) -> bool:
    """Whether matches agree on the relative pose of two cameras better than by chance.

    More matches must fit one fundamental matrix than random matches would in all attempts (Moisan and Stival 2004).
    """
    count = len(uv_one)
    if count <= _DETERMINED_BY:
        return False
    extent = float(max(np.ptp(uv_one, axis=0).max(), np.ptp(uv_other, axis=0).max()))
    cv2.setRNGSeed(0)
    _, inside = cv2.findFundamentalMat(
        uv_one, uv_other, cv2.FM_RANSAC, _CONSENSUS * extent, confidence=0.999, maxIters=_ATTEMPTS
    )
    agreeing = 0 if inside is None else int(inside.sum())
    by_chance = float(bdtrc(agreeing - _DETERMINED_BY - 1, count - _DETERMINED_BY, 2 * _CONSENSUS))
    return _ATTEMPTS * by_chance < _UNLIKELY


def _squares(one: Keypoints, other: Keypoints) -> Float32[Array, "n m"]:
    """Squared distances between descriptors."""
    likeness = one.descriptors @ other.descriptors.T
    found: Float32[Array, "n m"] = (
        (one.descriptors**2).sum(axis=1)[:, None] + (other.descriptors**2).sum(axis=1) - 2 * likeness
    )
    return found


@lru_cache(maxsize=64)  # an image is matched with many others
def _nearest_of_own(points: Keypoints) -> Float32[Array, " n"]:
    """Squared distance of each feature to the most similar one in its own image."""
    squares = _squares(points, points)
    np.fill_diagonal(squares, np.inf)
    found: Float32[Array, " n"] = squares.min(axis=1)
    return found
