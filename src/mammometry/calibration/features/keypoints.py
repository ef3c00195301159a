"""Natural features that two pictures share.

SIFT (Lowe 2004) of OpenCV, on a reduced picture: enough to tell which pictures show the same thing from where.
"""

from __future__ import annotations

import cv2
import numpy as np
from scipy.special import bdtrc

from mammometry.base.photograph import Photograph
from mammometry.base.value import value
from mammometry.geometry.arrays import Array, Float32, Float64

WIDTH_PX = 450
"""Columns, about, of the reduced picture: hundreds still match, as many as of 600, in three quarters of the time."""
MOST = 1000
"""Features of a picture, the strongest: more cost time and tell no more of where it was taken."""
_CONTRAST = 0.01  # of a feature; skin is weak: OpenCV's usual 0.04 leaves a tenth of them
_COARSE_STEP = 4  # pixels to one of the reduced picture, from which on half of each row and column are left out
_RATIO = 0.8  # of the nearest to the second nearest descriptor; Lowe 2004, section 7.1

_DETERMINED_BY = 7  # matches that determine a fundamental matrix (up to three of them)
_CONSENSUS = 0.006  # distance from an epipolar line up to which a match agrees, picture widths: as of known cameras
_ATTEMPTS = 2000  # fundamental matrices that are tried
_UNLIKELY = 1e-3  # probability below which matches do not agree by chance, in all attempts together


@value(eq=False)
class Keypoints:
    """Features of one picture."""

    uv: Float64[Array, "n 2"]
    """Places in the whole picture, px, integers at pixel centres."""
    descriptors: Float32[Array, "n 128"]


def keypoints(photograph: Photograph, width_px: int = WIDTH_PX, most: int = MOST) -> Keypoints:
    """Find features in a picture reduced to about `width_px` columns, the strongest `most`."""
    pixels = photograph.pixels
    step = max(1, round(pixels.shape[1] / width_px))
    if pixels.dtype == np.uint16:
        pixels = (pixels >> 8).astype(np.uint8)
    # Green alone: 13.5 million pixels of three colours take ten times as long to reduce.
    # Of a large one every other pixel does as well.
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
    # A block's middle, of the pixels that were taken of it.
    return Keypoints(uv=(uv + 0.5) * step - 0.5 * thin, descriptors=np.asarray(descriptors, np.float32))


def matched(one: Keypoints, other: Keypoints) -> tuple[Float64[Array, "m 2"], Float64[Array, "m 2"]]:
    """Find the places, px, of features that are each other's nearest, clearly before any second.

    The second may be in either picture: the squares of a patterned board look alike, and the nearest in the other
    picture is most probably another one.
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
    """Whether matches agree on where two cameras stand, wherever that is: more than chance explains.

    So many must fit one fundamental matrix that matches by chance would not, in all the attempts at finding it
    (Moisan and Stival 2004).
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


def _nearest_of_own(points: Keypoints) -> Float32[Array, " n"]:
    """Squared distance of each feature to the one most like it in its own picture."""
    squares = _squares(points, points)
    np.fill_diagonal(squares, np.inf)
    found: Float32[Array, " n"] = squares.min(axis=1)
    return found
